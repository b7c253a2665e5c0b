//! `patchlight info`.

use scene::{LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_RECT, LIGHT_SPOT, NONE};
use serde::Serialize;

use super::args::Common;
use super::output;
use crate::error::Error;
use crate::import::{LoadedScene, load_or_build};

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
}

pub fn run(common: &Common, spec: &str) -> Result<(), Error> {
    let loaded = load_or_build(spec)?;
    for line in &loaded.warnings {
        eprintln!("warning: {line}");
    }
    let info = Info::of(&loaded);
    if common.json {
        println!("{}", output::json(&info));
    } else {
        info.print();
    }
    Ok(())
}

impl Info {
    fn of(loaded: &LoadedScene) -> Self {
        let s = &loaded.scene;
        let area = |t: &scene::Triangle| f64::from(0.5 * t.edge_a.cross(t.edge_b).length());
        let count = |f: &dyn Fn(&scene::Material) -> bool| s.materials.iter().filter(|m| f(m)).count();
        let lights = s.lights.iter().map(|l| match l.kind {
            LIGHT_DIRECTIONAL => format!("directional, irradiance {} W/m²", l.color),
            LIGHT_POINT => format!("point at {} m, intensity {} W/sr", l.position, l.color),
            LIGHT_SPOT => format!("spot at {} m, intensity {} W/sr", l.position, l.color),
            LIGHT_RECT => format!("rectangle of {:.3} m², radiance {} W/m²/sr", l.area, l.color),
            other => format!("unknown kind {other}"),
        });
        let size = |bytes: usize| bytes as u64;
        Self {
            scene: loaded.name.clone(),
            file_triangles: loaded.file_triangles,
            triangles: s.triangles.len(),
            dropped_zero_area: loaded.dropped.zero_area,
            dropped_duplicates: loaded.dropped.duplicates,
            dropped_holes: loaded.dropped.holes,
            objects: loaded.objects.len(),
            materials: s.materials.len(),
            textured_materials: count(&|m| m.albedo_texture != NONE),
            masked_materials: count(&|m| m.mask_texture != NONE),
            emissive_materials: count(&|m| m.radiance.max_element() > 0.0),
            textures: s.textures.len(),
            area_m2: s.triangles.iter().map(area).sum(),
            emitting_area_m2: s.emitters.iter().map(|e| f64::from(e.area)).sum(),
            bounds_m: [s.bounds.0.to_array(), s.bounds.1.to_array()],
            metres_per_unit: loaded.metres_per_unit,
            lights: lights.collect(),
            sky: match (s.has_sky(), s.sky.map_width) {
                (false, _) => "none".into(),
                (true, 0) => format!("constant, radiance {} W/m²/sr", s.sky.radiance),
                (true, width) => format!("map of {width} x {}", s.sky.map_height),
            },
            hierarchy_nodes: s.nodes.len(),
            bytes: vec![
                ("triangles", size(size_of_val(&s.triangles[..]) + size_of_val(&s.uvs[..]))),
                ("hierarchy", size(size_of_val(&s.nodes[..]))),
                ("texels", size(size_of_val(&s.texels[..]))),
                ("sky map", size(size_of_val(&s.sky_map[..]))),
            ],
            seconds: loaded.timings.clone(),
        }
    }

    fn print(&self) {
        println!("{:24} {}", "scene", self.scene);
        println!("{:24} {} (file: {})", "triangles", self.triangles, self.file_triangles);
        println!(
            "{:24} {} without area, {} duplicates, {} transparent",
            "dropped", self.dropped_zero_area, self.dropped_duplicates, self.dropped_holes
        );
        println!("{:24} {}", "objects", self.objects);
        println!(
            "{:24} {} ({} textured, {} masked, {} emissive)",
            "materials", self.materials, self.textured_materials, self.masked_materials, self.emissive_materials
        );
        println!("{:24} {}", "textures", self.textures);
        println!("{:24} {:.4} m² (emitting {:.6} m²)", "surface", self.area_m2, self.emitting_area_m2);
        println!("{:24} {:?} .. {:?} m", "bounds", self.bounds_m[0], self.bounds_m[1]);
        println!("{:24} {} m", "unit of the file", self.metres_per_unit);
        for light in &self.lights {
            println!("{:24} {light}", "light");
        }
        println!("{:24} {}", "sky", self.sky);
        println!("{:24} {} nodes", "hierarchy", self.hierarchy_nodes);
        for (name, count) in &self.bytes {
            println!("{:24} {}", format!("memory, {name}"), output::bytes(*count));
        }
        for (name, seconds) in &self.seconds {
            println!("{:24} {seconds:.3} s", format!("time, {name}"));
        }
    }
}
