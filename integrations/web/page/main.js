// The page: scenes with lightmaps that a worker finds, and what one can do to their light.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

/** Rows below the lightmap that stay dark, for triangles without light. */
const DARK_ROWS = 2;
const PAINTS = ["#e9e4da", "#c9402f", "#d9a441", "#4f8a53", "#3a6ea5", "#2b2b2e"];
/** Reflectance at most. */
const WHITEST = 0.9;
/** Where the door of the atrium hangs, its edges, m, and its angle when it is open. */
const DOOR = { scene: "atrium", hinge: [11.4, 0, 3.1], size: [1.5, 2.4, 0.08], open: -1.45, color: [0.35, 0.16, 0.1] };
/** A tap moves the pointer less than this, pixels. */
const TAP = 6;

const $ = (selector) => document.querySelector(selector);
const root = document.documentElement;
const canvas = $("#picture");
const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
renderer.shadowMap.enabled = true;
renderer.shadowMap.autoUpdate = false;
renderer.toneMapping = THREE.NeutralToneMapping;
const camera = new THREE.PerspectiveCamera(60, 16 / 9, 0.02, 200);
const controls = new OrbitControls(camera, canvas);
controls.enableDamping = true;

/** The scene that is shown. */
let now;
let paint;
/** The sun's height over the horizon and its way round, radians. */
let sunAt = { height: 1, round: 0 };
const door = { angle: 0, wanted: 0 };

const worker = new Worker("light.js", { type: "module" });
let isBusy = false;
let isDue = false;
/** Scenes so far: answers for another are not heard. */
let scenes = 0;

const say = (text) => ($("#state").textContent = text);

/** Khronos' tone curve "PBR Neutral", which three has for what it draws, not for the background. */
function neutral(color) {
  const least = Math.min(...color);
  const own = color.map((x) => x - (least < 0.08 ? least - 6.25 * least * least : 0.04));
  const peak = Math.max(...own);
  if (peak < 0.76) {
    return own;
  }
  const next = 1 - 0.24 ** 2 / (peak + 0.24 - 0.76);
  const share = 1 - 1 / (0.15 * (peak - next) + 1);
  return own.map((x) => ((x * next) / peak) * (1 - share) + next * share);
}

/** Normals of triangles, the same at all corners. */
function flatNormals(positions) {
  const normals = new Float32Array(positions.length);
  const [a, b, c] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  for (let at = 0; at < positions.length; at += 9) {
    a.fromArray(positions, at);
    b.fromArray(positions, at + 3).sub(a);
    c.fromArray(positions, at + 6).sub(a);
    b.cross(c).normalize();
    for (let k = 0; k < 9; k += 3) {
      b.toArray(normals, at + k);
    }
  }
  return normals;
}

/** The scene's meshes, one a material, and all corners as the light's worker takes them. */
function meshesOf(numbers, description, folder) {
  const textures = new THREE.TextureLoader();
  const meshes = [];
  const corners = new Float32Array(9 * description.triangles.reduce((sum, count) => sum + count, 0));
  let [from, to] = [0, 0];
  description.triangles.forEach((count, number) => {
    const positions = numbers.subarray(from, from + 9 * count);
    const uvs = numbers.subarray(from + 9 * count, from + 15 * count);
    from += 15 * count;
    corners.set(positions, to);
    const { albedo, picture, radiance } = description.materials[number];
    const material = new THREE.MeshLambertMaterial({ side: THREE.DoubleSide });
    material.color.setRGB(...(picture ? [1, 1, 1] : albedo));
    if (picture) {
      material.map = textures.load(folder + picture);
      Object.assign(material.map, { colorSpace: THREE.SRGBColorSpace, flipY: false, anisotropy: 8 });
      material.map.wrapS = material.map.wrapT = THREE.RepeatWrapping;
    }
    material.emissive.setRGB(...radiance);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions.slice(), 3));
    geometry.setAttribute("normal", new THREE.BufferAttribute(flatNormals(positions), 3));
    geometry.setAttribute("uv", new THREE.BufferAttribute(uvs.slice(), 2));
    const mesh = new THREE.Mesh(geometry, material);
    mesh.castShadow = mesh.receiveShadow = true;
    Object.assign(mesh.userData, { number, first: to / 9, map: material.map, color: material.color.clone() });
    to += 9 * count;
    meshes.push(mesh);
  });
  return { meshes, corners };
}

