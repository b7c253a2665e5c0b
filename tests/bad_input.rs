//! Every bad scene is refused, or repaired with a warning, in words that name the file, the place and the remedy; no
//! bytes whatever make the import panic.

use std::path::Path;

use assets::import::{LoadOptions, LoadedScene, load, load_or_build, load_with};
use integration_tests::glb::glb;
use integration_tests::mutate::{Corpus, Outcome};
use scene::sampling::hash3;
use tempfile::TempDir;

const OBJ: &str = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\n\
                   o wall\nusemtl m\nf 1/1 2/2 3/3\nf 1/1 3/3 4\n";
const MTL: &str = "newmtl m\nKd 0.5 0.25 0.125\nKe 1 1 1\nmap_Kd t.png\n";
const TOML: &str = "version = 1\nmesh = \"a.obj\"\nmetres_per_unit = 0.5\n\n[camera]\neye = [0, 0, 3]\ntarget = [0.0, 0.0, 0.0]\n\n\
                    [[light]]\ntype = \"directional\"\ndirection = [0.0, -1.0, 0.0]\nirradiance = [1.0, 1.0, 1.0]\n";

fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let folder = TempDir::new().expect("a temporary folder");
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes).expect("a temporary file");
    }
    folder
}

fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_fn(width, height, |x, y| image::Rgb([(x * 40) as u8, (y * 40) as u8, 90]))
        .write_to(&mut bytes, image::ImageFormat::Png)
        .expect("a PNG in memory");
    bytes.into_inner()
}

/// The message of a scene that must be refused.
fn refusal(path: &Path) -> String {
    match load(path) {
        Ok(_) => panic!("{} was accepted", path.display()),
        Err(e) => e.to_string(),
    }
}

fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "\"{part}\" is missing in: {message}");
    }
}

fn refused(name: &str, bytes: &[u8], parts: &[&str]) {
    let folder = folder(&[("a.obj", OBJ.as_bytes()), ("a.mtl", MTL.as_bytes()), ("t.png", &png(2, 2)), (name, bytes)]);
    let message = refusal(&folder.path().join(name));
    assert_says(&message, &[name]);
    assert_says(&message, parts);
}

fn accepted(files: &[(&str, &[u8])], name: &str) -> (LoadedScene, TempDir) {
    let folder = folder(files);
    let scene = load(&folder.path().join(name)).unwrap_or_else(|e| panic!("{e}"));
    (scene, folder)
}

fn assert_one_warning(scene: &LoadedScene, parts: &[&str]) {
    let fits = |w: &&String| parts.iter().all(|p| w.contains(p));
    assert_eq!(scene.warnings.iter().filter(fits).count(), 1, "{parts:?} in {:?}", scene.warnings);
}

/// A triangle with its corner at this place on all axes, and edges this long, m.
fn triangle_at(corner: f32, edge: f32) -> String {
    let far = corner + edge;
    format!("v {corner} {corner} {corner}\nv {far} {corner} {corner}\nv {corner} {far} {corner}\nf 1 2 3\n")
}

#[test]
fn sizes_that_rays_cannot_resolve_are_refused_with_a_remedy() {
    refused("tiny.obj", triangle_at(0.0, 1e-5).as_bytes(), &["1.4142135e-5 m across", "metres_per_unit"]);
    refused("far.obj", triangle_at(1e6, 1.0).as_bytes(), &["1.000001e6 m", "steps", "nearer to the origin"]);
    let (near, _) = accepted(&[("near.obj", triangle_at(1e4, 1.0).as_bytes())], "near.obj");
    assert_one_warning(&near, &["near.obj", "steps", "nearer to the origin"]);
    for (corner, edge) in [(0.0, 1.0), (0.0, 0.01), (1e6, 1e6)] {
        let (good, _) = accepted(&[("good.obj", triangle_at(corner, edge).as_bytes())], "good.obj");
        assert!(!good.warnings.iter().any(|warning| warning.contains("steps")), "{corner} {edge}");
    }
}

