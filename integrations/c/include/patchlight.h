/* Patchlight: diffuse global illumination by radiosity, for C and C++.
 *
 * Lengths are metres; irradiance W/m2, radiance W/m2/sr, linear Rec.709 RGB; +y points upwards.
 *
 * Functions give a status; pl_last_error() says more of the last failure on the thread. Structures begin with their size:
 * set struct_size to sizeof of the structure, or let the pl_..._default function do so. Handles are ended by the function of
 * their name and `_free`; NULL is nothing to free. A handle is used by one thread at a time, unless it says otherwise;
 * different handles may be used by different threads. No function panics or unwinds into the caller. */

#ifndef PATCHLIGHT_H
#define PATCHLIGHT_H

#include <stddef.h>
#include <stdint.h>
#include <stdbool.h>
#ifdef PATCHLIGHT_VULKAN
#include <vulkan/vulkan.h>
#endif


// No texture.
#define PL_NONE UINT32_MAX

// Outcome of a function.
typedef enum PlStatus {
  // It did what it says.
  PL_OK = 0,
  // An argument, a scene or a light that makes no sense.
  PL_INPUT = 1,
  // A combination of scene, method and device that is not served.
  PL_UNSUPPORTED = 2,
  // More memory than there is, or than was allowed.
  PL_MEMORY = 3,
  // A device, its driver or the system.
  PL_DEVICE = 4,
  // A file that is missing, damaged or of another kind.
  PL_FILE = 5,
  // The callback, or pl_job_cancel, asked to stop.
  PL_CANCELLED = 6,
  // A fault of the library; please report it with the message.
  PL_PANIC = 7,
} PlStatus;

// Kind of a light.
typedef enum PlLightKind {
  // Parallel light along `direction`; `color` is the irradiance of a surface that faces it, W/m².
  PL_SUN = 0,
  // A point at `position`; `color` is its radiant intensity, W/sr.
  PL_POINT = 1,
  // A point that shines round `direction`, all of its intensity up to the half-angle `inner`, none beyond `outer`.
  PL_SPOT = 2,
  // A parallelogram from the corner `position` along `edge_a` and `edge_b`, to the side of edge_a × edge_b; `color` is its
  // radiance, W/m²/sr.
  PL_RECTANGLE = 3,
} PlLightKind;

// Light in a lightmap.
typedef enum PlLightPart {
  // Reflected at least once: for engines that light directly themselves.
  PL_INDIRECT = 0,
  // Direct and indirect.
  PL_FULL = 1,
  // All but the direct light of lights: for engines that know nothing of surfaces that shine and of skies.
  PL_WITHOUT_LIGHTS = 2,
} PlLightPart;

// How light goes between patches.
typedef enum PlMethod {
  // A product with the form factors for each bounce.
  PL_CLASSIC = 0,
  // All bounces in one product with a compressed operator, of relative error `epsilon`; made when the field is, unless the
  // bake has it.
  PL_LOW_RANK = 1,
  // All bounces in one product with a dense operator.
  PL_DENSE = 2,
  // One bounce an update, from the light of the update before.
  PL_FEEDBACK = 3,
  // A few samples a row and update, from the light of the update before.
  PL_TEMPORAL = 4,
} PlMethod;

// What is kept of each point.
typedef enum PlPointKind {
  // Irradiance for the point's normal: three numbers.
  PL_IRRADIANCE = 0,
  // An ambient cube: irradiance for +x, -x, +y, -y, +z, -z: eighteen numbers.
  PL_CUBE = 1,
  // Radiance as spherical harmonics of degree 1, L_00, L_1x, L_1y, L_1z: twelve numbers.
  PL_HARMONICS = 2,
} PlPointKind;

