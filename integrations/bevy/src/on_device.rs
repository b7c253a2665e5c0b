//! Light on Bevy's own device: from the buffers of a light field to textures, with no copy to the processor.
#![allow(unsafe_code, reason = "Vulkan's own calls")]

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use bevy::app::{App, Plugin};
use bevy::asset::AssetId;
use bevy::ecs::entity::Entity;
use bevy::ecs::prelude::*;
use bevy::image::Image;
use bevy::log::warn;
use bevy::platform::cell::SyncCell;
use bevy::render::render_asset::RenderAssets;
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::texture::GpuImage;
use bevy::render::{ExtractSchedule, MainWorld, Render, RenderApp, RenderSystems};
use patchlight::glam::Vec3;
use patchlight::runtime::vulkan::BufferHandle;
use patchlight::runtime::vulkan::ash::{self, vk};
use patchlight::{Error, LightField, Lighting, ObjectId, PointKind, PointSet, Silent};
use wgpu::hal::api::Vulkan as Api;
use wgpu::util::DeviceExt as _;

use crate::renderer::{PatchlightRendererError, executor};
use crate::shared::{Base, DeviceBake, Layout, Message, Report, Row, Setup, Targets, ToDevice};
use crate::work::{Move, apply};

/// Texels of a half-float picture whose rows fill what a copy to a texture asks for.
const ROW_STEP: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT / TEXEL;
/// Bytes of a texel.
const TEXEL: u32 = 8;
/// Threads of a workgroup of `gather.wgsl`.
const GROUP: u32 = 64;

/// Finds light in the render world.
pub(crate) struct OnDevicePlugin;

impl Plugin for OnDevicePlugin {
    fn build(&self, app: &mut App) {
        let report = app.world().resource::<Report>().clone();
        if let Some(render) = app.get_sub_app_mut(RenderApp) {
            render
                .insert_resource(report)
                .init_resource::<ToDevice>()
                .init_resource::<OnDevice>()
                .add_systems(ExtractSchedule, take)
                .add_systems(Render, light.in_set(RenderSystems::PrepareResources));
        }
    }
}

fn take(mut world: ResMut<MainWorld>, mut waiting: ResMut<ToDevice>) {
    waiting.messages.append(&mut world.resource_mut::<ToDevice>().messages);
}

/// The light of a scene.
#[derive(Resource, Default)]
struct OnDevice(Option<SyncCell<Lit>>);

/// A light field with the textures that it writes. The device goes last.
struct Lit {
    field: LightField,
    set: Option<PointSet>,
    objects: HashMap<Entity, ObjectId>,
    lightmap: Gather,
    probes: Option<Gather>,
    pipeline: wgpu::ComputePipeline,
    /// Textures do not have the newest light yet.
    is_due: bool,
    device: RenderDevice,
}

impl Drop for Lit {
    fn drop(&mut self) {
        wait(&self.device);
    }
}

/// Waits until nothing that was submitted reads a buffer of the light field any more.
fn wait(device: &RenderDevice) {
    if let Err(error) = device.poll(wgpu::PollType::wait_indefinitely()) {
        warn!("Patchlight: {error}");
    }
}

/// What is new for the light, found and shown. Has the world for itself, so that nobody else submits meanwhile.
fn light(world: &mut World) {
    let messages = std::mem::take(&mut world.resource_mut::<ToDevice>().messages);
    let (device, queue) = (world.resource::<RenderDevice>().clone(), world.resource::<RenderQueue>().clone());
    let report = world.resource::<Report>().clone();
    world.resource_scope(|world, mut own: Mut<OnDevice>| {
        if let Err(error) = follow(&mut own.0, messages, (&device, &queue), &report) {
            report.lock().error = Some(error.to_string());
            own.0 = None;
        }
        if let Some(lit) = &mut own.0 {
            let lit = SyncCell::get(lit);
            if lit.is_due
                && let Err(error) = lit.show(world.resource::<RenderAssets<GpuImage>>(), &queue)
            {
                report.lock().error = Some(error.to_string());
                own.0 = None;
            }
        }
    });
}

