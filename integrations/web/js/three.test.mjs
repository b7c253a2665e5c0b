// The adapter for three.js: units of lights, the lightmap at the places of a scene's meshes, probes.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import test from "node:test";

import * as THREE from "three";

import { Patchlight } from "../package/index.js";
import { PatchlightLightmaps, lightsOf } from "../package/three.js";

const module = await readFile(new URL("../package/patchlight_bg.wasm", import.meta.url));
const bake = new Uint8Array(await readFile(new URL("../package/native/cornell.bake", import.meta.url)));

const near = (found, expected, share = 1e-5) => {
  assert.equal(found.length, expected.length);
  const size = Math.max(...expected.map(Math.abs));
  found.forEach((number, k) => assert.ok(Math.abs(number - expected[k]) <= share * size, `${found} ${expected}`));
};

/** The box as a page would load it: moved meshes, some with indices, corners in another order. */
function boxScene(light) {
  const corners = light.triangles();
  const scene = new THREE.Scene();
  const offset = new THREE.Vector3(3, -2, 1);
  for (let part = 0; part < 2; part++) {
    const positions = [];
    for (let triangle = part; triangle < corners.length / 9; triangle += 2) {
      for (let k = 0; k < 3; k++) {
        const from = 9 * triangle + 3 * ((k + triangle) % 3);
        const at = new THREE.Vector3(...corners.subarray(from, from + 3));
        positions.push(...at.sub(offset).multiplyScalar(0.5).toArray());
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(positions, 3));
    if (part === 1) {
      geometry.setIndex([...Array(positions.length / 3).keys()]);
    }
    const mesh = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial());
    const group = new THREE.Group();
    group.position.copy(offset);
    mesh.scale.setScalar(2);
    group.add(mesh);
    scene.add(group);
  }
  return scene;
}

function lamp(scene) {
  const lamp = new THREE.PointLight(new THREE.Color(0.9, 0.7, 0.5), 0.1);
  lamp.position.set(0.25, 0.4, 0.3);
  scene.add(lamp);
  return lamp;
}

test("lights of three are ours in other units", () => {
  const scene = new THREE.Scene();
  const sun = new THREE.DirectionalLight(0xffffff, 3);
  sun.position.set(0, 5, 0);
  const spot = new THREE.SpotLight(0xffffff, 2, 0, 0.5, 0.25);
  spot.position.set(0, 2, 0);
  const panel = new THREE.RectAreaLight(0xffffff, 4, 2, 1);
  panel.position.set(1, 3, 1);
  panel.lookAt(1, 0, 1);
  const off = new THREE.PointLight();
  off.visible = false;
  scene.add(sun, spot, panel, off);
  const [first, second, third, ...none] = lightsOf(scene);
  assert.deepEqual(none, []);
  assert.deepEqual([first.kind, first.irradiance], ["sun", [3, 3, 3]]);
  near(new THREE.Vector3(...first.direction).normalize().toArray(), [0, -1, 0]);
  assert.deepEqual([second.kind, second.inner, second.outer], ["spot", 0.375, 0.5]);
  const [a, b] = [third.edgeA, third.edgeB].map((edge) => new THREE.Vector3(...edge));
  // It looks down, and is as large as it was.
  near(a.clone().cross(b).toArray(), [0, -2, 0], 1e-3);
  near(new THREE.Vector3(...third.corner).addScaledVector(a, 0.5).addScaledVector(b, 0.5).toArray(), [1, 3, 1], 1e-3);
  assert.deepEqual(third.radiance, [4, 4, 4]);
});

