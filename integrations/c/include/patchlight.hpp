// Patchlight for C++17: handles that end themselves, and exceptions instead of statuses. See patchlight.h.
#ifndef PATCHLIGHT_HPP
#define PATCHLIGHT_HPP

#include <array>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "patchlight.h"

namespace patchlight {

using Vec3 = std::array<float, 3>;

// A failure; what() names the mesh, the light or the file, and the remedy.
class Error : public std::runtime_error {
 public:
  Error(PlStatus status, const char* message) : std::runtime_error(message), status_(status) {}
  PlStatus status() const noexcept { return status_; }

 private:
  PlStatus status_;
};

inline void check(PlStatus status) {
  if (status != PL_OK) throw Error(status, pl_last_error());
}

namespace detail {
template <typename T, void (*End)(T*)>
struct Ender {
  void operator()(T* handle) const noexcept { End(handle); }
};
template <typename T, void (*End)(T*)>
using Handle = std::unique_ptr<T, Ender<T, End>>;

template <typename H, typename Make>
H made(Make make) {
  typename H::pointer handle = nullptr;
  check(make(&handle));
  return H(handle);
}
}  // namespace detail

// Progress of a bake: the phase, steps that are done, and all of them; false cancels. It must not throw.
using Progress = std::function<bool(const char* phase, std::uint64_t done, std::uint64_t total)>;

// Lights in radiometric units: see PlLightKind.
inline PlLight light_of(PlLightKind kind, Vec3 color) {
  PlLight light;
  pl_light_default(&light);
  light.kind = kind;
  for (int k = 0; k < 3; ++k) light.color[k] = color[k];
  return light;
}
inline PlLight sun(Vec3 direction, Vec3 irradiance) {
  PlLight light = light_of(PL_SUN, irradiance);
  for (int k = 0; k < 3; ++k) light.direction[k] = direction[k];
  return light;
}
inline PlLight point(Vec3 position, Vec3 intensity) {
  PlLight light = light_of(PL_POINT, intensity);
  for (int k = 0; k < 3; ++k) light.position[k] = position[k];
  return light;
}
inline PlLight rectangle(Vec3 corner, Vec3 edge_a, Vec3 edge_b, Vec3 radiance) {
  PlLight light = light_of(PL_RECTANGLE, radiance);
  for (int k = 0; k < 3; ++k) {
    light.position[k] = corner[k];
    light.edge_a[k] = edge_a[k];
    light.edge_b[k] = edge_b[k];
  }
  return light;
}

// Surfaces and lights.
class Scene {
 public:
  // A file (.toml, .obj, .gltf, .glb) or a built-in scene.
  static Scene load(const std::string& path) {
    return Scene(detail::made<Own>([&](PlScene** out) { return pl_scene_load(path.c_str(), out); }));
  }
  std::size_t triangle_count() const { return pl_scene_triangle_count(get()); }
  const PlScene* get() const noexcept { return own_.get(); }

