// Times of the module in Node. After `npm run build` and the native program.

import { readFile } from "node:fs/promises";

import { Patchlight } from "../package/index.js";

const UPDATES = 60;
const module = await readFile(new URL("../package/patchlight_bg.wasm", import.meta.url));
const bake = new Uint8Array(await readFile(new URL("../package/native/cornell.bake", import.meta.url)));

const ms = (work) => {
  const start = performance.now();
  for (let k = 0; k < UPDATES; k++) {
    work(k);
  }
  return ((performance.now() - start) / UPDATES).toFixed(2);
};

const start = performance.now();
const light = await Patchlight.load(bake, { module });
light.update();
console.log(`module: loaded and lit in ${(performance.now() - start).toFixed(0)} ms`);
const lamp = (k) => ({ kind: "point", position: [0.25 + k / 1000, 0.4, 0.3], intensity: [0.09, 0.07, 0.05] });
console.log(`module: an update ${ms((k) => light.update({ lights: [lamp(k)] }))} ms`);
console.log(`module: the surface ${ms(() => light.surface())} ms`);
const { width, height } = light.makeLightmap(0.01);
console.log(`module: a lightmap of ${width} x ${height} with direct light ${ms(() => light.lightmap({ part: "full" }))} ms`);