/// Does what messages say, of the light of several lightings the last.
fn follow(
    own: &mut Option<SyncCell<Lit>>,
    messages: Vec<Message>,
    (device, queue): (&RenderDevice, &RenderQueue),
    report: &Report,
) -> Result<(), Error> {
    let mut newest: Option<Lighting> = None;
    for message in messages {
        match (message, own.as_mut().map(SyncCell::get)) {
            (Message::End, _) => *own = None,
            (Message::Bake(mut bake, targets, scene), lit) => match (bake.setup.take(), lit) {
                (Some(setup), _) => {
                    *own = None;
                    *report.lock() = crate::shared::Done { scene, ..Default::default() };
                    *own = Some(SyncCell::new(Lit::new(&bake, setup, targets, device)?));
                }
                (None, Some(lit)) => lit.set_bake(&bake)?,
                (None, None) => {}
            },
            (Message::Base(base), Some(lit)) => lit.set_base(&base, queue),
            (Message::Light(lighting, moves), Some(lit)) => {
                report.lock().warnings.extend(lit.apply(&moves));
                newest = Some(*lighting);
            }
            (_, None) => {}
        }
    }
    if let (Some(lighting), Some(lit)) = (newest, own) {
        let start = Instant::now();
        let lit = SyncCell::get(lit);
        lit.field.update(&lighting)?;
        lit.is_due = true;
        let mut done = report.lock();
        done.updates += 1;
        done.seconds = start.elapsed().as_secs_f32();
    }
    Ok(())
}

impl Lit {
    fn new(bake: &DeviceBake, setup: Setup, targets: Targets, device: &RenderDevice) -> Result<Self, Error> {
        let own = device.wgpu_device();
        // SAFETY: `Self` keeps the device longer than the light field. Its functions are called by a system that has the
        // render world for itself.
        let vulkan = unsafe { executor(own) }?;
        let mut field = LightField::new(Arc::clone(&bake.bake), Box::new(vulkan), &setup.light, &Silent)?;
        let pipeline = pipeline(own);
        let mut set = None;
        let mut probes = None;
        if let (Some((points, layout)), Some(target)) = (setup.probes, targets.probes) {
            set = Some(field.add_points(&points, PointKind::Cube, &Silent)?);
            let sides = points.len() * PointKind::Cube.values();
            let rows: Vec<Row> = (0..sides as u32).map(|k| ([k; 3], [1.0, 0.0, 0.0])).collect();
            probes = Some(Gather::new(own, target, &layout, &rows));
        }
        let lightmap = Gather::new(own, targets.lightmap, &setup.lightmap, &bake.rows);
        let objects = HashMap::new();
        Ok(Self { field, set, objects, lightmap, probes, pipeline, is_due: false, device: device.clone() })
    }

    fn set_bake(&mut self, bake: &DeviceBake) -> Result<(), Error> {
        wait(&self.device);
        self.field.set_bake(Arc::clone(&bake.bake), &Silent)?;
        self.lightmap.rows = rows_buffer(self.device.wgpu_device(), &bake.rows);
        self.forget_sources();
        Ok(())
    }

    /// The light field may have other buffers now.
    fn forget_sources(&mut self) {
        self.lightmap.source = None;
        self.probes.iter_mut().for_each(|probes| probes.source = None);
    }

    fn set_base(&mut self, base: &Base, queue: &RenderQueue) {
        self.lightmap.set_base(&base.lightmap, queue);
        self.probes.iter().for_each(|probes| probes.set_base(&base.probes, queue));
        self.is_due = true;
    }

    /// Moves what moves; what is wrong with that.
    fn apply(&mut self, moves: &[Move]) -> Vec<String> {
        if moves.iter().any(|change| !matches!(change, Move::Place(..))) {
            wait(&self.device);
            self.forget_sources();
        }
        let Self { field, objects, .. } = self;
        let outcomes = moves.iter().map(|change| apply(field, objects, change));
        outcomes.filter_map(|outcome| Some(outcome.err()?.to_string())).collect()
    }

    /// Writes the textures, once they are there.
    fn show(&mut self, images: &RenderAssets<GpuImage>, queue: &RenderQueue) -> Result<(), Error> {
        let probes = self.probes.as_ref().map(|probes| probes.target);
        let targets: Option<Vec<&GpuImage>> =
            [Some(self.lightmap.target), probes].into_iter().flatten().map(|target| images.get(target)).collect();
        let Some(targets) = targets else { return Ok(()) };
        let interpolated = self.field.buffers().interpolated;
        let points = self.set.and_then(|set| self.field.point_buffer(set));
        let Some(vulkan) = self.field.vulkan_mut() else { return Ok(()) };
        let sources = [Some(interpolated), points].into_iter().flatten().filter_map(|buffer| vulkan.buffer(buffer));
        let sources: Vec<BufferHandle> = sources.collect();
        let device = self.device.wgpu_device();
        let mut copies = Vec::new();
        let mut encoder = device.create_command_encoder(&Default::default());
        let gathers = std::iter::once(&mut self.lightmap).chain(&mut self.probes);
        for ((gather, from), image) in gathers.zip(sources).zip(targets) {
            copies.push((from, gather.source(device, from.bytes)?));
            gather.record(device, &self.pipeline, image, &mut encoder);
        }
        // An encoder has either commands of `wgpu` or of Vulkan.
        let mut first = device.create_command_encoder(&Default::default());
        // SAFETY: the buffers live until `wait`; the recording is outside of a pass.
        unsafe { record_copies(device, &mut first, &copies) }?;
        queue.submit([first.finish(), encoder.finish()]);
        self.is_due = false;
        Ok(())
    }
}

