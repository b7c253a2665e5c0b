// A page in Chromium: lightmaps in three.js beside Patchlight's own picture of the box. After `npm run build`; skipped without Chromium.

import assert from "node:assert/strict";
import { readFile, writeFile } from "node:fs/promises";
import test from "node:test";

import { launch, luminance, serve, skip, ssim } from "./chromium.mjs";

const root = new URL("../", import.meta.url);

test("three.js shows the light of Patchlight's own picture", { skip }, async () => {
  const [server, browser] = [await serve(root), await launch()];
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
