//! Animations of glTF files: nodes that are moved and turned, and the parts of skins that their joints move, become
//! objects that move. Each is rigid; a triangle of a skin goes with the joint that holds most of it.

use std::collections::BTreeMap;

use glam::{Mat4, Quat, Vec3};
use gltf::animation::{Interpolation, Property};
use gltf::mesh::Mode;
use gltf::{Document, Node, Semantic};

use super::draft::{FileTriangle, Mesh};
use super::gltf_file::{File, UvRule, Vertices, add_faces, check_accessor, label, read_vertices};
use super::{ImportError, MovingObject, Pose};

/// Most triangles of an object: each is an element.
const MOST_TRIANGLES: usize = 4000;
/// Poses between two keys where several nodes turn one in another.
const BETWEEN: u32 = 4;
/// Time before a step at which the value is still the one before, s.
const STEP: f32 = 1e-3;
/// By how much the size of an object may change, as a share.
const RIGID: f32 = 1e-2;

/// Values of a property at ascending times.
struct Keys<T> {
    times: Vec<f32>,
    values: Vec<T>,
    is_stepped: bool,
}

impl<T: Copy> Keys<T> {
    fn at(&self, time: f32, between: impl Fn(T, T, f32) -> T) -> Option<T> {
        let next = self.times.partition_point(|&own| own <= time);
        let before = next.checked_sub(1);
        match (before, self.values.get(next)) {
            (Some(k), Some(&b)) if !self.is_stepped => {
                let share = (time - self.times[k]) / (self.times[next] - self.times[k]);
                Some(between(self.values[k], b, share))
            }
            (Some(k), _) => self.values.get(k).copied(),
            (None, first) => first.copied(),
        }
    }
}

/// How a node moves.
#[derive(Default)]
struct Tracks {
    positions: Option<Keys<Vec3>>,
    rotations: Option<Keys<Quat>>,
}

impl Tracks {
    fn times(&self) -> impl Iterator<Item = f32> + '_ {
        let of_positions = self.positions.iter().map(|keys| (&keys.times, keys.is_stepped));
        let of_rotations = self.rotations.iter().map(|keys| (&keys.times, keys.is_stepped));
        of_positions.chain(of_rotations).flat_map(|(times, is_stepped)| {
            let before = times.iter().map(|time| time - STEP).filter(move |_| is_stepped);
            times.iter().copied().chain(before)
        })
    }
}

/// Movement of the nodes of a file.
pub struct Movements<'a> {
    nodes: Vec<Node<'a>>,
    parents: Vec<Option<usize>>,
    tracks: BTreeMap<usize, Tracks>,
}

impl<'a> Movements<'a> {
    /// Reads the first animation. Nodes are a forest.
    pub fn read(file: &File, document: &'a Document, warnings: &mut Vec<String>) -> Result<Self, ImportError> {
        let nodes: Vec<Node> = document.nodes().collect();
        let mut parents = vec![None; nodes.len()];
        for node in &nodes {
            node.children().for_each(|child| parents[child.index()] = Some(node.index()));
        }
        let mut tracks: BTreeMap<usize, Tracks> = BTreeMap::new();
        let mut warn = |what: &str| warnings.push(format!("{}: {what}", file.path.display()));
        if document.animations().len() > 1 {
            warn("has several animations; the first one is read");
        }
        for (number, channel) in document.animations().take(1).flat_map(|animation| animation.channels()).enumerate() {
            let place = format!("animation 0, channel {number}");
            let target = channel.target();
            let index = target.node().index();
            let sampler = channel.sampler();
            check_accessor(file, &sampler.input(), &place)?;
            check_accessor(file, &sampler.output(), &place)?;
            let reader = channel.reader(|buffer| file.buffer(&buffer));
            let times: Vec<f32> = reader.read_inputs().map(Iterator::collect).unwrap_or_default();
            let ascend = |pair: &[f32]| pair[0] < pair[1];
            if times.is_empty() || !times.iter().all(|time| time.is_finite()) || !times.windows(2).all(ascend) {
                return Err(file.error(place, "its times are not finite numbers that ascend"));
            }
            let is_cubic = sampler.interpolation() == Interpolation::CubicSpline;
            let is_stepped = sampler.interpolation() == Interpolation::Step;
            let count = times.len();
            let short = || file.error(&place, format!("has fewer values than its {count} times"));
            use gltf::animation::util::ReadOutputs;
            match (target.property(), reader.read_outputs()) {
                (Property::Translation, Some(ReadOutputs::Translations(values))) => {
                    let values = at_keys(values.map(Vec3::from).collect(), count, is_cubic).ok_or_else(short)?;
                    if !values.iter().all(|value| value.is_finite()) {
                        return Err(file.error(place, "has a position that is not finite"));
                    }
                    tracks.entry(index).or_default().positions = Some(Keys { times, values, is_stepped });
                }
                (Property::Rotation, Some(ReadOutputs::Rotations(values))) => {
                    let values = values.into_f32().map(Quat::from_array).collect();
                    let mut values = at_keys(values, count, is_cubic).ok_or_else(short)?;
                    if !values.iter().all(|value| value.is_finite() && value.length_squared() > 0.0) {
                        return Err(file.error(place, "has a rotation that is none"));
                    }
                    values.iter_mut().for_each(|value| *value = value.normalize());
                    tracks.entry(index).or_default().rotations = Some(Keys { times, values, is_stepped });
                }
                (Property::Scale | Property::MorphTargetWeights, _) => {
                    warn(&format!("{place} changes a size or a shape, which is left as it is"));
                }
                _ => return Err(file.error(place, "has values of another kind than what it moves")),
            }
        }
        Ok(Self { nodes, parents, tracks })
    }

