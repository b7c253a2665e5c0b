// Light of a bake in a three.js scene: lightmaps that follow its lights, and harmonics for what moves.

import {
  BufferAttribute,
  ClampToEdgeWrapping,
  DataTexture,
  DataUtils,
  HalfFloatType,
  LinearFilter,
  Matrix4,
  RGBAFormat,
  SphericalHarmonics3,
  Vector3,
} from "three";

import { PatchlightWorkers } from "./workers.js";

/** Corners this close, as a share of the scene's size, are one. */
const SAME = 1e-5;
/** The channel of texture coordinates that lightmaps have in three. */
const CHANNEL = 1;

const rgb = (color, factor) => [color.r * factor, color.g * factor, color.b * factor];
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

/** The meshes of a three scene with their materials, the lights and an even sky, as `Baker.of` takes them. */
export function sceneOf(scene, { sky } = {}) {
  scene.updateMatrixWorld();
  const meshes = [];
  const numbers = new Map();
  const materials = [];
  const numberOf = (material) => {
    if (!numbers.has(material)) {
      numbers.set(material, materials.length);
      const reflectance = rgb(material.color ?? { r: 0.5, g: 0.5, b: 0.5 }, 1).map((x) => Math.min(x, 0.95));
      const radiance = material.emissive ? rgb(material.emissive, material.emissiveIntensity ?? 1) : [0, 0, 0];
      materials.push({ reflectance, radiance });
    }
    return numbers.get(material);
  };
  scene.traverseVisible((object) => {
    if (!object.isMesh || object.material?.transparent) {
      return;
    }
    const all = Array.isArray(object.material) ? object.material : [object.material];
    const geometry = object.geometry.clone().applyMatrix4(object.matrixWorld);
    const { array: positions, count } = geometry.getAttribute("position");
    const normals = geometry.getAttribute("normal")?.array ?? [];
    const indices = geometry.index ? Array.from(geometry.index.array) : [...Array(count).keys()];
    const groups = geometry.groups.length && all.length > 1 ? geometry.groups : [{ start: 0, count: indices.length, materialIndex: 0 }];
    for (const { start, count, materialIndex } of groups) {
      const own = indices.slice(start, start + count);
      meshes.push({ name: object.name, positions, normals, indices: own, material: numberOf(all[materialIndex]) });
    }
  });
  return { materials, meshes, lights: lightsOf(scene), sky, of: [...numbers.keys()] };
}

/** The triangles of a bake by their corners. */
class Corners {
  #step;
  #first = new Map();

  constructor(numbers) {
    let [low, high] = [Infinity, -Infinity];
    for (const number of numbers) {
      low = Math.min(low, number);
      high = Math.max(high, number);
    }
    this.#step = SAME * (high - low);
    for (let triangle = 0; triangle < numbers.length / 9; triangle++) {
      const at = (corner) => numbers.subarray(9 * triangle + 3 * corner, 9 * triangle + 3 * corner + 3);
      for (let first = 0; first < 3; first++) {
        const key = this.#key([0, 1, 2].map((k) => at((first + k) % 3)));
        if (!this.#first.has(key)) {
          this.#first.set(key, { triangle, first });
        }
      }
    }
  }