#if defined(PATCHLIGHT_VULKAN)
// Tables of a light field on the device, four floats a value: RGB and an unused one.
typedef enum PlTable {
#if defined(PATCHLIGHT_VULKAN)
  // Indirect irradiance between the receivers: what pl_field_surface reads.
  PL_SURFACE = 0,
#endif
#if defined(PATCHLIGHT_VULKAN)
  // Irradiance of the patches.
  PL_PATCHES = 1,
#endif
#if defined(PATCHLIGHT_VULKAN)
  // Irradiance of the elements.
  PL_ELEMENTS = 2,
#endif
#if defined(PATCHLIGHT_VULKAN)
  // First exitance of the patches.
  PL_SOURCE = 3,
#endif
} PlTable;
#endif

// A scene with everything about it that does not shine. May be used by several threads at once.
typedef struct PlBake PlBake;

// A scene that is being put together.
typedef struct PlBuilder PlBuilder;

// The light of a bake on a device.
typedef struct PlField PlField;

// A bake in the background.
typedef struct PlJob PlJob;

// A scene: surfaces and lights. May be read by several threads at once.
typedef struct PlScene PlScene;

// Settings of a bake.
typedef struct PlBakeSettings {
  // sizeof(PlBakeSettings).
  size_t struct_size;
  // About how many patches.
  size_t patch_count;
  // Rays of a receiver's row.
  uint32_t receiver_rays;
  // Rays to area lights, and to a map of the sky, from each sample.
  uint32_t sample_rays;
  // Bounces; 0 for all.
  uint32_t bounces;
  // Changes every random number; the same seed, the same bytes.
  uint32_t seed;
  // Most receivers; 0 for what suits the patches.
  size_t most_receivers;
  // Most resident memory, bytes; 0 for what is free. More is refused before work begins.
  uint64_t memory_limit;
} PlBakeSettings;

// Called now and then while work goes on, from any thread, by one at a time: `done` of `total` steps of a phase. Another
// result than 0 cancels the work.
typedef int (*PlProgress)(void *user, const char *phase, uint64_t done, uint64_t total);

// How far a background bake is.
typedef struct PlJobProgress {
  // Share of the whole work, 0 to 1, by an estimate.
  float share;
  // 1 when it has ended, for whatever reason.
  int is_finished;
} PlJobProgress;

// Sizes of a bake.
typedef struct PlBakeCounts {
  // Patches.
  size_t patches;
  // Elements.
  size_t elements;
  // Places where direct light is measured.
  size_t samples;
  // Receivers.
  size_t receivers;
  // Points between the receivers, of which pl_field_surface gives the light.
  size_t points;
} PlBakeCounts;

// Settings of a light field.
typedef struct PlFieldSettings {
  // sizeof(PlFieldSettings).
  size_t struct_size;
  // A PlMethod.
  uint32_t method;
  // Rays of each hemisphere of a point of pl_field_add_points.
  uint32_t point_rays;
  // Relative error of PL_LOW_RANK and PL_FEEDBACK.
  double epsilon;
} PlFieldSettings;

// A pinhole.
typedef struct PlCamera {
  // sizeof(PlCamera).
  size_t struct_size;
  // Place, m.
  float eye[3];
  // A point in the middle of the picture, m.
  float target[3];
  // Upwards, any length.
  float up[3];
  // Vertical field of view, degrees.
  float fov_degrees;
} PlCamera;

// A light that is no surface.
typedef struct PlLight {
  // sizeof(PlLight).
  size_t struct_size;
  // A PlLightKind.
  uint32_t kind;
  // Place, m.
  float position[3];
  // Direction in which it shines, any length.
  float direction[3];
  // Edges of a rectangle, m.
  float edge_a[3];
  // See edge_a.
  float edge_b[3];
  // Brightness; see PlLightKind.
  float color[3];
  // Half-angles of a spot, radians.
  float inner;
  // See inner.
  float outer;
} PlLight;

// A place whose light is asked for, on a surface or in the air.
typedef struct PlPoint {
  // Place, m.
  float position[3];
  // Normal, any length.
  float normal[3];
} PlPoint;