#[test]
fn what_is_no_file_is_refused_with_a_remedy() {
    let folder = folder(&[("empty.obj", b""), ("a.xyz", b"x")]);
    assert_says(&refusal(&folder.path().join("none.toml")), &["none.toml", "cannot be read", "give the path"]);
    assert_says(&refusal(folder.path()), &["is a folder", "give the scene file"]);
    assert_says(&refusal(&folder.path().join("empty.obj")), &["empty.obj", "is empty", "complete file"]);
    assert_says(&refusal(&folder.path().join("a.xyz")), &["a.xyz", "ending", ".toml, .obj, .gltf or .glb"]);
    std::fs::create_dir(folder.path().join("b.obj")).expect("a folder");
    assert_says(&refusal(&folder.path().join("b.obj")), &["b.obj", "is a folder"]);
    let error = load_or_build("atrium:many").err().map(|e| e.to_string()).unwrap_or_default();
    assert_says(&error, &["atrium:many", "not a number of triangles", "give"]);
    assert_says(
        &load_or_build("no-such-scene").err().map(|e| e.to_string()).unwrap_or_default(),
        &["no-such-scene", "give"],
    );
}

#[cfg(unix)]
#[test]
fn an_unreadable_file_is_refused() {
    use std::os::unix::fs::PermissionsExt;
    let folder = folder(&[("a.obj", OBJ.as_bytes())]);
    let path = folder.path().join("a.obj");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o000)).expect("permissions");
    if std::fs::read(&path).is_ok() {
        println!("skipped: this user may read everything");
        return;
    }
    assert_says(&refusal(&path), &["a.obj", "cannot be read", "may read"]);
}

#[test]
fn scene_files_are_refused_with_line_and_key() {
    let with = |from: &str, to: &str| TOML.replace(from, to).into_bytes();
    refused("s.toml", &with("metres_per_unit", "meters_per_unit"), &["line 3", "meters_per_unit", "metres_per_unit"]);
    refused("s.toml", &with("irradiance", "iradiance"), &["line 12", "iradiance"]);
    refused("s.toml", &with("version = 1", "version = 2"), &["line 1", "version 2", "version = 1"]);
    refused("s.toml", &with("version = 1", "# none"), &["version", "version = 1"]);
    refused("s.toml", &with("version = 1", "version = \"one\""), &["line 1", "version \"one\""]);
    refused("s.toml", &with("0.5", "-1.0"), &["line 3", "metres_per_unit", "above 0"]);
    refused("s.toml", &with("0.5", "nan"), &["line 3", "metres_per_unit", "finite"]);
    refused("s.toml", &with("0.5", "\"half\""), &["line 3", "f32"]);
    refused("s.toml", &with("a.obj", "b.obj"), &["b.obj", "does not exist", "correct the key `mesh`"]);
    refused("s.toml", &with("eye = [0, 0, 3]", "eye = [0, 0, 0]"), &["line 5", "same point", "move"]);
    refused("s.toml", &with("eye = [0, 0, 3]", "eye = [0, 3, 0]"), &["line 5", "up", "another up"]);
    refused("s.toml", &with("eye = [0, 0, 3]", "eye = [0, 0]"), &["line 6"]);
    refused("s.toml", &with("[0.0, -1.0, 0.0]", "[0.0, 0.0, 0.0]"), &["line 9", "light 1, direction", "not all 0"]);
    refused("s.toml", &with("[1.0, 1.0, 1.0]", "[1.0, -1.0, 1.0]"), &["light 1, irradiance", "not negative"]);
    refused(
        "s.toml",
        &with("\"directional\"", "\"laser\""),
        &["light 1, type", "laser", "directional, point, spot, rect or luminaire"],
    );
    refused("s.toml", &with("irradiance = [1.0, 1.0, 1.0]", ""), &["irradiance", "is missing"]);
    refused(
        "s.toml",
        &with("irradiance =", "position = [0.0, 0.0, 0.0]\nirradiance ="),
        &["position", "does not belong"],
    );
    refused("s.toml", &TOML.as_bytes()[..TOML.len() - 20], &["line 12"]);
    refused("s.toml", &[TOML.as_bytes(), b"\n[sky]\n"].concat(), &["sky", "radiance", "map"]);
}

