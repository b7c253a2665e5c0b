//! `patchlight scene`.

use assets::{export, procedural};
use experiments::Error;
use experiments::args::Common;
use experiments::output;

pub fn run(common: &Common, name: &str) -> Result<(), Error> {
    common.native_only("scene")?;
    let loaded = procedural::build(name)?;
    let folder = output::folder_or(&common.out, &format!("scene-{}", loaded.name));
    output::make_folder(&folder)?;
    let path = export::write_scene(&loaded, &folder)?;
    if common.json {
        println!(
            "{}",
            output::json(&serde_json::json!({ "scene": path, "triangles": loaded.scene.geometry.triangles.len() }))
        );
    } else {
        println!("{} ({} triangles)", path.display(), loaded.scene.geometry.triangles.len());
    }
    Ok(())
}
