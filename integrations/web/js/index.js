// The light of a baked scene in a page: what a program of the page uses.

import init, { LightField } from "./patchlight.js";

const LIGHT_NUMBERS = 16;
const KINDS = { sun: 0, point: 1, spot: 2, rectangle: 3 };
const NOWHERE = [0, 0, 0];

/** Loads a module once: from `source` (a URL, a response or bytes), or else from `own`. @internal */
export function loader(init, own) {
  let loading;
  return (source = own) => {
    loading ??= init({ module_or_path: source }).catch((error) => {
      loading = undefined;
      throw error;
    });
    return loading;
  };
}

const load = loader(init, new URL("patchlight_bg.wasm", import.meta.url));

/** A light as a row of numbers. */
function row(light, index) {
  const kind = KINDS[light.kind];
  if (kind === undefined) {
    throw new Error(`light ${index}: its kind is ${light.kind}; it is ${Object.keys(KINDS).join(", ")}`);
  }
  const color = [light.irradiance, light.intensity, light.intensity, light.radiance][kind];
  if (color === undefined) {
    throw new Error(`light ${index}: a ${light.kind} has ${["irradiance", "intensity", "intensity", "radiance"][kind]}`);
  }
  const place = (kind === KINDS.rectangle ? light.corner : light.position) ?? NOWHERE;
  const first = kind === KINDS.spot ? [light.inner ?? 0, light.outer, 0] : (light.edgeA ?? NOWHERE);
  return [kind, ...color, ...place, ...(light.direction ?? NOWHERE), ...first, ...(light.edgeB ?? NOWHERE)];
}

/** Rows of lights. @internal */
export function rows(lights) {
  const numbers = new Float32Array(LIGHT_NUMBERS * lights.length);
  lights.forEach((light, index) => numbers.set(row(light, index), LIGHT_NUMBERS * index));
  return numbers;
}

/** Corners of the triangles of meshes, nine numbers each, mesh after mesh. @internal */
export function cornersOf(meshes) {
  const count = ({ positions, indices = [] }) => indices.length || positions.length / 3;
  const corners = new Float32Array(3 * meshes.reduce((sum, mesh) => sum + count(mesh), 0));
  let at = 0;
  for (const mesh of meshes) {
    const { positions, indices = [] } = mesh;
    for (let corner = 0; corner < count(mesh); corner++) {
      const from = 3 * (indices.length ? indices[corner] : corner);
      for (let axis = 0; axis < 3; axis++) {
        corners[at++] = positions[from + axis];
      }
    }
  }
  return corners;
}

/** Bytes of a response, with progress. */
async function bytesOf(response, url, onProgress) {
  if (!response.ok) {
    throw new Error(`${url}: the server answers ${response.status} ${response.statusText}`);
  }
  const total = Number(response.headers.get("content-length")) || undefined;
  const parts = [];
  let done = 0;
  for (const reader = response.body.getReader(); ; ) {
    const { value } = await reader.read();
    if (value === undefined) {
      break;
    }
    parts.push(value);
    done += value.length;
    onProgress?.(done, total);
  }
  const bytes = new Uint8Array(done);
  let at = 0;
  for (const part of parts) {
    bytes.set(part, at);
    at += part.length;
  }
  return bytes;
}

/** Bytes as they are, or unpacked: a file of gzip begins with 1f 8b. */
async function unpacked(bytes, name) {
  if (bytes[0] !== 0x1f || bytes[1] !== 0x8b) {
    return bytes;
  }
  try {
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  } catch (error) {
    throw new Error(`${name}: cannot be unpacked: ${error.message}`);
  }
}

/** The light of a bake. */
export class Patchlight {
  #field;
  #memory;

  constructor(field, memory) {
    this.#field = field;
    this.#memory = memory;
  }

  /** Loads a bake: a URL, or its bytes; packed by gzip or not. */
  static async load(source, { method = "classic", module, onProgress } = {}) {
    const { memory } = await load(module);
    const isBytes = source instanceof Uint8Array || source instanceof ArrayBuffer;
    const name = isBytes ? "the bake" : String(source);
    const bytes = isBytes ? new Uint8Array(source) : await bytesOf(await fetch(source), source, onProgress);
    const bake = await unpacked(bytes, name);
    return new Patchlight(failing(() => new LightField(name, bake, method)), memory);
  }

