// The page of `page/` in Chromium: its scenes beside path tracing, hours, lamps, paint, the door, both widths. After `./make-page`;
// skipped without Chromium. Pictures are left in `page/shots`.

import assert from "node:assert/strict";
import { mkdir } from "node:fs/promises";
import test from "node:test";

import { launch, luminance, serve, skip, ssim } from "./chromium.mjs";

const dist = new URL("../page/dist/", import.meta.url);
const shots = new URL("../page/shots/", import.meta.url);
const WIDE = { width: 1280, height: 900 };
const NARROW = { width: 390, height: 844, hasTouch: true, isMobile: true };
/** Pixels that are compared: half of those of the path-traced pictures each way, which have noise. */
const [WIDTH, HEIGHT] = [400, 225];

/** A page on a scene, with what it says. */
async function show(browser, port, scene, viewport) {
  const page = await browser.newPage();
  const said = [];
  page.on("console", (message) => message.text().includes("due to ReadPixels") || said.push(message.text()));
  page.on("pageerror", (error) => said.push(error.message));
  await page.setViewport(viewport);
  await page.goto(`http://localhost:${port}/index.html#${scene}`);
  await lit(page);
  return { page, said };
}

const lit = (page) => page.waitForFunction("document.documentElement.dataset.state === 'lit'", { timeout: 180_000 });
const updates = (page) => page.evaluate("Number(document.documentElement.dataset.updates)");

/** Does something, and waits for the light that it asks for. */
async function change(page, work) {
  const before = await updates(page);
  await work();
  await page.waitForFunction(`Number(document.documentElement.dataset.updates) > ${before}`, { timeout: 120_000 });
  // The newest, and a frame with it.
  await new Promise((resolve) => setTimeout(resolve, 1500));
}

const set = (page, id, value) =>
  page.$eval(id, (input, value) => {
    input[input.type === "checkbox" ? "checked" : "value"] = value;
    input.dispatchEvent(new Event("input"));
  }, value);

/** Pixels of a picture at an address, RGB, 0 to 255. */
const pixels = (page, source) =>
  page.evaluate(async (source, width, height) => {
    const image = Object.assign(new Image(), { src: source });
    await image.decode();
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    const context = canvas.getContext("2d");
    context.drawImage(image, 0, 0, width, height);
    return Array.from(context.getImageData(0, 0, width, height).data).filter((_, k) => k % 4 < 3);
  }, source, WIDTH, HEIGHT);

/** The picture on the canvas. */
async function canvasPixels(page) {
  const canvas = await page.$("figure");
  await page.addStyleTag({ content: "figcaption { display: none }" });
  return pixels(page, `data:image/png;base64,${await canvas.screenshot({ encoding: "base64" })}`);
}

const mean = (rgb) => luminance(rgb).reduce((sum, x) => sum + x, 0) / (rgb.length / 3);
const shot = (page, name) => page.screenshot({ path: new URL(`${name}.png`, shots).pathname });

test("the page beside path tracing, and what one can do", { skip, timeout: 900_000 }, async (t) => {
  await mkdir(shots, { recursive: true });
  const [server, browser] = [await serve(dist), await launch()];
  const { port } = server.address();
  try {
    for (const [scene, least] of [["cornell", 0.94], ["office", 0.75], ["atrium", 0.6]]) {
      await t.test(scene, async () => {
        const { page, said } = await show(browser, port, scene, WIDE);
        const { firstLight } = await page.evaluate("({ ...document.documentElement.dataset })");
        await change(page, () => set(page, "#compare", true));
        await shot(page, `${scene}-compare`);
        const still = await pixels(page, `stills/${scene}.jpg`);
        await page.evaluate("document.querySelector('#still').hidden = document.querySelector('#divider').hidden = true");
        await page.addStyleTag({ content: ".tag { display: none }" });
        const own = await canvasPixels(page);
        const alike = ssim(luminance(own), luminance(still), WIDTH, () => false);
        const ratio = mean(own) / mean(still);
        console.log(`${scene}: SSIM ${alike.toFixed(3)}, mean ratio ${ratio.toFixed(3)}, first light after ${firstLight} ms`);
        assert.ok(alike > least && Math.abs(ratio - 1) < 0.08, `${scene}: SSIM ${alike}, mean ratio ${ratio}`);
        const flipped = own.toReversed();
        assert.ok(ssim(luminance(flipped), luminance(still), WIDTH, () => false) < least, "another picture is another one");
        await set(page, "#compare", false);
        if (scene === "atrium") {
          const light = [];
          for (const hour of [8, 12, 16]) {
            await change(page, () => set(page, "#hour", hour));
            light.push(mean(await canvasPixels(page)));
            await shot(page, `atrium-${hour}`);
          }
          assert.ok(Math.max(...light) > 1.05 * Math.min(...light), `${light}`);
          await change(page, () => set(page, "#door", true));
          await page.waitForFunction("document.querySelector('#door').checked");
        } else {
          const before = await canvasPixels(page);
          await change(page, () => set(page, "#lamp", 0.5));
          const half = await canvasPixels(page);
          assert.ok(mean(half) < 0.9 * mean(before), `${mean(half)} ${mean(before)}`);
          // Blue paint for what the middle of the picture shows.
          await page.click("#paints button:nth-child(6)");
          const { x, y, width, height } = await (await page.$("#picture")).boundingBox();
          await change(page, () => page.mouse.click(x + width / 2, y + height / 3));
          const painted = await canvasPixels(page);
          const blue = (rgb) => rgb.reduce((sum, value, k) => sum + (k % 3 === 2 ? value : 0), 0) / mean(rgb);
          assert.ok(blue(painted) > 1.1 * blue(half), `${blue(painted)} ${blue(half)}`);
          await shot(page, `${scene}-painted`);
        }
        assert.deepEqual(said, []);
        await page.close();
      });
    }
    await t.test("a narrow screen", async () => {
      const { page, said } = await show(browser, port, "cornell", NARROW);
      assert.equal(await page.evaluate("document.documentElement.scrollWidth"), NARROW.width);
      await shot(page, "narrow");
      assert.deepEqual(said, []);
    });
    await t.test("in the dark", async () => {
      const { page } = await show(browser, port, "cornell", WIDE);
      await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: "dark" }]);
      await shot(page, "dark");
    });
  } finally {
    await browser.close();
    server.close();
  }
});
