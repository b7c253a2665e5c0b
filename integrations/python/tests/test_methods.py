"""Inverse lighting, heat, terrain, the demonstration, and the stubs."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import patchlight
from patchlight import heat, howell, inverse
from patchlight.terrain import Terrain


@pytest.fixture(scope="module")
def lamps(bake: patchlight.Bake) -> patchlight.LightToPoints:
    x, z = np.meshgrid(np.linspace(0.1, 0.45, 4), np.linspace(0.1, 0.45, 3))
    lights = [patchlight.Light.point((a, 0.1, b), flux=1.0) for a, b in zip(x.flat, z.flat, strict=True)]
    x, z = np.meshgrid(np.linspace(0.05, 0.5, 8), np.linspace(0.05, 0.5, 6))
    places = np.stack([x, np.full_like(x, 0.005), z], axis=-1).reshape(-1, 3)
    return bake.lights_to_points(lights, places)


def test_lamps_are_found_that_made_the_light(lamps: patchlight.LightToPoints) -> None:
    wanted = np.random.default_rng(5).uniform(0, 2, 12)
    target = lamps.matvec(wanted)
    found = inverse.least_squares(lamps, target, tolerance=1e-12)
    assert found.residual < 1e-3 * target.mean()
    assert found.x == pytest.approx(wanted, abs=0.02)


def test_many_unknowns_are_found_by_the_adjoint(lamps: patchlight.LightToPoints, monkeypatch: pytest.MonkeyPatch) -> None:
    target = lamps.matvec(np.full(12, 0.8))
    few = inverse.least_squares(lamps, target)
    monkeypatch.setattr(inverse, "FEW", 0)
    many = inverse.least_squares(lamps, target, tolerance=1e-12)
    assert few.adjoint == 0 and few.forward == 12 and many.adjoint > 0
    assert many.x == pytest.approx(few.x, abs=0.02)


def test_bounds_hold_and_the_optimum_is_that_of_the_dense_problem(lamps: patchlight.LightToPoints) -> None:
    from scipy.optimize import lsq_linear

    target = np.full(lamps.shape[0], 2.0)
    found = inverse.least_squares(lamps, target, bounds=(0, 0.5), tolerance=1e-10)
    assert (found.x >= 0).all() and (found.x <= 0.5 + 1e-9).all()
    dense = lsq_linear(lamps.dense(), target, (0, 0.5))
    assert np.linalg.norm(lamps.matvec(found.x) - target) <= np.linalg.norm(lamps.matvec(dense.x) - target) * 1.01


def test_the_gradient_by_reflectances_is_that_of_differences(bake: patchlight.Bake) -> None:
    direct = np.random.default_rng(7).uniform(0, 1, (len(bake.patches), 3))
    target = np.full(direct.shape, 0.3)
    albedo = bake.patches.reflectance.astype(float)

    def value(rho: np.ndarray) -> float:
        operator = patchlight.AllBounces(bake.form_factors, rho, tolerance=1e-12)
        irradiance = operator.matvec((rho * direct).reshape(-1)).reshape(-1, 3)
        return float(((irradiance - target) ** 2).sum())

    operator = patchlight.AllBounces(bake.form_factors, albedo, tolerance=1e-12)
    _, derivatives = inverse.reflectance_gradient(operator, direct, lambda h: 2 * (h - target))
    for patch, band in ((3, 0), (57, 1), (140, 2)):
        step = np.zeros_like(albedo)
        step[patch, band] = 1e-4
        difference = (value(albedo + step) - value(albedo - step)) / 2e-4
        assert derivatives[patch, band] == pytest.approx(difference, rel=1e-3)


def test_reflectances_are_found_for_wanted_light(bake: patchlight.Bake) -> None:
    direct = np.full((len(bake.patches), 1), 1.0)
    groups = (bake.patches.normals[:, 1] > 0.9).astype(int)
    true = np.array([[0.7], [0.3]])[groups]
    target = patchlight.AllBounces(bake.form_factors, true).matvec((true * direct).reshape(-1)).reshape(-1, 1)
    found = inverse.reflectances(bake.form_factors, direct, target, np.full_like(true, 0.5), groups=groups)
    assert found.x[:, 0] == pytest.approx([0.7, 0.3], abs=0.01)


def box(cells: int = 3) -> tuple[howell.Mesh, list[np.ndarray]]:
    return howell.joined(
        howell.rectangle((0, 0, 0), (0, 0, 1), (1, 0, 0), (cells, cells)),
        howell.rectangle((0, 1, 0), (1, 0, 0), (0, 0, 1), (cells, cells)),
        howell.rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0), (cells, cells)),
        howell.rectangle((0, 0, 1), (0, 1, 0), (1, 0, 0), (cells, cells)),
        howell.rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1), (cells, cells)),
        howell.rectangle((1, 0, 0), (0, 0, 1), (0, 1, 0), (cells, cells)),
    )


def test_a_cavity_at_one_temperature_exchanges_nothing() -> None:
    mesh, _ = box()
    factors = patchlight.view_factors(mesh, "contour", obstruction=False)
    state = heat.exchange(factors, 0.6 * np.ones(len(mesh[1])), temperature=np.full(len(mesh[1]), 400.0))
    assert np.abs(state.net_flux).max() < 2e-3 * heat.STEFAN_BOLTZMANN * 400**4


def test_two_plates_and_insulated_walls() -> None:
    mesh, groups = box(6)
    n = len(mesh[1])
    factors = patchlight.view_factors(mesh, "contour", obstruction=False)
    temperature = np.full(n, np.nan)
    temperature[groups[0]], temperature[groups[1]] = 600.0, 300.0
    state = heat.exchange(factors, np.ones(n), temperature=temperature)
    areas = factors.areas
    flow = (areas * state.net_flux)[groups[0]].sum()
    # Light that falls on an insulated wall goes on until it meets a plate.
    walls = np.concatenate(groups[2:])
    dense = factors.toarray()
    through = np.linalg.solve(np.eye(len(walls)) - dense[np.ix_(walls, walls)], dense[np.ix_(walls, groups[1])])
    arriving = (dense[np.ix_(groups[0], groups[1])] + dense[np.ix_(groups[0], walls)] @ through).sum(axis=1)
    share = float(areas[groups[0]] @ arriving)
    assert flow == pytest.approx(heat.STEFAN_BOLTZMANN * (600**4 - 300**4) * share, rel=5e-3)
    # Walls of one temperature each would pass on (1 + F12) / 2; those that vary along the way pass on less.
    assert howell.parallel_rectangles(1, 1, 1) < share < (1 + howell.parallel_rectangles(1, 1, 1)) / 2
    assert np.abs(state.net_flux[walls]).max() < 1e-6 * flow
    assert (areas * state.net_flux).sum() == pytest.approx(0, abs=1e-3 * flow)
    assert 300 < state.temperature[walls].min() < state.temperature[walls].max() < 600


def test_concentric_spheres() -> None:
    # q = σ (T1⁴ - T2⁴) / (1/ε1 + (r1/r2)² (1/ε2 - 1)).
    mesh, groups = howell.joined(howell.sphere(0.5, True, 20), howell.sphere(1, False, 20))
    n = len(mesh[1])
    factors = patchlight.view_factors(mesh, "rays", rays=4096)
    factors = factors.multiply(1 / factors.sum(axis=1)[:, np.newaxis]).tocsr()
    temperature = np.where(np.arange(n) < len(groups[0]), 500.0, 300.0)
    state = heat.exchange(factors, np.where(np.arange(n) < len(groups[0]), 0.8, 0.5), temperature=temperature)
    expected = heat.STEFAN_BOLTZMANN * (500**4 - 300**4) / (1 / 0.8 + 0.25 * (1 / 0.5 - 1))
    assert state.net_flux[groups[0]].mean() == pytest.approx(expected, rel=0.01)


def test_bands_of_one_emissivity_are_grey() -> None:
    assert heat.band_fractions([5000.0], [0.5796, 1.0]).sum() == pytest.approx(1)
    # A quarter of black radiation lies below λT = 2897.8 µm K, the maximum.
    assert heat.band_fractions([1000.0], [2.8978])[0, 0] == pytest.approx(0.25005, abs=1e-4)
    mesh, groups = box(2)
    n = len(mesh[1])
    factors = patchlight.view_factors(mesh, "contour", obstruction=False)
    temperature = np.full(n, np.nan)
    temperature[groups[0]], temperature[groups[1]] = 600.0, 300.0
    grey = heat.exchange(factors, np.full(n, 0.7), temperature=temperature)
    bands = heat.exchange(factors, np.full((n, 3), 0.7), temperature=temperature, edges=[4.0, 9.0])
    assert bands.temperature == pytest.approx(grey.temperature, rel=1e-3)
    assert bands.net_flux[groups[0]] == pytest.approx(grey.net_flux[groups[0]], rel=1e-3)
    with pytest.raises(patchlight.InputError, match="wavelengths"):
        heat.exchange(factors, np.full((n, 3), 0.7), temperature=temperature)


def test_a_flat_terrain_is_warm_as_the_sun_makes_it() -> None:
    flat = Terrain(np.zeros((6, 6)), 10.0, albedo=0.1, emissivity=0.9, rays=64)
    absorbed = flat.absorbed([[0, 1, 0], [0, 0.5, -0.866]], 1000.0)
    assert absorbed[:, 0] == pytest.approx(np.full(50, 900.0), rel=1e-3)
    assert absorbed[:, 1] == pytest.approx(np.full(50, 450.0), rel=1e-2)
    kelvins = flat.equilibrium(absorbed, sky_temperature=0.0)
    assert kelvins[:, 0] == pytest.approx((1000 / heat.STEFAN_BOLTZMANN) ** 0.25, rel=1e-3)


def test_a_crater_is_lit_and_warmed_by_its_walls() -> None:
    # A spherical crater: all of it sees all of it alike, so that scattered light is even, ρ Φ / (4π R²) / (1 - ρ f) with
    # the sunlight Φ that it catches and its share f of the sphere (Buhl, Welch and Rea 1968).
    r = np.hypot(*np.meshgrid(np.linspace(-1, 1, 61), np.linspace(-1, 1, 61)))
    depth = np.where(r < 0.8, np.sqrt(np.maximum(1.0 - r**2, 0)) - 0.6, 0.0)
    crater = Terrain(-depth, 2 / 60, albedo=0.3, rays=512)
    sun = [[0, 1, 0]]
    scattered = crater.absorbed(sun, 1000.0)[:, 0] / 0.7 - crater.direct(sun, 1000.0)[:, 0]
    away = np.hypot(crater.centroids[:, 0] - 1, crater.centroids[:, 2] - 1)
    inside = scattered[away < 0.7]
    expected = 0.3 * 1000 * np.pi * 0.8**2 / (4 * np.pi) / (1 - 0.3 * 0.2)
    assert inside.mean() == pytest.approx(expected, rel=0.03)
    assert inside.std() < 0.1 * expected
    assert scattered[away > 0.9].max() < 0.1 * expected
    warm = crater.equilibrium(crater.absorbed(sun, 1000.0))[:, 0]
    assert warm[away < 0.2].mean() > warm[away > 0.9].mean()


def test_the_demonstration_writes_pictures(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "patchlight.demo", str(tmp_path)], check=True, capture_output=True)
    pictures = sorted(tmp_path.glob("*.png"))
    assert len(pictures) == 3 and all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)


EXAMPLE = """
import numpy as np
import patchlight

scene = patchlight.Scene.load("cornell")
bake: patchlight.Bake = scene.bake(patches=100)
light = bake.update([lamp * 2.0 for lamp in scene.lights])
lux: np.ndarray = patchlight.illuminance(light.patches)
factors: patchlight.ViewFactors = patchlight.view_factors((scene.vertices, scene.faces))
print(lux.mean(), factors.error.max())
"""


def test_the_stubs_are_strict(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    example = tmp_path / "example.py"
    example.write_text(EXAMPLE)
    # scipy and tqdm have no types without packages of stubs.
    own = ["-p", "patchlight", "--disable-error-code=import-untyped"]
    for checked in ([str(example)], own):
        run = subprocess.run(
            [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), *checked],
            capture_output=True, text=True, cwd=tmp_path, check=False,
        )  # fmt: skip
        assert run.returncode == 0, run.stdout
    example.write_text(EXAMPLE.replace("patches=100", "patches='many'"))
    run = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), str(example)],
        capture_output=True, text=True, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert run.returncode == 1 and "patches" in run.stdout