/** A sun whose shadows reach over the scene. */
function makeSun(bounds) {
  const sun = new THREE.DirectionalLight();
  const reach = bounds.getSize(new THREE.Vector3()).length() / 2;
  sun.castShadow = true;
  sun.shadow.mapSize.set(4096, 4096);
  Object.assign(sun.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1, far: 4 * reach });
  sun.shadow.normalBias = 0.03;
  sun.shadow.bias = -0.0002;
  bounds.getCenter(sun.target.position);
  sun.userData.reach = reach;
  return sun;
}

function makeLamp(position, { lamp, cone }) {
  const spot = new THREE.SpotLight(0xffffff, 1, 0, cone[1], 1 - cone[0] / cone[1], 2);
  spot.color.setRGB(...lamp);
  spot.position.fromArray(position);
  spot.target.position.fromArray(position).y -= 1;
  spot.castShadow = true;
  spot.shadow.mapSize.set(1024, 1024);
  spot.shadow.camera.near = 0.02;
  spot.shadow.normalBias = 0.02;
  return spot;
}

function makeDoor() {
  const geometry = new THREE.BoxGeometry(...DOOR.size).translate(DOOR.size[0] / 2, DOOR.size[1] / 2 + 0.01, 0).toNonIndexed();
  const material = new THREE.MeshLambertMaterial();
  material.color.setRGB(...DOOR.color);
  const mesh = new THREE.Mesh(geometry, material);
  mesh.castShadow = mesh.receiveShadow = true;
  mesh.position.fromArray(DOOR.hinge);
  return mesh;
}

async function open(name) {
  const id = ++scenes;
  isBusy = true;
  root.dataset.state = "loading";
  say("Loading");
  document.querySelectorAll("nav button").forEach((button) => button.setAttribute("aria-pressed", button.dataset.scene === name));
  const folder = "scenes/";
  const [description, buffer] = await Promise.all([
    fetch(`${folder}${name}.json`).then((response) => response.json()),
    fetch(`${folder}${name}.bin`).then((response) => response.arrayBuffer()),
  ]);
  if (id !== scenes) {
    return;
  }
  now?.meshes.forEach(({ geometry, material }) => [geometry, material, material.map].forEach((own) => own?.dispose()));
  now?.texture?.dispose();
  const { meshes, corners } = meshesOf(new Float32Array(buffer), description, folder);
  const scene = new THREE.Scene();
  scene.add(...meshes);
  const bounds = new THREE.Box3().setFromObject(scene);
  const sun = description.sun && makeSun(bounds);
  const lamps = description.lamps.map((position) => makeLamp(position, description));
  const hasDoor = DOOR.scene === name;
  const leaf = hasDoor ? makeDoor() : undefined;
  [sun, sun?.target, leaf, ...lamps, ...lamps.map(({ target }) => target)].forEach((object) => object && scene.add(object));
  now = { name, description, scene, meshes, sun, lamps, leaf, paint: new Map(), isOn: lamps.map(() => true) };
  Object.assign(door, { angle: 0, wanted: 0 });
  renderer.toneMappingExposure = description.exposure;
  resetView();
  resetLight();
  showControls();
  const probe = hasDoor ? [DOOR.hinge[0] + 0.75, 1.2, DOOR.hinge[2] + 0.7] : undefined;
  const leafCorners = leaf && Float32Array.from(leaf.geometry.getAttribute("position").array);
  const { texel, rays } = description;
  const own = { id, url: new URL(`${folder}${name}.bake.gz`, location.href).href, texel, rays, corners, probe, door: leafCorners };
  worker.postMessage({ kind: "load", scene: own, method: $("#method").value });
}