 private:
  friend class Builder;
  using Own = detail::Handle<PlScene, pl_scene_free>;
  explicit Scene(Own own) : own_(std::move(own)) {}
  Own own_;
};

// Puts a scene together.
class Builder {
 public:
  Builder() : own_(detail::made<Own>([](PlBuilder** out) { return pl_builder_new(out); })) {}
  std::uint32_t material(Vec3 reflectance, Vec3 radiance = {0, 0, 0}) {
    PlMaterial material;
    pl_material_default(&material);
    for (int k = 0; k < 3; ++k) {
      material.reflectance[k] = reflectance[k];
      material.radiance[k] = radiance[k];
    }
    std::uint32_t id = 0;
    check(pl_builder_add_material(own_.get(), &material, &id));
    return id;
  }
  // Positions of three vertices a triangle, or with indices of any; the object's number.
  std::uint32_t mesh(const std::vector<Vec3>& positions, const std::vector<std::uint32_t>& indices, std::uint32_t material,
                     const std::string& name = "") {
    PlMesh mesh;
    pl_mesh_default(&mesh);
    mesh.name = name.c_str();
    mesh.positions = positions.empty() ? nullptr : positions.front().data();
    mesh.vertex_count = positions.size();
    mesh.indices = indices.empty() ? nullptr : indices.data();
    mesh.index_count = indices.size();
    mesh.material = material;
    return this->mesh(mesh);
  }
  std::uint32_t mesh(const PlMesh& mesh) {
    std::uint32_t object = 0;
    check(pl_builder_add_mesh(own_.get(), &mesh, &object));
    return object;
  }
  std::uint32_t light(const PlLight& light) {
    std::uint32_t number = 0;
    check(pl_builder_add_light(own_.get(), &light, &number));
    return number;
  }
  void sky(Vec3 radiance) { check(pl_builder_set_sky(own_.get(), radiance.data())); }
  // The scene; the builder is empty after it.
  Scene build() {
    PlScene* scene = nullptr;
    check(pl_builder_build(own_.release(), &scene));
    return Scene(Scene::Own(scene));
  }

 private:
  using Own = detail::Handle<PlBuilder, pl_builder_free>;
  Own own_;
};

// What a scene at rest needs.
class Bake {
 public:
  static PlBakeSettings settings() {
    PlBakeSettings settings;
    pl_bake_settings_default(&settings);
    return settings;
  }
  explicit Bake(const Scene& scene, const PlBakeSettings& settings = Bake::settings(), Progress progress = nullptr)
      : own_(detail::made<Own>([&](PlBake** out) {
          return pl_bake_build(scene.get(), &settings, progress ? &call : nullptr, &progress, out);
        })) {}
  static Bake open(const std::string& path) {
    return Bake(detail::made<Own>([&](PlBake** out) { return pl_bake_open(path.c_str(), out); }));
  }
  void save(const std::string& path, const std::string& scene = "scene") const {
    check(pl_bake_save(get(), path.c_str(), scene.c_str()));
  }
  PlBakeCounts counts() const {
    PlBakeCounts counts;
    check(pl_bake_counts(get(), &counts));
    return counts;
  }
  const PlBake* get() const noexcept { return own_.get(); }

 private:
  friend class Job;
  using Own = detail::Handle<PlBake, pl_bake_free>;
  explicit Bake(Own own) : own_(std::move(own)) {}
  static int call(void* user, const char* phase, std::uint64_t done, std::uint64_t total) {
    return (*static_cast<Progress*>(user))(phase, done, total) ? 0 : 1;
  }
  Own own_;
};

// A bake in the background; it is cancelled when it goes out of scope.
class Job {
 public:
  explicit Job(const Scene& scene, const PlBakeSettings& settings = Bake::settings())
      : own_(detail::made<Own>([&](PlJob** out) { return pl_bake_start(scene.get(), &settings, out); })) {}
  PlJobProgress progress() const {
    PlJobProgress progress;
    check(pl_job_progress(own_.get(), &progress));
    return progress;
  }
  void cancel() const { check(pl_job_cancel(own_.get())); }
  // Waits for the bake; the job is empty after it.
  Bake wait() {
    PlBake* bake = nullptr;
    check(pl_job_wait(own_.release(), &bake));
    return Bake(Bake::Own(bake));
  }

