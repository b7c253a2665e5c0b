//! Registered photons as files: a table of the patches, the mesh with the light of its corners, the maps.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use firstshot::PhotonAccumulator;
use glam::{Vec2, Vec3};
use patches::PatchMesh;
use patchlight::method::firstshot::FirstShot;
use reference::file::write_whole;
use reference::{Picture, PictureFile as _, Precision};
use scene::Scene;

use shell::Error;

/// Texels of a row of the maps' picture.
const MAP_WIDTH: usize = 1024;

/// Writes into a folder that exists: `patches.csv` (centroid, normal, area, indirect irradiance and the standard
/// error of its luminance), `vertices.ply` (each triangle
/// with its own corners, metres, and their indirect irradiance on the front and on the back), `maps.exr` (indirect
/// irradiance of the cells of the illumination maps, cell k in column k mod 1024 of row k / 1024) and `maps.csv`
/// (object and number in its file of each triangle, its divisions n and first cell: n² on the front, in rows of equal
/// v, then n² on the back).
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_files(shot: &FirstShot, scene: &Scene, mesh: &PatchMesh, folder: &Path) -> Result<(), Error> {
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        write_whole(&path, |file| {
            file.write_all(bytes).map_err(|source| reference::Error::Write { path: path.clone(), source })
        })
    };
    let mut text = String::from("x,y,z,nx,ny,nz,area,indirect_r,indirect_g,indirect_b,standard_error\n");
    for light in shot.patch_light(mesh) {
        let c = light.patch.centroid;
        let n = light.patch.normal;
        let h = light.irradiance;
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{},{},{},{}",
            c.x, c.y, c.z, n.x, n.y, n.z, light.patch.area, h.x, h.y, h.z, light.error
        );
    }
    write("patches.csv", text.as_bytes())?;
    write("vertices.ply", &ply(shot, scene)?)?;

    let (maps, estimate) = shot.cells();
    let mut text = String::from("triangle,object,source,divisions,first_cell\n");
    for (k, (t, grid)) in scene.geometry.triangles.iter().zip(&maps.grids).enumerate() {
        let _ = writeln!(text, "{k},{},{},{},{}", t.object, t.source, grid.divisions, grid.first);
    }
    write("maps.csv", text.as_bytes())?;
    let rows = maps.areas().len().div_ceil(MAP_WIDTH).max(1);
    let mut pixels = estimate.irradiance.clone();
    pixels.resize(rows * MAP_WIDTH, Vec3::ZERO);
    let picture = Picture::from_pixels(MAP_WIDTH as u32, rows as u32, pixels)?;
    picture.write_exr(&folder.join("maps.exr"), Precision::Half)?;
    Ok(())
}

/// The mesh as binary PLY.
fn ply(shot: &FirstShot, scene: &Scene) -> Result<Vec<u8>, Error> {
    let (maps, estimate) = shot.cells();
    let light = if estimate.irradiance.is_empty() { vec![Vec3::ZERO; maps.len()] } else { estimate.irradiance.clone() };
    let corners = maps.corner_irradiance(scene, &light)?;
    let names = ["x", "y", "z", "front_r", "front_g", "front_b", "back_r", "back_g", "back_b"];
    let count = scene.geometry.triangles.len();
    let mut text = format!(
        "ply\nformat binary_little_endian 1.0\ncomment indirect irradiance, W/m2\nelement vertex {}\n",
        3 * count
    );
    for name in names {
        let _ = writeln!(text, "property float {name}");
    }
    let _ = write!(text, "element face {count}\nproperty list uchar uint vertex_indices\nend_header\n");
    let mut bytes = text.into_bytes();
    let geometry = scene.tables();
    for (t, [front, back]) in (0u32..).zip(&corners) {
        for (at, (front, back)) in [Vec2::ZERO, Vec2::X, Vec2::Y].into_iter().zip(front.iter().zip(back)) {
            for v in [geometry.position(t, at.x, at.y), *front, *back] {
                v.to_array().iter().for_each(|x| bytes.extend(x.to_le_bytes()));
            }
        }
    }
    for t in 0..count as u32 {
        bytes.push(3);
        (3 * t..3 * t + 3).for_each(|k| bytes.extend(k.to_le_bytes()));
    }
    Ok(bytes)
}
