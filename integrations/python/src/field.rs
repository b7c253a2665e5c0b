//! The light of a bake: updates, points, corners, texels, pictures.

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods as _, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods as _,
};
use patches::LightmapTexels;
use patchlight::glam::Vec3;
use patchlight::low_level::operator::Codec;
use patchlight::method::{FeedbackSettings, TemporalSettings};
use patchlight::outputs::{LightPart, at_corners, is_lit, lit_sides, on_lightmap};
use patchlight::scene::NONE;
use patchlight::{
    Cpu, DisplayTransform, LightSettings, MethodSettings, Picture, PictureRenderer, PictureSettings, Point, PointKind,
    PointSet, Tone,
};
use pyo3::prelude::*;

use crate::arrays::{from_rgb, from_vectors, vectors};
use crate::bake::Bake;
use crate::error::{exception, input};
use crate::lights::{Light, Sky, lighting};
use crate::scene::{camera, surface_points};
use crate::work::run;

type Rgb = (f32, f32, f32);
type Image<'py> = Bound<'py, PyArray3<f32>>;

/// A method by its name.
pub fn method_of(name: &str, epsilon: f64) -> PyResult<MethodSettings> {
    Ok(match name {
        "classic" => MethodSettings::Classic,
        "low_rank" => MethodSettings::Multibounce(Codec::LowRank { epsilon }),
        "multibounce" => MethodSettings::Multibounce(Codec::Dense),
        "feedback" => MethodSettings::Feedback(FeedbackSettings::default()),
        "temporal" => MethodSettings::Temporal(TemporalSettings::default()),
        _ => {
            let names = "\"classic\", \"low_rank\", \"multibounce\", \"feedback\" or \"temporal\"";
            return Err(input(format!("method is {name:?}; it must be {names}")));
        }
    })
}

fn image<'py>(py: Python<'py>, picture: &Picture) -> PyResult<Image<'py>> {
    let shape = [picture.height as usize, picture.width as usize, 3];
    PyArray1::from_slice(py, bytemuck::cast_slice(&picture.pixels)).reshape(shape)
}

/// The light of a bake on the CPU; `patchlight.LightField` documents it.
#[pyclass(frozen, module = "patchlight._core")]
pub struct LightField {
    renderer: Mutex<PictureRenderer>,
    sets: Mutex<Vec<(PointSet, usize)>>,
    lightmap: Mutex<Option<(f32, LightmapTexels)>>,
}

impl LightField {
    fn renderer(&self) -> MutexGuard<'_, PictureRenderer> {
        self.renderer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn sets(&self) -> MutexGuard<'_, Vec<(PointSet, usize)>> {
        self.sets.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads a device buffer.
    fn read<'py>(
        &self,
        py: Python<'py>,
        which: impl Fn(&patchlight::ReceiverBuffers) -> patchlight::runtime::plan::BufferId + Sync,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let values = py.detach(|| {
            let mut renderer = self.renderer();
            let field = renderer.light_mut();
            let buffer = which(field.buffers());
            field.download(buffer)
        });
        from_rgb(py, &values.map_err(exception)?)
    }
}

#[pymethods]
impl LightField {
    #[new]
    #[pyo3(signature = (bake, method, epsilon, point_rays, progress))]
    fn new(
        py: Python<'_>,
        bake: PyRef<'_, Bake>,
        method: &str,
        epsilon: f64,
        point_rays: u32,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let settings = LightSettings::default().with_method(method_of(method, epsilon)?).with_point_rays(point_rays);
        let pictures = PictureSettings::default().with_size((8, 8)).with_sub_frames(1);
        let own = bake.bake.clone();
        let renderer = run(py, progress.as_ref(), |watcher| {
            PictureRenderer::of_bake(own, Box::new(Cpu::new()), &settings, &pictures, watcher).map_err(exception)
        })?;
        Ok(Self { renderer: Mutex::new(renderer), sets: Mutex::default(), lightmap: Mutex::default() })
    }

    /// Finds the light under these lights; the number of the update.
    #[pyo3(signature = (lights, sky, emission))]
    fn update(
        &self,
        py: Python<'_>,
        lights: Vec<PyRef<'_, Light>>,
        sky: Option<PyRef<'_, Sky>>,
        emission: Option<PyReadonlyArray2<f32>>,
    ) -> PyResult<u32> {
        let emission = emission.as_ref().map(|emission| vectors(emission, "emission")).transpose()?;
        let lighting = lighting(&lights, sky.as_deref(), emission.unwrap_or(&[]));
        drop((lights, sky));
        let update = py.detach(|| self.renderer().light_mut().update(&lighting));
        Ok(update.map_err(exception)?.number)
    }