#[test]
fn a_sky_that_is_no_picture_is_refused() {
    for map in ["a.mtl", "none.hdr"] {
        let toml = format!("{TOML}\n[sky]\nmap = \"{map}\"\n");
        let folder = folder(&[("a.obj", OBJ.as_bytes()), ("a.mtl", MTL.as_bytes()), ("s.toml", toml.as_bytes())]);
        assert_says(&refusal(&folder.path().join("s.toml")), &[map, "cannot be used as a sky", "equirectangular"]);
    }
}

#[test]
fn a_luminaire_that_is_no_photometry_is_refused() {
    let endless =
        [b"IESNA:LM-63-2002\nTILT=NONE\n1 -1 1 2 1 1 2 0 0 0 1 1 0\n0 90 0 1 1 ", &[b'9'; 17 << 20][..]].concat();
    let files: [(&str, &[u8]); 5] = [
        ("a.obj", OBJ.as_bytes()),
        ("a.mtl", MTL.as_bytes()),
        ("empty.ies", b""),
        ("endless.ies", &endless),
        ("latin.ldt", b"M\xfcller\n1\n"),
    ];
    for (file, parts) in [
        ("a.obj", &["a.obj, line 1", "give an .ies or .ldt file"][..]),
        ("none.ies", &["none.ies", "cannot be read"]),
        ("empty.ies", &["empty.ies", "is empty"]),
        ("endless.ies", &["endless.ies", "larger than 16 MB"]),
        ("latin.ldt", &["latin.ldt, line 2", "Isym", "ends"]),
        ("", &["line 1", "photometry"]),
    ] {
        let toml = format!("{TOML}\n[[light]]\ntype = \"luminaire\"\nfile = \"{file}\"\nposition = [0, 1, 0]\n");
        let folder = folder(&[&files[..], &[("s.toml", toml.as_bytes())]].concat());
        assert_says(&refusal(&folder.path().join("s.toml")), parts);
    }
    // What comes after the numbers does not matter.
    let lamp = endless[..endless.len() - (17 << 20)].to_vec();
    let toml = format!("{TOML}\n[[light]]\ntype = \"luminaire\"\nfile = \"l.ies\"\nposition = [0, 1, 0]\n");
    let lamp = [&lamp[..], b"\nmore \xff\n"].concat();
    accepted(&[files[0], files[1], ("l.ies", &lamp), ("s.toml", toml.as_bytes())], "s.toml");
}

#[test]
fn spots_and_rectangles_that_make_no_sense_are_refused() {
    let spot = "\n[[light]]\ntype = \"spot\"\nposition = [0.0, 1.0, 0.0]\ndirection = [0.0, -1.0, 0.0]\nintensity = [1.0, 1.0, 1.0]\n\
                inner_degrees = 30.0\nouter_degrees = 20.0\n";
    refused("s.toml", &[TOML, spot].concat().into_bytes(), &["light 2, outer_degrees", "wider"]);
    let rect = "\n[[light]]\ntype = \"rect\"\ncorner = [0.0, 1.0, 0.0]\nedge_a = [1.0, 0.0, 0.0]\nedge_b = [2.0, 0.0, 0.0]\n\
                radiance = [1.0, 1.0, 1.0]\n";
    refused("s.toml", &[TOML, rect].concat().into_bytes(), &["light 2, edge_b", "parallel", "parallelogram"]);
    for (animation, parts) in [
        ("target = \"light\"\nindex = 4\nproperty = \"color\"\nkeyframes = []", ["index", "light 4 does not exist"]),
        ("target = \"sun\"\nproperty = \"color\"\nkeyframes = []", ["target", "give light or camera"]),
        ("target = \"light\"\nproperty = \"position\"\nkeyframes = []", ["property", "has no position"]),
        ("target = \"camera\"\nproperty = \"eye\"\nkeyframes = []", ["keyframes", "is empty"]),
        (
            "target = \"camera\"\nproperty = \"eye\"\nkeyframes = [{ time = 1.0, value = [0, 0, 0] }, { time = 1.0, value = [0, 0, 0] }]",
            ["keyframes", "ascending"],
        ),
    ] {
        let text = format!("{TOML}\n[[animation]]\n{animation}\n");
        refused("s.toml", text.as_bytes(), &parts);
    }
}

