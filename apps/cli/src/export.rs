//! `patchlight export`.

use std::path::{Path, PathBuf};

use assets::export::lit::{LitBy, LitSide, lit_gltf, lit_ply};
use assets::import::LoadedScene;
use clap::{ArgGroup, Args};
use glam::Vec3;
use patches::{LightmapTexels, VolumeSettings, VolumeSize, VoxelVolume};
use patchlight::light::with_lights;
use patchlight::outputs::{LightPart, ProbeVolume, at_corners, in_volume, is_lit, lit_sides, on_lightmap};
use patchlight::{Bake, Picture, PictureRenderer};
use reference::PictureFile as _;
use reference::file::write_whole;
use reference::picture::Precision;
use scene::{Scene, Sides, SurfacePoint};
use shell::Error;
use shell::args::common::{Animate, Common, parse_metres};
use shell::output;
use shell::progress::{Progress, interruptible, is_cancelled};
use shell::sequence::Movement;

use super::bake::{LightOptions, Lightable};

/// Texels of a lightmap, about, where no size is asked for.
const TEXELS: f64 = (1u32 << 20) as f64;

/// Write the light of a scene into files that engines and viewers read.
#[derive(Args, Debug)]
#[command(
    group(ArgGroup::new("outputs").required(true).multiple(true)),
    group(ArgGroup::new("air").multiple(true)),
    after_help = "Examples:\n  \
        patchlight export room.glb --lightmap --texel 0.05\n  \
        patchlight export sponza.toml --probes --volume --probe-count 4096 --indirect --out out/sponza\n  \
        patchlight export cornell --vertices --frames 24\n\n\
        Files (irradiance in W/m2, lengths in metres):\n  \
        --vertices  NAME-vertices.gltf: COLOR_0 is the light that a white surface shows, _IRRADIANCE the \
        irradiance;\n              \
        NAME-vertices.ply: the same for tools that read PLY\n  \
        --lightmap  NAME-lightmap.exr: irradiance; NAME-lightmap.gltf: the scene with its coordinates as TEXCOORD_1\n  \
        --probes    NAME-probes.json, NAME-probes.bin: ambient cubes and spherical harmonics of degree 1 on a grid\n  \
        --volume    NAME-volume.ktx2: ambient cubes as a 3D texture, laid out as Bevy's irradiance volumes are\n\n\
        Several frames each have a folder, frame-0000 and so on."
)]
pub struct Export {
    #[command(flatten)]
    pub light: LightOptions,
    /// Light at the corners of the triangles, as glTF and PLY.
    #[arg(long, group = "outputs")]
    pub vertices: bool,
    /// Light in a lightmap (EXR), with its texture coordinates in a glTF.
    #[arg(long, group = "outputs")]
    pub lightmap: bool,
    /// Light in the air, as JSON and binary.
    #[arg(long, groups = ["outputs", "air"])]
    pub probes: bool,
    /// Light in the air, as a 3D texture (KTX2).
    #[arg(long, groups = ["outputs", "air"])]
    pub volume: bool,
    /// Only light that was reflected, for engines that light directly themselves.
    #[arg(long)]
    pub indirect: bool,
    /// Edge of a lightmap's texels, m [default: about a million texels].
    #[arg(long, value_name = "METRES", value_parser = parse_metres, requires = "lightmap")]
    pub texel: Option<f32>,
    /// Voxels of the grid of probes, about; those inside of solids have none.
    #[arg(long, default_value_t = 2048, value_parser = clap::value_parser!(u32).range(1..=1 << 20), requires = "air")]
    pub probe_count: u32,
    /// Frames; with more than one the scene's lights move.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub frames: u32,
    /// Light motion from frame to frame [default: path].
    #[arg(long, value_enum, requires = "frames")]
    pub animate: Option<Animate>,
}