    /// Direct irradiance at the samples.
    fn direct<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.read(py, |buffers| buffers.direct)
    }

    /// First exitance of the patches.
    fn source<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.read(py, |buffers| buffers.source)
    }

    /// Indirect irradiance of the patches.
    fn at_patches<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.read(py, |buffers| buffers.patches)
    }

    /// Indirect irradiance of the elements.
    fn at_elements<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        self.read(py, |buffers| buffers.elements)
    }

    /// Indirect irradiance at the interpolation points.
    fn at_receivers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let values = py.detach(|| self.renderer().light_mut().surface_irradiance()).map_err(exception)?;
        from_vectors(py, &values)
    }

    /// Irradiance at the corners of the triangles, `(triangles, 9)`.
    fn at_corners<'py>(&self, py: Python<'py>, front: bool, direct: bool) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let part = if direct { LightPart::Full } else { LightPart::Indirect };
        let values = py.detach(|| at_corners(self.renderer().light_mut(), part, front)).map_err(exception)?;
        let count = values.len();
        PyArray1::from_slice(py, bytemuck::cast_slice(&values)).reshape([count, 9])
    }

    /// Irradiance in a lightmap with texels of this size, m: `(height, width, 3)`.
    fn on_lightmap<'py>(&self, py: Python<'py>, texel: f32, direct: bool) -> PyResult<Image<'py>> {
        let part = if direct { LightPart::Full } else { LightPart::Indirect };
        let made = py.detach(|| {
            let mut renderer = self.renderer();
            let field = renderer.light_mut();
            let mut lightmap = self.lightmap.lock().unwrap_or_else(PoisonError::into_inner);
            if lightmap.as_ref().is_none_or(|own| own.0 != texel) {
                *lightmap = Some((texel, texels_of(field, texel)?));
            }
            let Some((_, texels)) = lightmap.as_ref() else { return Err(input("no lightmap")) };
            let values = on_lightmap(field, texels, part).map_err(exception)?;
            let picture = texels.picture(&values).map_err(|error| exception(error.into()))?;
            Ok((texels.params.width, texels.params.height, picture))
        });
        let (width, height, values) = made?;
        let values: Vec<Vec3> = values.iter().map(|value| value.truncate()).collect();
        PyArray1::from_slice(py, bytemuck::cast_slice(&values)).reshape([height as usize, width as usize, 3])
    }

    /// Texture coordinates of the corners of each triangle in that lightmap, `(triangles, 6)`; NaN without a chart.
    fn lightmap_uvs<'py>(&self, py: Python<'py>, texel: f32, front: bool) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let lightmap = self.lightmap.lock().unwrap_or_else(PoisonError::into_inner);
        let Some((_, texels)) = lightmap.as_ref().filter(|own| own.0 == texel) else {
            return Err(input("no lightmap with texels of this size was made"));
        };
        let side = usize::from(!front);
        let uvs: Vec<f32> = texels
            .sides
            .iter()
            .flat_map(|sides| match sides[side] {
                NONE => [f32::NAN; 6],
                at => {
                    let uv = texels.uvs[at as usize];
                    let [a, b, c] = [uv.corner, uv.corner_a, uv.corner_b];
                    [a.x, a.y, b.x, b.y, c.x, c.y]
                }
            })
            .collect();
        let count = texels.sides.len();
        PyArray1::from_vec(py, uvs).reshape([count, 6])
    }

    /// Adds points whose light every update finds; their number.
    #[pyo3(signature = (points, normals, kind, progress))]
    fn add_points(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<f32>,
        normals: PyReadonlyArray2<f32>,
        kind: &str,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<usize> {
        let kind = match kind {
            "irradiance" => PointKind::Irradiance,
            "cube" => PointKind::Cube,
            "harmonics" => PointKind::HarmonicsL1,
            _ => return Err(input(format!("kind is {kind:?}; it must be \"irradiance\", \"cube\" or \"harmonics\""))),
        };
        let places = surface_points(vectors(&points, "points")?, vectors(&normals, "normals")?)?;
        let places: Vec<Point> =
            places.iter().map(|point| Point { position: point.position, normal: point.normal }).collect();
        let set = run(py, progress.as_ref(), |watcher| {
            self.renderer().light_mut().add_points(&places, kind, watcher).map_err(exception)
        })?;
        let mut sets = self.sets();
        sets.push((set, kind.values()));
        Ok(sets.len() - 1)
    }

    /// Removes points.
    fn remove_points(&self, py: Python<'_>, set: usize) -> PyResult<()> {
        let (set, _) = self.set(set)?;
        py.detach(|| self.renderer().light_mut().remove_points(set)).map_err(exception)
    }

    /// Light of points, `(points, values · 3)`.
    fn at_points<'py>(&self, py: Python<'py>, set: usize) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (set, values) = self.set(set)?;
        let light = py.detach(|| self.renderer().light_mut().read(set)).map_err(exception)?;
        let count = light.values.len() / values;
        from_vectors(py, &light.values)?.reshape([count, 3 * values])
    }

    /// A picture and its parts, radiance in W/m²/sr.
    #[pyo3(signature = (lights, sky, emission, eye, target, up, fov_degrees, size, sub_frames))]
    fn render<'py>(
        &self,
        py: Python<'py>,
        lights: Vec<PyRef<'_, Light>>,
        sky: Option<PyRef<'_, Sky>>,
        emission: Option<PyReadonlyArray2<f32>>,
        eye: Rgb,
        target: Rgb,
        up: Rgb,
        fov_degrees: f32,
        size: (u32, u32),
        sub_frames: u32,
    ) -> PyResult<(Image<'py>, Image<'py>, Image<'py>)> {
        let emission = emission.as_ref().map(|emission| vectors(emission, "emission")).transpose()?;
        let lighting = lighting(&lights, sky.as_deref(), emission.unwrap_or(&[]));
        drop((lights, sky));
        let camera = camera(eye, target, up, fov_degrees, size.0, size.1);
        let frame = py.detach(|| {
            let mut renderer = self.renderer();
            renderer.resize(size, sub_frames)?;
            renderer.picture(&lighting, &camera, 0)
        });
        let pictures = frame.map_err(exception)?.pictures;
        Ok((image(py, &pictures.full)?, image(py, &pictures.direct)?, image(py, &pictures.indirect)?))
    }
}

