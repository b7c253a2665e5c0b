//! glTF 2.0 and GLB. What the `gltf` crate reads without looking (ranges of accessors, cycles of nodes) is checked
//! first.
//!
//! Intensities are taken as they stand: one unit of the file is one W (sr⁻¹, m⁻²); emission is radiance.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{Mat4, Vec2, Vec3};
use gltf::accessor::Dimensions;
use gltf::mesh::Mode;
use gltf::{Accessor, Document, Gltf, Node, Primitive};
use scene::Light;

use super::draft::{FileTriangle, FinishDraft, MaterialDraft, Mesh, check_count, packed_normal};
use super::gltf_moving::Movements;
use super::optics::{GLASS, Optics};
use super::pictures::{MaskChannel, Source, guard};
use super::scene_file::beside;
use super::{ImportError, LoadOptions, View, lights};

/// The file in hand: for messages and paths.
pub(super) struct File<'a> {
    pub(super) path: &'a Path,
    /// One file that several buffers name is held once.
    buffers: Vec<Arc<Vec<u8>>>,
}

impl File<'_> {
    pub(super) fn error(&self, place: impl Into<String>, reason: impl Into<String>) -> ImportError {
        ImportError::Gltf { path: self.path.to_path_buf(), place: place.into(), reason: reason.into() }
    }

    pub(super) fn buffer(&self, buffer: &gltf::Buffer) -> Option<&[u8]> {
        self.buffers.get(buffer.index()).map(|bytes| bytes.as_slice())
    }
}

/// Reads a .gltf or .glb file with its buffers.
pub fn load(path: &Path, bytes: &[u8], options: &LoadOptions) -> Result<Mesh, ImportError> {
    let mut file = File { path, buffers: Vec::new() };
    let mut gltf = guard(|| Gltf::from_slice(bytes).map_err(|e| e.to_string()))
        .map_err(|reason| file.error("the whole file", format!("{reason} (truncated, or not glTF 2.0)")))?;
    file.buffers = read_buffers(&file, &mut gltf)?;
    let mut mesh = guard(|| Ok(collect(&file, &gltf.document, options)))
        .unwrap_or_else(|reason| Err(file.error("the whole file", format!("is not valid: {reason}"))))?;
    mesh.files.extend(gltf.buffers().filter_map(|buffer| match buffer.source() {
        gltf::buffer::Source::Uri(uri) => file_of(path, uri),
        gltf::buffer::Source::Bin => None,
    }));
    Ok(mesh)
}

/// The file that a URI names, unless it is the data itself.
fn file_of(path: &Path, uri: &str) -> Option<PathBuf> {
    (!uri.starts_with("data:")).then(|| beside(path, &percent_decode(uri)))
}

fn read_buffers(file: &File, gltf: &mut Gltf) -> Result<Vec<Arc<Vec<u8>>>, ImportError> {
    let mut buffers = Vec::new();
    let binary = gltf.blob.take().map(Arc::new);
    let mut read: BTreeMap<&str, Arc<Vec<u8>>> = BTreeMap::new();
    for buffer in gltf.buffers() {
        let place = format!("buffer {}", buffer.index());
        let bytes = match buffer.source() {
            gltf::buffer::Source::Bin => {
                binary.clone().ok_or_else(|| file.error(&place, "the binary part of the GLB is missing"))?
            }
            gltf::buffer::Source::Uri(uri) => match read.get(uri) {
                Some(bytes) => Arc::clone(bytes),
                None => {
                    let bytes = Arc::new(resource(file, &place, uri)?);
                    read.insert(uri, Arc::clone(&bytes));
                    bytes
                }
            },
        };
        if bytes.len() < buffer.length() {
            let reason = format!("has {} bytes where {} are declared (truncated)", bytes.len(), buffer.length());
            return Err(file.error(&place, reason));
        }
        buffers.push(bytes);
    }
    Ok(buffers)
}

