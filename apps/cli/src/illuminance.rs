//! `patchlight illuminance`.

use std::convert::Infallible;
use std::fmt::Write as _;
use std::path::Path;

use clap::Args;
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::ascii::FONT_8X13;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::{DrawTarget, Drawable as _, OriginDimensions, Pixel, Point, RgbColor as _, Size};
use embedded_graphics::text::{Baseline, Text};
use shell::Error;
use shell::args::common::{Common, parse_metres, parse_size};
use shell::output;
use shell::progress::Progress;
use shell::report::significant;

use glam::{Vec2, Vec3};
use patchlight::Picture;
use patchlight::outputs::{CalculationPlane, LightPart, PlaneKind, PlaneLight, illuminance, on_view};
use reference::PictureFile as _;
use reference::picture::Precision;
use scene::kernel::shade::decode_srgb;
use serde::Serialize;

use super::bake::{LightOptions, Lightable};

/// Width of the legend, its bar, and the height of a letter, pixels.
const LEGEND: u32 = 96;
const BAR: u32 = 20;
const LETTER: i32 = 13;
/// Marks of the legend beside zero.
const MARKS: u32 = 5;
/// Pixels of the longer side of a plane's picture, about.
const PLANE_PIXELS: u32 = 640;
/// Share of the values that the scale covers.
const COVERED: f32 = 0.99;

/// Measure illuminance (lx): in a view, and on calculation planes.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  \
    patchlight illuminance office --plane 0.75\n  \
    patchlight illuminance room.glb --plane 0.75 --cylindrical 1.2 --grid 0.25 --area 0,0,4,6 --scale 1000\n\n\
    Files:\n  \
    illuminance.exr, .png   lx on what the camera shows, as numbers and in false colours with a legend\n  \
    plane-K.csv, .png       lx at the points of the planes, in the order of the command line, horizontal ones first\n  \
    summary.json            mean, least and greatest illuminance of each plane, and uniformity (least over mean)\n\n\
    Irradiance is converted by 179 lm/W. Heights are along y, which points upwards.")]
pub struct Illuminance {
    #[command(flatten)]
    pub light: LightOptions,
    /// A horizontal plane at this height, m: illuminance from above. May be given several times.
    #[arg(long, value_name = "METRES", value_parser = parse_height)]
    pub plane: Vec<f32>,
    /// A plane at this height, m, for cylindrical illuminance: the mean from all sides. May be given several times.
    #[arg(long, value_name = "METRES", value_parser = parse_height)]
    pub cylindrical: Vec<f32>,
    /// Distance between the points of a plane, m.
    #[arg(long, value_name = "METRES", default_value_t = 0.25, value_parser = parse_metres)]
    pub grid: f32,
    /// The part of the planes that counts: x and z of two corners [default: all of the scene].
    #[arg(long, value_name = "X,Z,X,Z", allow_hyphen_values = true, value_parser = parse_area)]
    pub area: Option<(Vec2, Vec2)>,
    /// Illuminance with the last colour of the scale, lx [default: what 99 % of the values stay below].
    #[arg(long, value_name = "LUX", value_parser = parse_scale)]
    pub scale: Option<f32>,
    /// Picture size.
    #[arg(long, default_value = "640x360", value_parser = parse_size)]
    pub size: (u32, u32),
}

/// Contents of summary.json.
#[derive(Serialize)]
struct Report {
    scene: String,
    planes: Vec<PlaneReport>,
}

#[derive(Serialize)]
struct PlaneReport {
    kind: &'static str,
    height: f32,
    points: usize,
    mean: f32,
    minimum: f32,
    maximum: f32,
    /// Least over mean illuminance (U0).
    uniformity: f32,
}

