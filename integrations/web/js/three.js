// Light of a bake in a three.js scene: lightmaps that follow its lights, and harmonics for what moves.

import {
  BufferAttribute,
  ClampToEdgeWrapping,
  Color,
  DataTexture,
  DataUtils,
  HalfFloatType,
  LinearFilter,
  LinearSRGBColorSpace,
  Matrix4,
  RGBAFormat,
  SphericalHarmonics3,
  Vector3,
} from "three";

import { cornersOf } from "./index.js";
import { PatchlightWorkers } from "./workers.js";

/** Rows below the atlas that stay dark, for triangles without light. */
const DARK_ROWS = 2;
/** Texels of the canvas on which textures are averaged, each way. */
const MEAN_TEXELS = 16;
/** The channel of texture coordinates that lightmaps have in three. */
const CHANNEL = 1;

const rgb = (color, factor) => [color.r * factor, color.g * factor, color.b * factor];
const times = (a, b) => a.map((x, channel) => x * b[channel]);
const place = (object) => new Vector3().setFromMatrixPosition(object.matrixWorld);

/** Lights of a three scene as the module takes them: lux are W/m², candela W/sr, nits W/m²/sr, and the other way round. */
export function lightsOf(scene) {
  const lights = [];
  scene.updateMatrixWorld();
  scene.traverseVisible((object) => {
    const color = object.isLight && rgb(object.color, object.intensity);
    const along = () => place(object.target).sub(place(object)).toArray();
    if (object.isDirectionalLight) {
      object.target.updateMatrixWorld();
      lights.push({ kind: "sun", direction: along(), irradiance: color });
    } else if (object.isSpotLight) {
      object.target.updateMatrixWorld();
      const inner = object.angle * (1 - object.penumbra);
      const position = place(object).toArray();
      lights.push({ kind: "spot", position, direction: along(), inner, outer: object.angle, intensity: color });
    } else if (object.isPointLight) {
      lights.push({ kind: "point", position: place(object).toArray(), intensity: color });
    } else if (object.isRectAreaLight) {
      // It shines along its -z.
      const [x, y, z] = [new Vector3(), new Vector3(), new Vector3()];
      new Matrix4().copy(object.matrixWorld).extractBasis(x, y, z);
      const edgeA = y.setLength(object.height);
      const edgeB = x.setLength(object.width);
      const corner = place(object).addScaledVector(edgeA, -0.5).addScaledVector(edgeB, -0.5);
      const edges = { edgeA: edgeA.toArray(), edgeB: edgeB.toArray() };
      lights.push({ kind: "rectangle", corner: corner.toArray(), ...edges, radiance: color });
    }
  });
  return lights;
}

/** Mean colors of textures by their pictures. */
const means = new WeakMap();

/** Mean of a texture, linear RGB: a page has its picture on a canvas; without one it counts as white. */
function meanOf(texture) {
  const image = texture?.image;
  if (!image || typeof document === "undefined") {
    return [1, 1, 1];
  }
  if (!means.has(image)) {
    const canvas = Object.assign(document.createElement("canvas"), { width: MEAN_TEXELS, height: MEAN_TEXELS });
    const context = canvas.getContext("2d", { willReadFrequently: true });
    let mean = [1, 1, 1];
    try {
      context.drawImage(image, 0, 0, MEAN_TEXELS, MEAN_TEXELS);
      const { data } = context.getImageData(0, 0, MEAN_TEXELS, MEAN_TEXELS);
      const color = new Color();
      const sum = [0, 0, 0];
      for (let k = 0; k < data.length; k += 4) {
        color.setRGB(data[k] / 255, data[k + 1] / 255, data[k + 2] / 255, texture.colorSpace || LinearSRGBColorSpace);
        color.toArray().forEach((x, channel) => (sum[channel] += x));
      }
      mean = sum.map((x) => (4 * x) / data.length);
    } catch {
      // Compressed textures, and pictures of other servers, cannot be read.
    }
    means.set(image, mean);
  }
  return means.get(image);
}