impl LightField {
    fn set(&self, set: usize) -> PyResult<(PointSet, usize)> {
        self.sets().get(set).copied().ok_or_else(|| input(format!("point set {set} is not of this light field")))
    }
}

fn texels_of(field: &patchlight::LightField, texel: f32) -> PyResult<LightmapTexels> {
    let bake = field.bake();
    let made = LightmapTexels::new(bake.scene(), &lit_sides(bake), texel, &|point| is_lit(bake, point));
    made.map_err(|error| exception(error.into()))
}

/// A picture as it is displayed: bytes of red, green and blue, by a tone curve after 2 to so many stops.
#[pyfunction]
#[pyo3(signature = (radiance, stops, tone))]
pub fn displayed<'py>(
    py: Python<'py>,
    radiance: PyReadonlyArray3<f32>,
    stops: Option<f32>,
    tone: &str,
) -> PyResult<(Bound<'py, PyArray3<u8>>, f32)> {
    let tone = match tone {
        "none" => Tone::None,
        "agx" => Tone::Agx,
        "neutral" => Tone::Neutral,
        _ => return Err(input(format!("tone is {tone:?}; it must be \"agx\", \"neutral\" or \"none\""))),
    };
    let [height, width] = [0, 1].map(|axis| radiance.shape()[axis]);
    if radiance.shape()[2] != 3 {
        return Err(input("a picture has rows, columns and RGB"));
    }
    let numbers = radiance.as_slice().map_err(|_| input("the picture is not contiguous"))?;
    let pixels: Vec<Vec3> = bytemuck::cast_slice(numbers).to_vec();
    let picture = Picture::from_pixels(width as u32, height as u32, pixels).map_err(input)?;
    let stops = stops.unwrap_or_else(|| picture.automatic_stops());
    let bytes = picture.shown_bytes(&DisplayTransform { stops, tone });
    let channels = bytes.len() / (width * height).max(1);
    let rgb: Vec<u8> = bytes.chunks_exact(channels.max(1)).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect();
    Ok((PyArray1::from_vec(py, rgb).reshape([height, width, 3])?, stops))
}
