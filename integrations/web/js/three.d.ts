import type { DataTexture, Scene, SphericalHarmonics3, Vector3 } from "three";
import type { Light, Patchlight, Rgb, Vector } from "./index.js";

/** Lights of a three scene: lux are W/m², candela W/sr, nits W/m²/sr. */
export function lightsOf(scene: Scene): Light[];

export interface LightmapOptions {
  /** Edge of a texel, m [0.1]. */
  texel?: number;
  /** With direct light in the texels, for scenes whose own lights cast no shadows [false]. */
  direct?: boolean;
  /** Gives meshes copies of their materials [true]. */
  clone?: boolean;
}

/** Lightmaps of a three scene that follow its lights. Meshes must stand where they stood in the bake. */
export class PatchlightLightmaps {
  constructor(scene: Scene, light: Patchlight, options?: LightmapOptions);
  readonly texture: DataTexture;
  /** Triangles of the scene that the bake has, and those that it has not. */
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
