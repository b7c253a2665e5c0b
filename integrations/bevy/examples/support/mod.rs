//! Patchlight's scenes as those of Bevy: meshes by object and material, cameras, lights.

use std::collections::BTreeMap;

use assets::LoadedScene;
use bevy::asset::RenderAssetUsages;
use bevy::camera::Exposure;
use bevy::image::ImageAddressMode;
use bevy::image::{ImageSampler, ImageSamplerDescriptor};
use bevy::mesh::PrimitiveTopology;
use bevy::prelude::*;
use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat};
use bevy_patchlight::PatchlightStatic;
use patchlight::scene::gpu::{
    LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT, Light as OwnLight, Texture as OwnTexture,
};
use patchlight::scene::kernel::shade::encode_srgb;
use patchlight::scene::kernel::texture::texel;
use patchlight::scene::{LUMENS_PER_WATT, NONE};

/// A vector of Patchlight's as one of Bevy's.
pub fn vector(v: patchlight::glam::Vec3) -> Vec3 {
    Vec3::from_array(v.to_array())
}

fn linear(v: patchlight::glam::Vec3) -> Color {
    Color::linear_rgb(v.x, v.y, v.z)
}

/// Spawns the resting meshes of a scene, marked.
pub fn spawn_meshes(
    scene: &LoadedScene,
    commands: &mut Commands,
    meshes: &mut Assets<Mesh>,
    materials: &mut Assets<StandardMaterial>,
    images: &mut Assets<Image>,
) {
    let geometry = &scene.scene.geometry;
    let tables = scene.scene.tables();
    let textures: Vec<Handle<Image>> =
        geometry.textures.iter().map(|own| images.add(texture(own, &geometry.texels))).collect();
    let texture = |index: u32| (index != NONE).then(|| textures[index as usize].clone());
    let handles: Vec<Handle<StandardMaterial>> = scene
        .scene
        .materials
        .iter()
        .map(|own| {
            let base_color_texture = texture(own.albedo_texture);
            let radiance = own.radiance * LUMENS_PER_WATT;
            materials.add(StandardMaterial {
                base_color: if base_color_texture.is_some() { Color::WHITE } else { linear(own.albedo) },
                base_color_texture,
                emissive: LinearRgba::rgb(radiance.x, radiance.y, radiance.z),
                emissive_exposure_weight: 1.0,
                perceptual_roughness: 1.0,
                reflectance: 0.0,
                alpha_mode: if own.mask_texture == NONE { AlphaMode::Opaque } else { AlphaMode::Mask(own.mask_cutoff) },
                double_sided: true,
                cull_mode: None,
                ..default()
            })
        })
        .collect();
    let mut groups: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
    for (number, triangle) in geometry.triangles.iter().enumerate() {
        groups.entry((triangle.object, triangle.material)).or_default().push(number);
    }
    for ((object, material), triangles) in groups {
        let mut positions = Vec::new();
        let mut normals = Vec::new();
        let mut uvs = Vec::new();
        for number in triangles {
            let own = &geometry.triangles[number];
            let uv = &geometry.uvs[number];
            let flat = tables.normal(number as u32);
            positions.extend([own.corner, own.corner + own.edge_a, own.corner + own.edge_b].map(|p| p.to_array()));
            normals.extend(uv.normals().unwrap_or([flat; 3]).map(|n| n.to_array()));
            uvs.extend([uv.corner, uv.corner_a, uv.corner_b].map(|uv| [uv.x, 1.0 - uv.y]));
        }
        let mesh = Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
            .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
            .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, normals)
            .with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, uvs);
        let name = scene.objects.get(object as usize).cloned().unwrap_or_default();
        let material = handles[material as usize].clone();
        commands.spawn((Name::new(name), Mesh3d(meshes.add(mesh)), MeshMaterial3d(material), PatchlightStatic));
    }
}