    /// The node and those above it; of a ring, which nothing shows, each once.
    fn line(&self, index: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(Some(index), |&index| self.parents[index]).take(self.nodes.len())
    }

    /// Returns true if a node, or one above it, moves.
    fn is_moving(&self, index: usize) -> bool {
        self.line(index).any(|index| self.tracks.contains_key(&index))
    }

    /// Returns true for a node whose mesh moves: its own, or a skin of joints that move.
    pub fn moves_mesh(&self, node: &Node) -> bool {
        match node.skin() {
            Some(skin) => skin.joints().any(|joint| self.is_moving(joint.index())),
            None => self.is_moving(node.index()),
        }
    }

    fn world(&self, index: usize, time: f32) -> Mat4 {
        let local = |index: usize| {
            let transform = self.nodes[index].transform();
            let Some(tracks) = self.tracks.get(&index) else {
                return Mat4::from_cols_array_2d(&transform.matrix());
            };
            let (position, rotation, scale) = transform.decomposed();
            let moved = tracks.positions.as_ref().and_then(|keys| keys.at(time, |a, b, share| a.lerp(b, share)));
            let turned = tracks.rotations.as_ref().and_then(|keys| keys.at(time, |a, b, share| a.slerp(b, share)));
            let rotation = turned.unwrap_or(Quat::from_array(rotation));
            Mat4::from_scale_rotation_translation(scale.into(), rotation, moved.unwrap_or(position.into()))
        };
        self.line(index).fold(Mat4::IDENTITY, |below, index| local(index) * below)
    }

    /// Size and poses of a node; none where its size changes.
    fn poses(&self, index: usize) -> Option<(Vec3, Vec<Pose>)> {
        let own: Vec<&Tracks> = self.line(index).filter_map(|index| self.tracks.get(&index)).collect();
        let mut times: Vec<f32> = own.iter().flat_map(|tracks| tracks.times()).collect();
        if own.is_empty() {
            times.push(0.0);
        }
        times.sort_by(f32::total_cmp);
        times.dedup();
        if own.len() > 1 {
            let between = |pair: &[f32]| {
                let [a, b] = [pair[0], pair[1]];
                (1..BETWEEN).map(move |k| a + (b - a) * k as f32 / BETWEEN as f32)
            };
            let more: Vec<f32> = times.windows(2).flat_map(between).collect();
            times.extend(more);
            times.sort_by(f32::total_cmp);
            times.dedup();
        }
        let place = |time: f32| (time, self.world(index, time).to_scale_rotation_translation());
        let placed: Vec<_> = times.iter().map(|&time| place(time)).collect();
        let scale = placed.first().map_or(Vec3::ONE, |placed| placed.1.0);
        let is_rigid = |found: Vec3| (found - scale).abs().max_element() <= RIGID * scale.abs().max_element();
        if !placed.iter().all(|(_, (found, ..))| is_rigid(*found)) {
            return None;
        }
        let pose = |(time, (_, rotation, position)): (f32, (Vec3, Quat, Vec3))| Pose { time, position, rotation };
        Some((scale, placed.into_iter().map(pose).collect()))
    }