  #key(corners) {
    return corners.map((corner) => Array.from(corner, (x) => Math.round(x / this.#step)).join()).join(" ");
  }

  /** The triangle with these corners, and which of its corners is the first of them; what rounds the other way, too. */
  find(corners) {
    const shifts = [0, 0.25, -0.25];
    for (const x of shifts) {
      for (const y of shifts) {
        for (const z of shifts) {
          const moved = corners.map((corner) => [corner[0] + x * this.#step, corner[1] + y * this.#step, corner[2] + z * this.#step]);
          const found = this.#first.get(this.#key(moved));
          if (found !== undefined) {
            return found;
          }
        }
      }
    }
    return undefined;
  }
}

/** A picture of half floats. */
function lightmapTexture(width, height) {
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

/** What meshes were before they had a lightmap. */
const originals = new WeakMap();

/** Gives the meshes of a scene their places in a lightmap: how many of their triangles the bake has, and how many not. */
function attach(scene, triangles, uvs, texture, clone) {
  const corners = new Corners(triangles);
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
  let [found, missing] = [0, 0];
  scene.updateMatrixWorld();
  const meshes = [];
  scene.traverse((object) => object.isMesh && meshes.push(object));
  for (const mesh of meshes) {
    const before = originals.get(mesh) ?? { geometry: mesh.geometry, material: mesh.material };
    const geometry = before.geometry.index ? before.geometry.toNonIndexed() : before.geometry.clone();
    const positions = geometry.getAttribute("position");
    const own = new Float32Array(2 * positions.count);
    const at = new Vector3();
    let ownFound = 0;
    for (let vertex = 0; vertex + 2 < positions.count; vertex += 3) {
      const world = [0, 1, 2].map((k) => at.fromBufferAttribute(positions, vertex + k).applyMatrix4(mesh.matrixWorld).toArray());
      const same = corners.find(world);
      const first = same && 6 * same.triangle;
      if (same === undefined || Number.isNaN(uvs[first])) {
        missing++;
        continue;
      }
      ownFound++;
      for (let k = 0; k < 3; k++) {
        const from = first + 2 * ((same.first + k) % 3);
        own.set([uvs[from], uvs[from + 1]], 2 * (vertex + k));
      }
    }
    found += ownFound;
    if (ownFound > 0) {
      originals.set(mesh, before);
      geometry.setAttribute(`uv${CHANNEL}`, new BufferAttribute(own, 2));
      mesh.geometry = geometry;
      mesh.material = Array.isArray(before.material) ? before.material.map(lit) : lit(before.material);
    }
  }
  return { found, missing };
}

/**
 * Lightmaps of a three scene that nobody has baked: workers do, coarse at once and then finer, while the page goes on. `update` asks for
 * the light of the scene's lights and emissive materials; the texture has it when it is found.
 */
export class LiveLightmaps {
  #scene;
  #workers;
  #materials;
  #clone;
  #next;

  constructor(scene, { clone = true, sky, onLevel, onLight, ...options } = {}) {
    this.#scene = scene;
    this.#clone = clone;
    const { of, ...own } = sceneOf(scene, { sky });
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
    this.#workers = new PatchlightWorkers(own, { ...options, onLevel: hearLevel, onLight: hearLight });
  }

  #show({ width, height, triangles, uvs }) {
    this.texture?.dispose();
    this.texture = lightmapTexture(width, height);
    Object.assign(this, attach(this.#scene, triangles, uvs, this.texture, this.#clone));
  }

  /** Asks for the light of now; `sky` W/m²/sr. */
  update({ sky } = {}) {
    // The library's material 0 is grey.
    const emission = {};
    this.#materials.forEach((material, number) => {
      emission[number + 1] = material.emissive ? rgb(material.emissive, material.emissiveIntensity ?? 1) : [0, 0, 0];
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
 * `update` under the lights that the scene has then. Direct light is three's own, unless `direct` is true.
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
    const { width, height } = light.makeLightmap(texel);
    /** The texels, shared by all meshes. */
    this.texture = lightmapTexture(width, height);
    /** Triangles of the scene that the bake has, and those that it has not: they stay without light. */
    const { found, missing } = attach(scene, light.triangles(), light.lightmapUvs(), this.texture, clone);
    this.found = found;
    this.missing = missing;
  }

  /** Finds the light of the scene's lights; `sky` W/m²/sr, `emission` by the material's number in the bake. */
  update({ sky, emission } = {}) {
    this.#light.update({ lights: lightsOf(this.#scene), sky, emission });
    const irradiance = this.#light.lightmap({ direct: this.#direct });
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