// Triangles of one material.
typedef struct PlMesh {
  // sizeof(PlMesh).
  size_t struct_size;
  // Name for messages, or NULL.
  const char *name;
  // x, y, z of each vertex, m.
  const float *positions;
  // Number of vertices.
  size_t vertex_count;
  // Three vertices of each triangle, counter-clockwise as seen from its front; NULL where every three vertices are one.
  const uint32_t *indices;
  // Number of indices.
  size_t index_count;
  // Smooth normals of the vertices, or NULL.
  const float *normals;
  // u, v of each vertex, or NULL; v = 0 is the bottom row of the picture.
  const float *uvs;
  // A material of pl_builder_add_material.
  uint32_t material;
  // Three rows of four numbers: rotation with scale, and translation; or NULL.
  const float *transform;
} PlMesh;

// A diffuse material.
typedef struct PlMaterial {
  // sizeof(PlMaterial).
  size_t struct_size;
  // Reflectance of each channel, 0 to 0.95; not used where there is a texture.
  float reflectance[3];
  // Radiance of its front, W/m²/sr.
  float radiance[3];
  // A texture of pl_builder_add_texture instead of the reflectance, or PL_NONE.
  uint32_t texture;
  // With a texture: places of a lower alpha are holes; 0 for none.
  float cutoff;
} PlMaterial;

#if defined(PATCHLIGHT_VULKAN)
// A device of the caller's; handles stay the caller's.
typedef struct PlBorrowedDevice {
  // sizeof(PlBorrowedDevice).
  size_t struct_size;
  // vkGetInstanceProcAddr.
  PFN_vkGetInstanceProcAddr get_instance_proc_addr;
  // An instance of Vulkan 1.2 or newer.
  VkInstance instance;
  // The physical device that `device` was made from.
  VkPhysicalDevice physical_device;
  // The device.
  VkDevice device;
  // The queue that passes, uploads and downloads are submitted to.
  VkQueue queue;
  // Its family, which has VK_QUEUE_COMPUTE_BIT.
  uint32_t queue_family;
  // The features that the device was made with; pl_vulkan_enable_features fills them.
  const VkPhysicalDeviceFeatures *features;
  // See features.
  const VkPhysicalDeviceVulkan12Features *vulkan_1_2;
} PlBorrowedDevice;
#endif

#if defined(PATCHLIGHT_VULKAN)
// A part of a buffer on the device.
typedef struct PlBuffer {
  // The buffer.
  VkBuffer buffer;
  // First byte.
  uint64_t offset;
  // Bytes.
  uint64_t bytes;
} PlBuffer;
#endif

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Fills a structure with its size and defaults.
//
// # Safety
// `settings` is NULL or may be written.
void pl_bake_settings_default(struct PlBakeSettings *settings);

// Bakes a scene, on all cores; NULL settings are the defaults, a NULL callback is none.
//
// # Safety
// Pointers are what they say; the callback may be called from other threads.
enum PlStatus pl_bake_build(const struct PlScene *scene,
                            const struct PlBakeSettings *settings,
                            PlProgress progress,
                            void *user,
                            struct PlBake **out);

// Begins a bake in the background; the scene may be freed.
//
// # Safety
// Pointers are what they say.
enum PlStatus pl_bake_start(const struct PlScene *scene,
                            const struct PlBakeSettings *settings,
                            struct PlJob **out);

// How far a bake is.
//
// # Safety
// Pointers are what they say.
enum PlStatus pl_job_progress(const struct PlJob *job, struct PlJobProgress *out);

// Asks a bake to end as soon as it can; does not wait. May be called from any thread.
//
// # Safety
// The handle is live.
enum PlStatus pl_job_cancel(const struct PlJob *job);

// Waits for a bake and gives it; the job ends in any case.
//
// # Safety
// The job is not used again.
enum PlStatus pl_job_wait(struct PlJob *job, struct PlBake **out);

// Cancels a bake and does not wait.
//
// # Safety
// It is NULL or not used again.
void pl_job_free(struct PlJob *job);

// Opens a file of pl_bake_save, or of the program's `patchlight bake`.
//
// # Safety
// `path` ends with a zero; `out` may be written.
enum PlStatus pl_bake_open(const char *path, struct PlBake **out);

// Writes a bake with its scene; a name for the scene, or NULL.
//
// # Safety
// Texts end with a zero.
enum PlStatus pl_bake_save(const struct PlBake *bake, const char *path, const char *scene_name);

