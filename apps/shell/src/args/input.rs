//! Inputs of commands.

use std::io::Read as _;
use std::path::Path;

use patchlight::file::{BakeKind, HEAD_BYTES, kind_of};

/// Kind of file or folder under a name that a command is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// A scene file, or a built-in scene.
    Scene,
    /// The bake of a scene, or what claims to be one by its name.
    Bake,
    /// The bake of a world.
    World,
}

impl Input {
    /// Bakes are known by their first bytes, and by their name where these say nothing.
    pub fn of(path: &str) -> Self {
        let is_named = Path::new(path).extension().is_some_and(|ending| ending.eq_ignore_ascii_case("bake"));
        match kind(Path::new(path)) {
            Some(BakeKind::World) => Self::World,
            Some(BakeKind::Scene) => Self::Bake,
            None if is_named => Self::Bake,
            None => Self::Scene,
        }
    }
}

/// Kind of bake in a file, if any.
pub fn kind(path: &Path) -> Option<BakeKind> {
    let mut head = Vec::new();
    scene::host::open_regular(path).ok()?.take(HEAD_BYTES).read_to_end(&mut head).ok()?;
    kind_of(&head)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bakes_are_known_by_their_bytes_then_by_their_name() {
        let folder = tempfile::tempdir().unwrap();
        let input = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            Input::of(path.to_str().unwrap())
        };
        assert_eq!(input("a", b"PLBAKE\r\n\x01\0\0\0"), Input::World);
        assert_eq!(input("b.toml", b"PLBAKE\r\n\x02\0\0\0"), Input::Bake);
        assert_eq!(input("c.BAKE", b""), Input::Bake);
        assert_eq!(input("d.toml", b"version = 1"), Input::Scene);
        assert_eq!((Input::of("no such.bake"), Input::of("bake")), (Input::Bake, Input::Scene));
    }
}
