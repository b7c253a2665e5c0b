// Baking beside a page: a worker a level, the coarsest first. The finest that is ready finds the light.

const start = () => new Worker(new URL("./worker.js", import.meta.url), { type: "module" });

/**
 * A scene whose light becomes finer while the page goes on. Each level is baked in a worker of its own, which then finds the light,
 * and takes over from the coarser one before it.
 */
export class PatchlightWorkers {
  #scene;
  #options;
  #make;
  #baking;
  #active;
  #isBusy = false;
  #change = {};
  #isAsked = false;
  #isEnded = false;
  #handlers;

  /**
   * Begins. `scene` as for `Baker.of`. `onLevel` hears the layout of the lightmap of each level, before its first light; `onLight` its
   * texels, and the time of the update; `onProgress` and `onError` what their names say.
   */
  constructor(scene, { onLevel, onLight, onProgress, onError, makeWorker = start, ...options } = {}) {
    this.#scene = scene;
    this.#options = { patches: 1000, method: "classic", texel: 0.1, part: "indirect", ...options };
    this.#handlers = { onLevel, onLight, onProgress, onError };
    this.#make = makeWorker;
    this.#bake(0);
  }

  /** Asks for the light under these; of several that are asked for meanwhile the newest is found. What is left out stays. */
  update({ lights, sky, emission } = {}) {
    const change = this.#change;
    this.#change = {
      lights: lights ?? change.lights,
      sky: sky ?? change.sky,
      emission: emission === undefined ? change.emission : { ...change.emission, ...emission },
    };
    this.#isAsked = true;
    this.#find();
  }

  /** Ends the workers. */
  free() {
    this.#isEnded = true;
    this.#baking?.terminate();
    this.#active?.terminate();
  }

  #bake(level) {
    const worker = this.#make();
    this.#baking = worker;
    worker.onmessage = ({ data }) => this.#hear(worker, data);
    worker.onerror = (event) => this.#fail(event.message ?? String(event));
    worker.postMessage({ bake: { scene: this.#scene, level, options: this.#options } });
  }

  #hear(worker, { progress, ready, light, error }) {
    if (this.#isEnded) {
      return;
    }
    if (error !== undefined) {
      this.#fail(error);
    } else if (progress !== undefined) {
      this.#handlers.onProgress?.(progress);
    } else if (ready !== undefined) {
      this.#active?.terminate();
      this.#active = worker;
      this.#baking = undefined;
      this.#handlers.onLevel?.(ready);
      // Under the lights of now.
      this.#isBusy = false;
      this.#isAsked = true;
      this.#find();
      if (ready.level + 1 < ready.levels) {
        this.#bake(ready.level + 1);
      }
    } else if (light !== undefined && worker === this.#active) {
      this.#isBusy = false;
      this.#handlers.onLight?.(light);
      this.#find();
    }
  }

  #find() {
    if (this.#isAsked && !this.#isBusy && this.#active !== undefined) {
      this.#isBusy = true;
      this.#isAsked = false;
      this.#active.postMessage({ update: this.#change });
    }
  }

  #fail(message) {
    this.free();
    if (this.#handlers.onError === undefined) {
      throw new Error(message);
    }
    this.#handlers.onError(new Error(message));
  }
}
