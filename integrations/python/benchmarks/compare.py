"""Figures of ../../docs/measurements/python.md: ``python benchmarks/compare.py [catalogue|rooms|terrain|daylight|inverse]``.

Other packages are compared with where they are installed: ``pip install pyviewfactor raystrack pyradiance``.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import patchlight
from patchlight import daylight, howell, inverse
from patchlight.terrain import Terrain


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    return work(), time.perf_counter() - start


def catalogue() -> None:
    print("| configuration | closed form | contour | error, % | rays | error, % |\n|---|---:|---:|---:|---:|---:|")
    for case in howell.catalogue(48):
        contour = patchlight.view_factors(case.mesh, "contour", obstruction=case.obstruction, shadow_rays=64)
        rays = patchlight.view_factors(case.mesh, "rays", rays=int(np.clip((1 << 19) // len(case.mesh[1]), 512, 1 << 16)))
        found = [factors.between(case.receiver, case.source) for factors in (contour, rays)]
        cells = " | ".join(f"{value:.5f} | {100 * abs(value / case.expected - 1):.3f}" for value in found)
        print(f"| {case.name} | {case.expected:.5f} | {cells} |", flush=True)


def room(cells: int) -> howell.Mesh:
    """The inside of a box of 3 m with a box of 1 m in it, 24 ``cells``² facets."""

    def box(size: float, low: float, inside: bool) -> list[howell.Mesh]:
        a, b = low, low + size
        sides = [
            howell.rectangle((a, a, a), (0, 0, size), (size, 0, 0), (cells, cells)),
            howell.rectangle((a, b, a), (size, 0, 0), (0, 0, size), (cells, cells)),
            howell.rectangle((a, a, a), (size, 0, 0), (0, size, 0), (cells, cells)),
            howell.rectangle((a, a, b), (0, size, 0), (size, 0, 0), (cells, cells)),
            howell.rectangle((a, a, a), (0, size, 0), (0, 0, size), (cells, cells)),
            howell.rectangle((b, a, a), (0, 0, size), (0, size, 0), (cells, cells)),
        ]
        return sides if inside else [(vertices, faces[:, ::-1]) for vertices, faces in sides]

    mesh, _ = howell.joined(*box(3, 0, True), *box(1, 1.1, False))
    return mesh


def rooms() -> None:
    print("| facets | program | s | largest row error against contour, 4,096 shadow rays | RMS |\n|---:|---|---:|---:|---:|")
    for cells in (6, 20):
        mesh = room(cells)
        count = len(mesh[1])
        exact = patchlight.view_factors(mesh, "contour", shadow_rays=256) if count < 2000 else None

        def report(name: str, factors: Any, seconds: float) -> None:
            text = "– | –"
            if exact is not None:
                apart = np.asarray(factors) - exact.toarray()
                text = f"{np.sqrt((apart**2).sum(axis=1)).max():.4f} | {np.sqrt((apart**2).sum(axis=1).mean()):.4f}"
            print(f"| {count} | {name} | {seconds:.2f} | {text} |", flush=True)

        for rays in (1024, 4096):
            found, seconds = timed(lambda rays=rays: patchlight.view_factors(mesh, "rays", rays=rays))
            report(f"patchlight, {rays} rays", found.toarray(), seconds)
        if count < 2000:
            found, seconds = timed(lambda: patchlight.view_factors(mesh, "contour"))
            report("patchlight, contour", found.toarray(), seconds)
        try:
            import pyviewfactor
            import pyvista

            surface = pyvista.PolyData.from_regular_faces(mesh[0], mesh[1])
            small = pyvista.PolyData.from_regular_faces(*room(1))
            pyviewfactor.compute_viewfactor_matrix(small, obstacles=[small])  # compiles
            found, seconds = timed(lambda: pyviewfactor.compute_viewfactor_matrix(surface, obstacles=[surface]))
            report("pyviewfactor 1.1.0", found.T, seconds)
        except ImportError:
            print("| | pyviewfactor is not installed | | | |")
        if count > 2000:
            continue
        try:
            import raystrack

            def traced() -> Any:
                surfaces = [
                    raystrack.Surface(str(face), raystrack.Mesh(mesh[0][corners].astype(np.float32), [[0, 1, 2]]))
                    for face, corners in enumerate(mesh[1])
                ]
                sampling = raystrack.Sampling(density=1, rays_per_cell=4096)
                options = raystrack.SolveOptions(
                    sampling=sampling, accuracy=raystrack.Accuracy(max_replicates=1, min_replicates=1)
                )
                with raystrack.Solver(raystrack.Scene(surfaces), device="cpu") as solver:
                    run = solver.start(raystrack.Query(receiver_sides=("front",)), options)
                    return run.advance(raystrack.Budget(rays=4096 * count))

            found, seconds = timed(traced)
            dense = np.zeros((count, count))
            for row, channel, value in zip(found.data.row_indices, found.data.channel_indices, found.data.estimates, strict=True):
                own = found.channels[channel]
                if own.kind == "surface":
                    dense[int(found.sender_ids[row]), int(own.surface_id)] += value
            report("raystrack 2.0.0, 4096 rays", dense, seconds)
        except Exception as error:  # noqa: BLE001
            print(f"| {count} | raystrack: {error} | | | |")


def terrain() -> None:
    import resource

    side = 317
    x, z = np.meshgrid(np.linspace(0, 12, side), np.linspace(0, 12, side))
    rng = np.random.default_rng(1)
    heights = sum(np.sin(x * f + p) * np.cos(z * f + q) / f for f, p, q in rng.uniform(0.5, 6, (40, 3)))
    field, seconds = timed(lambda: Terrain(np.asarray(heights) * 20, 10.0, rays=512))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{len(field.faces)} facets, 512 rays: {seconds:.1f} s, {field.factors.nnz} factors, {memory:.2f} GB")
    suns = daylight.sun_position(172, np.arange(6, 19), 52.0, 0.0, 0.0)
    _, seconds = timed(lambda: field.equilibrium(field.absorbed(suns, 1000.0)))
    print(f"absorbed light and temperatures of 13 hours: {seconds:.1f} s")


def windowed() -> patchlight.Scene:
    """A room of 5 × 2.7 × 4 m with a window of 2 × 1.3 m in the wall x = 0."""
    parts = [
        howell.rectangle((0, 0, 0), (0, 0, 4), (5, 0, 0), (8, 10)),
        howell.rectangle((0, 2.7, 0), (5, 0, 0), (0, 0, 4), (10, 8)),
        howell.rectangle((0, 0, 0), (5, 0, 0), (0, 2.7, 0), (10, 6)),
        howell.rectangle((0, 0, 4), (0, 2.7, 0), (5, 0, 0), (6, 10)),
        howell.rectangle((5, 0, 0), (0, 0, 4), (0, 2.7, 0), (8, 6)),
        howell.rectangle((0, 0, 0), (0, 1.0, 0), (0, 0, 4), (3, 8)),
        howell.rectangle((0, 2.3, 0), (0, 0.4, 0), (0, 0, 4), (2, 8)),
        howell.rectangle((0, 1.0, 0), (0, 1.3, 0), (0, 0, 1), (3, 3)),
        howell.rectangle((0, 1.0, 3), (0, 1.3, 0), (0, 0, 1), (3, 3)),
    ]
    (vertices, faces), groups = howell.joined(*parts)
    reflectance = np.full(len(faces), 0.5)
    reflectance[groups[0]], reflectance[groups[1]] = 0.3, 0.8
    return patchlight.Scene(vertices, faces, reflectance)


def year() -> None:
    scene = windowed()
    x, z = np.meshgrid(np.linspace(0.25, 4.75, 20), np.linspace(0.25, 3.75, 10))
    places = np.stack([x, np.full_like(x, 0.8), z], axis=-1).reshape(-1, 3)
    bake, baked = timed(lambda: scene.bake(patches=2000, receivers=False))
    own, seconds = timed(lambda: daylight.coefficients(bake, places, rays=4096))
    print(f"bake {baked:.1f} s, coefficients of 200 points {seconds:.1f} s")
    weather = daylight.clear_year(52.0, 13.0, 1.0)
    _, annual = timed(lambda: own.annual(weather))
    sky = np.random.default_rng(1).uniform(0, 1, (len(own.parts), 8760))
    _, product = timed(lambda: own.irradiance(sky))
    print(f"a year with its suns {annual:.1f} s; 8,760 skies as one product {product:.2f} s")
    try:
        radiance_coefficients(scene, places, own, seconds)
    except ImportError:
        print("pyradiance is not installed")


def radiance_coefficients(scene: patchlight.Scene, places: Any, own: daylight.DaylightCoefficients, ours: float) -> None:
    """Daylight coefficients of the same points by Radiance's rfluxmtx, whose z points upwards and y north."""
    import pyradiance

    programs = Path(pyradiance.__file__).parent / "bin"
    library = Path(pyradiance.__file__).parent / "lib"

    def turned(p: Any) -> str:
        return f"{p[0]:.6f} {-p[2]:.6f} {p[1]:.6f}"

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        albedo = scene.materials[0][scene._core.triangle_materials()][:, 0]
        corners = scene._core.triangles().reshape(-1, 3, 3)
        lines = [f"void plastic m{value:.3f}\n0\n0\n5 {value} {value} {value} 0 0\n" for value in np.unique(albedo)]
        for number, (triangle, value) in enumerate(zip(corners, albedo, strict=True)):
            lines.append(f"m{value:.3f} polygon p{number}\n0\n0\n9 " + " ".join(turned(p) for p in triangle) + "\n")
        (path / "room.rad").write_text("\n".join(lines))
        sky = "#@rfluxmtx h=u u=Y\nvoid glow ground\n0\n0\n4 1 1 1 0\nground source below\n0\n0\n4 0 0 -1 180\n"
        sky += "#@rfluxmtx h=r1 u=Y\nvoid glow sky\n0\n0\n4 1 1 1 0\nsky source above\n0\n0\n4 0 0 1 180\n"
        (path / "sky.rad").write_text(sky)
        points = "\n".join(f"{turned(p)} 0 0 1" for p in places)
        environment = {"PATH": f"{programs}:/usr/bin:/bin", "RAYPATH": f".:{library}"}
        count = len(places)
        for samples in (4096, 65536):
            command = ["rfluxmtx", "-I+", "-n", "2", "-ab", "10", "-ad", str(samples), "-lw", f"{1 / samples:.2e}"]
            command += ["-y", str(count), "-", "sky.rad", "room.rad"]
            start = time.perf_counter()
            run = subprocess.run(command, input=points, capture_output=True, text=True, cwd=path, env=environment, check=False)
            seconds = time.perf_counter() - start
            if run.returncode != 0:
                print(run.stderr)
                return
            rows = [line.split() for line in run.stdout.splitlines() if line and line[0] in "0123456789-."]
            table = np.array([[float(x) for x in row] for row in rows if len(row) >= 3 * 146])
            theirs = table.reshape(count, -1, 3)[:, :, 0]
            overcast = daylight.cie_sky(1, (0, 1, 0), 100.0)
            even = np.append(0.0, np.ones(145))
            print(f"rfluxmtx -ad {samples}: {seconds:.1f} s, {seconds / ours:.1f} times ours")
            for name, sky_values in (("even sky", even), ("overcast sky", overcast)):
                found = own.irradiance(sky_values)[:, 0, 0]
                # Both name parts by rows from the horizon, north first; theirs has the ground first, too.
                expected = theirs[:, : len(even)] @ sky_values
                apart = found / expected - 1
                print(f"  {name}: mean {100 * apart.mean():+.2f} %, median {100 * np.median(abs(apart)):.2f} %, most {100 * abs(apart).max():.1f} %")


