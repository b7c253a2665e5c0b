//! Pictures of Bevy without a window.

use std::sync::{Arc, Mutex};

use bevy::camera::RenderTarget;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::render::gpu_readback::{Readback, ReadbackComplete};
use bevy::render::render_resource::{TextureFormat, TextureUsages};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_patchlight::{PatchlightPlugin, PatchlightSettings};
use half::f16;

/// An app that draws without a window, and waits for its light.
pub fn headless(settings: PatchlightSettings) -> App {
    let mut app = App::new();
    let window = WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() };
    app.add_plugins((
        DefaultPlugins.set(window).disable::<WinitPlugin>().disable::<LogPlugin>(),
        PatchlightPlugin,
    ));
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
    pub camera: Entity,
}

impl Shot {
    /// Of a camera's bundle.
    pub fn new(app: &mut App, size: UVec2, camera: impl Bundle) -> Self {
        let mut image = Image::new_target_texture(size.x, size.y, TextureFormat::Rgba16Float, None);
        image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        let target = app.world_mut().resource_mut::<Assets<Image>>().add(image);
        let own = (RenderTarget::Image(target.clone().into()), bevy::camera::Hdr, Tonemapping::None, Msaa::Sample4);
        let camera = app.world_mut().spawn((camera, own)).id();
        Self { size, target, camera }
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
        let halves: Vec<f32> =
            data.chunks_exact(2).map(|bytes| f16::from_le_bytes([bytes[0], bytes[1]]).to_f32()).collect();
        assert_eq!(halves.len(), 4 * (self.size.x * self.size.y) as usize);
        halves.chunks_exact(4).map(Vec3::from_slice).collect()
    }
}

/// Messages of the graphics driver's validation and of Bevy's renderer from now on: warnings and errors.
pub fn messages() -> Arc<Mutex<Vec<String>>> {
    use bevy::log::tracing_subscriber::layer::{Context, Layer, SubscriberExt as _};
    use bevy::log::tracing_subscriber::util::SubscriberInitExt as _;
    use bevy::log::tracing_subscriber::registry;

    struct Kept(Arc<Mutex<Vec<String>>>);
    impl<S: bevy::log::tracing::Subscriber> Layer<S> for Kept {
        fn on_event(&self, event: &bevy::log::tracing::Event<'_>, _: Context<'_, S>) {
            if *event.metadata().level() <= bevy::log::tracing::Level::WARN {
                self.0.lock().unwrap().push(format!("{event:?}"));
            }
        }
    }
    let kept = Arc::new(Mutex::new(Vec::new()));
    registry().with(Kept(Arc::clone(&kept))).init();
    kept
}
