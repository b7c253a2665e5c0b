// The module in Node beside the native program: the same bits, the same errors. After `npm run build`.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import test from "node:test";
import { gzipSync } from "node:zlib";

import { Patchlight } from "../package/index.js";

const folder = new URL("../package/native/", import.meta.url);
const module = await readFile(new URL("../package/patchlight_bg.wasm", import.meta.url));
const bake = new Uint8Array(await readFile(new URL("cornell.bake", folder)));
const lamp = { kind: "point", position: [0.25, 0.4, 0.3], intensity: [0.09, 0.07, 0.05] };

const native = async (name) => {
  const bytes = await readFile(new URL(name, folder));
  return new Uint32Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
};
const bits = (numbers) => new Uint32Array(numbers.slice().buffer);
const sum = (numbers) => numbers.reduce((total, number) => total + number, 0);

test("light has the bits of the native program", async () => {
  const light = await Patchlight.load(bake, { module });
  assert.equal(light.update(), 0);
  assert.deepEqual(bits(light.surface()), await native("own.f32"));
  assert.equal(light.surface().length, 3 * light.counts.points);
  light.update({ lights: [lamp] });
  assert.deepEqual(bits(light.surface()), await native("lamp.f32"));
  assert.notDeepEqual(bits(light.surface()), await native("own.f32"));
  const { width, height } = light.makeLightmap(0.025);
  assert.equal(light.lightmap().length, 3 * width * height);
  assert.deepEqual(bits(light.lightmap({ part: "full" })), await native("lightmap.f32"));
  assert.equal(light.lightmapUvs().length, 6 * light.counts.triangles);
  light.free();
});

test("bakes come packed", async () => {
  const packed = gzipSync(bake);
  const light = await Patchlight.load(packed, { module });
  light.update();
  assert.deepEqual(bits(light.surface()), await native("own.f32"));
  light.free();
  await assert.rejects(Patchlight.load(packed.subarray(0, packed.length / 2), { module }), /the bake: cannot be unpacked/);
});

test("light is a sum of what its lights give", async () => {
  const light = await Patchlight.load(bake, { module });
  light.update({ lights: [], sky: [0, 0, 0], emission: { 0: [0, 0, 0], 1: [0, 0, 0], 2: [0, 0, 0] } });
  assert.equal(sum(light.surface()), 0);
  light.update({ lights: [lamp] });
  const once = sum(light.surface());
  light.update({ lights: [{ ...lamp, intensity: [0.18, 0.14, 0.1] }] });
  assert.ok(once > 0 && Math.abs(sum(light.surface()) / once - 2) < 1e-5);
  light.free();
});

test("points in the air are lit", async () => {
  const light = await Patchlight.load(bake, { module });
  const set = light.addPoints([0.28, 0.45, 0.15], [0, 1, 0], "cube");
  light.update();
  assert.equal(light.points(set).length, 18);
  assert.ok(light.points(set).every((number) => number > 0));
  light.removePoints(set);
  assert.throws(() => light.points(set), /no point set/);
  light.free();
});

test("walls are painted, and what moves hides light", async () => {
  const light = await Patchlight.load(bake, { module });
  light.update({ lights: [lamp] });
  const own = sum(light.surface());
  for (let material = 0; material < 3; material++) {
    light.paint(material, [0.05, 0.05, 0.05]);
  }
  light.update();
  const dark = sum(light.surface());
  assert.ok(dark > 0 && dark < 0.2 * own, `${dark} of ${own}`);
  for (let material = 0; material < 3; material++) {
    light.paint(material);
  }
  light.update();
  assert.ok(Math.abs(sum(light.surface()) / own - 1) < 1e-5);
  // A plate below the lamp, and then far beside the box.
  const [a, b, c, d] = [[0, 0, 0], [0.3, 0, 0], [0, 0, 0.3], [0.1, 0.02, 0.1]];
  const corners = [a, b, c, a, d, b, a, c, d, b, d, c].flat();
  const at = (x, y, z) => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1];
  const plate = light.addObject(corners, 0, at(0.15, 0.3, 0.15));
  light.update();
  const hidden = sum(light.surface());
  assert.ok(hidden > 0 && Math.abs(hidden / own - 1) > 0.005, `${hidden} ${own}`);
  light.moveObject(plate, at(50, 0, 0));
  light.update();
  assert.ok(Math.abs(sum(light.surface()) / own - 1) < 1e-3);
  light.removeObject(plate);
  assert.throws(() => light.moveObject(plate, at(0, 0, 0)), /no object 0/);
  assert.throws(() => light.addObject(corners, 0, [1, 2]), /16 numbers/);
  assert.throws(() => light.addObject(corners, 99, at(0, 0, 0)), /material/);
  assert.throws(() => light.paint(99, [0, 0, 0]), /material 99 of/);
  assert.ok(Math.abs(light.error.error) < 0.1 && light.error.standardError > 0);
  light.free();
});

test("what is wrong is said, and nothing is lost by it", async () => {
  const cut = bake.slice(0, bake.length / 2);
  await assert.rejects(Patchlight.load(cut, { module }), /the bake/);
  await assert.rejects(Patchlight.load(new TextEncoder().encode("a diary"), { module }), /is no bake/);
  await assert.rejects(Patchlight.load(bake, { module, method: "magic" }), /it is classic/);
  const light = await Patchlight.load(bake, { module });
  assert.throws(() => light.update({ lights: [{ kind: "laser" }] }), /light 0: its kind is laser/);
  assert.throws(() => light.update({ lights: [{ kind: "sun", direction: [0, -1, 0] }] }), /has irradiance/);
  assert.throws(() => light.update({ lights: [{ ...lamp, intensity: [-1, 0, 0] }] }), /not negative/);
  assert.throws(() => light.update({ sky: [NaN, 0, 0] }), /radiance/);
  assert.throws(() => light.lightmap(), /no lightmap/);
  assert.throws(() => light.lightmap({ part: "half" }), /it is indirect/);
  assert.throws(() => light.makeLightmap(0.1, [0, 0, 0]), /no triangles/);
  assert.equal(light.update(), 0);
  light.free();
});

test("memory does not grow from update to update", async () => {
  const light = await Patchlight.load(bake, { module });
  const size = () => light.surface().buffer.byteLength;
  for (let frame = 0; frame < 20; frame++) {
    light.update({ lights: [{ ...lamp, position: [0.2 + frame / 200, 0.4, 0.3] }] });
  }
  const before = size();
  for (let frame = 0; frame < 200; frame++) {
    light.update({ lights: [{ ...lamp, position: [0.2 + frame / 2000, 0.4, 0.3] }] });
    light.surface();
  }
  assert.equal(size(), before);
  light.free();
});