    /// Objects of a node's mesh, in units of the file; none where they rest instead, which is said.
    pub fn objects(
        &self,
        file: &File,
        node: &Node,
        rules: &[UvRule],
        warnings: &mut Vec<String>,
    ) -> Result<Option<Vec<MovingObject>>, ImportError> {
        let name = label(node);
        let place = format!("node {} \"{name}\"", node.index());
        let mut rest = |why: &str| warnings.push(format!("{}, {place}: {why}; it rests", file.path.display()));
        // Movers by their number in the skin, and what brings vertices to them.
        let movers: Vec<(usize, String, Mat4)> = match node.skin() {
            None => vec![(node.index(), name.clone(), Mat4::IDENTITY)],
            Some(skin) => {
                if let Some(accessor) = skin.inverse_bind_matrices() {
                    check_accessor(file, &accessor, &place)?;
                }
                let matrices = skin.reader(|buffer| file.buffer(&buffer)).read_inverse_bind_matrices();
                let mut matrices = matrices.into_iter().flatten().map(|matrix| Mat4::from_cols_array_2d(&matrix));
                let joint = |joint: Node| {
                    (joint.index(), format!("{name} {}", label(&joint)), matrices.next().unwrap_or_default())
                };
                skin.joints().map(joint).collect()
            }
        };
        let mut objects = Vec::new();
        let mut count = 0;
        for primitive in node.mesh().into_iter().flat_map(|shape| shape.primitives()) {
            let place = format!("{place}, primitive {}", primitive.index());
            let is_faces = matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan);
            let Some(positions) = primitive.get(&Semantic::Positions).filter(|_| is_faces) else { continue };
            let material = primitive.material().index().unwrap_or(rules.len() - 1);
            let read = read_vertices(file, &primitive, &positions, Mat4::IDENTITY, &rules[material], &place)?;
            let Some(vertices) = read else { continue };
            let parts = match node.skin() {
                None => vec![vertices.indices.clone()],
                Some(_) => match by_joint(file, &primitive, &vertices, movers.len(), &place)? {
                    Some(parts) => parts,
                    None => {
                        rest("its skin has no joints or weights of its vertices");
                        return Ok(None);
                    }
                },
            };
            for ((index, name, to_mover), indices) in movers.iter().zip(parts) {
                let Some((scale, poses)) = self.poses(*index) else {
                    rest("its size changes");
                    return Ok(None);
                };
                let into = Mat4::from_scale(scale) * *to_mover;
                let moved = vertices.positions.iter().map(|&p| into.transform_point3(p)).collect();
                let part = Vertices { positions: moved, indices, uvs: vertices.uvs.clone(), ..Vertices::default() };
                let mode = if node.skin().is_some() { Mode::Triangles } else { primitive.mode() };
                let mut mesh = Mesh { objects: vec![String::new()], ..Mesh::default() };
                add_faces(mode, &part, (material as u32, into.determinant() < 0.0), &mut mesh)
                    .map_err(|reason| file.error(&place, reason))?;
                count += mesh.triangles.len();
                let has_area = |t: &&FileTriangle| {
                    let [a, b, c] = t.corners;
                    (b - a).cross(c - a).length_squared() > 0.0
                };
                let object =
                    MovingObject::of_triangles(name.clone(), material, mesh.triangles.iter().filter(has_area), poses);
                objects.extend((!object.corners.is_empty()).then_some(object));
            }
        }
        if count > MOST_TRIANGLES {
            rest(&format!("has {count} triangles, and what moves up to {MOST_TRIANGLES}"));
            return Ok(None);
        }
        Ok(Some(objects))
    }
}

/// Values at the keys: of cubic splines those between the tangents; none where there are too few.
fn at_keys<T: Copy>(values: Vec<T>, count: usize, is_cubic: bool) -> Option<Vec<T>> {
    let values: Vec<T> = match is_cubic {
        true => values.chunks_exact(3).map(|key| key[1]).take(count).collect(),
        false => values.into_iter().take(count).collect(),
    };
    (values.len() == count).then_some(values)
}