// Sizes of a bake.
//
// # Safety
// Pointers are what they say.
enum PlStatus pl_bake_counts(const struct PlBake *bake, struct PlBakeCounts *out);

// Ends a bake; light fields of it stay.
//
// # Safety
// It is NULL or not used again.
void pl_bake_free(struct PlBake *bake);

// The message of the last failure on this thread, UTF-8; empty before the first. It names the mesh, the light or the file,
// and the remedy. Valid until the next failure on the thread.
const char *pl_last_error(void);

// Version of the library: major · 10000 + minor · 100 + patch.
uint32_t pl_version(void);

// Fills a structure with its size and defaults.
//
// # Safety
// `settings` is NULL or may be written.
void pl_field_settings_default(struct PlFieldSettings *settings);

// Fills a structure with its size and defaults.
//
// # Safety
// `camera` is NULL or may be written.
void pl_camera_default(struct PlCamera *camera);

// Puts a bake on a device: "cpu", "vulkan", "auto", a number or a part of a name; NULL for "cpu". The field keeps the bake.
//
// # Safety
// Pointers are what they say.
enum PlStatus pl_field_new(const struct PlBake *bake,
                           const struct PlFieldSettings *settings,
                           const char *device,
                           struct PlField **out);

// Sets the lights of the next update, instead of those that there were; at first they are the scene's. A light that is
// switched off best stays in the list with the color zero.
//
// # Safety
// `lights` begins `count` structures.
enum PlStatus pl_field_set_lights(struct PlField *field,
                                  const struct PlLight *lights,
                                  size_t count);

// Sets a constant sky, three numbers, W/m²/sr, of the next update.
//
// # Safety
// `radiance` has three numbers.
enum PlStatus pl_field_set_sky(struct PlField *field, const float *radiance);

// Sets what a material shines with from the next update on, three numbers, W/m²/sr.
//
// # Safety
// `radiance` has three numbers.
enum PlStatus pl_field_set_emission(struct PlField *field, uint32_t material, const float *radiance);

// Finds the light. On a device the work is submitted and not waited for; what reads results waits.
//
// # Safety
// The handle is live.
enum PlStatus pl_field_update(struct PlField *field);

// Indirect irradiance on the surfaces, W/m²: RGB at the `points` of pl_bake_counts. Waits.
//
// # Safety
// `rgb` has room for `count` numbers.
enum PlStatus pl_field_surface(struct PlField *field, float *rgb, size_t count);

// Adds points whose indirect light every update finds from now on, by a PlPointKind; their number goes to `out_set`. Their
// rays are traced here, once.
//
// # Safety
// `points` begins `count` structures.
enum PlStatus pl_field_add_points(struct PlField *field,
                                  const struct PlPoint *points,
                                  size_t count,
                                  uint32_t kind,
                                  uint32_t *out_set);

// Removes points; others keep their numbers.
//
// # Safety
// The handle is live.
enum PlStatus pl_field_remove_points(struct PlField *field, uint32_t set);

// The light of points after the last update: RGB of each value of each point. Waits.
//
// # Safety
// `values` has room for `count` numbers.
enum PlStatus pl_field_points(struct PlField *field, uint32_t set, float *values, size_t count);

// The newest light of points that has arrived; waits for nothing. `out_is_new` becomes 0 where none has arrived yet, and then
// the values stay as they are. From the first call on each update begins a copy.
//
// # Safety
// `values` has room for `count` numbers.
enum PlStatus pl_field_try_points(struct PlField *field,
                                  uint32_t set,
                                  float *values,
                                  size_t count,
                                  int *out_is_new);

// Lays out a lightmap with texels of this size, m, and gives its size in texels. It lies on the caller's triangles: nine
// numbers each, its corners, m, counter-clockwise from the front; NULL for those of the bake, which are cut where something
// stands on them. A triangle has its front's light, or its back's where only that has any.
//
// # Safety
// `corners` is NULL or begins nine numbers for each of `triangle_count` triangles.
enum PlStatus pl_field_make_lightmap(struct PlField *field,
                                     const float *corners,
                                     size_t triangle_count,
                                     float texel,
                                     uint32_t *out_width,
                                     uint32_t *out_height);

