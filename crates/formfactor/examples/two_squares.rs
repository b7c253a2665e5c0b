//! Two parallel unit squares at a distance of one metre: their form factor and its closed form, and the light between
//! them.

use std::ops::ControlFlow;

use glam::{Vec3, Vec4};
use patches::{PatchSize, SubdivideSettings, subdivide};
use patchlight_formfactor::{Contour, Polygon, Stop, form_factors, jacobi};
use scene::gpu::{Triangle, TriangleUv};
use scene::{Material, Scene, SceneParts, SidePolicy};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let half = |corner: Vec3, edge_a: Vec3, edge_b: Vec3| Triangle { corner, edge_a, edge_b, ..Triangle::default() };
    let far = Vec3::new(1.0, 1.0, 0.0);
    let triangles = vec![
        half(Vec3::ZERO, Vec3::X, Vec3::Y),
        half(far, Vec3::NEG_X, Vec3::NEG_Y),
        half(Vec3::Z, Vec3::Y, Vec3::X),
        half(Vec3::Z + far, Vec3::NEG_Y, Vec3::NEG_X),
    ];
    let uvs = vec![TriangleUv::default(); 4];
    let materials = vec![Material::default()];
    let scene = Scene::new(SceneParts { triangles, uvs, materials, ..SceneParts::default() })?;

    let settings = SubdivideSettings { size: PatchSize::Area(0.5), sides: SidePolicy::Front, ..Default::default() };
    let cut = subdivide(&scene, &settings)?;
    let polygons: Vec<Polygon> = cut.polygons()?;
    let surfaces = cut.surfaces(&scene, &polygons);
    let rows = form_factors(&Contour::default(), &surfaces, &|_, _| ControlFlow::Continue(()))?;

    // All four patches have the same area: the squares' factor is the mean of their rows' sums.
    let total: f32 = rows.factors.values.iter().sum::<f32>() / 4.0;
    println!("form factor {total:.6}, closed form 0.199825");

    let lower_shines: Vec<Vec4> = cut.patches.iter().map(|p| Vec4::splat(f32::from(p.normal.z > 0.0))).collect();
    let light = jacobi(&rows.factors, &lower_shines, &[Vec4::splat(0.5); 4], Stop::Tolerance(1e-6))?;
    println!("irradiance {:?} W/m² after {} bounces", light.irradiance, light.iterations);
    Ok(())
}
