//! A method of one's own: each patch receives the mean exitance of the scene, as an "ambient" term does. Beside classic
//! radiosity, which knows who sees whom.

use std::sync::Arc;

use patchlight::{
    Bake, BakeSettings, FramePlan, LightField, LightSettings, Method, MethodReport, PictureRenderer, PictureSettings,
    Result, Silent,
};
use runtime::cpu::Cpu;
use runtime::recipe::formfactor::SparseTables;
use transport::Csr;

/// `H_i = Σ_j (a_j / a) E_j` for every patch i.
struct Ambient(Arc<Csr>);

impl Ambient {
    fn new(bake: &Bake) -> Self {
        let areas = bake.mesh().areas();
        let all: f32 = areas.iter().sum();
        let n = areas.len();
        let row_start = (0..=n).map(|i| (i * n) as u32).collect();
        let column_index = (0..n * n).map(|k| (k % n) as u32).collect();
        let values = (0..n * n).map(|k| areas[k % n] / all).collect();
        Self(Arc::new(Csr { rows: n, columns: n, row_start, column_index, values }))
    }
}

impl Method for Ambient {
    fn add_passes(&mut self, frame: &mut FramePlan) -> Result<()> {
        let rows = SparseTables::new(&mut frame.plan, &mut frame.tables, "ambient", &self.0);
        rows.gather(&mut frame.plan, "method", frame.patches.source, frame.patches.irradiance)?;
        frame.bounce()?;
        Ok(())
    }

    fn report(&self) -> MethodReport {
        MethodReport::default()
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let loaded = assets::load_or_build("cornell")?;
    let settings = BakeSettings::default().with_patch_count(300);
    let bake = Arc::new(Bake::build(&loaded.scene, &settings, &Silent)?);
    let light = LightSettings::default();
    let pictures = PictureSettings::default().with_size((80, 60)).with_sub_frames(1);
    let camera = loaded.view.camera(80, 60);
    let ambient = Box::new(Ambient::new(&bake));
    let ours = LightField::with_method(Arc::clone(&bake), Box::new(Cpu::new()), &light, ambient)?;
    let mut ours = PictureRenderer::new(ours, &pictures)?;
    let mut classic = PictureRenderer::of_bake(bake, Box::new(Cpu::new()), &light, &pictures, &Silent)?;
    for (name, renderer) in [("ambient", &mut ours), ("classic", &mut classic)] {
        let picture = renderer.picture(&loaded.scene.lighting, &camera, 0)?;
        println!("{name:8} mean indirect radiance {:.4}", picture.pictures.indirect.mean());
    }
    Ok(())
}