/// A texture with its coarser levels.
fn texture(own: &OwnTexture, texels: &[u32]) -> Image {
    let level = |k: u32| (own.width >> k).max(1) * (own.height >> k).max(1);
    let bytes = (0..(0..own.levels).map(level).sum()).flat_map(|k| {
        let color = texel(texels, own.offset + k);
        let srgb = |x: f32| (encode_srgb(x.clamp(0.0, 1.0)) * 255.0 + 0.5) as u8;
        [srgb(color.x), srgb(color.y), srgb(color.z), (color.w * 255.0 + 0.5) as u8]
    });
    let size = Extent3d { width: own.width, height: own.height, depth_or_array_layers: 1 };
    let format = TextureFormat::Rgba8UnormSrgb;
    let mut image = Image::new_fill(size, TextureDimension::D2, &[0; 4], format, RenderAssetUsages::default());
    image.data = Some(bytes.collect());
    image.texture_descriptor.mip_level_count = own.levels;
    let mut sampler = ImageSamplerDescriptor { anisotropy_clamp: 8, ..ImageSamplerDescriptor::linear() };
    sampler.set_address_mode(ImageAddressMode::Repeat);
    image.sampler = ImageSampler::Descriptor(sampler);
    image
}

/// Spawns a light, for tests; a spot's fall-off and a rectangle's lack of shadows are Bevy's.
#[allow(dead_code, reason = "examples have lights of their own")]
pub fn spawn_light(light: &OwnLight, commands: &mut Commands) -> Option<Entity> {
    let color = light.color * LUMENS_PER_WATT;
    let size = color.max_element();
    let tint = linear(color / size.max(f32::MIN_POSITIVE));
    let sphere = 4.0 * std::f32::consts::PI;
    let along = |direction: Vec3| {
        let up = if direction.y.abs() > 0.99 { Vec3::X } else { Vec3::Y };
        Transform::from_translation(vector(light.position)).looking_to(direction, up)
    };
    let entity = match light.kind {
        LIGHT_DIRECTIONAL => commands.spawn((
            DirectionalLight { color: tint, illuminance: size, shadow_maps_enabled: true, ..default() },
            along(vector(light.direction)),
        )),
        LIGHT_POINT => commands.spawn((
            PointLight { color: tint, intensity: size * sphere, range: 100.0, shadow_maps_enabled: true, ..default() },
            Transform::from_translation(vector(light.position)),
        )),
        LIGHT_SPOT => commands.spawn((
            SpotLight {
                color: tint,
                intensity: size * sphere,
                range: 100.0,
                inner_angle: light.cos_inner.acos(),
                outer_angle: light.cos_outer.acos(),
                shadow_maps_enabled: true,
                ..default()
            },
            along(vector(light.direction)),
        )),
        LIGHT_RECT => {
            let (a, b) = (vector(light.edge_a), vector(light.edge_b));
            let mut transform = Transform::from_translation(vector(light.position) + 0.5 * (a + b));
            transform.look_to(a.cross(b).normalize(), a.normalize());
            let lumens = size * std::f32::consts::PI * light.area;
            commands.spawn((
                RectLight { color: tint, intensity: lumens, range: 100.0, width: b.length(), height: a.length() },
                transform,
            ))
        }
        _ => return None,
    };
    Some(entity.id())
}

/// The camera of a scene: place, projection, and the exposure with which a picture shows its radiance in W/m²/sr times
/// `scale`.
pub fn camera(scene: &LoadedScene, scale: f32) -> impl Bundle {
    let view = &scene.view;
    let transform = Transform::from_translation(vector(view.eye)).looking_at(vector(view.target), vector(view.up));
    let projection = PerspectiveProjection { fov: view.vertical_fov_degrees.to_radians(), near: 0.01, ..default() };
    // Bevy multiplies by 2^-EV / 1.2.
    let ev100 = -(1.2 * scale / LUMENS_PER_WATT).log2();
    (Camera3d::default(), Projection::Perspective(projection), transform, Exposure { ev100 })
}