 private:
  using Own = detail::Handle<PlJob, pl_job_free>;
  Own own_;
};

// A lightmap: its size in texels, and the texture coordinates of the corners of its triangles, six numbers each, NaN for those
// without light.
struct Lightmap {
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::vector<float> uvs;
};

// The light of a bake on a device.
class LightField {
 public:
  static PlFieldSettings settings(PlMethod method = PL_CLASSIC) {
    PlFieldSettings settings;
    pl_field_settings_default(&settings);
    settings.method = method;
    return settings;
  }
  // "cpu", "vulkan", "auto", a number or a part of a name.
  explicit LightField(const Bake& bake, const PlFieldSettings& settings = LightField::settings(), const char* device = "cpu")
      : own_(detail::made<Own>([&](PlField** out) { return pl_field_new(bake.get(), &settings, device, out); })) {}
#ifdef PATCHLIGHT_VULKAN
  LightField(const Bake& bake, const PlFieldSettings& settings, const PlBorrowedDevice& device)
      : own_(detail::made<Own>([&](PlField** out) { return pl_field_new_on(bake.get(), &settings, &device, out); })) {}
  void record(VkCommandBuffer commands, std::uint32_t slot) { check(pl_field_record(get(), commands, slot)); }
  PlBuffer buffer(PlTable table) {
    PlBuffer buffer;
    check(pl_field_buffer(get(), table, &buffer));
    return buffer;
  }
#endif
  void set_lights(const std::vector<PlLight>& lights) { check(pl_field_set_lights(get(), lights.data(), lights.size())); }
  void set_sky(Vec3 radiance) { check(pl_field_set_sky(get(), radiance.data())); }
  void set_emission(std::uint32_t material, Vec3 radiance) { check(pl_field_set_emission(get(), material, radiance.data())); }
  void update() { check(pl_field_update(get())); }
  std::vector<float> surface(std::size_t points) {
    return read(3 * points, [&](float* out, std::size_t count) { return pl_field_surface(get(), out, count); });
  }
  std::uint32_t add_points(const std::vector<PlPoint>& points, PlPointKind kind = PL_IRRADIANCE) {
    std::uint32_t set = 0;
    check(pl_field_add_points(get(), points.data(), points.size(), kind, &set));
    return set;
  }
  std::vector<float> points(std::uint32_t set, std::size_t numbers) {
    return read(numbers, [&](float* out, std::size_t count) { return pl_field_points(get(), set, out, count); });
  }
  // A closed mesh that moves; of a transform three rows of four numbers.
  std::uint32_t add_object(const PlMesh& mesh, const float* transform = nullptr) {
    std::uint32_t object = 0;
    check(pl_field_add_object(get(), &mesh, transform, &object));
    return object;
  }
  void move_object(std::uint32_t object, const float* transform) { check(pl_field_move_object(get(), object, transform)); }
  void remove_object(std::uint32_t object) { check(pl_field_remove_object(get(), object)); }
  // On triangles of nine numbers each.
  Lightmap make_lightmap(const std::vector<float>& corners, float texel) {
    Lightmap made;
    const auto count = corners.size() / 9;
    check(pl_field_make_lightmap(get(), corners.data(), count, texel, &made.width, &made.height));
    made.uvs = read(6 * count, [&](float* out, std::size_t size) { return pl_field_lightmap_uvs(get(), out, size); });
    return made;
  }
  // RGB of each texel, row by row.
  std::vector<float> lightmap(const Lightmap& lightmap, PlLightPart part = PL_INDIRECT) {
    return read(std::size_t{3} * lightmap.width * lightmap.height, [&](float* out, std::size_t count) {
      return pl_field_lightmap(get(), part, out, count);
    });
  }
  // RGB of each pixel, row by row.
  std::vector<float> picture(const PlCamera& camera, std::uint32_t width, std::uint32_t height, std::uint32_t sub_frames = 16) {
    return read(std::size_t{3} * width * height, [&](float* out, std::size_t count) {
      return pl_field_picture(get(), &camera, width, height, sub_frames, out, count);
    });
  }
  PlField* get() noexcept { return own_.get(); }

 private:
  using Own = detail::Handle<PlField, pl_field_free>;
  template <typename Read>
  static std::vector<float> read(std::size_t count, Read from) {
    std::vector<float> values(count);
    check(from(values.data(), count));
    return values;
  }
  Own own_;
};

}  // namespace patchlight

#endif  // PATCHLIGHT_HPP