/** The camera of the path-traced picture. */
function resetView() {
  const { eye, target, fov } = now.description;
  camera.fov = fov;
  camera.position.fromArray(eye);
  controls.target.fromArray(target).sub(camera.position);
  const distance = now.name === "cornell" ? controls.target.length() : 0.6;
  controls.target.setLength(distance).add(camera.position);
  Object.assign(controls, { minDistance: 0.2 * distance, maxDistance: now.name === "cornell" ? 1.6 * distance : 3 });
  camera.near = now.name === "cornell" ? 0.005 : 0.05;
  camera.updateProjectionMatrix();
  controls.update();
}

/** The lights of the path-traced picture. */
function resetLight() {
  const { sun } = now.description;
  if (sun) {
    const [x, y, z] = new THREE.Vector3(...sun.direction).normalize().negate().toArray();
    sunAt = { height: Math.asin(y), round: Math.atan2(z, x) };
    $("#hour").value = 11;
    $("#clock").textContent = "";
  }
  $("#sky").value = $("#lamp").value = 1;
  $("#tint").value = "#ffffff";
  $("#door").checked = false;
  door.wanted = door.angle = 0;
  now.isOn.fill(true);
  now.meshes.forEach((mesh) => setPaint(mesh, undefined));
  changed();
}

/** Radiance that a material has of its own, under the lamps' slider. */
const radianceOf = ({ radiance }) => {
  const tint = new THREE.Color($("#tint").value).toArray();
  return radiance.map((x, channel) => x * Number($("#lamp").value) * tint[channel]);
};

/** Gives a surface a colour, or that which it had. */
function setPaint(mesh, color) {
  const { material, userData } = mesh;
  const isTextured = color === undefined && userData.map;
  material.map = isTextured ? userData.map : null;
  material.color.copy(color ?? userData.color);
  material.needsUpdate = true;
  if (color !== undefined || now.paint.has(userData.number)) {
    now.paint.set(userData.number, color?.toArray().map((x) => Math.min(x, WHITEST)));
  }
}

/** Puts what the controls say into three's scene, and asks for its light. */
function changed() {
  const { description, sun, lamps, scene, meshes } = now;
  const brightness = Number($("#lamp").value);
  const tint = new THREE.Color($("#tint").value);
  let skyShare = Number($("#sky").value);
  if (sun) {
    const { height, round } = sunAt;
    const along = new THREE.Vector3(Math.cos(height) * Math.cos(round), Math.sin(height), Math.cos(height) * Math.sin(round));
    sun.position.copy(sun.target.position).addScaledVector(along, 2 * sun.userData.reach);
    // Low, the sun is red and weak, and so is the sky.
    const depth = Math.max(Math.sin(height), 0.03);
    const own = Math.sin(Math.asin(-description.sun.direction[1] / Math.hypot(...description.sun.direction)));
    const through = [0.08, 0.14, 0.28].map((loss) => Math.exp(-loss * (1 / depth - 1 / own)));
    sun.color.setRGB(...description.sun.irradiance.map((x, channel) => x * through[channel]));
    sun.visible = height > 0.01;
    skyShare *= Math.min(1, 0.25 + 0.75 * Math.sqrt(depth / own));
    const radius = 50 * (1 - Math.max(height, 0) / (Math.PI / 2));
    $("#dome .sun").setAttribute("cx", radius * Math.cos(round));
    $("#dome .sun").setAttribute("cy", radius * Math.sin(round));
  }
  const sky = description.sky.map((x) => x * skyShare);
  now.sky = sky;
  scene.background = new THREE.Color().setRGB(...neutral(sky.map((x) => x * description.exposure)), THREE.LinearSRGBColorSpace);
  lamps.forEach((lamp, k) => {
    lamp.color.setRGB(...description.lamp).multiply(tint);
    lamp.intensity = now.isOn[k] ? brightness : 0;
  });
  meshes.forEach((mesh) => mesh.material.emissive.setRGB(...radianceOf(description.materials[mesh.userData.number])));
  document.querySelectorAll("#lamps button").forEach((button, k) => button.setAttribute("aria-pressed", now.isOn[k]));
  document.querySelectorAll("label:has(output) input").forEach((input) => {
    const shown = input.nextElementSibling;
    if (shown.id !== "clock") {
      shown.textContent = `${Math.round(100 * Number(input.value))} %`;
    }
  });
  renderer.shadowMap.needsUpdate = true;
  ask();
}