pub fn run(common: &Common, args: &Illuminance) -> Result<(), Error> {
    let progress = Progress::new(common.quiet);
    let Lightable { loaded, mut renderer, out } = Lightable::of(common, &args.light, "illuminance", &progress)?;
    let camera = loaded.view.camera(args.size.0, args.size.1);
    renderer.update_light(&loaded.scene.lighting, &camera)?;

    let seen = progress.phase("light of the view", |_| on_view(renderer.light_mut(), &camera, LightPart::Full))?;
    let lux: Vec<Option<f32>> = seen.iter().map(|&e| Some(illuminance(e))).collect();
    let numbers = seen.iter().map(|&e| Vec3::splat(illuminance(e))).collect();
    let numbers = Picture::from_pixels(args.size.0, args.size.1, numbers).map_err(patchlight::Error::from)?;
    numbers.write_exr(&out.join("illuminance.exr"), Precision::Single)?;
    let scale = args.scale.unwrap_or_else(|| even_scale(&lux));
    write_colours(&out.join("illuminance.png"), args.size, &lux, scale)?;

    let mut report = Report { scene: loaded.name.clone(), planes: Vec::new() };
    let horizontal = args.plane.iter().map(|&height| (PlaneKind::Horizontal, height));
    let cylindrical = args.cylindrical.iter().map(|&height| (PlaneKind::Cylindrical, height));
    for (number, (kind, height)) in horizontal.chain(cylindrical).enumerate() {
        let plane = CalculationPlane { kind, height, spacing: args.grid, area: args.area };
        let light = progress
            .phase("light of a plane", |_| plane.light(renderer.light_mut()))
            .map_err(|error| Error::of_scene(error, &args.light.scene))?;
        let Some([mean, minimum, maximum]) = light.statistics() else {
            progress.warn(&format!("the plane at {height} m has no point in the open; it is left out"));
            continue;
        };
        output::write_text(&out.join(format!("plane-{number}.csv")), &table(&light))?;
        let (size, colours) = magnified(&light);
        let scale = args.scale.unwrap_or_else(|| even_scale(&light.lux));
        write_colours(&out.join(format!("plane-{number}.png")), size, &colours, scale)?;
        report.planes.push(PlaneReport {
            kind: if kind == PlaneKind::Horizontal { "horizontal" } else { "cylindrical" },
            height,
            points: light.lux.iter().flatten().count(),
            mean,
            minimum,
            maximum,
            uniformity: if mean > 0.0 { minimum / mean } else { 0.0 },
        });
    }
    let text = output::json(&report);
    output::write_text(&out.join("summary.json"), &text)?;
    if common.json {
        say!("{text}");
        return Ok(());
    }
    for plane in &report.planes {
        let [mean, minimum, maximum] = [plane.mean, plane.minimum, plane.maximum].map(|x| significant(x.into()));
        say!(
            "{:11} {} m: mean {mean} lx, least {minimum}, greatest {maximum}, uniformity {:.2} ({} points)",
            plane.kind,
            plane.height,
            plane.uniformity,
            plane.points
        );
    }
    progress.note(&format!("written to {}", out.display()));
    Ok(())
}

fn parse_height(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(height) if height.is_finite() => Ok(height),
        _ => Err(format!("`{text}` is no height in metres")),
    }
}

fn parse_scale(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(scale) if scale > 0.0 && scale.is_finite() => Ok(scale),
        _ => Err(format!("`{text}` is no illuminance: a number of lx above 0")),
    }
}

fn parse_area(text: &str) -> Result<(Vec2, Vec2), String> {
    let numbers: Vec<f32> = text.split(',').filter_map(|part| part.trim().parse().ok()).collect();
    match numbers[..] {
        [a, b, c, d] if [a, b, c, d].iter().all(|x| x.is_finite()) && a != c && b != d => {
            let p = Vec2::new(a, b);
            let q = Vec2::new(c, d);
            Ok((p.min(q), p.max(q)))
        }
        _ => Err(format!("`{text}` is not X,Z,X,Z of two corners, m")),
    }
}

/// A round number below which nearly all values are.
fn even_scale(lux: &[Option<f32>]) -> f32 {
    let mut all: Vec<f32> = lux.iter().flatten().copied().collect();
    all.sort_by(f32::total_cmp);
    let top = all.get((all.len().saturating_sub(1) as f32 * COVERED).ceil() as usize).copied().unwrap_or(0.0).max(1e-3);
    let mut power = 1e-3;
    while 10.0 * power < top {
        power *= 10.0;
    }
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|step| step * power).find(|&scale| scale >= top).unwrap_or(top)
}