pub fn run(common: &Common, args: &Export) -> Result<(), Error> {
    let progress = Progress::new(common.quiet);
    let Lightable { loaded, mut renderer, out } = Lightable::of(common, &args.light, "export", &progress)?;
    let places = interruptible(|| Places::of(args, &loaded, renderer.light().bake(), &progress))
        .map_err(|error| Error::of_scene(error, &args.light.scene))?;
    let movement = Movement::new(&loaded, (args.animate.unwrap_or(Animate::Path), None), args.frames, &progress);
    let mut written = Vec::new();
    for number in 0..args.frames {
        let (lights, view) = movement.at(number);
        renderer.update_light(&with_lights(&loaded.scene, &lights), &view.camera(1, 1))?;
        let folder = if args.frames > 1 { out.join(format!("frame-{number:04}")) } else { out.clone() };
        output::make_folder(&folder)?;
        let files = Files { loaded: &loaded, folder: &folder, part: args.part(), progress: &progress };
        written.extend(places.write(&mut renderer, &files)?);
        if is_cancelled() {
            return Err(Error::Cancelled);
        }
    }
    if common.json {
        say!("{}", output::json(&serde_json::json!({ "files": written })));
    } else {
        for path in &written {
            let bytes = std::fs::metadata(path).map_or(0, |file| file.len());
            say!("{} ({})", path.display(), output::bytes(bytes));
        }
    }
    Ok(())
}

impl Export {
    fn part(&self) -> LightPart {
        if self.indirect { LightPart::Indirect } else { LightPart::Full }
    }
}

/// Points where light is asked for.
struct Places {
    /// Sides with receivers, in the order of their triangles.
    sides: Vec<(u32, bool)>,
    vertices: bool,
    lightmap: Option<LightmapTexels>,
    volume: Option<VoxelVolume>,
    probes: bool,
    texture: bool,
}

/// Destination of files.
struct Files<'a> {
    loaded: &'a LoadedScene,
    folder: &'a Path,
    part: LightPart,
    progress: &'a Progress,
}

impl Places {
    fn of(args: &Export, loaded: &LoadedScene, bake: &Bake, progress: &Progress) -> patchlight::Result<Self> {
        let scene = &bake.scene();
        let lit = lit_sides(bake);
        let numbered = (0u32..).zip(&lit);
        let sides: Vec<(u32, bool)> = numbered
            .flat_map(|(t, side)| [(t, true, side.front), (t, false, side.back)])
            .filter_map(|(t, front, is_lit)| is_lit.then_some((t, front)))
            .collect();
        let is_lit = |point: &SurfacePoint| is_lit(bake, point);
        let lightmap = match args.lightmap {
            false => None,
            true => {
                let texel = args.texel.unwrap_or_else(|| even_texel(scene, &lit));
                let made = progress.phase("lightmap", |_| lightmap(loaded, &lit, texel, &is_lit, progress));
                Some(made.map_err(patchlight::Error::from)?)
            }
        };
        let volume = match args.probes || args.volume {
            false => None,
            true => {
                let size = VolumeSize::Count(args.probe_count);
                let settings = VolumeSettings { size, ..VolumeSettings::default() };
                let made = progress.phase("probes", |_| VoxelVolume::new(scene, &settings, &is_lit));
                Some(made.map_err(patchlight::Error::from)?)
            }
        };
        Ok(Self { sides, vertices: args.vertices, lightmap, volume, probes: args.probes, texture: args.volume })
    }

