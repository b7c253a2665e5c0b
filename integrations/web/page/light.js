// The light of a scene, beside the page: a worker that loads bakes, and makes texels of half floats under the lights of now.

import { Patchlight } from "../package/index.js";

let light;
let bytes;
let scene;
let door;
let probe;
/** What was asked for last. */
let asked;

/** Answers, with the scene's number. */
const answer = (data, moved = []) => postMessage({ id: scene?.id, ...data }, moved);

const float = new Float32Array(1);
const word = new Uint32Array(float.buffer);

/** A number that is not negative as a half float. */
function half(x) {
  float[0] = Math.min(x, 65504);
  const bits = word[0];
  const exponent = (bits >>> 23) - 112;
  if (exponent <= 0) {
    return Math.round(float[0] * 2 ** 24);
  }
  return (exponent << 10) + ((bits >>> 13) & 0x3ff) + ((bits >>> 12) & 1);
}

/** The module, packed: any server sends it so. */
async function unpackedModule() {
  const packed = await fetch("patchlight_bg.wasm.gz");
  const headers = { "content-type": "application/wasm" };
  return new Response(packed.body.pipeThrough(new DecompressionStream("gzip")), { headers });
}
const module = unpackedModule();

/** Loads the scene's bake by a method. */
async function load(method) {
  light?.free();
  light = undefined;
  light = await Patchlight.load(bytes, { method, module: await module });
  const { width, height } = light.makeLightmap(scene.texel, scene.corners, { rays: scene.rays });
  if (scene.probe) {
    probe = light.addPoints(scene.probe, [0, 1, 0], "cube");
  }
  door = asked = undefined;
  const { counts, error } = light;
  answer({ kind: "ready", width, height, uvs: light.lightmapUvs(), counts, error });
}

async function fetched(url) {
  const response = await fetch(url);
  if (!response.ok) {
    throw new Error(`${url}: the server answers ${response.status}`);
  }
  const total = Number(response.headers.get("content-length"));
  const parts = [];
  let done = 0;
  for (const reader = response.body.getReader(); ; ) {
    const { value } = await reader.read();
    if (value === undefined) {
      return new Uint8Array(await new Blob(parts).arrayBuffer());
    }
    parts.push(value);
    done += value.length;
    answer({ kind: "progress", share: total ? done / total : 0 });
  }
}

/** Light under the lights, the paint and the door of now. */
function update({ change, paint, place }) {
  const start = performance.now();
  const question = JSON.stringify([change, paint, place]);
  const isNew = question !== asked;
  asked = question;
  for (const [material, color] of paint) {
    light.paint(material, color);
  }
  if (place && door === undefined) {
    door = light.addObject(scene.door, 0, place);
  } else if (place) {
    light.moveObject(door, place);
  }
  light.update(change);
  const milliseconds = performance.now() - start;
  const irradiance = light.lightmap({ part: "without_lights" });
  const texels = new Uint16Array((irradiance.length / 3) * 4);
  for (let from = 0, to = 0; from < irradiance.length; from += 3, to += 4) {
    texels[to] = half(irradiance[from]);
    texels[to + 1] = half(irradiance[from + 1]);
    texels[to + 2] = half(irradiance[from + 2]);
    texels[to + 3] = 0x3c00;
  }
  const air = probe === undefined ? undefined : light.points(probe).slice();
  answer({ kind: "light", texels, air, milliseconds: isNew ? milliseconds : undefined }, [texels.buffer]);
}

async function hear({ kind, ...data }) {
  if (kind === "load") {
    ({ scene } = data);
    probe = undefined;
    bytes = await fetched(scene.url);
    await load(data.method);
  } else if (kind === "method") {
    await load(data.method);
  } else {
    update(data);
  }
}

// One after the other: loading waits.
let turn = Promise.resolve();
onmessage = ({ data }) => {
  turn = turn.then(() => hear(data)).catch((error) => answer({ kind: "error", message: error.message }));
};
