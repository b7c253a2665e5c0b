// Bakes scenes of arrays. The module that does is another one than that of `index.js`, and half as large again.

import init, { Baker as OwnBaker } from "./bake/patchlight.js";
import { Patchlight, failing, loader, rows } from "./index.js";

const NOWHERE = [0, 0, 0];

const load = loader(init, new URL("bake/patchlight_bg.wasm", import.meta.url));

/** Bakes a scene of arrays where it runs: in a worker, so that the page goes on. */
export class Baker {
  #baker;
  #memory;
  #levels;

  constructor(baker, memory, levels) {
    this.#baker = baker;
    this.#memory = memory;
    this.#levels = levels;
  }

  /** Takes a scene: `materials` with `reflectance` and `radiance`, `meshes` in their places, `lights`, `sky`. */
  static async of({ materials = [], meshes, lights = [], sky = NOWHERE }, { patches = 1000, module } = {}) {
    const { memory } = await load(module);
    return failing(() => {
      const baker = new OwnBaker();
      const numbers = materials.map(({ reflectance, radiance = NOWHERE }) =>
        baker.add_material(Float32Array.from(reflectance), Float32Array.from(radiance)),
      );
      for (const { name = "", positions, indices = [], normals = [], material } of meshes) {
        if (material !== undefined && numbers[material] === undefined) {
          throw new Error(`mesh ${name}: material ${material} of ${materials.length}`);
        }
        const own = material === undefined ? 0 : numbers[material];
        baker.add_mesh(name, Float32Array.from(positions), Uint32Array.from(indices), Float32Array.from(normals), own);
      }
      return new Baker(baker, memory, baker.begin(rows(lights), Float32Array.from(sky), patches));
    });
  }

  /** Levels, 0 the coarsest. */
  get levels() {
    return this.#levels;
  }

  /** Bakes a level: its light. Nothing else runs meanwhile; `onProgress` hears the phase and how far it is. */
  level(level, { method = "classic", onProgress } = {}) {
    const listener = onProgress && { heard: onProgress };
    return new Patchlight(failing(() => this.#baker.level(level, method, listener)), this.#memory);
  }

  /** Gives the memory back; lights stay. */
  free() {
    this.#baker.free();
  }
}
