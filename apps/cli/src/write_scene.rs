//! `patchlight scene`.

use assets::{export, procedural};
use shell::Error;
use shell::args::Common;
use shell::output;
use shell::progress::{interruptible, is_cancelled};

pub fn run(common: &Common, name: &str) -> Result<(), Error> {
    common.native_only("scene")?;
    output::check_out(&common.out)?;
    let loaded = interruptible(|| procedural::build(name))?;
    let folder = output::folder_or(&common.out, &format!("scene-{}", loaded.name));
    let files = interruptible(|| export::SceneFiles::of(&loaded, &folder))?;
    let Some(path) = files.write(&|| !is_cancelled())? else { return Err(Error::Cancelled) };
    if common.json {
        say!(
            "{}",
            output::json(&serde_json::json!({ "scene": path, "triangles": loaded.scene.geometry.triangles.len() }))
        );
    } else {
        say!("{} ({} triangles)", path.display(), loaded.scene.geometry.triangles.len());
    }
    Ok(())
}
