// A worker that bakes one level of a scene, and finds its light from then on: `PatchlightWorkers` starts and ends it.

import { Baker } from "./baker.js";
import { cornersOf } from "./index.js";

let light;
let part;

/** The light of now, as texels that the page takes over. */
function find(change) {
  const start = performance.now();
  light.update(change);
  const texels = light.lightmap({ part }).slice();
  postMessage({ light: { texels, milliseconds: performance.now() - start } }, [texels.buffer]);
}

/** Bakes a level and lays out its lightmap. */
async function bake({ scene, level, options }) {
  const { module, patches, method, texel } = options;
  part = options.part;
  const baker = await Baker.of(scene, { module, patches });
  const { levels } = baker;
  const onProgress = (phase, share) => postMessage({ progress: { level, levels, phase, share } });
  light = baker.level(level, { method, onProgress });
  baker.free();
  const { width, height } = light.makeLightmap(texel, cornersOf(scene.meshes));
  const uvs = light.lightmapUvs();
  const ready = { level, levels, width, height, uvs, counts: light.counts };
  postMessage({ ready }, [uvs.buffer]);
}

globalThis.onmessage = async ({ data }) => {
  try {
    if (data.bake !== undefined) {
      await bake(data.bake);
    } else {
      find(data.update);
    }
  } catch (error) {
    postMessage({ error: error.message });
  }
};
