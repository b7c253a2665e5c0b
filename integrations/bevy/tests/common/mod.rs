//! Pictures of Bevy without a window.

use std::sync::{Arc, Mutex};

use bevy::camera::RenderTarget;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_resource::{TextureFormat, TextureUsages};
use bevy::render::settings::{InstanceFlags, RenderCreation, WgpuSettings};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_patchlight::{PatchlightPlugin, PatchlightSettings};
use half::f16;

/// An app that draws without a window, and waits for its light.
pub fn headless(settings: PatchlightSettings) -> App {
    headless_in(settings, std::path::Path::new("assets"))
}

/// The same with assets in a folder.
pub fn headless_in(settings: PatchlightSettings, assets: &std::path::Path) -> App {
    let renderer = WgpuSettings { instance_flags: InstanceFlags::VALIDATION, ..WgpuSettings::default() };
    headless_on(settings, assets, renderer.into())
}

/// The same on a device that light shares.
#[cfg(feature = "vulkan")]
pub fn headless_shared(settings: PatchlightSettings) -> App {
    let renderer = WgpuSettings { instance_flags: InstanceFlags::VALIDATION, ..WgpuSettings::default() };
    let renderer = bevy_patchlight::vulkan_renderer(&renderer).unwrap();
    headless_on(PatchlightSettings { shares_device: true, ..settings }, std::path::Path::new("assets"), renderer)
}

fn headless_on(settings: PatchlightSettings, assets: &std::path::Path, renderer: RenderCreation) -> App {
    let mut app = App::new();
    let window = WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() };
    let renderer = RenderPlugin { render_creation: renderer, synchronous_pipeline_compilation: true, ..default() };
    let files = AssetPlugin { file_path: assets.to_string_lossy().into_owned(), ..default() };
    let own = DefaultPlugins.set(window).set(renderer).set(files).disable::<WinitPlugin>().disable::<LogPlugin>();
    // One thread draws: a picture is that of its frame, and nothing is drawn while an app ends.
    let own = own.disable::<PipelinedRenderingPlugin>();
    app.add_plugins((own, PatchlightPlugin));
    app.insert_resource(settings);
    app.insert_resource(ClearColor(Color::BLACK));
    app.insert_resource(bevy::light::GlobalAmbientLight { brightness: 0.0, ..default() });
    app.finish();
    app.cleanup();
    app
}

/// A camera into a picture.
#[derive(Clone)]
pub struct Shot {
    size: UVec2,
    target: Handle<Image>,
}

impl Shot {
    /// Of a camera's bundle.
    pub fn new(app: &mut App, size: UVec2, camera: impl Bundle) -> Self {
        let mut image = Image::new_target_texture(size.x, size.y, TextureFormat::Rgba16Float, None);
        image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        let target = app.world_mut().resource_mut::<Assets<Image>>().add(image);
        let own = (RenderTarget::Image(target.clone().into()), bevy::camera::Hdr, Tonemapping::None, Msaa::Sample4);
        app.world_mut().spawn((camera, own));
        Self { size, target }
    }

    /// The picture after so many frames, linear, row by row.
    pub fn take(&self, app: &mut App, frames: usize) -> Vec<Vec3> {
        (0..frames).for_each(|_| app.update());
        let found = Arc::new(Mutex::new(None));
        let own = Arc::clone(&found);
        let reader = app
            .world_mut()
            .spawn(Readback::texture(self.target.clone()))
            .observe(move |event: On<ReadbackComplete>| *own.lock().unwrap() = Some(event.data.clone()))
            .id();
        let mut data = None;
        for _ in 0..50 {
            app.update();
            data = found.lock().unwrap().take();
            if data.is_some() {
                break;
            }
        }
        app.world_mut().entity_mut(reader).despawn();
        let data: Vec<u8> = data.expect("the picture comes back within 50 frames");
        // Rows may be padded.
        let rows = data.chunks_exact(data.len() / self.size.y as usize);
        let pixels = rows.flat_map(|row| &row[..8 * self.size.x as usize]).copied().collect::<Vec<u8>>();
        let half = |bytes: &[u8]| f16::from_le_bytes([bytes[0], bytes[1]]).to_f32();
        pixels.chunks_exact(8).map(|pixel| Vec3::new(half(pixel), half(&pixel[2..]), half(&pixel[4..]))).collect()
    }
}

/// Warnings and errors of the graphics driver's validation, of `wgpu` and of the plugin from now on.
pub fn messages() -> Arc<Mutex<Vec<String>>> {
    use bevy::log::tracing_subscriber::layer::{Context, Layer, SubscriberExt as _};
    use bevy::log::tracing_subscriber::registry;
    use bevy::log::tracing_subscriber::util::SubscriberInitExt as _;

    struct Kept(Arc<Mutex<Vec<String>>>);
    impl<S: bevy::log::tracing::Subscriber> Layer<S> for Kept {
        fn on_event(&self, event: &bevy::log::tracing::Event<'_>, _: Context<'_, S>) {
            let target = event.metadata().target();
            let is_asked = ["wgpu", "naga", "bevy_patchlight"].iter().any(|own| target.starts_with(own));
            if is_asked && *event.metadata().level() <= bevy::log::tracing::Level::WARN {
                self.0.lock().unwrap().push(format!("{event:?}"));
            }
        }
    }
    let kept = Arc::new(Mutex::new(Vec::new()));
    registry().with(Kept(Arc::clone(&kept))).init();
    kept
}
