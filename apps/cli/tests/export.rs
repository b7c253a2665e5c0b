//! `patchlight export`: files that other programs read.

mod program;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use program::{fails, run, succeeds, text};
use reference::PictureFile as _;
use scene::Picture;

#[test]
fn light_in_files_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let printed = succeeds(&[
        "export",
        "cornell",
        "--vertices",
        "--lightmap",
        "--probes",
        "--volume",
        "--texel",
        "0.1",
        "--probe-count",
        "27",
        "--patch-count",
        "150",
        "--out",
        out.to_str().unwrap(),
        "--quiet",
        "--json",
    ]);
    let names =
        ["vertices.gltf", "vertices.ply", "lightmap.gltf", "lightmap.exr", "probes.json", "probes.bin", "volume.ktx2"];
    let sizes: BTreeMap<&str, u64> =
        names.iter().map(|name| (*name, fs::metadata(out.join(format!("cornell-{name}"))).unwrap().len())).collect();
    assert!(sizes.values().all(|&bytes| bytes > 100), "{sizes:?}");
    assert!(names.iter().all(|name| printed.contains(name)));

    // Both glTF files hold all sides, where they were.
    let whole = assets::procedural::build("cornell").unwrap();
    for name in ["vertices", "lightmap"] {
        let read = assets::import::load(&out.join(format!("cornell-{name}.gltf"))).unwrap();
        assert!(read.scene.geometry.triangles.len() >= whole.scene.geometry.triangles.len(), "{name}");
        let a = read.scene.geometry.bounds;
        let b = whole.scene.geometry.bounds;
        assert!(a.0.distance(b.0) + a.1.distance(b.1) < 1e-4, "{name}: {a:?} {b:?}");
    }
    let picture = Picture::read(&out.join("cornell-lightmap.exr")).unwrap();
    let lit = picture.pixels.iter().filter(|pixel| pixel.min_element() > 0.0).count();
    assert!(lit > picture.pixels.len() / 3 && picture.pixels.iter().all(|pixel| pixel.is_finite()));
    // The coordinates are in the file, and lead to texels with light.
    let (gltf, buffers, _) = gltf::import(out.join("cornell-lightmap.gltf")).unwrap();
    let mut corners = 0;
    for primitive in gltf.meshes().flat_map(|mesh| mesh.primitives()) {
        let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(|data| &data.0[..]));
        for [u, v] in reader.read_tex_coords(1).unwrap().into_f32() {
            let x = ((u * picture.width as f32) as u32).min(picture.width - 1);
            let y = ((v * picture.height as f32) as u32).min(picture.height - 1);
            assert!((0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v));
            corners += u32::from(picture.pixels[(x + picture.width * y) as usize].max_element() > 0.0);
        }
    }
    assert!(corners > 60, "{corners}");
    let description = fs::read_to_string(out.join("cornell-probes.json")).unwrap();
    let binary = fs::read(out.join("cornell-probes.bin")).unwrap();
    assert!(!patchlight::outputs::ProbeVolume::from_files(&description, &binary).unwrap().is_empty());
}

#[test]
fn what_cannot_apply_is_refused_and_frames_have_folders() {
    for (options, said) in [
        (&["export", "cornell"][..], "--vertices"),
        (&["export", "cornell", "--vertices", "--texel", "0.1"], "--lightmap"),
        (&["export", "cornell", "--lightmap", "--texel", "0"], "--texel"),
        (&["export", "cornell", "--vertices", "--probe-count", "8"], "--probes"),
    ] {
        let message = fails(2, options);
        assert!(message.contains(said), "{options:?}: {message}");
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let tiny = fails(
        1,
        &["export", "cornell", "--lightmap", "--texel", "1e-5", "--patch-count", "60", "--out", out.to_str().unwrap()],
    );
    assert!(tiny.contains("texels"), "{tiny}");
    succeeds(&[
        "export",
        "cornell",
        "--vertices",
        "--indirect",
        "--frames",
        "3",
        "--patch-count",
        "60",
        "--out",
        out.to_str().unwrap(),
        "--quiet",
    ]);
    let of = |frame: &str| fs::read(out.join(frame).join("cornell-vertices.bin")).unwrap();
    assert!(of("frame-0000") != of("frame-0001"), "the light does not move");
}

#[test]
fn a_bake_gives_the_files_that_its_scene_gives() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    succeeds(&["bake", "cornell", "--patch-count", "60", "--for", "classic", "--quiet", "--out", &path("c.bake")]);
    let export = |of: &str, more: &[&str], out: &str| {
        let all = ["export", of, "--lightmap", "--vertices", "--texel", "0.2", "--quiet", "--out", out];
        succeeds(&[&all, more].concat());
    };
    export("cornell", &["--patch-count", "60"], &path("scene"));
    export(&path("c.bake"), &[], &path("bake"));
    export("cornell", &["--patch-count", "90"], &path("other"));
    let read = |folder: &str, name: &str| fs::read(format!("{}/{name}", path(folder))).unwrap();
    for name in ["cornell-lightmap.exr", "cornell-vertices.bin", "cornell-vertices.ply"] {
        assert!(read("scene", name) == read("bake", name), "{name} differs");
        assert!(read("scene", name) != read("other", name), "{name} of other patches is the same");
    }
}

