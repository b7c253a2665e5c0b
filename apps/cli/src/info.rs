//! `patchlight info`.

mod operator;

use std::time::Instant;

use scene::gpu::{LIGHT_DIRECTIONAL, LIGHT_LUMINAIRE, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT};
use scene::math::luminance;
use scene::{LUMENS_PER_WATT, NONE};
use serde::Serialize;

use assets::import::{LoadedScene, load_or_build};
use shell::Error;
use shell::args::{Common, FormFactors, OperatorOptions, PatchOptions};
use shell::output;
use shell::progress::interruptible;

use patches::{Density, MeshSettings, PatchKind, PatchMesh, lit_sampler};
use patchlight::BakeSettings;

#[derive(Serialize)]
struct Info {
    scene: String,
    file_triangles: usize,
    triangles: usize,
    dropped_zero_area: usize,
    dropped_duplicates: usize,
    dropped_holes: usize,
    objects: usize,
    materials: usize,
    textured_materials: usize,
    masked_materials: usize,
    emissive_materials: usize,
    textures: usize,
    area_m2: f64,
    emitting_area_m2: f64,
    bounds_m: [[f32; 3]; 2],
    metres_per_unit: f32,
    lights: Vec<String>,
    sky: String,
    hierarchy_nodes: usize,
    bytes: Vec<(&'static str, u64)>,
    seconds: Vec<(&'static str, f64)>,
    #[serde(skip_serializing_if = "Option::is_none")]
    patches: Option<Patches>,
    #[serde(skip_serializing_if = "Option::is_none")]
    operator: Option<operator::Operator>,
}

/// Patches of a scene.
#[derive(Serialize)]
struct Patches {
    kind: &'static str,
    /// Voxels with patches, and their edge.
    #[serde(skip_serializing_if = "Option::is_none")]
    voxels: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    voxel_edge_m: Option<f32>,
    samples: usize,
    sample_points: usize,
    patches: usize,
    elements: usize,
    /// Area of all patches, and of both sides of all triangles.
    area_m2: f64,
    surface_sides_m2: f64,
    min_area_m2: f32,
    median_area_m2: f32,
    max_area_m2: f32,
    bytes: Vec<(&'static str, u64)>,
    seconds: f64,
}

pub fn run(common: &Common, spec: &str, patches: &PatchOptions, operator: &OperatorOptions) -> Result<(), Error> {
    if !operator.needs_device() {
        common.native_only("info without --operator --codec bc1, bc3, bc6h or bc7")?;
    }
    if operator.operator {
        common.out.as_deref().map(output::check_folder).transpose()?;
    }
    let loaded = interruptible(|| load_or_build(spec))?;
    for line in &loaded.warnings {
        tell!("warning: {line}");
    }
    let mut info = Info::of(&loaded);
    if patches.is_given() || operator.operator {
        let start = Instant::now();
        let kind = patches.kind(FormFactors::Hemisphere);
        let settings = BakeSettings::default()
            .with_patches(kind)
            .with_patch_count(patches.count())
            .with_focus(patches.focus.unwrap_or_default().focus(&loaded, &loaded.animation))
            .with_voxel_size(patches.voxel_size)
            .with_seed(common.seed);
        let mesh = interruptible(|| make_mesh(&loaded, &settings))?;
        info.patches = Some(Patches::of(&mesh, kind, info.area_m2, start.elapsed().as_secs_f64()));
        if operator.operator {
            let source = operator::Source { loaded: &loaded, mesh: &mesh, settings: &settings };
            info.operator = Some(operator::Operator::of(common, &source, operator)?);
        }
    }
    if common.json {
        say!("{}", output::json(&info));
    } else {
        info.print();
    }
    Ok(())
}

impl Info {
    fn of(loaded: &LoadedScene) -> Self {
        let s = &loaded.scene;
        let count = |f: &dyn Fn(&scene::Material) -> bool| s.materials.iter().filter(|m| f(m)).count();
        let lights = s.lighting.lights.iter().map(|l| match l.kind {
            LIGHT_DIRECTIONAL => format!("directional, irradiance {} W/m²", l.color),
            LIGHT_POINT => format!("point at {} m, intensity {} W/sr", l.position, l.color),
            LIGHT_SPOT => format!("spot at {} m, intensity {} W/sr", l.position, l.color),
            LIGHT_RECT => format!("rectangle of {:.3} m², radiance {} W/m²/sr", l.area, l.color),
            LIGHT_LUMINAIRE => {
                let power = 4.0 * std::f32::consts::PI * l.color;
                let flux = LUMENS_PER_WATT * luminance(power);
                format!("luminaire at {} m, power {power} W, flux {flux:.0} lm", l.position)
            }
            other => format!("unknown kind {other}"),
        });
        let size = |bytes: usize| bytes as u64;
        Self {
            scene: loaded.name.clone(),
            file_triangles: loaded.file_triangles,
            triangles: s.geometry.triangles.len(),
            dropped_zero_area: loaded.dropped.zero_area,
            dropped_duplicates: loaded.dropped.duplicates,
            dropped_holes: loaded.dropped.holes,
            objects: loaded.objects.len(),
            materials: s.materials.len(),
            textured_materials: count(&|m| m.albedo_texture != NONE),
            masked_materials: count(&|m| m.mask_texture != NONE),
            emissive_materials: count(&|m| m.radiance.max_element() > 0.0),
            textures: s.geometry.textures.len(),
            area_m2: s.geometry.triangles.iter().map(|t| f64::from(0.5 * t.edge_a.cross(t.edge_b).length())).sum(),
            // The sum of nothing is −0.
            emitting_area_m2: s.emitters.iter().map(|e| f64::from(e.area)).sum::<f64>().abs(),
            bounds_m: [s.geometry.bounds.0.to_array(), s.geometry.bounds.1.to_array()],
            metres_per_unit: loaded.metres_per_unit,
            lights: lights.collect(),
            sky: match (s.has_sky(), s.lighting.sky.map_width) {
                (false, _) => "none".into(),
                (true, 0) => format!("constant, radiance {} W/m²/sr", s.lighting.sky.radiance),
                (true, width) => format!("map of {width} x {}", s.lighting.sky.map_height),
            },
            hierarchy_nodes: s.geometry.nodes.len(),
            bytes: vec![
                ("triangles", size(size_of_val(&s.geometry.triangles[..]) + size_of_val(&s.geometry.uvs[..]))),
                ("hierarchy", size(size_of_val(&s.geometry.nodes[..]))),
                ("texels", size(size_of_val(&s.geometry.texels[..]))),
                ("sky map", size(size_of_val(&s.lighting.sky_map[..]))),
                ("distributions", size(size_of_val(&s.lighting.distributions[..]))),
            ],
            seconds: loaded.timings.clone(),
            patches: None,
            operator: None,
        }
    }

    fn print(&self) {
        say!("{:24} {}", "scene", self.scene);
        say!("{:24} {} (file: {})", "triangles", self.triangles, self.file_triangles);
        say!(
            "{:24} {} without area, {} duplicates, {} transparent",
            "dropped",
            self.dropped_zero_area,
            self.dropped_duplicates,
            self.dropped_holes
        );
        say!("{:24} {}", "objects", self.objects);
        say!(
            "{:24} {} ({} textured, {} masked, {} emissive)",
            "materials",
            self.materials,
            self.textured_materials,
            self.masked_materials,
            self.emissive_materials
        );
        say!("{:24} {}", "textures", self.textures);
        say!("{:24} {:.4} m² (emitting {:.6} m²)", "surface", self.area_m2, self.emitting_area_m2);
        say!("{:24} {:?} .. {:?} m", "bounds", self.bounds_m[0], self.bounds_m[1]);
        say!("{:24} {} m", "unit of the file", self.metres_per_unit);
        for light in &self.lights {
            say!("{:24} {light}", "light");
        }
        say!("{:24} {}", "sky", self.sky);
        say!("{:24} {} nodes", "hierarchy", self.hierarchy_nodes);
        for (name, count) in &self.bytes {
            say!("{:24} {}", format!("memory, {name}"), output::bytes(*count));
        }
        for (name, seconds) in &self.seconds {
            say!("{:24} {seconds:.3} s", format!("time, {name}"));
        }
        if let Some(patches) = &self.patches {
            patches.print();
        }
        if let Some(operator) = &self.operator {
            operator.print();
        }
    }
}

fn make_mesh(loaded: &LoadedScene, settings: &BakeSettings) -> Result<PatchMesh, Error> {
    let made = MeshSettings {
        kind: settings.patches,
        count: settings.patch_count,
        voxel_size: settings.voxel_size,
        samples: settings.samples,
        seed: settings.seed,
    };
    let density = match settings.patches.has_voxels() {
        true => Density::default(),
        false => Density::new(&loaded.scene, settings.focus, settings.seed)?,
    };
    let sampler = lit_sampler(&loaded.scene, made.count, density, made.seed)?;
    Ok(PatchMesh::new(&loaded.scene, sampler.as_ref(), &made)?)
}

impl Patches {
    /// `area`: of the triangles, one side, m².
    fn of(mesh: &PatchMesh, kind: PatchKind, area: f64, seconds: f64) -> Self {
        let mut areas = mesh.areas();
        areas.sort_by(f32::total_cmp);
        Self {
            kind: kind.name(),
            voxels: mesh.lookup.as_ref().map(|lookup| lookup.offsets.len() - 1),
            voxel_edge_m: mesh.lookup.as_ref().map(|lookup| lookup.params.shape.edges.x),
            samples: mesh.samples,
            sample_points: mesh.points.len(),
            patches: mesh.patches.len(),
            elements: mesh.elements.len(),
            area_m2: areas.iter().map(|&a| f64::from(a)).sum(),
            surface_sides_m2: 2.0 * area,
            min_area_m2: areas.first().copied().unwrap_or(0.0),
            median_area_m2: areas.get(areas.len() / 2).copied().unwrap_or(0.0),
            max_area_m2: areas.last().copied().unwrap_or(0.0),
            bytes: mesh.bytes().to_vec(),
            seconds,
        }
    }

    fn print(&self) {
        say!("{:24} {} of kind {}, {} elements", "patches", self.patches, self.kind, self.elements);
        if let (Some(voxels), Some(edge)) = (self.voxels, self.voxel_edge_m) {
            say!("{:24} {voxels} with patches, edge {edge:.4} m", "voxels");
        }
        say!("{:24} {} ({} points of patches)", "samples", self.samples, self.sample_points);
        say!("{:24} {:.4} m² (both sides of the surface: {:.4} m²)", "area", self.area_m2, self.surface_sides_m2);
        say!(
            "{:24} min {:.3e}, median {:.3e}, max {:.3e} m²",
            "area of a patch",
            self.min_area_m2,
            self.median_area_m2,
            self.max_area_m2
        );
        for (name, count) in &self.bytes {
            say!("{:24} {}", format!("memory, {name}"), output::bytes(*count));
        }
        say!("{:24} {:.3} s", "time, patches", self.seconds);
    }
}