test("meshes take the texels of their triangles", async () => {
  const light = await Patchlight.load(bake, { module });
  const scene = boxScene(light);
  lamp(scene);
  const maps = new PatchlightLightmaps(scene, light, { texel: 0.01 });
  assert.ok(maps.found > 20 && maps.missing < 3, `${maps.found} ${maps.missing}`);
  maps.update();
  const expected = light.lightmap({ part: "without_lights" }).slice();
  const { data, width, height } = maps.texture.image;
  const texels = expected.length / 3;
  assert.equal(texels, width * (height - 2));
  const brightest = Math.max(...expected);
  const texel = (k, channel) => THREE.DataUtils.fromHalfFloat(data[4 * k + channel]);
  for (let k = 0; k < texels; k += 7) {
    for (let channel = 0; channel < 3; channel++) {
      assert.ok(Math.abs(texel(k, channel) - expected[3 * k + channel]) < 1e-3 * brightest);
    }
  }
  // Light at the middles of triangles is that of the nearest interpolation points; rows the other way round it is not.
  light.update();
  const [surface, points] = [light.surface().slice(), light.surfacePoints()];
  let [wrong, flipped, all] = [0, 0, 0];
  scene.traverse((mesh) => {
    if (!mesh.isMesh) {
      return;
    }
    const [positions, uvs] = ["position", "uv1"].map((name) => mesh.geometry.getAttribute(name));
    for (let vertex = 0; vertex < positions.count; vertex += 3) {
      const at = new THREE.Vector3();
      const uv = new THREE.Vector2();
      for (let k = 0; k < 3; k++) {
        at.addScaledVector(new THREE.Vector3().fromBufferAttribute(positions, vertex + k).applyMatrix4(mesh.matrixWorld), 1 / 3);
        uv.addScaledVector(new THREE.Vector2().fromBufferAttribute(uvs, vertex + k), 1 / 3);
      }
      let [nearest, distance] = [0, Infinity];
      for (let k = 0; k < points.length / 3; k++) {
        const d = at.distanceToSquared(new THREE.Vector3(...points.subarray(3 * k, 3 * k + 3)));
        [nearest, distance] = d < distance ? [k, d] : [nearest, distance];
      }
      const row = Math.min(Math.floor(uv.y * height), height - 1);
      const column = Math.min(Math.floor(uv.x * width), width - 1);
      const other = surface[3 * nearest + 1];
      wrong += Math.abs(texel(row * width + column, 1) - other);
      flipped += Math.abs(texel((height - 1 - row) * width + column, 1) - other);
      all += other;
    }
  });
  assert.ok(wrong < 0.15 * all && flipped > 2 * wrong, `${wrong} ${flipped} of ${all}`);
  maps.dispose();
  light.free();
});

test("a scene that is another has no light, and says so", async () => {
  const light = await Patchlight.load(bake, { module });
  const scene = new THREE.Scene();
  const material = new THREE.MeshStandardMaterial();
  scene.add(new THREE.Mesh(new THREE.BoxGeometry(), material));
  const maps = new PatchlightLightmaps(scene, light);
  assert.deepEqual([maps.found, maps.missing], [0, 12]);
  assert.equal(scene.children[0].material, material);
  assert.throws(() => maps.harmonics(new THREE.Vector3()), /makeProbes/);
  assert.throws(() => maps.makeProbes([0, 0, 0], [1, 1, 1], [1, 2, 2]), /at least 2/);
  light.free();
});

test("probes have the light of their places, and between them a mean", async () => {
  const light = await Patchlight.load(bake, { module });
  const scene = boxScene(light);
  const bulb = lamp(scene);
  const maps = new PatchlightLightmaps(scene, light, { texel: 0.05 });
  const [low, high] = [[0.1, 0.1, 0.1], [0.45, 0.45, 0.45]];
  maps.makeProbes(low, high, [2, 2, 3]);
  maps.update();
  const set = light.addPoints([...low, 0.1, 0.1, 0.275], [0, 1, 0, 0, 1, 0], "harmonics");
  light.update();
  const expected = light.points(set).slice();
  const of = (values) => [values.slice(0, 3), values.slice(6, 9), values.slice(9, 12), values.slice(3, 6)].map((v) => Array.from(v));
  const found = (at) => maps.harmonics(new THREE.Vector3(...at)).coefficients.slice(0, 4).map((c) => c.toArray());
  // Points find their rows by rays, other ones for each.
  near(found(low).flat(), of(expected.subarray(0, 12)).flat(), 0.01);
  const between = of(expected.subarray(0, 12)).flat().map((x, k) => (x + of(expected.subarray(12)).flat()[k]) / 2);
  near(found([0.1, 0.1, 0.1875]).flat(), between, 0.01);
  // It follows the lamp.
  bulb.intensity = 0.2;
  maps.update();
  near(found(low).flat(), of(expected.subarray(0, 12)).flat().map((x) => 2 * x), 0.01);
  maps.dispose();
  light.free();
});
