import type { SceneArrays } from "./baker.js";
import type { Light, LightPart, LoadOptions, Method, Rgb } from "./index.js";

/** Layout of the lightmap of a level. */
export interface Level {
  level: number;
  levels: number;
  width: number;
  height: number;
  /** Coordinates in the lightmap of the corners of all meshes' triangles, six numbers each; NaN for triangles without light. */
  uvs: Float32Array;
  counts: { triangles: number; patches: number; receivers: number; points: number };
}

/** Irradiance in the texels, W/m², row by row: RGB; the time of the update in its worker. */
export interface LightOfWorker {
  texels: Float32Array;
  milliseconds: number;
}

export interface WorkerOptions {
  /** About how many patches [1000]. */
  patches?: number;
  method?: Method;
  /** Edge of a texel, m [0.1]. */
  texel?: number;
  /** Light in the texels [indirect]. */
  part?: LightPart;
  module?: LoadOptions["module"];
  onLevel?: (level: Level) => void;
  onLight?: (light: LightOfWorker) => void;
  onProgress?: (progress: { level: number; levels: number; phase: string; share: number }) => void;
  onError?: (error: Error) => void;
  /** Makes a worker of `patchlight/worker`, where a bundler needs to see it. */
  makeWorker?: () => Worker;
}

/** A scene whose light becomes finer while the page goes on: a worker a level. */
export class PatchlightWorkers {
  constructor(scene: SceneArrays, options?: WorkerOptions);
  /** Asks for the light under these; what is left out stays; emission by the material's number in the scene, plus one. */
  update(change?: { lights?: readonly Light[]; sky?: Rgb; emission?: Readonly<Record<number, Rgb>> }): void;
  free(): void;
}
