/* A room put together in memory, with a lamp and a sun through its window; prints light on a desk. */
#include <stdio.h>
#include <stdlib.h>

#include "patchlight.h"

#define CHECK(call)                                                      \
  do {                                                                   \
    if ((call) != PL_OK) {                                               \
      fprintf(stderr, "%s\n", pl_last_error());                          \
      exit(1);                                                           \
    }                                                                    \
  } while (0)

/* Corner and two edges of each wall, m. The window is a gap in that of x = 0. */
static const float walls[9][3][3] = {
    {{0, 0, 0}, {0, 0, 4}, {5, 0, 0}},     {{0, 2.7f, 0}, {5, 0, 0}, {0, 0, 4}},    {{0, 0, 0}, {5, 0, 0}, {0, 2.7f, 0}},
    {{0, 0, 4}, {0, 2.7f, 0}, {5, 0, 0}},  {{5, 0, 0}, {0, 0, 4}, {0, 2.7f, 0}},    {{0, 0, 0}, {0, 1, 0}, {0, 0, 4}},
    {{0, 2.3f, 0}, {0, 0.4f, 0}, {0, 0, 4}}, {{0, 1, 0}, {0, 1.3f, 0}, {0, 0, 1}}, {{0, 1, 3}, {0, 1.3f, 0}, {0, 0, 1}},
};

static int show(void *user, const char *phase, uint64_t done, uint64_t total) {
  (void)user;
  if (done == total) fprintf(stderr, "%s\n", phase);
  return 0;
}

int main(void) {
  PlBuilder *builder;
  CHECK(pl_builder_new(&builder));
  PlMaterial plaster;
  pl_material_default(&plaster);
  plaster.reflectance[0] = 0.8f;
  plaster.reflectance[1] = 0.75f;
  plaster.reflectance[2] = 0.7f;
  uint32_t material;
  CHECK(pl_builder_add_material(builder, &plaster, &material));
  for (int wall = 0; wall < 9; ++wall) {
    float corners[4][3];
    for (int k = 0; k < 3; ++k) {
      const float p = walls[wall][0][k], a = walls[wall][1][k], b = walls[wall][2][k];
      corners[0][k] = p;
      corners[1][k] = p + a;
      corners[2][k] = p + a + b;
      corners[3][k] = p + b;
    }
    const uint32_t indices[6] = {0, 1, 2, 0, 2, 3};
    PlMesh mesh;
    pl_mesh_default(&mesh);
    mesh.name = "wall";
    mesh.positions = corners[0];
    mesh.vertex_count = 4;
    mesh.indices = indices;
    mesh.index_count = 6;
    mesh.material = material;
    CHECK(pl_builder_add_mesh(builder, &mesh, NULL));
  }
  PlLight lights[2];
  pl_light_default(&lights[0]);
  const float lamp[3] = {2.5f, 2.4f, 2.0f};
  for (int k = 0; k < 3; ++k) {
    lights[0].position[k] = lamp[k];
    lights[0].color[k] = 0.5f;
  }
  pl_light_default(&lights[1]);
  lights[1].kind = PL_SUN;
  lights[1].direction[0] = 1.0f;
  lights[1].direction[1] = -0.7f;
  for (int k = 0; k < 3; ++k) lights[1].color[k] = 450.0f;
  CHECK(pl_builder_add_light(builder, &lights[0], NULL));
  CHECK(pl_builder_add_light(builder, &lights[1], NULL));
  const float sky[3] = {20, 22, 25};
  CHECK(pl_builder_set_sky(builder, sky));
  PlScene *scene;
  CHECK(pl_builder_build(builder, &scene));

  PlBakeSettings settings;
  pl_bake_settings_default(&settings);
  settings.patch_count = 200;
  settings.receiver_rays = 256;
  PlBake *bake;
  CHECK(pl_bake_build(scene, &settings, show, NULL, &bake));
  pl_scene_free(scene);

  PlField *field;
  CHECK(pl_field_new(bake, NULL, "cpu", &field));
  pl_bake_free(bake);
  const PlPoint desk = {{4.0f, 0.75f, 3.0f}, {0, 1, 0}};
  uint32_t set;
  CHECK(pl_field_add_points(field, &desk, 1, PL_IRRADIANCE, &set));
  for (int step = 0; step < 3; ++step) {
    float light[3];
    CHECK(pl_field_set_lights(field, lights, 2));
    CHECK(pl_field_update(field));
    CHECK(pl_field_points(field, set, light, 3));
    printf("lamp %.2f W/sr: %.3f %.3f %.3f W/m2 of indirect light on the desk\n", lights[0].color[0], light[0], light[1],
           light[2]);
    for (int k = 0; k < 3; ++k) lights[0].color[k] *= 20.0f;
  }
  pl_field_free(field);
  return 0;
}
