//! How a light update grows with patches, receivers, triangles and lights.

use std::sync::Arc;

use glam::Vec3;
use patchlight::renderer::ReceiverUpdate;
use patchlight::{Bake, BakeSettings, Renderer};
use scene::math::sin_cos_2pi;
use scene::sampling::{hash3, unit};
use scene::{Camera, LIGHT_POINT, Light};

use super::{Event, Measuring, Named, Row, TILES};
use crate::bench::{load, suited_settings};
use crate::error::Error;
use crate::output;
use crate::report::{Plot, Series};

/// Patches of the curve over them.
pub const COUNTS: [u32; 4] = [1000, 2000, 4000, 8000];
/// Patches of the other curves, at most: no more than the most of that one.
const COUNT: u32 = 2000;
/// Scenes of the curve over triangles.
const SCENES: [&str; 3] = ["atrium:30000", "atrium:100000", "atrium:300000"];
/// Lamps of the curve over lights.
const LAMPS: [u32; 4] = [1, 4, 16, 64];
/// The lamps stand in this middle part of the scene, and move by this part of it in a frame.
const INNER: f32 = 0.8;
const STEP: f32 = 0.01;

/// All curves; each row says which it belongs to.
pub fn measure(
    measuring: &Measuring,
    counts: &[u32],
    keep: &mut dyn FnMut(Row) -> Result<(), Error>,
) -> Result<(), Error> {
    let Measuring { common, args, loaded, progress } = *measuring;
    for &count in counts {
        let settings = suited_settings(common, args, loaded, count as usize);
        keep(measuring.point("patches", &settings)?)?;
    }
    let count = counts.iter().copied().max().unwrap_or(COUNT).min(COUNT) as usize;
    let settings = suited_settings(common, args, loaded, count);
    for &receiver_density in &args.densities {
        keep(measuring.point("receivers", &BakeSettings { receiver_density, ..settings })?)?;
    }
    let mut renderer = measuring.renderer(&settings)?;
    for lamps in LAMPS {
        let named = Named { method: TILES, event: Event::Move.name(), receivers: ReceiverUpdate::InView };
        let row = measuring.measured(&mut renderer, &named, &|number| measuring.lamps(lamps, number))?;
        keep(Row { curve: Some("lights"), ..row })?;
    }
    drop(renderer);
    for scene in SCENES {
        let loaded = output::import(scene, progress)?;
        let measuring = Measuring { loaded: &loaded, ..*measuring };
        keep(measuring.point("triangles", &suited_settings(common, args, &loaded, count))?)?;
    }
    Ok(())
}

impl Measuring<'_> {
    fn renderer(&self, settings: &BakeSettings) -> Result<Renderer, Error> {
        let Self { common, loaded, progress, .. } = *self;
        let bake = Arc::new(Bake::build(&loaded.scene, settings, progress)?);
        load(common, &bake, &self.render_settings(), progress)
    }

    /// A point of a curve.
    fn point(&self, curve: &'static str, settings: &BakeSettings) -> Result<Row, Error> {
        let row = self.frames(&mut self.renderer(settings)?, TILES, Event::Move, ReceiverUpdate::InView)?;
        Ok(Row { curve: Some(curve), ..row })
    }

    /// Point lamps all over the scene that go round in circles, as bright together as one of 1 kW/sr.
    fn lamps(&self, count: u32, number: u32) -> (Vec<Light>, Camera) {
        let (low, high) = self.loaded.scene.geometry.bounds;
        let (middle, half) = ((low + high) * 0.5, (high - low) * (0.5 * INNER));
        let lamp = |k: u32| {
            let place = Vec3::from_array([0, 1, 2].map(|axis| 2.0 * unit(hash3(k, axis, 0x6c61_6d70)) - 1.0));
            let (sin, cos) = sin_cos_2pi(number as f32 / self.args.frames() as f32);
            let way = Vec3::new(cos, 0.0, sin) * STEP;
            let color = Vec3::splat(1e3 / count as f32);
            Light { position: middle + (place + way) * half, kind: LIGHT_POINT, color, ..Light::default() }
        };
        let size = self.args.size();
        ((0..count).map(lamp).collect(), self.loaded.view.camera(size.0, size.1))
    }
}

/// What a curve is over.
type Size = fn(&Row) -> usize;

/// The curves as plots.
pub fn plots(rows: &[Row]) -> Vec<Plot> {
    let curves: [(&str, Size); 4] = [
        ("patches", |row| row.patches),
        ("receivers", |row| row.receivers),
        ("triangles", |row| row.triangles),
        ("lights", |row| row.lights),
    ];
    let plot = |(name, size): (&str, Size)| {
        let of_curve: Vec<&Row> = rows.iter().filter(|row| row.curve == Some(name)).collect();
        let line = |series: &str, value: &dyn Fn(&Row) -> f64| Series {
            name: series.to_owned(),
            points: of_curve.iter().map(|row| (size(row) as f64, value(row))).collect(),
        };
        let mut series = vec![line("light update", &|row| row.light_update.median_ms)];
        for pass in ["direct", "method", "lookup", "view"] {
            series.push(line(pass, &|row| row.passes.get(pass).copied().unwrap_or(0.0)));
        }
        let title = format!("A light update over {name}");
        (!of_curve.is_empty()).then(|| Plot { title, unit: "ms".into(), x: name.into(), logarithmic: false, series })
    };
    curves.into_iter().filter_map(plot).collect()
}