#[test]
fn bad_faces_are_refused_with_object_face_and_line() {
    let with = |from: &str, to: &str| OBJ.replace(from, to).into_bytes();
    refused(
        "b.obj",
        &with("f 1/1 3/3 4", "f 1/1 3/3 9"),
        &["line 12", "\"wall\"", "face 2", "vertex index 9", "4 vertices"],
    );
    refused("b.obj", &with("f 1/1 3/3 4", "f 1/1 3/3 0"), &["line 12", "face 2", "index 0"]);
    refused("b.obj", &with("f 1/1 3/3 4", "f -5 -1 -2"), &["face 2", "index -5"]);
    refused("b.obj", &with("f 1/1 3/3 4", "f 1/1 3/7 4"), &["face 2", "texture index 7"]);
    refused("b.obj", &with("f 1/1 3/3 4", "f 1/1 3/-9223372036854775807 4"), &["face 2", "not a corner"]);
    refused("b.obj", &with("f 1/1 3/3 4", "f 1 2"), &["face 2", "2 corner(s)"]);
    refused("b.obj", &with("f 1/1 3/3 4", "f 1 x 3"), &["face 2", "\"x\" is not a corner"]);
    refused(
        "b.obj",
        &with("v 1 1 0", "v 1 nan 0"),
        &["line 11", "\"wall\"", "face 1", "vertex 3 (line 4)", "not finite"],
    );
    refused("b.obj", &with("v 1 1 0", "v 1 1e999 0"), &["face 1", "not finite", "export the mesh again"]);
    refused("b.obj", &with("v 1 1 0", "v 1 y 0"), &["line 4", "\"y\" is not a number"]);
    refused("b.obj", &with("v 1 1 0", "v 1 1"), &["line 4", "2 number(s) where 3"]);
    refused("b.obj", &with("v 1 1 0", "v 1 1e30 0"), &["\"wall\"", "face 1", "1e9 m", "metres_per_unit"]);
    refused("b.obj", b"v 0 0 0\nv 1 0 0\n", &["no triangle", "at least one surface"]);
    refused("b.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", &["no triangle with an area"]);
    refused("b.obj", b"hello", &["neither a vertex nor a face"]);
    let garbage: Vec<u8> = (0..5000).map(|k| hash3(k, 1, 2) as u8).collect();
    for name in ["g.obj", "g.glb", "g.gltf", "g.toml"] {
        refused(name, &garbage, &[";"]);
    }
}