/// Positions and lightmap coordinates of all corners of a glTF file, and its lightmap.
fn atlas(folder: &Path, name: &str) -> (Vec<[f32; 5]>, Picture) {
    let (gltf, buffers, _) = gltf::import(folder.join(format!("{name}-lightmap.gltf"))).unwrap();
    let mut corners = Vec::new();
    for primitive in gltf.meshes().flat_map(|mesh| mesh.primitives()) {
        let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(|data| &data.0[..]));
        let uvs = reader.read_tex_coords(1).unwrap().into_f32();
        corners.extend(reader.read_positions().unwrap().zip(uvs).map(|([x, y, z], [u, v])| [x, y, z, u, v]));
    }
    (corners, Picture::read(&folder.join(format!("{name}-lightmap.exr"))).unwrap())
}

#[test]
fn an_atlas_of_the_file_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let export = |of: &Path, out: &str| {
        let out = path(out);
        let arguments = ["--lightmap", "--texel", "0.2", "--patch-count", "60", "--quiet", "--out"];
        succeeds(&[&["export", of.to_str().unwrap()][..], &arguments, &[out.to_str().unwrap()]].concat())
    };
    export(Path::new("cornell"), "first");
    // A scene with that atlas, whose materials do not use it.
    let file = path("first/cornell-lightmap.gltf");
    let mut json: serde_json::Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    for material in json["materials"].as_array_mut().unwrap() {
        material["pbrMetallicRoughness"].as_object_mut().unwrap().remove("baseColorTexture");
    }
    let scene = path("first/room.gltf");
    fs::write(&scene, json.to_string()).unwrap();
    export(&scene, "second");
    let first = atlas(&path("first"), "cornell").0;
    let second = atlas(&path("second"), "room");
    assert!(second.0.len() > 60);
    let is_in = |corner: &[f32; 5], shift: f32| {
        let near = |other: &[f32; 5]| corner.iter().zip(other).all(|(a, b)| (a + shift - b).abs() < 1e-4);
        first.iter().any(near)
    };
    assert!(second.0.iter().all(|corner| is_in(corner, 0.0)) && !second.0.iter().all(|corner| is_in(corner, 0.01)));
    assert_eq!(second.1.width, second.1.height);
    // From a bake it is the same; an atlas in which triangles lie on each other is not taken, with a warning.
    let bake = path("room.bake");
    let of = scene.to_str().unwrap();
    let to = bake.to_str().unwrap();
    succeeds(&["bake", of, "--patch-count", "60", "--for", "classic", "--quiet", "--out", to]);
    export(&bake, "third");
    let third = atlas(&path("third"), "room");
    assert!(third.0 == second.0 && third.1 == second.1);
    let uv = json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"].as_u64().unwrap() as usize;
    let view = &json["bufferViews"][json["accessors"][uv]["bufferView"].as_u64().unwrap() as usize];
    let first = view["byteOffset"].as_u64().unwrap() as usize;
    let length = view["byteLength"].as_u64().unwrap() as usize;
    let binary = path("first/cornell-lightmap.bin");
    let mut bytes = fs::read(&binary).unwrap();
    bytes.copy_within(first..first + length / 2, first + length / 2);
    fs::write(&binary, bytes).unwrap();
    let arguments = ["--lightmap", "--texel", "0.2", "--patch-count", "60", "--out"];
    let output = run(&[&["export", of][..], &arguments, &[path("fourth").to_str().unwrap()]].concat());
    let warned = text(&output.stderr);
    assert!(output.status.success(), "{warned}");
    assert!(warned.contains("TEXCOORD_1") && warned.contains("same place in the atlas"), "{warned}");
}