/** Asks the worker for the light of now; one question at a time, and the newest. */
function ask() {
  if (isBusy) {
    isDue = true;
    return;
  }
  isBusy = true;
  isDue = false;
  const { description, sun, lamps, leaf } = now;
  const lights = lamps.map((lamp) => {
    const color = lamp.color.toArray().map((x) => x * lamp.intensity);
    const [inner, outer] = description.cone;
    return { kind: "spot", position: lamp.position.toArray(), direction: [0, -1, 0], inner, outer, intensity: color };
  });
  if (sun?.visible) {
    const direction = sun.target.position.clone().sub(sun.position).normalize().toArray();
    lights.push({ kind: "sun", direction, irradiance: sun.color.toArray() });
  }
  const emission = {};
  description.materials.forEach((material, number) => {
    if (material.radiance.some((x) => x > 0)) {
      emission[number] = radianceOf(material);
    }
  });
  leaf?.updateMatrixWorld();
  worker.postMessage({
    kind: "update",
    change: { lights, sky: now.sky, emission },
    paint: [...now.paint],
    place: leaf?.matrixWorld.toArray(),
  });
}

/** Gives the meshes their places in a lightmap. */
function attach({ width, height, uvs }) {
  const rows = height + DARK_ROWS;
  now.texture?.dispose();
  const texture = new THREE.DataTexture(new Uint16Array(4 * width * rows), width, rows, THREE.RGBAFormat, THREE.HalfFloatType);
  Object.assign(texture, { magFilter: THREE.LinearFilter, minFilter: THREE.LinearFilter, channel: 1 });
  now.texture = texture;
  const dark = [0.5 / width, 1 - 0.5 / rows];
  for (const { geometry, material, userData } of now.meshes) {
    const count = geometry.getAttribute("position").count;
    const places = Float32Array.from({ length: 2 * count }, (_, k) => {
      const place = uvs[6 * userData.first + k];
      return Number.isNaN(place) ? dark[k % 2] : k % 2 ? (place * height) / rows : place;
    });
    geometry.setAttribute("uv1", new THREE.BufferAttribute(places, 2));
    material.lightMap = texture;
    material.needsUpdate = true;
  }
}

worker.onerror = (event) => say(event.message ?? "The worker cannot start");
worker.onmessage = ({ data }) => {
  if (data.id !== scenes) {
    return;
  }
  if (data.kind === "progress") {
    say(`Loading ${Math.round(100 * data.share)} %`);
  } else if (data.kind === "ready") {
    attach(data);
    $("#patches").textContent = data.counts.patches.toLocaleString("en");
    $("#points").textContent = data.counts.points.toLocaleString("en");
    const { error, standardError } = data.error ?? {};
    const percent = (x) => (100 * x).toFixed(1);
    $("#error").textContent = data.error ? `${error < 0 ? "−" : "+"}${percent(Math.abs(error))} ± ${percent(standardError)} %` : "unknown";
    isBusy = false;
    ask();
  } else if (data.kind === "light") {
    now.texture.image.data.set(data.texels);
    now.texture.needsUpdate = true;
    if (now.leaf && data.air) {
      // Light of the air about it, the mean of six sides.
      const mean = (channel) => [0, 1, 2, 3, 4, 5].reduce((sum, side) => sum + data.air[3 * side + channel] / 6, 0);
      now.leaf.material.emissive.setRGB(...DOOR.color.map((albedo, channel) => (albedo * mean(channel)) / Math.PI));
    }
    if (data.milliseconds !== undefined) {
      $("#milliseconds").textContent = `${data.milliseconds.toFixed(1)} ms`;
      say(`light update ${data.milliseconds.toFixed(1)} ms`);
      root.dataset.milliseconds = data.milliseconds;
    }
    root.dataset.state = "lit";
    root.dataset.updates = Number(root.dataset.updates ?? 0) + 1;
    root.dataset.firstLight ??= performance.now().toFixed(0);
    isBusy = false;
    if (isDue) {
      ask();
    }
  } else {
    say(data.message);
    root.dataset.state = "failed";
    isBusy = false;
  }
};

