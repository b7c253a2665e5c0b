//! A folder of reference data: pictures and irradiance at points, made by another program.

use std::path::{Path, PathBuf};

use glam::Vec3;
use scene::{NONE, SurfacePoint};

use crate::error::Error;
use crate::picture::{Picture, PictureFile};

/// Irradiance at a point of a surface, with standard errors (1 σ), W/m².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReferencePoint {
    /// Position in scene units (not metres).
    pub position: Vec3,
    /// Unit normal of the side that is lit.
    pub normal: Vec3,
    /// Irradiance straight from emitters, lights and sky.
    pub direct: Vec3,
    /// Irradiance after one or more bounces.
    pub indirect: Vec3,
    /// Standard error of `direct`.
    pub direct_error: Vec3,
    /// Standard error of `indirect`.
    pub indirect_error: Vec3,
}

/// Contents of a reference folder: `full.exr`, and where they exist `direct.exr`, `indirect.exr`, `points.csv`.
#[derive(Clone, Debug)]
pub struct ReferenceData {
    /// The folder.
    pub folder: PathBuf,
    /// Radiance to the eye.
    pub full: Picture,
    /// Lights seen directly and light that reached the visible surface straight from a light.
    pub direct: Option<Picture>,
    /// The rest; full − direct where the file is missing.
    pub indirect: Option<Picture>,
    /// Irradiance at points; empty where the file is missing.
    pub points: Vec<ReferencePoint>,
}

impl ReferenceData {
    /// Reads a folder.
    ///
    /// # Errors
    /// Names the file that is missing or damaged; [`scene::Error::SizeMismatch`] when the pictures disagree.
    pub fn load(folder: &Path) -> Result<Self, Error> {
        let optional = |name: &str| {
            let path = folder.join(name);
            if path.exists() { Picture::read(&path).map(Some) } else { Ok(None) }
        };
        let full = Picture::read(&folder.join("full.exr"))?;
        let direct = optional("direct.exr")?;
        let mut indirect = optional("indirect.exr")?;
        if let (Some(direct), None) = (&direct, &indirect) {
            indirect = Some(full.minus(direct)?);
        }
        for part in [&direct, &indirect].into_iter().flatten() {
            full.check_size(part)?;
        }
        let points = folder.join("points.csv");
        let points = if points.exists() { read_points(&points)? } else { Vec::new() };
        Ok(Self { folder: folder.to_path_buf(), full, direct, indirect, points })
    }

    /// The points as the tracer takes them, in metres.
    pub fn surface_points(&self, metres_per_unit: f32) -> Vec<SurfacePoint> {
        self.points
            .iter()
            .map(|p| SurfacePoint {
                position: p.position * metres_per_unit,
                patch: NONE,
                normal: p.normal,
                weight: 1.0,
            })
            .collect()
    }

    /// Indirect irradiance at the points, W/m².
    pub fn point_indirect(&self) -> Vec<Vec3> {
        self.points.iter().map(|p| p.indirect).collect()
    }
}

/// Reads a table of points: a header with the columns `px py pz nx ny nz`, `direct_r …`, `indirect_r …`,
/// `se_indirect_r …`, `se_direct_r …` in any order, then one point a line.
///
/// # Errors
/// [`Error::Read`], or [`Error::Points`] with the line.
pub fn read_points(path: &Path) -> Result<Vec<ReferencePoint>, Error> {
    let failed = |source| Error::Read { path: path.to_path_buf(), source };
    let bytes = scene::host::read_regular(path).map_err(failed)?;
    let text = String::from_utf8(bytes).map_err(|e| failed(std::io::Error::other(e)))?;
    let failed = |line: usize, reason: String| Error::Points { path: path.to_path_buf(), line, reason };
    let mut lines = text.lines().enumerate();
    let header: Vec<&str> = lines.next().map(|(_, l)| l.split(',').map(str::trim).collect()).unwrap_or_default();
    let triple = |names: [&str; 3]| -> Result<[usize; 3], Error> {
        let mut columns = [0; 3];
        for (column, name) in columns.iter_mut().zip(names) {
            *column = header
                .iter()
                .position(|h| *h == name)
                .ok_or_else(|| failed(1, format!("the header has no column {name}")))?;
        }
        Ok(columns)
    };
    let position = triple(["px", "py", "pz"])?;
    let normal = triple(["nx", "ny", "nz"])?;
    let direct = triple(["direct_r", "direct_g", "direct_b"])?;
    let indirect = triple(["indirect_r", "indirect_g", "indirect_b"])?;
    let direct_error = triple(["se_direct_r", "se_direct_g", "se_direct_b"])?;
    let indirect_error = triple(["se_indirect_r", "se_indirect_g", "se_indirect_b"])?;
    let mut points = Vec::new();
    for (index, line) in lines.filter(|(_, l)| !l.trim().is_empty()) {
        let mut values = Vec::with_capacity(header.len());
        for field in line.split(',') {
            let value = field.trim().parse::<f32>().ok().filter(|x| x.is_finite());
            values
                .push(value.ok_or_else(|| failed(index + 1, format!("\"{}\" is not a finite number", field.trim())))?);
        }
        if values.len() != header.len() {
            return Err(failed(index + 1, format!("{} values for {} columns", values.len(), header.len())));
        }
        let vector = |columns: [usize; 3]| Vec3::from_array(columns.map(|c| values[c]));
        points.push(ReferencePoint {
            position: vector(position),
            normal: vector(normal),
            direct: vector(direct),
            indirect: vector(indirect),
            direct_error: vector(direct_error),
            indirect_error: vector(indirect_error),
        });
    }
    Ok(points)
}