/** What a material shines with, W/m²/sr. */
function radianceOf(material) {
  const color = material.emissive ? rgb(material.emissive, material.emissiveIntensity ?? 1) : [0, 0, 0];
  return color.some((x) => x > 0) ? times(color, meanOf(material.emissiveMap)) : color;
}

/** What meshes were before they had a lightmap. */
const originals = new WeakMap();

/** The meshes of a three scene in their places, a part for each of their materials: hidden and transparent ones, too, or not. */
function partsOf(scene, isAll) {
  scene.updateMatrixWorld();
  const parts = [];
  const visit = (mesh) => {
    if (!mesh.isMesh || (mesh.material?.transparent && !isAll)) {
      return;
    }
    const all = Array.isArray(mesh.material) ? mesh.material : [mesh.material];
    const geometry = (originals.get(mesh)?.geometry ?? mesh.geometry).clone().applyMatrix4(mesh.matrixWorld);
    const { array: positions, count } = geometry.getAttribute("position");
    const normals = geometry.getAttribute("normal")?.array ?? [];
    const indices = geometry.index ? Array.from(geometry.index.array) : [...Array(count).keys()];
    const whole = [{ start: 0, count: indices.length, materialIndex: 0 }];
    const groups = geometry.groups.length && all.length > 1 ? geometry.groups : whole;
    for (const { start, count, materialIndex } of groups) {
      const own = indices.slice(start, start + count);
      parts.push({ mesh, first: start, name: mesh.name, positions, normals, indices: own, material: all[materialIndex] });
    }
  };
  if (isAll) {
    scene.traverse(visit);
  } else {
    scene.traverseVisible(visit);
  }
  return parts;
}

/** The parts of a three scene with their materials, the lights and an even sky, as `Baker.of` takes them. */
function arraysOf(scene, parts, sky) {
  const numbers = new Map();
  const materials = [];
  const numberOf = (material) => {
    if (!numbers.has(material)) {
      numbers.set(material, materials.length);
      const color = times(rgb(material.color ?? { r: 0.5, g: 0.5, b: 0.5 }, 1), meanOf(material.map));
      materials.push({ reflectance: color.map((x) => Math.min(x, 0.95)), radiance: radianceOf(material) });
    }
    return numbers.get(material);
  };
  const meshes = parts.map(({ name, positions, normals, indices, material }) => {
    return { name, positions, normals, indices, material: numberOf(material) };
  });
  return { materials, meshes, lights: lightsOf(scene), sky, of: [...numbers.keys()] };
}

/** The meshes of a three scene with their materials, the lights and an even sky, as `Baker.of` takes them. */
export function sceneOf(scene, { sky } = {}) {
  return arraysOf(scene, partsOf(scene, false), sky);
}

/** Light of the texels: three lights by its lights, and knows nothing of surfaces that shine and of skies. */
const partOf = (direct) => (direct ? "full" : "without_lights");

/** A picture of half floats, with the dark rows. */
function lightmapTexture(width, rows) {
  const height = rows + DARK_ROWS;
  const texture = new DataTexture(new Uint16Array(4 * width * height), width, height, RGBAFormat, HalfFloatType);
  Object.assign(texture, { magFilter: LinearFilter, minFilter: LinearFilter, channel: CHANNEL });
  return Object.assign(texture, { wrapS: ClampToEdgeWrapping, wrapT: ClampToEdgeWrapping, generateMipmaps: false });
}

/** Writes irradiance, RGB, into such a picture. */
function write(texture, irradiance) {
  const { data } = texture.image;
  const one = DataUtils.toHalfFloat(1);
  for (let texel = 0; texel < irradiance.length / 3; texel++) {
    for (let channel = 0; channel < 3; channel++) {
      data[4 * texel + channel] = DataUtils.toHalfFloat(Math.min(irradiance[3 * texel + channel], 65504));
    }
    data[4 * texel + 3] = one;
  }
  texture.needsUpdate = true;
}