// Texture coordinates in the lightmap of the corners of its triangles: six numbers each, NaN for those without light.
//
// # Safety
// `uvs` has room for `count` numbers.
enum PlStatus pl_field_lightmap_uvs(struct PlField *field,
                                    float *uvs,
                                    size_t count);

// Number of triangles of the bake's scene, which are cut where something stands on them.
//
// # Safety
// The handle is live or NULL.
size_t pl_field_triangle_count(const struct PlField *field);

// Irradiance in the lightmap after the last update, W/m²: RGB of each texel, row by row, of a PlLightPart. Waits.
//
// # Safety
// `rgb` has room for `count` numbers.
enum PlStatus pl_field_lightmap(struct PlField *field,
                                uint32_t part,
                                float *rgb,
                                size_t count);

// A picture under the lights that are set: radiance, W/m²/sr, RGB of each pixel, row by row from the top. Waits.
//
// # Safety
// `rgb` has room for `count` numbers.
enum PlStatus pl_field_picture(struct PlField *field,
                               const struct PlCamera *camera,
                               uint32_t width,
                               uint32_t height,
                               uint32_t sub_frames,
                               float *rgb,
                               size_t count);

// Ends a light field.
//
// # Safety
// It is NULL or not used again; recordings of it are finished on the device.
void pl_field_free(struct PlField *field);

// Adds an object that moves through the scene: it throws shadows, takes light away from what is behind it, and reflects. A
// closed mesh of a few hundred triangles, with a material of the baked scene; its own transform comes before `transform`,
// three rows of four numbers, or NULL. Its number goes to `out_object`.
//
// # Safety
// Pointers are what they say.
enum PlStatus pl_field_add_object(struct PlField *field,
                                  const struct PlMesh *mesh,
                                  const float *transform,
                                  uint32_t *out_object);

// Moves an object, from the next update on: three rows of four numbers.
//
// # Safety
// `transform` is NULL, for its first place, or begins twelve numbers.
enum PlStatus pl_field_move_object(struct PlField *field, uint32_t object, const float *transform);

// Removes an object; others keep their numbers.
//
// # Safety
// The handle is live.
enum PlStatus pl_field_remove_object(struct PlField *field, uint32_t object);

// Fills a structure with its size and defaults: a point of 1 W/sr.
//
// # Safety
// `light` is NULL or may be written.
void pl_light_default(struct PlLight *light);

// Fills a structure with its size and defaults: grey of 0.5.
//
// # Safety
// `material` is NULL or may be written.
void pl_material_default(struct PlMaterial *material);

// Fills a structure with its size and nothing else.
//
// # Safety
// `mesh` is NULL or may be written.
void pl_mesh_default(struct PlMesh *mesh);

// Begins a scene.
//
// # Safety
// `out` may be written.
enum PlStatus pl_builder_new(struct PlBuilder **out);

// Adds a picture of sRGB bytes: red, green, blue and alpha of each texel, row by row from the top.
//
// # Safety
// `rgba` has 4 · width · height bytes.
enum PlStatus pl_builder_add_texture(struct PlBuilder *builder,
                                     uint32_t width,
                                     uint32_t height,
                                     const uint8_t *rgba,
                                     uint32_t *out_texture);

// Adds a material. Material 0 is grey of 0.5 and is there already.
//
// # Safety
// Pointers are what they say.
enum PlStatus pl_builder_add_material(struct PlBuilder *builder,
                                      const struct PlMaterial *material,
                                      uint32_t *out_material);

// Adds the triangles of a mesh; their number goes to `out_object`, unless that is NULL.
//
// # Safety
// Tables of the mesh are as long as it says.
enum PlStatus pl_builder_add_mesh(struct PlBuilder *builder, const struct PlMesh *mesh, uint32_t *out_object);