fn other() -> Error {
    Error::new(patchlight::ErrorKind::Device, PatchlightRendererError::OtherDevice)
}

/// Copies buffers of a light field to those of `wgpu`, after all that was submitted before.
///
/// # Safety
/// The buffers live until the commands are executed.
unsafe fn record_copies(
    device: &wgpu::Device,
    encoder: &mut wgpu::CommandEncoder,
    copies: &[(BufferHandle, vk::Buffer)],
) -> Result<(), Error> {
    // SAFETY: nothing of it is destroyed.
    let own = unsafe { device.as_hal::<Api>() }.ok_or_else(other)?;
    let raw: &ash::Device = own.raw_device();
    // SAFETY: the command buffer is being recorded, and stays so; the buffers live, as the caller promises.
    unsafe {
        encoder.as_hal_mut::<Api, _, _>(|encoder| {
            let commands = encoder.ok_or_else(other)?.raw_handle();
            let all = vk::PipelineStageFlags::ALL_COMMANDS;
            let access = vk::AccessFlags::MEMORY_READ | vk::AccessFlags::MEMORY_WRITE;
            let barrier = [vk::MemoryBarrier::default().src_access_mask(access).dst_access_mask(access)];
            raw.cmd_pipeline_barrier(commands, all, all, vk::DependencyFlags::empty(), &barrier, &[], &[]);
            for (from, to) in copies {
                let region = [vk::BufferCopy { src_offset: from.offset, dst_offset: 0, size: from.bytes }];
                raw.cmd_copy_buffer(commands, from.buffer, *to, &region);
            }
            raw.cmd_pipeline_barrier(commands, all, all, vk::DependencyFlags::empty(), &barrier, &[], &[]);
            Ok(())
        })
    }
}

fn pipeline(device: &wgpu::Device) -> wgpu::ComputePipeline {
    let module = device.create_shader_module(wgpu::include_wgsl!("gather.wgsl"));
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("patchlight gather"),
        layout: None,
        module: &module,
        entry_point: Some("gather"),
        compilation_options: Default::default(),
        cache: None,
    })
}

/// A picture that takes its texels from values of a light field.
struct Gather {
    target: AssetId<Image>,
    size: [u32; 3],
    rows: wgpu::Buffer,
    base: wgpu::Buffer,
    shown: wgpu::Buffer,
    shape: wgpu::Buffer,
    texels: wgpu::Buffer,
    /// Copy of a buffer of the light field, and its handle.
    source: Option<(wgpu::Buffer, vk::Buffer, u64)>,
}