/** Gives the meshes of parts their places in a lightmap: how many of their triangles have light in it, and how many not. */
function attach(parts, uvs, texture, clone) {
  const { width, height } = texture.image;
  const dark = [0.5 / width, 1 - 0.5 / height];
  const own = new Map();
  let [corner, found, missing] = [0, 0, 0];
  for (const { mesh, first, indices } of parts) {
    if (!own.has(mesh)) {
      const geometry = originals.get(mesh)?.geometry ?? mesh.geometry;
      const count = geometry.index?.count ?? geometry.getAttribute("position").count;
      own.set(mesh, { found: 0, places: Float32Array.from({ length: 2 * count }, (_, k) => dark[k % 2]) });
    }
    const { places } = own.get(mesh);
    for (let vertex = first; vertex + 2 < first + indices.length; vertex += 3, corner += 3) {
      if (Number.isNaN(uvs[2 * corner])) {
        missing++;
        continue;
      }
      own.get(mesh).found++;
      for (let k = 0; k < 3; k++) {
        const [u, v] = uvs.subarray(2 * (corner + k));
        places.set([u, (v * (height - DARK_ROWS)) / height], 2 * (vertex + k));
      }
    }
  }
  const materials = new Map();
  const lit = (material) => {
    if (!materials.has(material)) {
      const own = clone ? material.clone() : material;
      own.lightMap = texture;
      own.lightMapIntensity = 1;
      own.needsUpdate = true;
      materials.set(material, own);
    }
    return materials.get(material);
  };
  for (const [mesh, { found: ownFound, places }] of own) {
    found += ownFound;
    if (ownFound === 0) {
      continue;
    }
    const before = originals.get(mesh) ?? { geometry: mesh.geometry, material: mesh.material };
    const geometry = before.geometry.index ? before.geometry.toNonIndexed() : before.geometry.clone();
    originals.set(mesh, before);
    geometry.setAttribute(`uv${CHANNEL}`, new BufferAttribute(places, 2));
    mesh.geometry = geometry;
    mesh.material = Array.isArray(before.material) ? before.material.map(lit) : lit(before.material);
  }
  return { found, missing };
}

/**
 * Lightmaps of a three scene that nobody has baked: workers do, coarse at once and then finer, while the page goes on. `update` asks for
 * the light of the scene's lights and emissive materials; the texture has it when it is found.
 */
export class LiveLightmaps {
  #scene;
  #parts;
  #workers;
  #materials;
  #clone;
  #next;

  constructor(scene, { clone = true, direct = false, sky, onLevel, onLight, ...options } = {}) {
    this.#scene = scene;
    this.#clone = clone;
    this.#parts = partsOf(scene, false);
    const { of, ...own } = arraysOf(scene, this.#parts, sky);
    this.#materials = of;
    /** The texels, shared by all meshes; another one for each level. */
    this.texture = undefined;
    const hearLevel = (level) => {
      this.#next = level;
      onLevel?.(level);
    };
    const hearLight = (light) => {
      if (this.#next !== undefined) {
        this.#show(this.#next);
        this.#next = undefined;
      }
      write(this.texture, light.texels);
      onLight?.(light);
    };
    this.#workers = new PatchlightWorkers(own, { ...options, part: partOf(direct), onLevel: hearLevel, onLight: hearLight });
  }

  #show({ width, height, uvs }) {
    this.texture?.dispose();
    this.texture = lightmapTexture(width, height);
    Object.assign(this, attach(this.#parts, uvs, this.texture, this.#clone));
  }

  /** Asks for the light of now; `sky` W/m²/sr. */
  update({ sky } = {}) {
    // The library's material 0 is grey.
    const emission = {};
    this.#materials.forEach((material, number) => {
      emission[number + 1] = radianceOf(material);
    });
    this.#workers.update({ lights: lightsOf(this.#scene), sky, emission });
  }

  /** Ends the workers and gives the texture back. */
  dispose() {
    this.#workers.free();
    this.texture?.dispose();
  }
}

/**
 * Lightmaps of a three scene that was baked: its meshes get `lightMap`s with the irradiance of all bounces, found anew by
 * `update` under the lights that the scene has then. Direct light of lights is three's own, unless `direct` is true.
 */