/// Bytes of a data URI or of a file beside this one.
fn resource(file: &File, place: &str, uri: &str) -> Result<Vec<u8>, ImportError> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, encoded) =
            data.split_once(";base64,").ok_or_else(|| file.error(place, "its data URI is not base64"))?;
        return STANDARD.decode(encoded).map_err(|e| file.error(place, format!("its data URI is broken: {e}")));
    }
    let path = beside(file.path, &percent_decode(uri));
    scene::host::read_regular(&path).map_err(|source| ImportError::Read { path, source })
}

fn percent_decode(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let mut out = Vec::new();
    let mut k = 0;
    while k < bytes.len() {
        let code =
            (bytes[k] == b'%').then(|| uri.get(k + 1..k + 3)).flatten().and_then(|h| u8::from_str_radix(h, 16).ok());
        out.push(code.unwrap_or(bytes[k]));
        k += if code.is_some() { 3 } else { 1 };
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// Origin of a material's texture coordinates in the mesh's.
#[derive(Clone, Copy, Default)]
pub(super) struct UvRule {
    set: u32,
    transform: Option<([f32; 2], f32, [f32; 2])>,
}

impl UvRule {
    /// KHR_texture_transform; then v from the bottom as in OBJ.
    fn apply(&self, uv: [f32; 2]) -> Vec2 {
        let mut uv = Vec2::from(uv);
        if let Some((offset, rotation, scale)) = self.transform {
            let s = f64::from(rotation).sin() as f32;
            let c = f64::from(rotation).cos() as f32;
            let p = uv * Vec2::from(scale);
            uv = Vec2::new(c * p.x + s * p.y, c * p.y - s * p.x) + Vec2::from(offset);
        }
        Vec2::new(uv.x, 1.0 - uv.y)
    }
}

fn collect(file: &File, document: &Document, options: &LoadOptions) -> Result<Mesh, ImportError> {
    let mut mesh = Mesh::default();
    let mut rules = Vec::new();
    let mut pictures = Pictures { file, found: BTreeMap::new() };
    for material in document.materials() {
        let (draft, rule) = read_material(&mut pictures, &material, &mut mesh.warnings)?;
        mesh.materials.push(draft);
        rules.push(rule);
    }
    // Primitives without material.
    mesh.materials.push(MaterialDraft { albedo: Vec3::splat(0.8), ..MaterialDraft::new("(default)") });
    rules.push(UvRule::default());

    let Some(root) = document.default_scene().or_else(|| document.scenes().next()) else {
        return Err(file.error("scenes", "there is no scene"));
    };
    let mut stack: Vec<(Node, Mat4)> = root.nodes().map(|n| (n, Mat4::IDENTITY)).collect();
    stack.reverse();
    let mut visited = BTreeSet::new();
    let mut placed: Vec<(Node, Mat4)> = Vec::new();
    while let Some((node, parent)) = stack.pop() {
        if !visited.insert(node.index()) {
            return Err(file.error(format!("node {}", node.index()), "has two parents, or is its own ancestor"));
        }
        let to_world = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        let children: Vec<_> = node.children().map(|child| (child, to_world)).collect();
        stack.extend(children.into_iter().rev());
        placed.push((node, to_world));
    }
    // Many nodes may show one mesh: what that comes to is known before any of it is made.
    let triangles =
        placed.iter().filter_map(|(node, _)| node.mesh()).flat_map(|shape| shape.primitives()).map(|p| face_count(&p));
    let count = triangles.fold(0usize, usize::saturating_add);
    check_count(file.path, count, options)?;
    let movements = Movements::read(file, document, &mut mesh.warnings)?;
    let moves = |node: &Node| node.mesh().is_some() && movements.moves_mesh(node);
    let has_rest = placed.iter().any(|(node, _)| node.mesh().is_some() && !moves(node));
    if !has_rest && placed.iter().any(|(node, _)| moves(node)) {
        mesh.warnings.push(format!("{}: everything moves; it is read as it stands at first", file.path.display()));
    }
    for (node, to_world) in &placed {
        let own =
            if has_rest && moves(node) { movements.objects(file, node, &rules, &mut mesh.warnings)? } else { None };
        add_node(file, node, *to_world, (&rules, own.is_none()), &mut mesh)?;
        mesh.moving.extend(own.into_iter().flatten());
    }
    Ok(mesh)
}

/// Triangles of a primitive, by its own account.
fn face_count(primitive: &Primitive) -> usize {
    let positions = primitive.get(&gltf::Semantic::Positions).map_or(0, |positions| positions.count());
    let corners = primitive.indices().map_or(positions, |indices| indices.count());
    match primitive.mode() {
        Mode::Triangles => corners / 3,
        Mode::TriangleStrip | Mode::TriangleFan => corners.saturating_sub(2),
        _ => 0,
    }
}

pub(super) fn label(node: &Node) -> String {
    let mesh_name = node.mesh().and_then(|m| m.name().map(str::to_owned));
    node.name().map(str::to_owned).or(mesh_name).unwrap_or_else(|| format!("node {}", node.index()))
}

/// Adds what a node has; its mesh where that rests.
fn add_node(
    file: &File,
    node: &Node,
    to_world: Mat4,
    (rules, rests): (&[UvRule], bool),
    mesh: &mut Mesh,
) -> Result<(), ImportError> {
    let place = || format!("node {} \"{}\"", node.index(), label(node));
    if let Some(camera) = node.camera().filter(|_| mesh.view.is_none()) {
        match camera.projection() {
            gltf::camera::Projection::Perspective(p) => {
                let eye = to_world.transform_point3(Vec3::ZERO);
                let forward = to_world.transform_vector3(Vec3::NEG_Z).normalize_or_zero();
                let up = to_world.transform_vector3(Vec3::Y).normalize_or_zero();
                let vertical_fov_degrees = p.yfov().to_degrees();
                let sound = eye.is_finite() && forward.cross(up).length() > 1e-4;
                if sound && (0.01..=179.0).contains(&vertical_fov_degrees) {
                    mesh.view = Some(View { eye, target: eye + forward, up, vertical_fov_degrees });
                } else {
                    mesh.warnings.push(format!(
                        "{}, {}: its camera makes no sense and is ignored",
                        file.path.display(),
                        place()
                    ));
                }
            }
            gltf::camera::Projection::Orthographic(_) => {
                mesh.warnings.push(format!("{}, {}: orthographic cameras are ignored", file.path.display(), place()))
            }
        }
    }
    if let Some(light) = node.light() {
        let built = build_light(&light, to_world)
            .map_err(|(key, reason)| file.error(format!("light of {}", place()), format!("{key}: {reason}")))?;
        mesh.lights.push(built);
    }
    let Some(shape) = node.mesh().filter(|_| rests) else { return Ok(()) };
    mesh.objects.push(label(node));
    for primitive in shape.primitives() {
        add_primitive(file, &primitive, to_world, rules, mesh, &place())?;
    }
    Ok(())
}

fn build_light(light: &gltf::khr_lights_punctual::Light, to_world: Mat4) -> Result<Light, lights::Fault> {
    use gltf::khr_lights_punctual::Kind;
    let color = Vec3::from(light.color()) * light.intensity();
    let position = to_world.transform_point3(Vec3::ZERO);
    let direction = to_world.transform_vector3(Vec3::NEG_Z);
    match light.kind() {
        Kind::Directional => lights::directional(direction, color),
        Kind::Point => lights::point(position, color),
        Kind::Spot { inner_cone_angle, outer_cone_angle } => {
            lights::spot(position, direction, color, inner_cone_angle.to_degrees(), outer_cone_angle.to_degrees())
        }
    }
}

/// The set of texture coordinates that lightmaps have by custom.
const LIGHTMAP_SET: u32 = 1;

fn add_primitive(
    file: &File,
    primitive: &Primitive,
    to_world: Mat4,
    rules: &[UvRule],
    mesh: &mut Mesh,
    node: &str,
) -> Result<(), ImportError> {
    let place = format!("{node}, primitive {}", primitive.index());
    if !matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
        mesh.warnings.push(format!("{}, {place}: points and lines are ignored", file.path.display()));
        return Ok(());
    }
    let material = primitive.material().index().unwrap_or(mesh.materials.len() - 1);
    let rule = rules[material];
    let Some(positions) = primitive.get(&gltf::Semantic::Positions) else {
        mesh.warnings.push(format!("{}, {place}: has no positions and is ignored", file.path.display()));
        return Ok(());
    };
    let Some(vertices) = read_vertices(file, primitive, &positions, to_world, &rule, &place)? else { return Ok(()) };
    let flipped = to_world.determinant() < 0.0;
    add_faces(primitive.mode(), &vertices, (material as u32, flipped), mesh)
        .map_err(|reason| file.error(&place, reason))
}

/// Vertex attributes of a primitive.
#[derive(Default)]
pub(super) struct Vertices {
    /// In the world, in units of the file.
    pub(super) positions: Vec<Vec3>,
    /// Coordinates of the material's textures; empty where there are none.
    pub(super) uvs: Vec<Vec2>,
    /// Normals in the world, packed; empty where there are none.
    pub(super) normals: Vec<u32>,
    /// In the atlas of a lightmap; empty where there are none.
    pub(super) lightmap: Vec<Vec2>,
    pub(super) indices: Vec<u32>,
}

/// Reads them, once their accessors are checked; none where there are no faces.
pub(super) fn read_vertices(
    file: &File,
    primitive: &Primitive,
    positions: &Accessor,
    to_world: Mat4,
    rule: &UvRule,
    place: &str,
) -> Result<Option<Vertices>, ImportError> {
    let uvs = primitive.get(&gltf::Semantic::TexCoords(rule.set));
    let atlas = primitive.get(&gltf::Semantic::TexCoords(LIGHTMAP_SET));
    let indices = primitive.indices();
    let normals = primitive.get(&gltf::Semantic::Normals);
    let accessors = [Some(positions), uvs.as_ref(), atlas.as_ref(), normals.as_ref(), indices.as_ref()];
    for accessor in accessors.into_iter().flatten() {
        check_accessor(file, accessor, place)?;
    }
    let count = indices.map_or(positions.count(), |i| i.count());
    if positions.count() == 0 || count == 0 {
        return Ok(None);
    }
    let is = |a: &Accessor, d: Dimensions| a.dimensions() == d;
    let is_pairs = |a: &Option<Accessor>| a.as_ref().is_none_or(|a| is(a, Dimensions::Vec2));
    let are_normals = normals.as_ref().is_none_or(|a| is(a, Dimensions::Vec3));
    if !is(positions, Dimensions::Vec3) || !are_normals || !is_pairs(&uvs) || !is_pairs(&atlas) {
        return Err(file.error(place, "POSITION and NORMAL must have three, TEXCOORD two numbers"));
    }
    let reader = primitive.reader(|buffer| file.buffer(&buffer));
    let positions: Vec<Vec3> = reader
        .read_positions()
        .map(|p| p.map(|p| to_world.transform_point3(Vec3::from(p))).collect())
        .unwrap_or_default();
    let uvs: Vec<Vec2> = if uvs.as_ref().is_some_and(|a| a.count() > 0) {
        reader.read_tex_coords(rule.set).map(|t| t.into_f32().map(|uv| rule.apply(uv)).collect()).unwrap_or_default()
    } else {
        Vec::new()
    };
    let turned = if to_world.determinant() == 0.0 { Mat4::ZERO } else { to_world.inverse().transpose() };
    let normals = match reader.read_normals().filter(|_| normals.is_some_and(|a| a.count() > 0)) {
        Some(normals) => normals.map(|n| packed_normal(turned.transform_vector3(Vec3::from(n)))).collect(),
        None => Vec::new(),
    };
    let has_atlas = rule.set != LIGHTMAP_SET && atlas.is_some_and(|a| a.count() > 0);
    let lightmap: Vec<Vec2> = match reader.read_tex_coords(LIGHTMAP_SET).filter(|_| has_atlas) {
        Some(uvs) => uvs.into_f32().map(Vec2::from).collect(),
        None => Vec::new(),
    };
    let indices: Vec<u32> = match reader.read_indices() {
        Some(indices) => indices.into_u32().collect(),
        None => (0..positions.len() as u32).collect(),
    };
    Ok(Some(Vertices { positions, uvs, normals, lightmap, indices }))
}

/// Adds the triangles of a primitive, turned round where its node mirrors; else what is wrong with one.
pub(super) fn add_faces(
    mode: Mode,
    vertices: &Vertices,
    (material, flipped): (u32, bool),
    mesh: &mut Mesh,
) -> Result<(), String> {
    let Vertices { positions, uvs, normals, lightmap, indices } = vertices;
    let object = mesh.objects.len() as u32 - 1;
    let corners = |face: usize| match mode {
        Mode::TriangleStrip if face % 2 == 1 => [indices[face + 1], indices[face], indices[face + 2]],
        Mode::TriangleStrip => [indices[face], indices[face + 1], indices[face + 2]],
        Mode::TriangleFan => [indices[0], indices[face + 1], indices[face + 2]],
        _ => [indices[3 * face], indices[3 * face + 1], indices[3 * face + 2]],
    };
    let faces = if mode == Mode::Triangles { indices.len() / 3 } else { indices.len().saturating_sub(2) };
    for face in 0..faces {
        let mut at = corners(face);
        if flipped {
            at.swap(1, 2);
        }
        if let Some(bad) = at.iter().find(|k| **k as usize >= positions.len()) {
            return Err(format!(
                "face {}: vertex index {bad} is out of range, there are {}",
                face + 1,
                positions.len()
            ));
        }
        let corners = at.map(|k| positions[k as usize]);
        if corners.iter().any(|c| !c.is_finite()) {
            return Err(format!("face {}: has a coordinate that is not finite", face + 1));
        }
        // As long as all triangles so far have some.
        if !lightmap.is_empty() && mesh.lightmap_uvs.len() == mesh.triangles.len() {
            mesh.lightmap_uvs.push(at.map(|k| lightmap.get(k as usize).copied().unwrap_or(Vec2::NAN)));
        }
        let uvs = at.map(|k| uvs.get(k as usize).copied().unwrap_or_default());
        let normals = at.map(|k| normals.get(k as usize).copied().unwrap_or_default());
        mesh.triangles.push(FileTriangle { corners, uvs, normals, material, object });
    }
    Ok(())
}

/// Refuses accessors that reach beyond their view or buffer.
pub(super) fn check_accessor(file: &File, accessor: &Accessor, place: &str) -> Result<(), ImportError> {
    let error = |reason: &str| file.error(format!("{place}, accessor {}", accessor.index()), reason);
    if accessor.sparse().is_some() {
        return Err(error("sparse accessors are not read"));
    }
    let Some(view) = accessor.view() else { return Err(error("has no buffer view")) };
    let size = accessor.size() as u64;
    let stride = view.stride().map_or(size, |s| s as u64);
    if stride < size {
        return Err(error("its stride is shorter than its elements"));
    }
    let end = (accessor.count() as u64)
        .saturating_sub(1)
        .checked_mul(stride)
        .and_then(|x| x.checked_add(size))
        .and_then(|x| x.checked_add(accessor.offset() as u64));
    let view_end = (view.offset() as u64).checked_add(view.length() as u64);
    let buffer = file.buffers.get(view.buffer().index()).map_or(0, |b| b.len() as u64);
    if accessor.count() > 0 && end.is_none_or(|end| end > view.length() as u64) {
        return Err(error("reaches beyond its buffer view"));
    }
    if view_end.is_none_or(|end| end > buffer) {
        return Err(error("its buffer view reaches beyond the buffer (truncated)"));
    }
    Ok(())
}

/// Roughness below which a surface counts as smooth.
const SMOOTH: f32 = 0.01;

/// Specular reflection and transmission of a material, and the share of its colour that is left to diffuse reflection:
/// metals, and smooth KHR_materials_transmission. Without a volume the surface is a pane.
fn optics(material: &gltf::Material, color: Vec3, warn: &mut impl FnMut(&str)) -> (Optics, f32) {
    let pbr = material.pbr_metallic_roughness();
    let clear = material.transmission().map_or(0.0, |transmission| transmission.transmission_factor());
    if pbr.roughness_factor() >= SMOOTH {
        if clear > 0.0 {
            warn("lets light through a rough surface; it is read as one that lets none through");
        }
        return (Optics::default(), 1.0);
    }
    let metal = pbr.metallic_factor();
    let optics = Optics {
        mirror: color * metal,
        transmittance: color * (clear * (1.0 - metal)),
        index_of_refraction: material.ior().unwrap_or(GLASS),
        is_pane: clear > 0.0 && material.volume().is_none_or(|volume| volume.thickness_factor() <= 0.0),
    };
    (optics, (1.0 - clear) * (1.0 - metal))
}

fn read_material(
    pictures: &mut Pictures,
    material: &gltf::Material,
    warnings: &mut Vec<String>,
) -> Result<(MaterialDraft, UvRule), ImportError> {
    let file = pictures.file;
    let index = material.index().unwrap_or_default();
    let name = material.name().map_or_else(|| format!("material {index}"), str::to_owned);
    let mut warn = |what: &str| warnings.push(format!("{}, material {name}: {what}", file.path.display()));
    let pbr = material.pbr_metallic_roughness();
    let [r, g, b, alpha] = pbr.base_color_factor();
    let base = pbr.base_color_texture();
    let emissive = material.emissive_texture();
    let surface = pbr.metallic_roughness_texture();
    let normals = material.normal_texture();
    let first = base.as_ref().or(emissive.as_ref()).or(surface.as_ref());
    let alone = UvRule { set: normals.as_ref().map_or(0, gltf::material::NormalTexture::tex_coord), transform: None };
    let rule = first.map_or(alone, |info| {
        let transform = info.texture_transform().map(|t| (t.offset(), t.rotation(), t.scale()));
        let set = info.texture_transform().and_then(|t| t.tex_coord()).unwrap_or_else(|| info.tex_coord());
        UvRule { set, transform }
    });
    let color = Vec3::new(r, g, b);
    let (optics, diffuse) = optics(material, color, &mut warn);
    let mut draft = MaterialDraft {
        albedo: color * diffuse,
        albedo_factor: color * diffuse,
        radiance: Vec3::from(material.emissive_factor()) * material.emissive_strength().unwrap_or(1.0),
        ..MaterialDraft::new(&name)
    };
    draft.set_optics(optics).iter().for_each(|what| warn(what));
    if let Some(info) = &base {
        draft.albedo_picture = Some(pictures.read(&info.texture().source())?);
    }
    if let Some(info) = &emissive {
        if info.tex_coord() != rule.set && base.is_some() {
            warn("its emissive texture uses other texture coordinates and is ignored");
        } else {
            draft.radiance_picture = Some(pictures.read(&info.texture().source())?);
        }
    }
    draft.finish = read_finish(pictures, material, rule.set, &mut warn)?;
    let cutoff = match material.alpha_mode() {
        gltf::material::AlphaMode::Opaque => return Ok((draft, rule)),
        gltf::material::AlphaMode::Mask => material.alpha_cutoff().unwrap_or(0.5),
        gltf::material::AlphaMode::Blend => {
            warn("is blended; it is drawn with holes where alpha is below 0.5");
            0.5
        }
    };
    match draft.albedo_picture.clone() {
        Some(source) if alpha > 0.0 => {
            draft.mask = Some((source, MaskChannel::Alpha));
            draft.mask_cutoff = cutoff / alpha;
        }
        _ => draft.hole = alpha < cutoff,
    }
    Ok((draft, rule))
}

/// Normals, roughness and metalness of a material whose other textures use a set of coordinates. What is so smooth that
/// it mirrors has no lobe.
fn read_finish(
    pictures: &mut Pictures,
    material: &gltf::Material,
    set: u32,
    warn: &mut impl FnMut(&str),
) -> Result<FinishDraft, ImportError> {
    let pbr = material.pbr_metallic_roughness();
    let mut finish = FinishDraft::default();
    if let Some(normals) = material.normal_texture() {
        if normals.tex_coord() == set {
            finish.normal_picture = Some(pictures.read(&normals.texture().source())?);
            finish.normal_scale = normals.scale();
        } else {
            warn("its normal texture uses other texture coordinates and is ignored");
        }
    }
    if pbr.roughness_factor() < SMOOTH {
        return Ok(finish);
    }
    finish.roughness = Some(pbr.roughness_factor());
    finish.metallic = pbr.metallic_factor();
    if let Some(surface) = pbr.metallic_roughness_texture() {
        let of_transform = surface.texture_transform().and_then(|t| t.tex_coord());
        if of_transform.unwrap_or_else(|| surface.tex_coord()) == set {
            finish.surface_picture = Some(pictures.read(&surface.texture().source())?);
        } else {
            warn("its texture of roughness uses other texture coordinates and is ignored");
        }
    }
    Ok(finish)
}

/// Encoded pictures of the file: each is read once, however many materials show it.
struct Pictures<'a> {
    file: &'a File<'a>,
    /// By where their bytes are.
    found: BTreeMap<Place, Source>,
}

