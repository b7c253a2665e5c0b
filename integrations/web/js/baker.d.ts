import type { Light, LoadOptions, Method, Patchlight, Rgb } from "./index.js";

export interface SceneArrays {
  /** Reflectance 0 to 0.95, and what the front shines with, W/m²/sr. */
  materials?: readonly { reflectance: Rgb; radiance?: Rgb }[];
  /** Meshes in their places, m; triangles counter-clockwise from the front; `material` is a number in `materials`. */
  meshes: readonly {
    name?: string;
    positions: ArrayLike<number>;
    indices?: ArrayLike<number>;
    normals?: ArrayLike<number>;
    material?: number;
  }[];
  lights?: readonly Light[];
  /** Radiance of an even sky, W/m²/sr. */
  sky?: Rgb;
}

/** Bakes a scene of arrays where it runs; `PatchlightWorkers` does so beside the page. */
export class Baker {
  static of(scene: SceneArrays, options?: { patches?: number; module?: LoadOptions["module"] }): Promise<Baker>;
  readonly levels: number;
  level(level: number, options?: { method?: Method; onProgress?: (phase: string, share: number) => void }): Patchlight;
  free(): void;
}
