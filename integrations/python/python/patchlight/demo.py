"""``python -m patchlight.demo [FOLDER]``: a room is baked, lit, and lit again; writes pictures."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import patchlight
from patchlight import plots


def _png(path: Path, rgb: np.ndarray) -> None:
    """Writes a picture without any other package."""
    import struct
    import zlib

    height, width, _ = rgb.shape
    rows = b"".join(b"\0" + row.tobytes() for row in rgb)

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 6)) + chunk(b"IEND", b""))


def main(folder: str = "patchlight-demo") -> None:
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    scene = patchlight.Scene.load("cornell")
    bake = scene.bake(patches=600, progress=sys.stderr.isatty())
    print(f"baked in {time.perf_counter() - start:.1f} s: {bake}")
    for number, colour in enumerate(((1, 1, 1), (1, 0.6, 0.3), (0.3, 0.5, 1))):
        lights = [light * colour for light in scene.lights]
        begin = time.perf_counter()
        light = bake.update(lights)
        indirect = patchlight.illuminance(light.patches).mean()
        took = time.perf_counter() - begin
        print(f"light {number}: {indirect:.0f} lx of indirect light on average, found in {1e3 * took:.1f} ms")
        picture = bake.render(size=(480, 480), lights=lights, sub_frames=4)
        _png(out / f"light-{number}.png", plots.display(picture))
    print(f"written to {out}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
