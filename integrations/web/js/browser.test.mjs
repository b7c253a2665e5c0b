// A page in Chromium: lightmaps in three.js beside Patchlight's own picture of the box. After `npm run build`; skipped without Chromium.

import assert from "node:assert/strict";
import { access, readFile, writeFile } from "node:fs/promises";
import http from "node:http";
import { extname } from "node:path";
import test from "node:test";

import puppeteer from "puppeteer-core";

const root = new URL("../", import.meta.url);
const types = { ".html": "text/html", ".js": "text/javascript", ".json": "application/json", ".wasm": "application/wasm" };
const chromium = process.env.CHROMIUM ?? "/usr/bin/chromium";
const isThere = await access(chromium).then(() => true, () => false);

/** A server of this folder. */
async function serve() {
  const server = http.createServer(async ({ url }, response) => {
    const path = decodeURIComponent(new URL(url, "http://localhost").pathname);
    try {
      const bytes = await readFile(new URL(`.${path}`, root));
      response.writeHead(200, { "content-type": types[extname(path)] ?? "application/octet-stream" });
      response.end(bytes);
    } catch {
      response.writeHead(404);
      response.end();
    }
  });
  await new Promise((resolve) => server.listen(0, resolve));
  return server;
}

/** Chromium, which draws on the processor. */
function launch() {
  const args = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];
  return puppeteer.launch({ executablePath: chromium, headless: true, args, protocolTimeout: 300_000 });
}

/** Luminance of RGB. */
const luminance = (rgb) =>
  Float64Array.from({ length: rgb.length / 3 }, (_, k) => 0.2126 * rgb[3 * k] + 0.7152 * rgb[3 * k + 1] + 0.0722 * rgb[3 * k + 2]);

/** Structural similarity (Wang et al. 2004) of two pictures in windows of 8 x 8 pixels, those with an excluded one left out. */
function ssim(a, b, width, isExcluded) {
  const size = 8;
  const range = b.reduce((most, x) => Math.max(most, x), 0);
  const [c1, c2] = [(0.01 * range) ** 2, (0.03 * range) ** 2];
  let [sum, count] = [0, 0];
  for (let top = 0; top + size <= a.length / width; top += size / 2) {
    for (let left = 0; left + size <= width; left += size / 2) {
      const pixels = Array.from({ length: size * size }, (_, k) => left + (k % size) + width * (top + Math.floor(k / size)));
      if (pixels.some(isExcluded)) {
        continue;
      }
      const mean = (of) => pixels.reduce((total, k) => total + of(k), 0) / pixels.length;
      const [ma, mb] = [mean((k) => a[k]), mean((k) => b[k])];
      const [va, vb] = [mean((k) => (a[k] - ma) ** 2), mean((k) => (b[k] - mb) ** 2)];
      const ab = mean((k) => (a[k] - ma) * (b[k] - mb));
      sum += ((2 * ma * mb + c1) * (2 * ab + c2)) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
      count++;
    }
  }
  return sum / count;
}

test("three.js shows the light of Patchlight's own picture", { skip: !isThere && `no Chromium at ${chromium}` }, async () => {
  const [server, browser] = [await serve(), await launch()];
  try {
    const page = await browser.newPage();
    const said = [];
    // The driver speaks of the pixels that are read here, to be compared.
    page.on("console", (message) => message.text().includes("due to ReadPixels") || said.push(message.text()));
    page.on("pageerror", (error) => said.push(error.message));
    await page.goto(`http://localhost:${server.address().port}/js/compare.html`);
    await page.waitForFunction("document.title === 'drawn'", { timeout: 120_000 });
    const { radiance, found, missing, milliseconds } = await page.evaluate("result");
    const bytes = await readFile(new URL("package/native/indirect.f32", root));
    const own = new Float32Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
    const { width, height } = JSON.parse(await readFile(new URL("package/native/cornell.json", root), "utf8"));
    assert.equal(radiance.length, 3 * width * height);
    await writeFile(new URL("package/native/three.f32", root), Float32Array.from(radiance));
    // What is seen of the lamp itself, and beside the box, reflects nothing.
    const isDark = (pixel) => own[3 * pixel] === 0;
    const [theirs, ours] = [luminance(radiance), luminance(own)];
    const similar = ssim(theirs, ours, width, isDark);
    const total = (picture) => picture.reduce((sum, x, k) => (isDark(k) ? sum : sum + x), 0);
    const ratio = total(theirs) / total(ours);
    console.log(`SSIM ${similar.toFixed(4)}, mean ratio ${ratio.toFixed(4)}, drawn after ${milliseconds.toFixed(0)} ms`);
    assert.ok(similar >= 0.97, `SSIM ${similar}`);
    assert.ok(Math.abs(ratio - 1) < 0.02, `mean ratio ${ratio}`);
    assert.ok(found > 20 && missing < found / 2, `${found} ${missing}`);
    // Another picture is another one.
    const flipped = Float64Array.from(theirs, (_, k) => theirs[theirs.length - 1 - k]);
    assert.ok(ssim(flipped, ours, width, isDark) < 0.9);
    assert.deepEqual(said, []);
  } finally {
    await browser.close();
    server.close();
  }
});