/** Controls of what this scene has. */
function showControls() {
  const { sun, lamps, description, leaf } = now;
  $("#of-sun").hidden = !sun;
  const shines = description.materials.some(({ radiance }) => radiance.some((x) => x > 0));
  $("#of-lamps").hidden = !shines && lamps.length === 0;
  $("#door").parentElement.hidden = !leaf;
  $("#lamps").replaceChildren(
    ...lamps.map((_, k) => {
      const button = Object.assign(document.createElement("button"), { type: "button", textContent: k + 1 });
      button.setAttribute("aria-label", `Lamp ${k + 1}`);
      button.setAttribute("aria-pressed", "true");
      button.addEventListener("click", () => {
        now.isOn[k] = !now.isOn[k];
        changed();
      });
      return button;
    }),
  );
  setCompare(false);
}

/** The sun's way through the day. */
function byHour(hour) {
  const share = (hour - 6) / 12;
  const turn = Math.PI * share;
  const high = 1.15;
  return { height: high * Math.sin(turn), round: Math.PI * (0.05 + 0.9 * share) + Math.PI };
}

$("#hour").addEventListener("input", ({ target }) => {
  const hour = Number(target.value);
  sunAt = byHour(hour);
  const minutes = Math.round((hour % 1) * 60);
  $("#clock").textContent = `${Math.floor(hour)}:${String(minutes).padStart(2, "0")}`;
  setCompare(false);
  changed();
});
for (const id of ["#sky", "#lamp", "#tint"]) {
  $(id).addEventListener("input", () => {
    setCompare(false);
    changed();
  });
}
$("#door").addEventListener("input", ({ target }) => {
  door.wanted = target.checked ? DOOR.open : 0;
  setCompare(false);
});
$("#method").addEventListener("input", ({ target }) => {
  isBusy = true;
  say("Another method");
  worker.postMessage({ kind: "method", method: target.value });
});
document.querySelectorAll("nav button").forEach((button) => {
  button.addEventListener("click", () => (location.hash = button.dataset.scene));
});

const dome = $("#dome");
dome.querySelector(".way").setAttribute(
  "d",
  Array.from({ length: 45 }, (_, k) => {
    const { height, round } = byHour(6.5 + k / 4);
    const radius = 50 * (1 - height / (Math.PI / 2));
    return `${k ? "L" : "M"}${(radius * Math.cos(round)).toFixed(1)} ${(radius * Math.sin(round)).toFixed(1)}`;
  }).join(""),
);
const dragSun = (event) => {
  if (event.buttons === 0 && event.type !== "pointerdown") {
    return;
  }
  const { left, top, width, height } = dome.getBoundingClientRect();
  const [x, y] = [((event.clientX - left) / width - 0.5) * 104, ((event.clientY - top) / height - 0.5) * 104];
  const radius = Math.min(Math.hypot(x, y), 49);
  sunAt = { height: (1 - radius / 50) * (Math.PI / 2), round: Math.atan2(y, x) };
  $("#clock").textContent = "";
  setCompare(false);
  changed();
};
dome.addEventListener("pointerdown", (event) => {
  dome.setPointerCapture(event.pointerId);
  dragSun(event);
});
dome.addEventListener("pointermove", dragSun);

