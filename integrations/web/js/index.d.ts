/** Red, green, blue. */
export type Rgb = readonly [number, number, number];
/** Metres, or a direction of any length. */
export type Vector = readonly [number, number, number];

export type Light =
  /** `irradiance` is that of a surface that faces it, W/m²; `direction` goes from the sun. */
  | { kind: "sun"; direction: Vector; irradiance: Rgb }
  /** `intensity`, W/sr. */
  | { kind: "point"; position: Vector; intensity: Rgb }
  /** Half-angles in radians: all of the intensity within `inner`, none beyond `outer`. */
  | { kind: "spot"; position: Vector; direction: Vector; inner?: number; outer: number; intensity: Rgb }
  /** `radiance`, W/m²/sr, to the side of edgeA × edgeB. */
  | { kind: "rectangle"; corner: Vector; edgeA: Vector; edgeB: Vector; radiance: Rgb };

/** What was reflected; that and all direct light; or all but the direct light of lights, for programs that light by lights only. */
export type LightPart = "indirect" | "full" | "without_lights";

/** How light goes between patches. */
export type Method = "classic" | "low_rank" | "multibounce" | "feedback" | "temporal";

export interface LoadOptions {
  method?: Method;
  /** The compiled module: a URL, a response, bytes; the file beside this one unless given. */
  module?: string | URL | Response | BufferSource;
  /** Bytes so far, and all of them where the server says so. */
  onProgress?: (done: number, total?: number) => void;
}

/** The light of a bake on the CPU. */
export class Patchlight {
  /** Loads a bake: a URL, or its bytes; packed by gzip or not. */
  static load(source: string | URL | Uint8Array | ArrayBuffer, options?: LoadOptions): Promise<Patchlight>;
  readonly counts: { triangles: number; patches: number; receivers: number; points: number };
  /** Finds the light; the number of the update. What is left out stays as it is; emission by the material's number, W/m²/sr. */
  update(change?: { lights?: readonly Light[]; sky?: Rgb; emission?: Readonly<Record<number, Rgb>> }): number;
  /** Paints a material with a reflectance, 0 to 0.95, from the next update on; with none as the bake has it. Not by "low_rank" and "multibounce". */
  paint(material: number, reflectance?: Rgb): void;
  /** Adds a closed mesh that moves, of a few hundred triangles: nine numbers each, a material, a column-major matrix; its number. */
  addObject(corners: ArrayLike<number>, material: number, place: ArrayLike<number>): number;
  /** Moves it, from the next update on. */
  moveObject(object: number, place: ArrayLike<number>): void;
  removeObject(object: number): void;
  /** The bake's own estimate of its error, a share of its light, and the standard error of that. */
  readonly error: { error: number; standardError: number } | undefined;
  /** Indirect irradiance at the interpolation points, W/m²: RGB. Valid until the next table is asked for. */
  surface(): Float32Array;
  /** Positions of the interpolation points, m. */
  surfacePoints(): Float32Array;
  /** Corners of the bake's triangles, m: nine numbers each. */
  triangles(): Float32Array;
  /** Makes a lightmap with texels of this size, m, on triangles of nine numbers each, on the bake's own for none; so many rays from each texel to what shines. */
  makeLightmap(texel: number, triangles?: ArrayLike<number>, options?: { rays?: number }): { width: number; height: number };
  /** Irradiance in its texels, W/m², row by row: RGB of a part. Valid until the next table is asked for. */
  lightmap(options?: { part?: LightPart }): Float32Array;
  /** Coordinates of its triangles' corners in it, six numbers each; NaN for triangles without light. */
  lightmapUvs(): Float32Array;
  /** Adds points whose indirect light every update finds; their number. */
  addPoints(places: ArrayLike<number>, normals: ArrayLike<number>, kind?: "irradiance" | "cube" | "harmonics"): number;
  removePoints(set: number): void;
  /** Light of points: RGB of each value. Valid until the next table is asked for. */
  points(set: number): Float32Array;
  /** Gives the memory back. */
  free(): void;
}
