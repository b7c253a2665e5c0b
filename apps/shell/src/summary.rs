//! `summary.json`: what a command measured. Absent parts are left out, never zero.

use std::collections::BTreeMap;

use patchlight::EnergyCheck;
use reference::metrics::{PictureErrors, PointErrors};
use serde::{Deserialize, Serialize};

/// Time of one pass over all frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PassTimes {
    /// Median, ms.
    pub median_ms: f64,
    /// Greatest, ms.
    pub max_ms: f64,
}

impl PassTimes {
    /// Median and maximum of one time a frame, or nothing for no frames.
    pub fn of(times: &[f64]) -> Option<Self> {
        let mut sorted = times.to_vec();
        sorted.sort_by(f64::total_cmp);
        Some(Self { median_ms: *sorted.get(sorted.len() / 2)?, max_ms: *sorted.last()? })
    }
}

/// Whole light updates: from "a light has moved" to irradiance at every visible point.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LightUpdate {
    /// Median over the frames, ms.
    pub median_ms: f64,
    /// Greatest, ms.
    pub max_ms: f64,
    /// Time of each frame, ms: all its passes but those of the pixels.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frames_ms: Vec<f64>,
    /// Receivers whose light the last update found.
    pub visible_receivers: usize,
    /// Interpolation points likewise.
    pub visible_points: usize,
    /// Bytes of all that frames hold beside the scene.
    pub bytes: u64,
}

/// Photons of the last frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PhotonCounts {
    /// Photons that were started.
    pub photons: u64,
    /// Photon hits of indirect light.
    pub registered: u64,
    /// Segments traced.
    pub segments: u64,
    /// Relative error of the patches' irradiance, by the photons' own account.
    pub relative_error: f64,
}

impl PhotonCounts {
    /// Summary of the last round.
    pub fn of(round: &firstshot::Round) -> Self {
        let firstshot::Round { photons, registered, segments, error } = *round;
        // An error that is not known is 1: nothing but noise. Infinity is no number of JSON.
        Self { photons, registered, segments, relative_error: if error.is_finite() { error } else { 1.0 } }
    }
}

/// Measurements of a command.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the scene.
    pub scene: String,
    /// Name of the method.
    pub method: String,
    /// Storage of the operator of all bounces, where that was chosen.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub codec: Option<String>,
    /// Decoder of its texture blocks, where it has any: `texture` unit or `kernel`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decode: Option<&'static str>,
    /// Device that ran the kernels.
    pub device: String,
    /// Patches.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patches: Option<usize>,
    /// Points that receive it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub receivers: Option<usize>,
    /// Photons traced, where photons carry the light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photons: Option<PhotonCounts>,
    /// Frames rendered.
    pub frames: u32,
    /// Seed of the random numbers.
    pub seed: u32,
    /// Time a frame of each pass: direct, gather, method, lookup, shade.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub passes: BTreeMap<String, PassTimes>,
    /// Whole light updates.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_update: Option<LightUpdate>,
    /// Seconds of each phase before the first frame.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub bake: BTreeMap<String, f64>,
    /// The bake's estimate of its own errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub energy: Option<EnergyCheck>,
    /// Greatest resident memory of the process.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peak_memory_bytes: Option<u64>,
    /// Bytes of each part.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub bytes: BTreeMap<String, u64>,
    /// Errors of the picture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub full: Option<PictureErrors>,
    /// Errors of its indirect part.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub indirect: Option<PictureErrors>,
    /// Errors of the indirect irradiance at points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<PointErrors>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absent_parts_are_left_out() {
        let text = serde_json::to_string(&Summary { scene: "a".into(), ..Summary::default() }).unwrap();
        assert_eq!(text, r#"{"scene":"a","method":"","device":"","frames":0,"seed":0}"#);
        assert_eq!(PassTimes::of(&[]), None);
        assert_eq!(PassTimes::of(&[3.0, 1.0, 2.0]), Some(PassTimes { median_ms: 2.0, max_ms: 3.0 }));
    }
}