impl Gather {
    fn new(device: &wgpu::Device, target: AssetId<Image>, layout: &Layout, rows: &[Row]) -> Self {
        let [width, height, depth] = layout.size;
        let stride = width.next_multiple_of(ROW_STEP);
        let filled = |contents: &[u8], usage| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage })
        };
        let empty = |size: u64, usage| {
            device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false })
        };
        let shape: Vec<u8> = [width, stride, 0, 0].into_iter().flat_map(u32::to_le_bytes).collect();
        let shown: Vec<u8> = layout.shown.iter().flat_map(|receiver| receiver.to_le_bytes()).collect();
        let storage = wgpu::BufferUsages::STORAGE;
        let texels = u64::from(TEXEL) * u64::from(stride) * u64::from(height) * u64::from(depth);
        Self {
            target,
            size: layout.size,
            rows: rows_buffer(device, rows),
            base: empty(12 * rows.len().max(1) as u64, storage | wgpu::BufferUsages::COPY_DST),
            shown: filled(&shown, storage),
            shape: filled(&shape, wgpu::BufferUsages::UNIFORM),
            texels: empty(texels, storage | wgpu::BufferUsages::COPY_SRC),
            source: None,
        }
    }

    fn set_base(&self, base: &[Vec3], queue: &RenderQueue) {
        let bytes: Vec<u8> = base.iter().flat_map(|value| value.to_array()).flat_map(f32::to_le_bytes).collect();
        let room = self.base.size() as usize;
        queue.write_buffer(&self.base, 0, &bytes[..bytes.len().min(room)]);
    }

    /// The buffer that a buffer of the light field of so many bytes is copied to.
    fn source(&mut self, device: &wgpu::Device, bytes: u64) -> Result<vk::Buffer, Error> {
        match &self.source {
            Some((_, raw, size)) if *size == bytes => Ok(*raw),
            _ => {
                let (buffer, raw) = source_buffer(device, bytes)?;
                self.source = Some((buffer, raw, bytes));
                Ok(raw)
            }
        }
    }

    fn record(
        &self,
        device: &wgpu::Device,
        pipeline: &wgpu::ComputePipeline,
        image: &GpuImage,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        let Some((source, ..)) = &self.source else { return };
        let buffers = [source, &self.rows, &self.base, &self.shown, &self.texels, &self.shape];
        let entries: Vec<_> = (0..)
            .zip(buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let layout = &pipeline.get_bind_group_layout(0);
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries });
        let [width, height, depth_or_array_layers] = self.size;
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(width.div_ceil(GROUP), height * depth_or_array_layers, 1);
        drop(pass);
        let bytes_per_row = Some(TEXEL * width.next_multiple_of(ROW_STEP));
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row, rows_per_image: Some(height) };
        encoder.copy_buffer_to_texture(
            wgpu::TexelCopyBufferInfo { buffer: &self.texels, layout },
            image.texture.as_image_copy(),
            wgpu::Extent3d { width, height, depth_or_array_layers },
        );
    }
}

fn rows_buffer(device: &wgpu::Device, rows: &[Row]) -> wgpu::Buffer {
    let words = rows.iter().flat_map(|(points, weights)| points.iter().copied().chain(weights.map(f32::to_bits)));
    let mut contents: Vec<u8> = words.flat_map(u32::to_le_bytes).collect();
    contents.resize(contents.len().max(24), 0);
    let usage = wgpu::BufferUsages::STORAGE;
    device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents: &contents, usage })
}

/// A buffer of `wgpu` with its handle, which `wgpu` does not give of buffers that it makes itself.
fn source_buffer(device: &wgpu::Device, bytes: u64) -> Result<(wgpu::Buffer, vk::Buffer), Error> {
    // SAFETY: nothing of it is destroyed.
    let own = unsafe { device.as_hal::<Api>() }.ok_or_else(other)?;
    let (raw, instance) = (own.raw_device(), own.shared_instance().raw_instance());
    let failed = |call: &'static str| {
        move |result: vk::Result| {
            let error = PatchlightRendererError::Vulkan { call, result: result.to_string() };
            Error::new(patchlight::ErrorKind::Device, error)
        }
    };
    let usage = vk::BufferUsageFlags::STORAGE_BUFFER | vk::BufferUsageFlags::TRANSFER_DST;
    let create = vk::BufferCreateInfo::default().size(bytes).usage(usage);
    // SAFETY: the device lives; what is made is given to `wgpu`, which destroys it, or destroyed here.
    unsafe {
        let buffer = raw.create_buffer(&create, None).map_err(failed("vkCreateBuffer"))?;
        let needs = raw.get_buffer_memory_requirements(buffer);
        let types = instance.get_physical_device_memory_properties(own.raw_physical_device());
        let is_local = |k: &u32| {
            let flags = types.memory_types_as_slice()[*k as usize].property_flags;
            needs.memory_type_bits & (1 << k) != 0 && flags.contains(vk::MemoryPropertyFlags::DEVICE_LOCAL)
        };
        let kind = (0..types.memory_type_count).find(is_local).unwrap_or(needs.memory_type_bits.trailing_zeros());
        let allocate = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(kind);
        let memory = raw.allocate_memory(&allocate, None).map_err(|result| {
            raw.destroy_buffer(buffer, None);
            failed("vkAllocateMemory")(result)
        })?;
        raw.bind_buffer_memory(buffer, memory, 0).map_err(|result| {
            raw.destroy_buffer(buffer, None);
            raw.free_memory(memory, None);
            failed("vkBindBufferMemory")(result)
        })?;
        let managed = wgpu::hal::vulkan::Buffer::from_raw_managed(buffer, memory, 0, needs.size);
        let usage = wgpu::BufferUsages::STORAGE;
        let descriptor = wgpu::BufferDescriptor { label: None, size: bytes, usage, mapped_at_creation: false };
        Ok((device.create_buffer_from_hal::<Api>(managed, &descriptor), buffer))
    }
}