#[test]
fn what_can_be_repaired_is_a_warning() {
    let (scene, _f) = accepted(&[("a.obj", OBJ.as_bytes())], "a.obj");
    assert_one_warning(&scene, &["a.mtl", "cannot be read", "mid-grey"]);
    assert_one_warning(&scene, &["material m is not in any MTL file"]);
    assert_one_warning(&scene, &["has no light", "a sun and a sky were added"]);
    assert_eq!(
        scene.scene.materials[scene.scene.geometry.triangles[0].material as usize].albedo,
        glam::Vec3::splat(0.5)
    );

    let (scene, _f) = accepted(&[("a.obj", OBJ.as_bytes()), ("a.mtl", MTL.as_bytes())], "a.obj");
    assert_one_warning(&scene, &["t.png", "cannot be used", "mid-grey"]);
    assert_eq!(scene.scene.materials[0].albedo, glam::Vec3::splat(0.5));

    let mut broken = png(8, 8);
    broken.truncate(60);
    let (scene, _f) = accepted(&[("a.obj", OBJ.as_bytes()), ("a.mtl", MTL.as_bytes()), ("t.png", &broken)], "a.obj");
    assert_one_warning(&scene, &["t.png", "cannot be used", "mid-grey"]);

    let mtl = "newmtl m\nKd 1.0 -0.5 0.5\nmap_d mask.png\n";
    let (scene, _f) = accepted(&[("a.obj", OBJ.as_bytes()), ("a.mtl", mtl.as_bytes())], "a.obj");
    assert_one_warning(&scene, &["material m", "reflectance", "0.95"]);
    assert_one_warning(&scene, &["mask.png", "no holes"]);
    assert_eq!(scene.scene.materials[0].albedo, glam::Vec3::new(0.95, 0.0, 0.5));

    // Without area, and the same triangle from another corner; the other winding is another triangle.
    let obj = OBJ.to_owned() + "f 1 1 2\nf 1 2 2\nf 3 1 2\nf 2 1 3\n";
    let (scene, _f) = accepted(&[("a.obj", obj.as_bytes()), ("a.mtl", MTL.as_bytes()), ("t.png", &png(2, 2))], "a.obj");
    assert_one_warning(&scene, &["2 triangle(s) without area"]);
    assert_one_warning(&scene, &["1 triangle(s) equal to another one"]);
    assert_eq!((scene.file_triangles, scene.scene.geometry.triangles.len()), (6, 3));

    let obj = OBJ.replace("o wall", "o caf\u{e9}").into_bytes();
    let latin1: Vec<u8> = String::from_utf8_lossy(&obj).chars().map(|c| c as u8).collect();
    let (scene, _f) = accepted(&[("a.obj", &latin1), ("a.mtl", MTL.as_bytes()), ("t.png", &png(2, 2))], "a.obj");
    assert!(scene.objects[0].starts_with("caf"), "{:?}", scene.objects);
}

#[test]
fn huge_textures_are_refused_before_they_are_decoded() {
    // A PNG header that claims 60,000 x 60,000 texels.
    let mut bytes = png(2, 2);
    bytes[16..20].copy_from_slice(&60_000u32.to_be_bytes());
    bytes[20..24].copy_from_slice(&60_000u32.to_be_bytes());
    let (scene, _f) = accepted(&[("a.obj", OBJ.as_bytes()), ("a.mtl", MTL.as_bytes()), ("t.png", &bytes)], "a.obj");
    assert_one_warning(&scene, &["t.png", "cannot be used"]);
}

fn triangle_json(count: usize, nodes: &str) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":{nodes},
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
        {{"bufferView":1,"componentType":5125,"count":3,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":12}}],
        "buffers":[{{"byteLength":48}}]}}"#
    )
}

fn triangle_binary(last_index: u32, last_z: f32) -> Vec<u8> {
    let positions = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, last_z];
    let mut out: Vec<u8> = positions.iter().flat_map(|x| x.to_le_bytes()).collect();
    out.extend([0u32, 1, last_index].iter().flat_map(|x| x.to_le_bytes()));
    out
}

const NODE: &str = r#"[{"mesh":0,"name":"leaf"}]"#;