def lamps() -> None:
    scene = patchlight.Scene.load("office")
    bake = scene.bake(patches=1000, receivers=False)
    low, high = scene.bounds
    rng = np.random.default_rng(1)
    lights = [patchlight.Light.point(low + (high - low) * p, flux=10.0) for p in rng.uniform([0.1, 0.8, 0.1], [0.9, 0.9, 0.9], (12, 3))]
    places = low + (high - low) * rng.uniform([0.05, 0.25, 0.05], [0.95, 0.3, 0.95], (100, 3))
    chain = bake.lights_to_points(lights, places)
    target = np.full(chain.shape[0], 1.0)
    found = inverse.least_squares(chain, target, tolerance=1e-6)

    from scipy.optimize import minimize

    forward = [0]

    def value(x: Any) -> float:
        forward[0] += 1
        return float(((chain.matvec(x) - target) ** 2).mean())

    start = np.full(12, 0.5)
    other = minimize(value, start, method="L-BFGS-B", bounds=[(0, None)] * 12, options={"maxiter": 500, "maxfun": 10_000})
    print(f"adjoint: RMS {found.residual:.5f}, {found.forward} forward and {found.adjoint} adjoint products")
    print(f"finite differences: RMS {np.sqrt(other.fun):.5f}, {forward[0]} forward products; largest difference {abs(other.x - found.x).max():.4f}")


if __name__ == "__main__":
    tables = {"catalogue": catalogue, "rooms": rooms, "terrain": terrain, "daylight": year, "inverse": lamps}
    for name in sys.argv[1:] or tables:
        print(f"\n## {name}\n")
        tables[name]()
