// A baked box under a lamp, in Node: in a folder with `npm install patchlight three`, and a bake of `patchlight bake cornell --for-frames`.

import { readFile } from "node:fs/promises";
import * as THREE from "three";
import { Patchlight } from "patchlight";
import { PatchlightLightmaps } from "patchlight/three";

const module = await readFile(new URL(import.meta.resolve("patchlight/patchlight_bg.wasm")));
const light = await Patchlight.load(await readFile("cornell.bake.gz"), { module });
// The bake's own triangles as a mesh, under a lamp.
const geometry = new THREE.BufferGeometry();
geometry.setAttribute("position", new THREE.BufferAttribute(light.triangles(), 3));
geometry.computeVertexNormals();
const room = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ color: 0xb4b4b4 }));
const lamp = new THREE.PointLight(0xffffff, 0.1);
lamp.position.set(0.25, 0.4, 0.3);
const scene = new THREE.Scene().add(room, lamp);
const maps = new PatchlightLightmaps(scene, light, { texel: 0.02 });
const mean = () => {
  maps.update();
  const { data } = room.material.lightMap.image;
  let sum = 0;
  for (let k = 0; k < data.length; k += 4) {
    sum += THREE.DataUtils.fromHalfFloat(data[k]);
  }
  return (4 * sum) / data.length;
};
const once = mean();
lamp.intensity *= 2;
console.log(`${maps.found} triangles have light; mean ${once.toFixed(4)}, with twice the lamp ${mean().toFixed(4)} W/m²`);