/// Location of a picture's bytes.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum Place {
    /// The number of a buffer view.
    View(usize),
    /// The number of the picture, whose bytes are its own.
    Picture(usize),
}

impl Pictures<'_> {
    fn read(&mut self, image: &gltf::Image) -> Result<Source, ImportError> {
        let place = match image.source() {
            gltf::image::Source::View { view, .. } => Place::View(view.index()),
            gltf::image::Source::Uri { .. } => Place::Picture(image.index()),
        };
        if let Some(source) = self.found.get(&place) {
            return Ok(source.clone());
        }
        let source = read_picture(self.file, image)?;
        self.found.insert(place, source.clone());
        Ok(source)
    }
}

fn read_picture(file: &File, image: &gltf::Image) -> Result<Source, ImportError> {
    let place = format!("image {}", image.index());
    let name = format!("{}, {place}", file.path.display());
    match image.source() {
        gltf::image::Source::View { view, .. } => {
            let bytes = file
                .buffers
                .get(view.buffer().index())
                .and_then(|b| b.get(view.offset()..view.offset().checked_add(view.length())?));
            let bytes =
                bytes.ok_or_else(|| file.error(&place, "its buffer view reaches beyond the buffer (truncated)"))?;
            Ok(Source::Embedded { name, bytes: Arc::new(bytes.to_vec()) })
        }
        gltf::image::Source::Uri { uri, .. } if uri.starts_with("data:") => {
            Ok(Source::Embedded { name, bytes: Arc::new(resource(file, &place, uri)?) })
        }
        gltf::image::Source::Uri { uri, .. } => Ok(Source::File(beside(file.path, &percent_decode(uri)))),
    }
}