$("#paints").replaceChildren(
  ...[undefined, ...PAINTS].map((color) => {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: color ? "" : "↺" });
    button.style.background = color ?? "#fff";
    button.setAttribute("role", "radio");
    button.setAttribute("aria-checked", "false");
    button.setAttribute("aria-label", color ?? "as it was");
    button.addEventListener("click", () => {
      const isChosen = button.getAttribute("aria-checked") === "true";
      document.querySelectorAll("#paints button").forEach((other) => other.setAttribute("aria-checked", "false"));
      button.setAttribute("aria-checked", String(!isChosen));
      paint = isChosen ? undefined : { color: color && new THREE.Color(color) };
      canvas.style.cursor = paint ? "crosshair" : "";
    });
    return button;
  }),
);
let pressed;
canvas.addEventListener("pointerdown", ({ clientX, clientY }) => (pressed = [clientX, clientY]));
canvas.addEventListener("pointerup", ({ clientX, clientY }) => {
  const isTap = pressed && Math.hypot(clientX - pressed[0], clientY - pressed[1]) < TAP;
  if (!paint || !isTap || !now) {
    return;
  }
  const { left, top, width, height } = canvas.getBoundingClientRect();
  const at = new THREE.Vector2((2 * (clientX - left)) / width - 1, 1 - (2 * (clientY - top)) / height);
  const ray = new THREE.Raycaster();
  ray.setFromCamera(at, camera);
  const [hit] = ray.intersectObjects(now.meshes);
  if (hit) {
    setPaint(hit.object, paint.color);
    setCompare(false);
    changed();
  }
});

/** Puts the path-traced picture beside ours. */
function setCompare(isOn) {
  $("#compare").checked = isOn;
  controls.enabled = !isOn;
  ["#still", "#divider", ".tag.left", ".tag.right"].forEach((selector) => ($(selector).hidden = !isOn));
  if (isOn) {
    $("#still").src = `stills/${now.name}.jpg`;
    resetLight();
    resetView();
    setDivider(50);
  }
}
function setDivider(percent) {
  const own = Math.min(Math.max(percent, 0), 100);
  $("#still").style.clipPath = `inset(0 ${100 - own}% 0 0)`;
  $("#divider").style.left = `${own}%`;
  $("#divider").setAttribute("aria-valuenow", Math.round(own));
}
$("#compare").addEventListener("input", ({ target }) => setCompare(target.checked));
const divider = $("#divider");
divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
divider.addEventListener("pointermove", ({ buttons, clientX }) => {
  if (buttons) {
    const { left, width } = canvas.getBoundingClientRect();
    setDivider((100 * (clientX - left)) / width);
  }
});
divider.addEventListener("keydown", ({ key }) => {
  const step = { ArrowLeft: -2, ArrowRight: 2 }[key] ?? 0;
  setDivider(Number(divider.getAttribute("aria-valuenow")) + step);
});

const names = ["cornell", "office", "atrium"];
const named = () => names.find((name) => location.hash === `#${name}`) ?? names[0];
const openNamed = () => open(named()).catch((error) => say(error.message));
addEventListener("hashchange", openNamed);
openNamed();

renderer.setAnimationLoop(() => {
  if (!now) {
    return;
  }
  const { clientWidth, clientHeight } = canvas;
  const ratio = Math.min(devicePixelRatio, 2);
  if (canvas.width !== Math.round(clientWidth * ratio) || canvas.height !== Math.round(clientHeight * ratio)) {
    renderer.setPixelRatio(ratio);
    renderer.setSize(clientWidth, clientHeight, false);
    camera.aspect = clientWidth / clientHeight;
    camera.updateProjectionMatrix();
  }
  if (door.angle !== door.wanted && now.leaf) {
    const left = door.wanted - door.angle;
    door.angle = Math.abs(left) < 0.02 ? door.wanted : door.angle + 0.02 * Math.sign(left);
    now.leaf.rotation.y = door.angle;
    changed();
  }
  controls.update();
  renderer.render(now.scene, camera);
});
