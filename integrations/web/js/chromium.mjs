// A server of a folder, Chromium that draws on the processor, and how alike two pictures are: for the tests in a page.

import { access, readFile } from "node:fs/promises";
import http from "node:http";
import { extname } from "node:path";

import puppeteer from "puppeteer-core";

const types = {
  ".css": "text/css",
  ".html": "text/html",
  ".jpg": "image/jpeg",
  ".js": "text/javascript",
  ".json": "application/json",
  ".wasm": "application/wasm",
};
export const chromium = process.env.CHROMIUM ?? "/usr/bin/chromium";
const isThere = await access(chromium).then(() => true, () => false);
/** Why tests in a page are skipped, or false. */
export const skip = !isThere && `no Chromium at ${chromium}`;

/** A server of a folder, a URL. */
export async function serve(root) {
  const server = http.createServer(async ({ url }, response) => {
    const path = decodeURIComponent(new URL(url, "http://localhost").pathname);
    try {
      const bytes = await readFile(new URL(`.${path}`, root));
      response.writeHead(200, { "content-type": types[extname(path)] ?? "application/octet-stream", "content-length": bytes.length });
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
export function launch() {
  const args = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];
  return puppeteer.launch({ executablePath: chromium, headless: true, args, protocolTimeout: 300_000 });
}

/** Luminance of RGB. */
export const luminance = (rgb) =>
  Float64Array.from({ length: rgb.length / 3 }, (_, k) => 0.2126 * rgb[3 * k] + 0.7152 * rgb[3 * k + 1] + 0.0722 * rgb[3 * k + 2]);

/** Structural similarity (Wang et al. 2004) of two pictures in windows of 8 x 8 pixels, those with an excluded one left out. */
export function ssim(a, b, width, isExcluded) {
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
