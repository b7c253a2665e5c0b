// Bakes in the module: beside that of the native program, and in workers, for which Node's threads stand in.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import test from "node:test";
import { Worker as Thread } from "node:worker_threads";

import * as THREE from "three";

import { Baker } from "../package/baker.js";
import { LiveLightmaps, sceneOf } from "../package/three.js";
import { PatchlightWorkers } from "../package/workers.js";

const module = await readFile(new URL("../package/bake/patchlight_bg.wasm", import.meta.url));
const lamp = { kind: "point", position: [0.5, 0.8, 0.5], intensity: [1, 1, 1] };
const mean = (numbers, channel) => {
  const own = numbers.filter((_, k) => k % 3 === channel);
  return own.reduce((sum, number) => sum + number, 0) / own.length;
};

/** A room of one metre: a red floor, white walls and a ceiling, open to nothing. */
function room() {
  const scene = new THREE.Scene();
  const white = new THREE.MeshStandardMaterial({ color: new THREE.Color(0.7, 0.7, 0.7) });
  const red = new THREE.MeshStandardMaterial({ color: new THREE.Color(0.7, 0.05, 0.05) });
  const walls = [
    [[0.5, 0, 0.5], [-Math.PI / 2, 0, 0], red],
    [[0.5, 1, 0.5], [Math.PI / 2, 0, 0], white],
    [[0, 0.5, 0.5], [0, Math.PI / 2, 0], white],
    [[1, 0.5, 0.5], [0, -Math.PI / 2, 0], white],
    [[0.5, 0.5, 0], [0, 0, 0], white],
    [[0.5, 0.5, 1], [0, Math.PI, 0], white],
  ];
  for (const [place, turn, material] of walls) {
    const wall = new THREE.Mesh(new THREE.PlaneGeometry(1, 1), material);
    wall.position.set(...place);
    wall.rotation.set(...turn);
    scene.add(wall);
  }
  const light = new THREE.PointLight(0xffffff, 1);
  light.position.set(...lamp.position);
  scene.add(light);
  return { scene, light, white };
}

test("a scene of arrays is baked, and finer levels are nearer to the truth", async () => {
  const { scene } = room();
  const arrays = sceneOf(scene);
  assert.deepEqual([arrays.meshes.length, arrays.materials.length, arrays.lights.length], [6, 2, 1]);
  const baker = await Baker.of(arrays, { module, patches: 300 });
  assert.ok(baker.levels > 1);
  const phases = new Set();
  const found = [];
  for (let level = 0; level < baker.levels; level++) {
    const light = baker.level(level, { onProgress: (phase, share) => phases.add(phase) && assert.ok(share >= 0 && share <= 1) });
    light.update();
    // The floor takes no less light than the walls, and light has become red.
    const surface = light.surface();
    found.push([mean(surface, 0), mean(surface, 1)]);
    light.free();
  }
  baker.free();
  assert.ok(phases.has("form_factors") && phases.has("receivers"), [...phases]);
  const last = found.at(-1);
  for (const [red, green] of found) {
    assert.ok(red > 1.2 * green && green > 0, `${red} ${green}`);
    assert.ok(Math.abs(red / last[0] - 1) < 0.1, `${red} ${last}`);
  }
  await assert.rejects(Baker.of({ meshes: [{ name: "odd", positions: [0, 0] }] }, { module }), /odd/);
  await assert.rejects(Baker.of({ meshes: [] }, { module }), /triangle/);
});

/** A worker of a page as a thread of Node. */
class PageWorker {
  #thread;

  constructor() {
    const url = new URL("../package/worker.js", import.meta.url).href;
    const text = `
      const { parentPort } = require("node:worker_threads");
      globalThis.postMessage = (message, transfer) => parentPort.postMessage(message, transfer);
      const loaded = import(${JSON.stringify(url)});
      parentPort.on("message", (data) => loaded.then(() => globalThis.onmessage({ data })));
    `;
    this.#thread = new Thread(text, { eval: true });
    this.#thread.on("message", (data) => this.onmessage?.({ data }));
    this.#thread.on("error", (error) => this.onerror?.({ message: error.message }));
  }

  postMessage(message) {
    this.#thread.postMessage(message);
  }

  terminate() {
    this.#thread.terminate();
  }
}

test("workers bake one level after the other, and the finest finds the light", async () => {
  const { scene } = room();
  const levels = [];
  let workers;
  const texels = await new Promise((resolve, reject) => {
    workers = new PatchlightWorkers(sceneOf(scene), {
      module,
      patches: 300,
      texel: 0.1,
      makeWorker: () => new PageWorker(),
      onLevel: (level) => levels.push(level),
      onLight: (light) => levels.length === levels[0].levels && resolve(light.texels),
      onError: reject,
    });
  });
  assert.deepEqual(levels.map(({ level }) => level), [...levels.keys()]);
  assert.ok(levels.length > 1 && levels.at(-1).counts.points > levels[0].counts.points);
  const { width, height } = levels.at(-1);
  assert.equal(texels.length, 3 * width * height);
  assert.ok(mean(texels, 0) > 1.2 * mean(texels, 1));
  workers.free();
  await assert.rejects(
    new Promise((_, reject) => {
      new PatchlightWorkers({ meshes: [] }, { module, makeWorker: () => new PageWorker(), onError: reject });
    }),
    /triangle/,
  );
});

test("a three scene follows its lights and materials while it is baked", async () => {
  const { scene, light, white } = room();
  const block = new THREE.Mesh(new THREE.BoxGeometry(0.3, 0.3, 0.3), white);
  block.position.set(0.4, 0.15, 0.5);
  scene.add(block);
  let heard;
  const next = () => new Promise((resolve) => (heard = resolve));
  const maps = new LiveLightmaps(scene, {
    module,
    patches: 200,
    texel: 0.1,
    makeWorker: () => new PageWorker(),
    onLight: () => heard?.(),
    onError: (error) => assert.fail(error.message),
  });
  const brightness = () => {
    const { data } = maps.texture.image;
    let sum = 0;
    for (let k = 0; k < data.length; k += 4) {
      sum += THREE.DataUtils.fromHalfFloat(data[k]);
    }
    return sum;
  };
  await next();
  // A block stands on the floor, which the bake cuts: the page's own triangles are found, but perhaps for its hidden side.
  assert.ok(maps.missing <= 2);
  assert.equal(maps.found + maps.missing, 2 * 6 + 12);
  const mesh = scene.children.find((child) => child.isMesh);
  assert.ok(mesh.material.lightMap === maps.texture && mesh.geometry.getAttribute("uv1") !== undefined);
  const settle = async () => {
    for (let k = 0; k < 4; k++) {
      maps.update();
      await next();
    }
    return brightness();
  };
  const once = await settle();
  light.intensity = 3;
  const thrice = await settle();
  assert.ok(thrice / once > 2.5, `${thrice} ${once}`);
  light.intensity = 0;
  white.emissive = new THREE.Color(1, 1, 1);
  assert.ok((await settle()) > 0);
  maps.dispose();
});