/// A line a point.
fn table(light: &PlaneLight) -> String {
    let mut text = String::from("x,y,z,lux\n");
    for (k, lux) in (0u32..).zip(&light.lux) {
        if let Some(lux) = lux {
            let p = light.place(k);
            let _ = writeln!(text, "{},{},{},{lux}", p.x, p.y, p.z);
        }
    }
    text
}

/// The points of a plane as squares of some pixels.
fn magnified(light: &PlaneLight) -> ((u32, u32), Vec<Option<f32>>) {
    let [width, height] = light.counts;
    let times = (PLANE_PIXELS / width.max(height)).max(1);
    let size = (width * times, height * times);
    let value = |pixel: u32| light.lux[(pixel % size.0 / times + width * (pixel / size.0 / times)) as usize];
    (size, (0..size.0 * size.1).map(value).collect())
}

/// A picture that letters are drawn into.
struct Canvas {
    width: u32,
    height: u32,
    pixels: Vec<[u8; 3]>,
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.width, self.height)
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(place, color) in pixels {
            if let (Ok(x), Ok(y)) = (u32::try_from(place.x), u32::try_from(place.y))
                && x < self.width
                && y < self.height
            {
                self.pixels[(x + self.width * y) as usize] = [color.r(), color.g(), color.b()];
            }
        }
        Ok(())
    }
}

/// Writes values in false colours with a legend beside them; what has no value is grey.
fn write_colours(path: &Path, size: (u32, u32), lux: &[Option<f32>], scale: f32) -> Result<(), Error> {
    // Room for all marks of the legend.
    let height = size.1.max((MARKS as i32 * 2 * LETTER) as u32);
    let mut canvas =
        Canvas { width: size.0 + LEGEND, height, pixels: vec![[16; 3]; ((size.0 + LEGEND) * height) as usize] };
    let color = |share: f32| colorous::TURBO.eval_continuous(f64::from(share.clamp(0.0, 1.0))).as_array();
    for (k, value) in (0u32..).zip(lux) {
        let place = k % size.0 + canvas.width * (k / size.0);
        canvas.pixels[place as usize] = value.map_or([96; 3], |value| color(value / scale));
    }
    let top = LETTER;
    let bottom = height as i32 - LETTER - 1;
    for y in top..=bottom {
        let share = (bottom - y) as f32 / (bottom - top) as f32;
        let first = size.0 + 8 + canvas.width * y as u32;
        canvas.pixels[first as usize..(first + BAR) as usize].fill(color(share));
    }
    let style = MonoTextStyle::new(&FONT_8X13, Rgb888::WHITE);
    for mark in 0..=MARKS {
        let y = bottom - (bottom - top) * mark as i32 / MARKS as i32;
        let unit = if mark == MARKS { " lx" } else { "" };
        let text = format!("{}{unit}", significant(f64::from(scale) * f64::from(mark) / f64::from(MARKS)));
        let place = Point::new((size.0 + 8 + BAR + 4) as i32, y);
        let Ok(_) = Text::with_baseline(&text, place, style, Baseline::Middle).draw(&mut canvas);
    }
    let pixels = canvas.pixels.iter().map(|p| Vec3::from_array(p.map(|c| decode_srgb(f32::from(c) / 255.0)))).collect();
    let picture = Picture::from_pixels(canvas.width, canvas.height, pixels).map_err(patchlight::Error::from)?;
    Ok(picture.write_png(path, 0.0)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_are_round_and_cover_the_values() {
        for (top, expected) in [(430.0, 500.0), (1.0, 1.0), (1.1, 2.0), (0.0, 1e-3), (7e4, 1e5)] {
            let scale = even_scale(&[Some(top), None, Some(0.5 * top)]);
            assert!((scale / expected - 1.0).abs() < 1e-3 || top < 1e-3 && scale >= top, "{top}: {scale}");
        }
    }

    #[test]
    fn areas() {
        assert_eq!(parse_area("3,4,1,-2"), Ok((Vec2::new(1.0, -2.0), Vec2::new(3.0, 4.0))));
        for wrong in ["", "1,2,3", "1,2,1,4", "a,b,c,d", "1,2,3,inf"] {
            assert!(parse_area(wrong).is_err(), "{wrong}");
        }
    }
}
