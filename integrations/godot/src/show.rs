//! A lightmap and its probes in Godot's rendering server, on meshes of their own beside those of the scene.

use godot::classes::geometry_instance_3d::GiMode;
use godot::classes::image::Format;
use godot::classes::mesh::{ArrayType, PrimitiveType};
use godot::classes::rendering_server::TextureLayeredType;
use godot::classes::{ArrayMesh, GeometryInstance3D, Image, MeshInstance3D, Node, RenderingServer};
use godot::prelude::*;
use patchlight::glam::{Vec2, Vec3};
use patchlight::outputs::LiveLightmap;

use crate::gather::{Gathered, below};
use crate::probes::{Tetrahedra, harmonics};
use crate::work::{Light, ProbeLight};

/// Rows below the atlas that stay dark, for triangles to which no light comes.
const DARK_ROWS: u32 = 2;
/// Bytes of a texel.
const TEXEL: usize = 6;

/// Meshes with their places in a lightmap, the lightmap, and its probes.
pub struct Show {
    /// Meshes of the scene, and the one that takes the place of each.
    meshes: Vec<(Gd<MeshInstance3D>, Gd<ArrayMesh>)>,
    size: (u32, u32),
    scenario: Rid,
    texture: Option<Rid>,
    lightmap: Rid,
    /// Made when there is light: Godot does not hear of bounds that it gets later.
    instance: Option<Rid>,
    probes: Option<Tetrahedra>,
}

impl Show {
    /// Makes the meshes; they are shown with the first light.
    pub fn new(gathered: &Gathered, lightmap: &LiveLightmap, scenario: Rid) -> Self {
        let (width, height) = lightmap.size();
        let corners = gathered.corners();
        let uvs = lightmap.corner_uvs(&corners);
        let all = (height + DARK_ROWS) as f32;
        let dark = Vector2::new(0.5 / width as f32, 1.0 - 0.5 / all);
        let in_picture = |uv: Vec2| Vector2::new(uv.x, uv.y * height as f32 / all);
        let mut of_surface = Vec::new();
        let mut first = 0;
        for (surface, _) in &gathered.surfaces {
            let count = surface.positions.len() / 3;
            let own = uvs[first..first + count].iter().flat_map(|uvs| match uvs {
                // Godot's second corner is our third.
                Some([a, b, c]) => [*a, *c, *b].map(in_picture),
                None => [dark; 3],
            });
            of_surface.push(own.collect::<PackedVector2Array>());
            first += count;
        }
        let meshes = gathered.meshes.iter().map(|(instance, surfaces)| {
            let mut mesh = ArrayMesh::new_gd();
            for (number, (arrays, surface)) in surfaces.iter().enumerate() {
                let own = arrays.duplicate_shallow();
                if let Some(surface) = surface {
                    own.clone().set(ArrayType::TEX_UV2.ord() as usize, &of_surface[*surface].to_variant());
                }
                mesh.add_surface_from_arrays(PrimitiveType::TRIANGLES, &own);
                if let Some(material) = instance.get_active_material(number as i32) {
                    mesh.surface_set_material(number as i32, &material);
                }
            }
            (instance.clone(), mesh)
        });
        let meshes = meshes.collect();
        let own = RenderingServer::singleton().lightmap_create();
        Self {
            meshes,
            size: (width, height + DARK_ROWS),
            texture: None,
            scenario,
            lightmap: own,
            instance: None,
            probes: None,
        }
    }

    /// Shows a light.
    pub fn show(&mut self, light: &Light, root: &Gd<Node>) {
        let (width, height) = self.size;
        let mut texels = light.texels.clone();
        texels.resize(TEXEL * width as usize * height as usize, 0);
        let bytes = PackedByteArray::from(texels);
        let Some(image) = Image::create_from_data(width as i32, height as i32, false, Format::RGBH, &bytes) else {
            return;
        };
        let mut server = RenderingServer::singleton();
        match self.texture {
            Some(texture) => server.texture_2d_update(texture, &image, 0),
            None => {
                let layers = array![&image];
                let texture = server.texture_2d_layered_create(&layers, TextureLayeredType::LAYERED_2D_ARRAY);
                server.lightmap_set_textures(self.lightmap, texture, false);
                self.texture = Some(texture);
            }
        }
        if let Some(probes) = &light.probes {
            self.show_probes(probes, root);
        }
        if self.instance.is_none() {
            self.attach();
        }
    }

    fn show_probes(&mut self, light: &ProbeLight, root: &Gd<Node>) {
        if self.probes.as_ref().is_none_or(|own| own.grid != light.grid) {
            self.probes = Tetrahedra::new(light.grid);
            // Godot lets probes fade towards the low corners of their bounds; at a third of the way they are whole.
            let size = light.grid.step * Vec3::from(light.grid.counts.map(|count| count as f32));
            let low = light.grid.first - 0.5 * light.grid.step - size;
            let vector = |v: Vec3| Vector3::new(v.x, v.y, v.z);
            let bounds = Aabb::new(vector(low), vector(3.0 * size));
            let mut server = RenderingServer::singleton();
            server.lightmap_set_probe_bounds(self.lightmap, bounds);
            server.lightmap_set_probe_interior(self.lightmap, false);
            if let Some(instance) = self.instance.take() {
                server.free_rid(instance);
            }
        }
        if let Some(own) = &self.probes {
            RenderingServer::singleton().lightmap_set_probe_capture_data(
                self.lightmap,
                &own.points,
                &harmonics(light),
                &own.tetrahedra,
                &own.tree,
            );
        }
        // Godot looks at probes when an instance changes.
        let mut all = Vec::new();
        below::<GeometryInstance3D>(root, &mut all);
        let mut server = RenderingServer::singleton();
        for instance in all.iter().filter(|instance| instance.get_gi_mode() == GiMode::DYNAMIC) {
            server.instance_set_extra_visibility_margin(instance.get_instance(), instance.get_extra_cull_margin());
        }
    }

    /// Puts the meshes with their lightmap into the place of those of the scene, whose nodes know nothing of it.
    fn attach(&mut self) {
        let mut server = RenderingServer::singleton();
        let lightmap = server.instance_create2(self.lightmap, self.scenario);
        self.instance = Some(lightmap);
        let whole = Rect2::new(Vector2::ZERO, Vector2::ONE);
        for (instance, mesh) in &self.meshes {
            if !instance.is_instance_valid() {
                continue;
            }
            let own = instance.get_instance();
            server.instance_set_base(own, mesh.get_rid());
            server.instance_geometry_set_lightmap(own, lightmap, whole, 0);
        }
    }
}

impl Drop for Show {
    fn drop(&mut self) {
        let mut server = RenderingServer::singleton();
        for (instance, _) in &self.meshes {
            if !instance.is_instance_valid() {
                continue;
            }
            let own = instance.get_instance();
            server.instance_geometry_set_lightmap(own, Rid::Invalid, Rect2::default(), 0);
            if let Some(mesh) = instance.get_mesh() {
                server.instance_set_base(own, mesh.get_rid());
                for surface in 0..instance.get_surface_override_material_count() {
                    let material = instance.get_surface_override_material(surface);
                    let material = material.map_or(Rid::Invalid, |own| own.get_rid());
                    server.instance_set_surface_override_material(own, surface, material);
                }
            }
        }
        if let Some(instance) = self.instance {
            server.free_rid(instance);
        }
        server.free_rid(self.lightmap);
        if let Some(texture) = self.texture {
            server.free_rid(texture);
        }
    }
}