/// Corners of the triangles of each joint of a skin; none where the vertices have no weights.
fn by_joint(
    file: &File,
    primitive: &gltf::Primitive,
    vertices: &Vertices,
    count: usize,
    place: &str,
) -> Result<Option<Vec<Vec<u32>>>, ImportError> {
    let own = [Semantic::Joints(0), Semantic::Weights(0)].map(|semantic| primitive.get(&semantic));
    for accessor in own.iter().flatten() {
        check_accessor(file, accessor, place)?;
    }
    let reader = primitive.reader(|buffer| file.buffer(&buffer));
    let (Some(joints), Some(weights)) = (reader.read_joints(0), reader.read_weights(0)) else { return Ok(None) };
    if primitive.mode() != Mode::Triangles {
        return Ok(None);
    }
    let held: Vec<[(u16, f32); 4]> = joints
        .into_u16()
        .zip(weights.into_f32())
        .map(|(joints, weights)| [0, 1, 2, 3].map(|k| (joints[k], weights[k])))
        .collect();
    let mut parts = vec![Vec::new(); count];
    for face in vertices.indices.chunks_exact(3) {
        let mut sums: BTreeMap<u16, f32> = BTreeMap::new();
        let of_face = face.iter().filter_map(|&vertex| held.get(vertex as usize)).flatten();
        of_face.for_each(|&(joint, weight)| *sums.entry(joint).or_default() += weight);
        let most = sums.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some(part) = most.and_then(|(joint, _)| parts.get_mut(joint as usize)) {
            part.extend_from_slice(face);
        }
    }
    Ok(Some(parts))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use base64::Engine;
    use base64::engine::general_purpose::STANDARD;

    use super::*;
    use crate::import::{LoadOptions, gltf_file};

    /// Tables of a file.
    #[derive(Default)]
    struct Tables {
        bytes: Vec<u8>,
        views: Vec<String>,
        accessors: Vec<String>,
    }

    impl Tables {
        /// Adds an accessor; its number.
        fn add(&mut self, bytes: &[u8], component: u32, kind: &str, count: usize) -> usize {
            let view = format!(r#"{{"buffer":0,"byteOffset":{},"byteLength":{}}}"#, self.bytes.len(), bytes.len());
            self.views.push(view);
            self.bytes.extend_from_slice(bytes);
            let number = self.accessors.len();
            let accessor = format!(
                r#"{{"bufferView":{number},"componentType":{component},"type":"{kind}","count":{count},"min":[0,0,0],"max":[1,1,1]}}"#
            );
            let accessor =
                if kind == "VEC3" { accessor } else { accessor.replace(r#","min":[0,0,0],"max":[1,1,1]"#, "") };
            self.accessors.push(accessor);
            number
        }

        fn floats(&mut self, kind: &str, width: usize, values: &[f32]) -> usize {
            self.add(bytemuck::cast_slice(values), 5126, kind, values.len() / width)
        }

        fn file(&self, rest: &str) -> String {
            let data = STANDARD.encode(&self.bytes);
            format!(
                r#"{{"asset":{{"version":"2.0"}},"scene":0,{rest},"buffers":[{{"byteLength":{},"uri":"data:application/octet-stream;base64,{data}"}}],"bufferViews":[{}],"accessors":[{}]}}"#,
                self.bytes.len(),
                self.views.join(","),
                self.accessors.join(",")
            )
        }
    }

    /// A triangle that rests, one on an arm that turns on a base that goes, with this interpolation and channel.
    fn arm(interpolation: &str, path: &str) -> String {
        let mut t = Tables::default();
        let corners = t.floats("VEC3", 3, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
        let times = t.floats("SCALAR", 1, &[0.0, 1.0]);
        let ways = t.floats("VEC3", 3, &[0.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let turns = t.floats("VEC4", 4, &[0.0, 0.0, 0.0, 1.0, 0.0, half, 0.0, half]);
        t.file(&format!(
            r#""scenes":[{{"nodes":[0,1]}}],
            "nodes":[{{"name":"floor","mesh":0}},{{"name":"base","children":[2]}},
                {{"name":"arm","mesh":0,"translation":[0,3,0],"scale":[2,2,2]}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":{corners}}}}}]}}],
            "animations":[{{"samplers":[{{"input":{times},"output":{ways},"interpolation":"{interpolation}"}},
                {{"input":{times},"output":{turns}}}],
                "channels":[{{"sampler":0,"target":{{"node":1,"path":"{path}"}}}},
                {{"sampler":1,"target":{{"node":2,"path":"rotation"}}}}]}}]"#
        ))
    }

    fn read(text: &str) -> Result<Mesh, ImportError> {
        gltf_file::load(Path::new("arm.gltf"), text.as_bytes(), &LoadOptions::default())
    }

    #[test]
    fn animated_nodes_move_and_the_others_rest() {
        let mesh = read(&arm("LINEAR", "translation")).unwrap();
        assert_eq!((mesh.triangles.len(), mesh.objects.len(), mesh.moving.len()), (1, 1, 1));
        let object = &mesh.moving[0];
        assert_eq!(object.name, "arm");
        let tip = |time: f32| object.transform(time).transform_point3(object.corners[1]);
        assert!((tip(0.0) - Vec3::new(2.0, 3.0, 0.0)).length() < 1e-5, "{}", tip(0.0));
        assert!((tip(1.0) - Vec3::new(2.0, 3.0, -2.0)).length() < 1e-5, "{}", tip(1.0));
        let half = 2.0 * std::f32::consts::FRAC_1_SQRT_2;
        assert!((tip(0.5) - Vec3::new(1.0 + half, 3.0, -half)).length() < 0.02, "{}", tip(0.5));
        let stepped = read(&arm("STEP", "translation")).unwrap();
        let origin = |time: f32| stepped.moving[0].transform(time).translation.x;
        assert!(origin(0.9).abs() < 1e-5 && (origin(1.0) - 2.0).abs() < 1e-5);
    }

    #[test]
    fn sizes_rest_and_faulty_animations_are_named() {
        let mesh = read(&arm("LINEAR", "scale")).unwrap();
        assert!(mesh.moving.len() == 1 && mesh.warnings.iter().any(|w| w.contains("channel 0 changes a size")));
        let error = read(&arm("LINEAR", "rotation")).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(error.contains("animation 0, channel 0") || error.contains("not valid"), "{error}");
        let backwards = arm("CUBICSPLINE", "translation");
        let error = read(&backwards).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(error.contains("fewer values than its 2 times"), "{error}");
    }

    #[test]
    fn parts_of_a_skin_follow_their_joints() {
        let mut t = Tables::default();
        let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 5.0, 0.0, 1.0, 5.0, 0.0, 0.0, 5.0, -1.0];
        let corners = t.floats("VEC3", 3, &corners);
        let joints: Vec<u8> = [[0u8, 1, 0, 0]; 6].concat();
        let joints = t.add(&joints, 5121, "VEC4", 6);
        let (low, high) = ([0.9, 0.1, 0.0, 0.0], [0.2, 0.8, 0.0, 0.0]);
        let weights = t.floats("VEC4", 4, &[low, low, low, high, high, high].concat());
        let to_root = Mat4::from_translation(Vec3::NEG_X).to_cols_array();
        let to_hand = Mat4::from_translation(Vec3::new(-1.0, -5.0, 0.0)).to_cols_array();
        let matrices = t.floats("MAT4", 16, &[to_root, to_hand].concat());
        let times = t.floats("SCALAR", 1, &[0.0, 1.0]);
        let ways = t.floats("VEC3", 3, &[0.0, 5.0, 0.0, 0.0, 7.0, 0.0]);
        let floor = t.floats("VEC3", 3, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
        let mesh = read(&t.file(&format!(
            r#""scenes":[{{"nodes":[0,1,2]}}],
            "nodes":[{{"mesh":1}},{{"name":"root","translation":[1,0,0],"children":[3]}},{{"name":"body","mesh":0,"skin":0}},
                {{"name":"hand","translation":[0,5,0]}}],
            "skins":[{{"joints":[1,3],"inverseBindMatrices":{matrices}}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":{corners},"JOINTS_0":{joints},"WEIGHTS_0":{weights}}}}}]}},
                {{"primitives":[{{"attributes":{{"POSITION":{floor}}}}}]}}],
            "animations":[{{"samplers":[{{"input":{times},"output":{ways}}}],
                "channels":[{{"sampler":0,"target":{{"node":3,"path":"translation"}}}}]}}]"#
        )))
        .unwrap();
        let names: Vec<&str> = mesh.moving.iter().map(|object| object.name.as_str()).collect();
        assert_eq!((names, mesh.triangles.len()), (vec!["body root", "body hand"], 1));
        let corner = |k: usize, time: f32| {
            let object = &mesh.moving[k];
            object.transform(time).transform_point3(object.corners[0])
        };
        assert!(corner(0, 1.0).length() < 1e-5);
        assert!((corner(1, 0.0) - Vec3::Y * 5.0).length() < 1e-5 && (corner(1, 1.0) - Vec3::Y * 7.0).length() < 1e-5);
    }
}