  /** Triangles, patches, receivers, and interpolation points of the surfaces. */
  get counts() {
    const [triangles, patches, receivers, points] = this.#field.counts();
    return { triangles, patches, receivers, points };
  }

  /** Finds the light; what is left out stays as it is. */
  update({ lights, sky, emission } = {}) {
    return failing(() => {
      if (lights !== undefined) {
        this.#field.set_lights(rows(lights));
      }
      if (sky !== undefined) {
        this.#field.set_sky(...sky);
      }
      for (const [material, radiance] of Object.entries(emission ?? {})) {
        this.#field.set_emission(Number(material), ...radiance);
      }
      return this.#field.update();
    });
  }

  /** Paints a material with a reflectance, 0 to 0.95, from the next update on; with none as the bake has it. */
  paint(material, reflectance = []) {
    failing(() => this.#field.paint(material, Float32Array.from(reflectance)));
  }

  /** Adds a closed mesh that moves: corners of triangles, nine numbers each, a material, a column-major matrix; its number. */
  addObject(corners, material, place) {
    return failing(() => this.#field.add_object(Float32Array.from(corners), material, Float32Array.from(place)));
  }

  /** Moves it, from the next update on. */
  moveObject(object, place) {
    failing(() => this.#field.move_object(object, Float32Array.from(place)));
  }

  /** Removes it. */
  removeObject(object) {
    failing(() => this.#field.remove_object(object));
  }

  /** The bake's own estimate of its error, a share of its light, and the standard error of that. */
  get error() {
    const [error, standardError] = this.#field.error();
    return error === undefined ? undefined : { error, standardError };
  }

  /** Indirect irradiance at the interpolation points, W/m²: RGB. Valid until the next table is asked for. */
  surface() {
    return this.#table(() => this.#field.surface());
  }

  /** Positions of the interpolation points, m. */
  surfacePoints() {
    return this.#table(() => this.#field.surface_points()).slice();
  }

  /** Corners of the bake's triangles, m: nine numbers each. */
  triangles() {
    return this.#table(() => this.#field.triangles()).slice();
  }

  /**
   * Makes a lightmap with texels of this size, m, on triangles of nine numbers each; on the bake's own for none. `rays` go from each
   * texel to each material that shines, and to the sky, once.
   */
  makeLightmap(texel, triangles = [], { rays } = {}) {
    const [width, height] = failing(() => this.#field.make_lightmap(texel, Float32Array.from(triangles)));
    if (rays !== undefined) {
      failing(() => this.#field.set_rays(rays));
    }
    return { width, height };
  }

  /** Irradiance in its texels, W/m², row by row: RGB of a part. Valid until the next table is asked for. */
  lightmap({ part = "indirect" } = {}) {
    return this.#table(() => this.#field.lightmap(part));
  }

  /** Coordinates of its triangles' corners in it, six numbers each; NaN for triangles without light. */
  lightmapUvs() {
    return this.#table(() => this.#field.lightmap_uvs()).slice();
  }

  /** Adds points whose indirect light every update finds from now on; their number. */
  addPoints(places, normals, kind = "irradiance") {
    return failing(() => this.#field.add_points(Float32Array.from(places), Float32Array.from(normals), kind));
  }

  /** Removes them. */
  removePoints(set) {
    failing(() => this.#field.remove_points(set));
  }

  /** Their light: RGB of each value. Valid until the next table is asked for. */
  points(set) {
    return this.#table(() => this.#field.points(set));
  }

  /** Gives the memory back. */
  free() {
    this.#field.free();
  }

  #table(make) {
    const table = failing(make);
    const { pointer, length } = table;
    table.free();
    // Made anew each time: memory that grows takes the buffer of before away.
    return new Float32Array(this.#memory.buffer, pointer, length);
  }
}

/** The module throws texts; a page gets errors. @internal */
export function failing(work) {
  try {
    return work();
  } catch (error) {
    throw error instanceof Error ? error : new Error(String(error));
  }
}