#[test]
fn bad_gltf_is_refused_with_its_place() {
    let good = glb(&triangle_json(3, NODE), &triangle_binary(2, 0.0));
    let (scene, _f) = accepted(&[("a.glb", &good)], "a.glb");
    assert_eq!(scene.scene.geometry.triangles.len(), 1);
    let bad = |json: &str, binary: &[u8], parts: &[&str]| refused("b.glb", &glb(json, binary), parts);
    bad(&triangle_json(3, NODE), &triangle_binary(7, 0.0), &["\"leaf\"", "face 1", "index 7", "export"]);
    bad(&triangle_json(3, NODE), &triangle_binary(2, f32::NAN), &["\"leaf\"", "face 1", "not finite"]);
    bad(&triangle_json(4_000_000_000, NODE), &triangle_binary(2, 0.0), &["accessor 0", "beyond its buffer view"]);
    bad(&triangle_json(3, NODE), &triangle_binary(2, 0.0)[..40], &["buffer 0", "truncated"]);
    bad(&triangle_json(3, r#"[{"children":[1]},{"children":[0]}]"#), &triangle_binary(2, 0.0), &["node 0", "ancestor"]);
    bad("{}", &[], &["not glTF 2.0"]);
    refused("b.glb", &good[..good.len() / 2], &["truncated"]);
}

#[test]
fn no_damaged_file_makes_a_reader_panic_hang_or_fill_the_memory() {
    let corpus = Corpus::new();
    let mut read = 0;
    let mut refused = 0;
    for number in 0..3000 {
        let (name, bytes) = corpus.mutant(number);
        match corpus.read(name, &bytes) {
            Outcome::Read => read += 1,
            Outcome::Refused(message) => {
                assert!(message.len() > 20, "{name}, number {number}: {message}");
                refused += 1;
            }
            Outcome::Fault(what) => panic!("{name}, number {number}: {what}"),
        }
    }
    // Both occur: the changes neither always break a file nor never.
    assert!(read > 500 && refused > 500, "{read} read, {refused} refused");
}

#[test]
fn the_sound_files_that_are_damaged_are_read() {
    let corpus = Corpus::new();
    for name in corpus.names() {
        assert_eq!(corpus.read_sound(name), Outcome::Read, "{name}");
    }
}

#[test]
fn libraries_of_materials_may_be_named_twice_and_anywhere() {
    let other = "newmtl n\nKd 0.25 0.5 0.75\n";
    let faces = "usemtl m\nf 1/1 2/2 3/3\nusemtl n\nf 1/1 3/3 4\n";
    let start = OBJ.find("usemtl").unwrap();
    let vertices = OBJ[..start].replace("mtllib a.mtl\n", "");
    for text in [
        format!("mtllib a.mtl b.mtl\n{vertices}{faces}"),
        format!("mtllib a.mtl\nmtllib b.mtl\n{vertices}{faces}"),
        format!("mtllib a.mtl\nmtllib b.mtl\nmtllib a.mtl\n{vertices}{faces}"),
        format!("mtllib a.mtl\n{vertices}{}", faces.replace("usemtl n", "mtllib b.mtl\nusemtl n")),
        format!("{vertices}{faces}mtllib a.mtl\nmtllib b.mtl\n"),
    ] {
        let files =
            [("a.obj", text.as_bytes()), ("a.mtl", MTL.as_bytes()), ("b.mtl", other.as_bytes()), ("t.png", &png(2, 2))];
        let (scene, _f) = accepted(&files, "a.obj");
        let names: Vec<&str> =
            scene.scene.geometry.triangles.iter().map(|t| scene.materials[t.material as usize].as_str()).collect();
        assert_eq!(names, ["m", "n"], "{text}");
        assert_eq!(scene.scene.materials[1].albedo, glam::Vec3::new(0.25, 0.5, 0.75), "{text}");
    }
}

#[test]
fn lines_may_end_in_carriage_returns() {
    let files: [(&str, &str); 2] = [("a.obj", OBJ), ("a.mtl", MTL)];
    let [unix, mac, dos] = ["\n", "\r", "\r\n"].map(|end| {
        let files = files.map(|(name, text)| (name, text.replace('\n', end).into_bytes()));
        let files = [(files[0].0, &files[0].1[..]), (files[1].0, &files[1].1[..]), ("t.png", &png(2, 2))];
        let (scene, _f) = accepted(&files, "a.obj");
        (scene.content_hash, scene.scene.geometry.triangles.len())
    });
    assert!(unix == mac && unix == dos && unix.1 == 2);
    // A fault is in its own line.
    let wrong = OBJ.replace("f 1/1 3/3 4", "f 1/1 3/3 9").replace('\n', "\r");
    refused("b.obj", wrong.as_bytes(), &["line 12", "index 9"]);
}

#[test]
fn a_picture_that_is_far_larger_than_its_file_is_refused() {
    // A header that promises 16,384 x 16,384 texels of 24 bits, with a right checksum.
    let mut bytes = png(2, 2);
    bytes[16..20].copy_from_slice(&16_384u32.to_be_bytes());
    bytes[20..24].copy_from_slice(&16_384u32.to_be_bytes());
    let sum = crc32fast::hash(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&sum.to_be_bytes());
    let (scene, _f) = accepted(&[("a.obj", OBJ.as_bytes()), ("a.mtl", MTL.as_bytes()), ("t.png", &bytes)], "a.obj");
    assert_one_warning(&scene, &["t.png", "16384 x 16384", "768 MB", "smaller picture"]);
    assert!(scene.textures.is_empty());
}

#[test]
fn a_picture_that_many_materials_show_is_read_once() {
    let picture = png(64, 64);
    let materials: Vec<String> =
        (0..200).map(|_| r#"{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}"#.to_owned()).collect();
    let json = triangle_json(3, NODE).replacen(
        '{',
        &format!(
            r#"{{"materials":[{}],"textures":[{{"source":0}}],"images":[{{"bufferView":2,"mimeType":"image/png"}}],"#,
            materials.join(",")
        ),
        1,
    );
    let json = json.replace(
        r#""byteLength":12}]"#,
        &format!(r#""byteLength":12}},{{"buffer":0,"byteOffset":48,"byteLength":{}}}]"#, picture.len()),
    );
    let json = json.replace(r#"[{"byteLength":48}]"#, &format!(r#"[{{"byteLength":{}}}]"#, 48 + picture.len()));
    let bytes = glb(&json, &[triangle_binary(2, 0.0), picture].concat());
    let (scene, _f) = accepted(&[("a.glb", &bytes)], "a.glb");
    assert_eq!((scene.materials.len(), scene.textures.len()), (201, 1));
    let texels = 64 * 64 * 4 / 3;
    assert!(scene.scene.geometry.texels.len() < 2 * (texels + 64), "{}", scene.scene.geometry.texels.len());
}

#[test]
fn instances_beyond_memory_are_refused_before_they_are_made() {
    // 2,000 nodes that show one mesh.
    let nodes: Vec<String> = (0..2000).map(|k| format!(r#"{{"mesh":0,"translation":[{k},0,0]}}"#)).collect();
    let numbers: Vec<String> = (0..2000).map(|k| k.to_string()).collect();
    let json = triangle_json(3, &format!("[{}]", nodes.join(",")));
    let json = json.replace(r#""nodes":[0]"#, &format!(r#""nodes":[{}]"#, numbers.join(",")));
    let folder = folder(&[("a.glb", &glb(&json, &triangle_binary(2, 0.0)))]);
    let path = folder.path().join("a.glb");
    let scene = load(&path).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(scene.scene.geometry.triangles.len(), 2000);
    let options = LoadOptions { memory_limit: Some(100_000), ..LoadOptions::default() };
    let message = load_with(&path, &options).err().map(|e| e.to_string()).unwrap_or_default();
    assert_says(&message, &["a.glb", "2000 triangles", "MB", "simplify", "fewer places"]);
}

#[test]
fn light_beyond_all_numbers_is_refused_or_lowered() {
    let with = |from: &str, to: &str| TOML.replace(from, to).into_bytes();
    refused("s.toml", &with("[1.0, 1.0, 1.0]", "[1.0, 1e38, 1.0]"), &["light 1, irradiance", "at most"]);
    let mtl = MTL.replace("Ke 1 1 1", "Ke 1e38 1 1");
    let (scene, _f) = accepted(&[("a.obj", OBJ.as_bytes()), ("a.mtl", mtl.as_bytes()), ("t.png", &png(2, 2))], "a.obj");
    assert_one_warning(&scene, &["material m", "emission", "above"]);
    assert!(scene.scene.materials[0].radiance.max_element() < 1e16);
}