    /// Writes the light of the last update; the files.
    fn write(&self, renderer: &mut PictureRenderer, files: &Files) -> Result<Vec<PathBuf>, Error> {
        let Files { loaded, folder, part, progress } = *files;
        let mut written = Vec::new();
        if self.vertices {
            let name = format!("{}-vertices", loaded.name);
            let [back, front] = [false, true].map(|front| at_corners(renderer.light_mut(), part, front));
            let back = back?;
            let front = front?;
            let side = |&(triangle, is_front): &(u32, bool)| LitSide {
                triangle,
                front: is_front,
                irradiance: if is_front { &front } else { &back }[triangle as usize],
            };
            let sides: Vec<LitSide> = self.sides.iter().map(side).collect();
            let mut scene = lit_gltf(loaded, folder, &name, &sides, LitBy::Corners)?;
            scene.add(&format!("{name}.ply"), lit_ply(loaded, &sides));
            written.extend(scene.write(&|| !is_cancelled())?.map(Path::to_path_buf));
            written.push(folder.join(format!("{name}.ply")));
        }
        if let Some(lightmap) = &self.lightmap {
            let name = format!("{}-lightmap", loaded.name);
            let values =
                progress.phase("light of the texels", |_| on_lightmap(renderer.light_mut(), lightmap, part))?;
            let texels: Vec<Vec3> =
                lightmap.picture(&values).map_err(patchlight::Error::from)?.iter().map(|v| v.truncate()).collect();
            let exr = format!("{name}.exr");
            let of: Vec<&(u32, bool)> =
                self.sides.iter().filter(|&&(triangle, front)| lightmap.uv(triangle, front).is_some()).collect();
            let uvs: Vec<_> = of.iter().filter_map(|&&(triangle, front)| lightmap.uv(triangle, front)).collect();
            let sides: Vec<LitSide> =
                of.iter().map(|&&(triangle, front)| LitSide { triangle, front, irradiance: [Vec3::ZERO; 3] }).collect();
            let by = LitBy::Lightmap { uvs: &uvs, width: lightmap.params.width, texels: &texels, exr: &exr };
            let scene = lit_gltf(loaded, folder, &name, &sides, by)?;
            let path = folder.join(&exr);
            let picture = Picture::from_pixels(lightmap.params.width, lightmap.params.height, texels.clone());
            picture.map_err(patchlight::Error::from)?.write_exr(&path, Precision::Single)?;
            written.extend(scene.write(&|| !is_cancelled())?.map(Path::to_path_buf));
            written.push(path);
        }
        if let Some(volume) = &self.volume {
            let values = progress.phase("light of the probes", |_| in_volume(renderer.light_mut(), volume, part))?;
            let probes = ProbeVolume::new(volume, values)?;
            let mut files = Vec::new();
            if self.probes {
                let (description, binary) = probes.to_files()?;
                files.push(("probes.bin", binary));
                files.push(("probes.json", description.into_bytes()));
            }
            if self.texture {
                files.push(("volume.ktx2", probes.to_ktx2()));
            }
            for (file, bytes) in files {
                let path = folder.join(format!("{}-{file}", loaded.name));
                let failed = |source| reference::Error::Write { path: path.clone(), source };
                write_whole(&path, |file| std::io::Write::write_all(file, &bytes).map_err(failed))?;
                written.push(path);
            }
        }
        Ok(written)
    }
}

/// The lightmap of the atlas that the scene's file brings, or of our own.
fn lightmap(
    loaded: &LoadedScene,
    lit: &[Sides],
    texel: f32,
    is_lit: &(impl Fn(&SurfacePoint) -> bool + Sync),
    progress: &Progress,
) -> Result<LightmapTexels, patches::Error> {
    let scene = &loaded.scene;
    if !loaded.lightmap_uvs.is_empty() {
        let uvs: Vec<_> = scene.geometry.triangles.iter().map(|t| loaded.lightmap_uvs.of(t)).collect();
        match LightmapTexels::with_uvs(scene, lit, &uvs, texel, is_lit) {
            Err(error @ patches::Error::AtlasOverlap { .. }) => {
                progress.warn(&format!("TEXCOORD_1 is not taken for the lightmap: {error}"));
            }
            made => return made,
        }
    }
    LightmapTexels::new(scene, lit, texel, is_lit)
}

/// Edge of texels of which about [`TEXELS`] cover the lit sides, m.
fn even_texel(scene: &Scene, sides: &[Sides]) -> f32 {
    let area = |(t, side): (&scene::gpu::Triangle, &Sides)| {
        0.5 * f64::from(t.edge_a.cross(t.edge_b).length()) * f64::from(u8::from(side.front) + u8::from(side.back))
    };
    let area: f64 = scene.geometry.triangles.iter().zip(sides).map(area).sum();
    (area / TEXELS).sqrt().max(f64::from(f32::MIN_POSITIVE)) as f32
}
