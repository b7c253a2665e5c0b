// What goes wrong at the border: NULL, sizes, names, cancellation, threads; nothing crashes, and every message says what.
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <thread>

#include "patchlight.hpp"

namespace {

int failures = 0;

void expect(bool holds, const char* what, int line) {
  if (!holds) {
    std::fprintf(stderr, "line %d: %s; last error: %s\n", line, what, pl_last_error());
    ++failures;
  }
}
#define EXPECT(condition) expect((condition), #condition, __LINE__)

bool says(const char* text) { return std::strstr(pl_last_error(), text) != nullptr; }

patchlight::Scene box() {
  patchlight::Builder builder;
  const auto grey = builder.material({0.5f, 0.5f, 0.5f});
  const std::vector<std::uint32_t> quad{0, 1, 2, 0, 2, 3};
  builder.mesh({{0, 0, 0}, {0, 0, 1}, {1, 0, 1}, {1, 0, 0}}, quad, grey, "floor");
  builder.mesh({{0, 1, 0}, {1, 1, 0}, {1, 1, 1}, {0, 1, 1}}, quad, grey, "ceiling");
  builder.light(patchlight::point({0.5f, 0.5f, 0.5f}, {1, 1, 1}));
  return builder.build();
}

PlBakeSettings small() {
  auto settings = patchlight::Bake::settings();
  settings.patch_count = 60;
  settings.receiver_rays = 64;
  return settings;
}

void nulls() {
  PlScene* scene = nullptr;
  PlBake* bake = nullptr;
  PlField* field = nullptr;
  EXPECT(pl_builder_new(nullptr) == PL_INPUT && says("NULL"));
  EXPECT(pl_builder_build(nullptr, &scene) == PL_INPUT && says("builder is NULL"));
  EXPECT(pl_scene_load(nullptr, &scene) == PL_INPUT && says("path is NULL"));
  EXPECT(pl_bake_build(nullptr, nullptr, nullptr, nullptr, &bake) == PL_INPUT && says("scene is NULL"));
  EXPECT(pl_field_new(nullptr, nullptr, nullptr, &field) == PL_INPUT && says("bake is NULL"));
  EXPECT(pl_field_update(nullptr) == PL_INPUT && says("field is NULL"));
  EXPECT(pl_job_wait(nullptr, &bake) == PL_INPUT && pl_job_cancel(nullptr) == PL_INPUT);
  EXPECT(pl_scene_triangle_count(nullptr) == 0 && pl_field_triangle_count(nullptr) == 0);
  pl_scene_free(nullptr);
  pl_bake_free(nullptr);
  pl_field_free(nullptr);
  pl_job_free(nullptr);
  pl_builder_free(nullptr);
  pl_light_default(nullptr);
}

void scenes() {
  PlBuilder* builder = nullptr;
  EXPECT(pl_builder_new(&builder) == PL_OK);
  PlMesh mesh;
  pl_mesh_default(&mesh);
  const float positions[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  const std::uint32_t indices[3] = {0, 1, 7};
  mesh.name = "broken";
  mesh.positions = positions;
  mesh.vertex_count = 3;
  mesh.indices = indices;
  mesh.index_count = 3;
  mesh.material = 5;
  EXPECT(pl_builder_add_mesh(builder, &mesh, nullptr) == PL_INPUT && says("`broken`") && says("material 5"));
  mesh.material = 0;
  mesh.struct_size = 3;
  EXPECT(pl_builder_add_mesh(builder, &mesh, nullptr) == PL_INPUT && says("struct_size"));
  mesh.struct_size = sizeof mesh;
  EXPECT(pl_builder_add_mesh(builder, &mesh, nullptr) == PL_OK);
  PlLight light;
  pl_light_default(&light);
  light.kind = 77;
  EXPECT(pl_builder_add_light(builder, &light, nullptr) == PL_INPUT && says("77"));
  light.kind = PL_POINT;
  light.position[1] = NAN;
  EXPECT(pl_builder_add_light(builder, &light, nullptr) == PL_INPUT && says("finite"));
  PlScene* scene = nullptr;
  // The builder says what was wrong with a mesh when it is built.
  EXPECT(pl_builder_build(builder, &scene) == PL_INPUT && says("`broken`") && says("vertex 7 of 3"));
  EXPECT(pl_scene_load("no such file.obj", &scene) == PL_FILE && says("no such file.obj"));
}

// A structure of a newer header is taken where its new fields are zeros, and refused where they are not.
void versions() {
  struct Newer {
    PlBakeSettings known;
    std::uint64_t more;
  } newer{};
  pl_bake_settings_default(&newer.known);
  newer.known.struct_size = sizeof newer;
  newer.known.patch_count = 60;
  newer.known.receiver_rays = 64;
  const auto scene = box();
  PlBake* bake = nullptr;
  EXPECT(pl_bake_build(scene.get(), &newer.known, nullptr, nullptr, &bake) == PL_OK);
  pl_bake_free(bake);
  newer.more = 1;
  EXPECT(pl_bake_build(scene.get(), &newer.known, nullptr, nullptr, &bake) == PL_INPUT && says("does not know"));
  // An older one has fewer fields; the others are the defaults.
  auto older = small();
  older.struct_size = offsetof(PlBakeSettings, receiver_rays);
  older.receiver_rays = 0xffffffff;
  EXPECT(pl_bake_build(scene.get(), &older, nullptr, nullptr, &bake) == PL_OK);
  pl_bake_free(bake);
  EXPECT(pl_version() >= 100);
}

void bakes() {
  const auto scene = box();
  std::atomic<int> steps{0};
  const patchlight::Bake bake(scene, small(), [&](const char* phase, std::uint64_t done, std::uint64_t total) {
    EXPECT(phase[0] != 0 && done <= total);
    ++steps;
    return true;
  });
  EXPECT(steps > 0 && bake.counts().patches > 0);
  try {
    const patchlight::Bake cancelled(scene, small(), [](const char*, std::uint64_t, std::uint64_t) { return false; });
    EXPECT(!"it was cancelled");
  } catch (const patchlight::Error& error) {
    EXPECT(error.status() == PL_CANCELLED);
  }
  auto large = small();
  large.patch_count = 4000;
  large.memory_limit = 1 << 20;
  PlBake* refused = nullptr;
  EXPECT(pl_bake_build(scene.get(), &large, nullptr, nullptr, &refused) == PL_MEMORY);
  patchlight::Job job(scene, small());
  const auto waited = job.wait();
  EXPECT(waited.counts().patches == bake.counts().patches);
  auto slow = small();
  slow.patch_count = 3000;
  patchlight::Job stopped(scene, slow);
  stopped.cancel();
  try {
    stopped.wait();
    EXPECT(!"it was cancelled");
  } catch (const patchlight::Error& error) {
    EXPECT(error.status() == PL_CANCELLED);
  }
  { patchlight::Job dropped(scene, slow); }
  const std::string path = "border-test.bake";
  bake.save(path);
  const auto opened = patchlight::Bake::open(path);
  EXPECT(opened.counts().points == bake.counts().points);
  std::remove(path.c_str());
  PlBake* none = nullptr;
  EXPECT(pl_bake_open(path.c_str(), &none) == PL_FILE && says("border-test.bake"));
}

void fields() {
  const auto scene = box();
  const patchlight::Bake bake(scene, small());
  patchlight::LightField field(bake);
  const auto lamp = patchlight::point({0.5f, 0.5f, 0.5f}, {1, 1, 1});
  const auto set = field.add_points({{{0.5f, 0.2f, 0.5f}, {0, 1, 0}}, {{0.2f, 0.2f, 0.5f}, {0, 1, 0}}});
  float values[6];
  EXPECT(pl_field_points(field.get(), set, values, 6) == PL_INPUT && says("point set"));
  field.update();
  const auto one = field.points(set, 6);
  EXPECT(one[0] > 0 && std::isfinite(one[5]));
  EXPECT(pl_field_points(field.get(), set, values, 5) == PL_INPUT && says("room for 5 numbers; there are 6"));
  EXPECT(pl_field_points(field.get(), 9, values, 6) == PL_INPUT && says("point set 9"));
  auto twice = lamp;
  for (float& channel : twice.color) channel *= 2;
  field.set_lights({twice});
  int is_new = 0;
  EXPECT(pl_field_try_points(field.get(), set, values, 6, &is_new) == PL_OK);
  field.update();
  const auto two = field.points(set, 6);
  EXPECT(std::fabs(two[0] / one[0] - 2) < 1e-4);
  EXPECT(pl_field_try_points(field.get(), set, values, 6, &is_new) == PL_OK && is_new == 1 && values[0] == two[0]);
  const auto cubes = field.add_points({{{0.5f, 0.5f, 0.5f}, {0, 1, 0}}}, PL_CUBE);
  EXPECT(field.points(cubes, 18)[0] > 0);
  EXPECT(pl_field_remove_points(field.get(), set) == PL_OK && pl_field_points(field.get(), set, values, 6) == PL_INPUT);
  field.set_emission(1, {1, 1, 1});
  EXPECT(pl_field_set_emission(field.get(), 99, twice.color) == PL_INPUT && says("material 99"));
  field.set_sky({0.1f, 0.1f, 0.1f});
  field.update();
  EXPECT(field.surface(bake.counts().points)[0] >= 0);
  std::uint32_t width = 0, height = 0;
  EXPECT(pl_field_lightmap(field.get(), 1, values, 6) == PL_INPUT && says("pl_field_make_lightmap"));
  EXPECT(pl_field_make_lightmap(field.get(), nullptr, 0, 0.1f, &width, &height) == PL_OK && width > 0 && height > 0);
  std::vector<float> texels(std::size_t{3} * width * height), uvs(6 * pl_field_triangle_count(field.get()));
  EXPECT(pl_field_lightmap(field.get(), PL_FULL, texels.data(), texels.size()) == PL_OK);
  EXPECT(pl_field_lightmap(field.get(), 3, texels.data(), texels.size()) == PL_INPUT && says("PlLightPart"));
  EXPECT(pl_field_lightmap_uvs(field.get(), uvs.data(), uvs.size()) == PL_OK);
  EXPECT(pl_field_lightmap_uvs(field.get(), uvs.data(), 6) == PL_INPUT && says("uvs has room"));
  // Triangles of one's own: a part of the floor, whose texture coordinates are there, and one in the air.
  const std::vector<float> own{0.2f, 0, 0.2f, 0.2f, 0, 0.4f, 0.4f, 0, 0.2f, 0.2f, 0.5f, 0.2f, 0.3f, 0.5f, 0.2f, 0.2f, 0.6f, 0.2f};
  const auto lightmap = field.make_lightmap(own, 0.05f);
  EXPECT(lightmap.uvs.size() == 12 && lightmap.uvs[0] > 0 && lightmap.uvs[0] < 1 && std::isnan(lightmap.uvs[6]));
  const auto indirect = field.lightmap(lightmap, PL_INDIRECT), full = field.lightmap(lightmap, PL_FULL);
  EXPECT(indirect.size() == std::size_t{3} * lightmap.width * lightmap.height && indirect[0] > 0 && full[0] > indirect[0]);
  PlCamera camera;
  pl_camera_default(&camera);
  camera.eye[2] = 3;
  camera.target[0] = camera.target[1] = camera.target[2] = 0.5f;
  const auto picture = field.picture(camera, 32, 24, 2);
  double sum = 0;
  for (const float value : picture) sum += value;
  EXPECT(sum > 0 && std::isfinite(sum));
}

// A board that moves between the floor and the ceiling takes light away from points, and gives it back when it goes.
void objects() {
  const auto scene = box();
  const patchlight::Bake bake(scene, small());
  patchlight::LightField field(bake);
  field.update();
  const auto open = field.surface(bake.counts().points);
  const float corners[4][3] = {{0, 0, 0}, {0.8f, 0, 0}, {0.4f, 0, 0.8f}, {0.4f, 0.1f, 0.4f}};
  const std::uint32_t indices[12] = {0, 1, 2, 0, 3, 1, 1, 3, 2, 2, 3, 0};
  PlMesh mesh;
  pl_mesh_default(&mesh);
  mesh.name = "board";
  mesh.positions = corners[0];
  mesh.vertex_count = 4;
  mesh.indices = indices;
  mesh.index_count = 12;
  float place[12] = {1, 0, 0, 0.1f, 0, 1, 0, 0.3f, 0, 0, 1, 0.1f};
  const auto object = field.add_object(mesh, place);
  field.update();
  const auto covered = field.surface(bake.counts().points);
  place[7] = 0.7f;
  field.move_object(object, place);
  field.update();
  const auto moved = field.surface(bake.counts().points);
  EXPECT(covered != open && moved != covered);
  place[0] = std::nanf("");
  EXPECT(pl_field_move_object(field.get(), object, place) == PL_INPUT);
  mesh.material = 99;
  std::uint32_t none = 0;
  EXPECT(pl_field_add_object(field.get(), &mesh, nullptr, &none) == PL_INPUT && says("material"));
  EXPECT(pl_field_add_object(field.get(), nullptr, nullptr, nullptr) == PL_INPUT && says("out_object"));
  field.remove_object(object);
  field.update();
  EXPECT(field.surface(bake.counts().points) == open);
  EXPECT(pl_field_remove_object(field.get(), object) == PL_INPUT && says("object 0 is not of this field"));
}

// Different handles on different threads, and messages of each thread's own.
void threads() {
  const auto scene = box();
  const patchlight::Bake bake(scene, small());
  std::vector<std::thread> all;
  for (int k = 0; k < 3; ++k) {
    all.emplace_back([&, k] {
      patchlight::LightField field(bake);
      for (int frame = 0; frame < 5; ++frame) field.update();
      PlScene* none = nullptr;
      const std::string name = "missing-" + std::to_string(k) + ".obj";
      EXPECT(pl_scene_load(name.c_str(), &none) == PL_FILE && says(name.c_str()));
    });
  }
  for (auto& thread : all) thread.join();
}

}  // namespace

int main() try {
  nulls();
  scenes();
  versions();
  bakes();
  fields();
  objects();
  threads();
  std::printf("%d failures\n", failures);
  return failures == 0 ? 0 : 1;
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
