// Times of the module in Node, beside those that the native program has said. After `npm run build` and that program.

import { readFile } from "node:fs/promises";

import { Patchlight } from "../package/index.js";

const UPDATES = 40;
const module = await readFile(new URL("../package/patchlight_bg.wasm", import.meta.url));
const scenes = [
  ["cornell", 0.01, (k) => ({ kind: "point", position: [0.25 + k / 1000, 0.4, 0.3], intensity: [0.09, 0.07, 0.05] })],
  ["office", 0.07, (k) => ({ kind: "point", position: [2 + k / 1000, 2, 2], intensity: [6, 5, 4] })],
  ["atrium", 0.16, (k) => ({ kind: "sun", direction: [0.3 + k / 1000, -1, 0.38], irradiance: [30, 28, 25] })],
];

for (const [name, texel, lamp] of scenes) {
  const bake = new Uint8Array(await readFile(new URL(`../package/bench/${name}.bake`, import.meta.url)));
  const light = await Patchlight.load(bake, { module });
  light.update();
  const { width, height } = light.makeLightmap(texel);
  let [update, all] = [0, 0];
  for (let k = 0; k < UPDATES; k++) {
    const lights = [lamp(k)];
    const start = performance.now();
    light.update({ lights });
    update += performance.now() - start;
    light.lightmap();
    all += performance.now() - start;
  }
  const ms = (sum) => (sum / UPDATES).toFixed(2);
  console.log(`module ${name}: an update ${ms(update)} ms, with ${width} x ${height} texels ${ms(all)} ms`);
  light.free();
}
