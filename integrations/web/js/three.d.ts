import type { DataTexture, Scene, SphericalHarmonics3, Vector3 } from "three";
import type { SceneArrays } from "./baker.js";
import type { Light, Patchlight, Rgb, Vector } from "./index.js";
import type { WorkerOptions } from "./workers.js";

/** Lights of a three scene: lux are W/m², candela W/sr, nits W/m²/sr. */
export function lightsOf(scene: Scene): Light[];

export interface LightmapOptions {
  /** Edge of a texel, m [0.1]. */
  texel?: number;
  /** With the direct light of lights in the texels, for scenes whose own lights cast no shadows [false]. */
  direct?: boolean;
  /** Gives meshes copies of their materials [true]. */
  clone?: boolean;
}

/** Lightmaps of a three scene that follow its lights. Meshes must stand where they stood in the bake. */
export class PatchlightLightmaps {
  constructor(scene: Scene, light: Patchlight, options?: LightmapOptions);
  readonly texture: DataTexture;
  /** Triangles of the scene that have light of the bake, and those that it does not know, or no light comes to. */
  readonly found: number;
  readonly missing: number;
  /** Finds the light of the scene's lights. */
  update(change?: { sky?: Rgb; emission?: Readonly<Record<number, Rgb>> }): void;
  /** Probes in a box for what moves; every update lights them. */
  makeProbes(low: Vector, high: Vector, counts: readonly [number, number, number]): void;
  /** Radiance at a place as harmonics, for `LightProbe.sh`. */
  harmonics(position: Vector3, target?: SphericalHarmonics3): SphericalHarmonics3;
  dispose(): void;
}

/** The meshes of a three scene with their materials, lights and an even sky, for `Baker.of`; `of` are three's materials. */
export function sceneOf(scene: Scene, options?: { sky?: Rgb }): SceneArrays & { of: object[] };

/** Lightmaps of a three scene that nobody has baked: workers do, coarse at once and then finer. */
export class LiveLightmaps {
  constructor(scene: Scene, options?: Omit<WorkerOptions, "part"> & Omit<LightmapOptions, "texel"> & { sky?: Rgb });
  /** None before the first light; another one for each level. */
  readonly texture: DataTexture | undefined;
  readonly found: number;
  readonly missing: number;
  /** Asks for the light of the scene's lights and emissive materials. */
  update(change?: { sky?: Rgb }): void;
  dispose(): void;
}