export class PatchlightLightmaps {
  #scene;
  #light;
  #direct;
  #probes;

  constructor(scene, light, { texel = 0.1, direct = false, clone = true } = {}) {
    this.#scene = scene;
    this.#light = light;
    this.#direct = direct;
    const parts = partsOf(scene, true);
    const { width, height } = light.makeLightmap(texel, cornersOf(parts));
    /** The texels, shared by all meshes. */
    this.texture = lightmapTexture(width, height);
    /** Triangles of the scene that have light of the bake, and those that it does not know, or no light comes to. */
    const { found, missing } = attach(parts, light.lightmapUvs(), this.texture, clone);
    this.found = found;
    this.missing = missing;
  }

  /** Finds the light of the scene's lights; `sky` W/m²/sr, `emission` by the material's number in the bake. */
  update({ sky, emission } = {}) {
    this.#light.update({ lights: lightsOf(this.#scene), sky, emission });
    const irradiance = this.#light.lightmap({ part: partOf(this.#direct) });
    write(this.texture, irradiance);
    this.#probes?.read(this.#light);
  }

  /** Probes in a box, `counts` of them along each axis, for what moves; every update lights them. */
  makeProbes(low, high, counts) {
    this.#probes?.remove(this.#light);
    this.#probes = new Probes(this.#light, low, high, counts);
  }

  /** Radiance at a place, as harmonics of the first degree between the eight probes about it: for `LightProbe.sh`. */
  harmonics(position, target = new SphericalHarmonics3()) {
    if (this.#probes === undefined) {
      throw new Error("there are no probes; makeProbes makes them");
    }
    return this.#probes.at(position, target);
  }

  /** Gives the texture back; the light of the bake is the caller's. */
  dispose() {
    this.#probes?.remove(this.#light);
    this.texture.dispose();
  }
}

/** A grid of probes. */
class Probes {
  #set;
  #low;
  #step;
  #counts;
  #values = new Float32Array();

  constructor(light, low, high, counts) {
    if (counts.some((count) => !Number.isInteger(count) || count < 2)) {
      throw new Error(`counts of probes are ${counts}; at least 2 along each axis`);
    }
    this.#low = low;
    this.#counts = counts;
    this.#step = [0, 1, 2].map((axis) => (high[axis] - low[axis]) / (counts[axis] - 1));
    const places = [];
    for (let z = 0; z < counts[2]; z++) {
      for (let y = 0; y < counts[1]; y++) {
        for (let x = 0; x < counts[0]; x++) {
          places.push(...[x, y, z].map((k, axis) => low[axis] + k * this.#step[axis]));
        }
      }
    }
    const normals = places.map((_, k) => (k % 3 === 1 ? 1 : 0));
    this.#set = light.addPoints(places, normals, "harmonics");
  }

  read(light) {
    this.#values = light.points(this.#set).slice();
  }

  remove(light) {
    light.removePoints(this.#set);
  }

  at(position, target) {
    const cell = [0, 1, 2].map((axis) => {
      const at = (position.getComponent(axis) - this.#low[axis]) / this.#step[axis];
      const within = Math.min(Math.max(at, 0), this.#counts[axis] - 1.000001);
      return [Math.floor(within), within - Math.floor(within)];
    });
    target.zero();
    // Ours are L_00, L_1x, L_1y, L_1z; those of three L_00, L_1y, L_1z, L_1x.
    const places = [0, 3, 1, 2];
    for (let corner = 0; corner < 8; corner++) {
      let [weight, index] = [1, 0];
      for (let axis = 2; axis >= 0; axis--) {
        const far = (corner >> axis) & 1;
        weight *= far ? cell[axis][1] : 1 - cell[axis][1];
        index = index * this.#counts[axis] + cell[axis][0] + far;
      }
      for (let k = 0; k < 4; k++) {
        const from = 12 * index + 3 * k;
        const [r, g, b] = this.#values.subarray(from, from + 3);
        target.coefficients[places[k]].addScaledVector(new Vector3(r, g, b), weight);
      }
    }
    return target;
  }
}