// Adds a light; its number among the scene's lights goes to `out_light`, unless that is NULL.
//
// # Safety
// Pointers are what they say.
enum PlStatus pl_builder_add_light(struct PlBuilder *builder,
                                   const struct PlLight *light,
                                   uint32_t *out_light);

// The same radiance, W/m²/sr, from every direction that sees no surface.
//
// # Safety
// `radiance` has three numbers.
enum PlStatus pl_builder_set_sky(struct PlBuilder *builder, const float *radiance);

// An equirectangular map of radiances, W/m²/sr: red, green and blue, row by row from the top; its middle column is -z.
//
// # Safety
// `rgb` has 3 · width · height numbers.
enum PlStatus pl_builder_set_sky_map(struct PlBuilder *builder,
                                     uint32_t width,
                                     uint32_t height,
                                     const float *rgb);

// Ends the builder, in any case, and gives the scene.
//
// # Safety
// The builder is not used again.
enum PlStatus pl_builder_build(struct PlBuilder *builder, struct PlScene **out);

// Ends a builder that is not built.
//
// # Safety
// It is NULL or not used again.
void pl_builder_free(struct PlBuilder *builder);

// Reads a scene file (.toml, .obj, .gltf, .glb), or makes the built-in scene of that name.
//
// # Safety
// `path` ends with a zero; `out` may be written.
enum PlStatus pl_scene_load(const char *path, struct PlScene **out);

// Least and greatest coordinates, m: three numbers each.
//
// # Safety
// Pointers are what they say.
enum PlStatus pl_scene_bounds(const struct PlScene *scene, float *out_low, float *out_high);

// Number of triangles; 0 of NULL.
//
// # Safety
// The handle is live or NULL.
size_t pl_scene_triangle_count(const struct PlScene *scene);

// Number of lights; 0 of NULL.
//
// # Safety
// The handle is live or NULL.
size_t pl_scene_light_count(const struct PlScene *scene);

// Ends a scene; bakes of it stay.
//
// # Safety
// It is NULL or not used again.
void pl_scene_free(struct PlScene *scene);

#if defined(PATCHLIGHT_VULKAN)
// Fills a structure with its size and nothing else.
//
// # Safety
// `device` is NULL or may be written.
void pl_borrowed_device_default(struct PlBorrowedDevice *device);
#endif

#if defined(PATCHLIGHT_VULKAN)
// Enables in the structures that a device is going to be made with what the kernels need; everything else in them stays.
// `supported` is what vkGetPhysicalDeviceFeatures says.
//
// # Safety
// Pointers are what they say.
enum PlStatus pl_vulkan_enable_features(const VkPhysicalDeviceFeatures *supported,
                                        VkPhysicalDeviceFeatures *features,
                                        VkPhysicalDeviceVulkan12Features *vulkan_1_2);
#endif

#if defined(PATCHLIGHT_VULKAN)
// Puts a bake on a device of the caller's, which outlives the field. While a function of the field runs, no other thread uses
// the queue.
//
// # Safety
// Handles are live, belong together, and stay so until the field is freed.
enum PlStatus pl_field_new_on(const struct PlBake *bake,
                              const struct PlFieldSettings *settings,
                              const struct PlBorrowedDevice *device,
                              struct PlField **out);
#endif

#if defined(PATCHLIGHT_VULKAN)
// As pl_field_update, recorded into a command buffer of the caller's that is in the recording state; the caller submits it.
// `slot` is 0 or 1: of each slot at most one recording is under way on the device.
//
// # Safety
// The command buffer is of the field's device and family; the last recording of the slot is finished on the device.
enum PlStatus pl_field_record(struct PlField *field,
                              VkCommandBuffer commands,
                              uint32_t slot);
#endif

#if defined(PATCHLIGHT_VULKAN)
// A PlTable on the device, for shaders of the caller's on the same device: they see the last update after a memory barrier
// from all commands. Another buffer after pl_field_add_points, pl_field_remove_points, and updates with more lights.
//
// # Safety
// Pointers are what they say.
enum PlStatus pl_field_buffer(struct PlField *field,
                              uint32_t which,
                              struct PlBuffer *out);
#endif

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* PATCHLIGHT_H */
