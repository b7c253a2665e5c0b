"""Bakes: the chain of operators is the library's light, adjoints are exact, files keep bytes."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import patchlight


def test_the_chain_of_operators_is_the_librarys_light(bake: patchlight.Bake) -> None:
    exitance = bake.direct()
    light = bake.update()
    source = bake.element_shares @ exitance
    assert source == pytest.approx(light.source, abs=1e-5 * float(light.source.max()))
    irradiance = bake.operator.matvec(source.reshape(-1)).reshape(-1, 3)
    assert irradiance == pytest.approx(light.patches, abs=1e-4 * float(light.patches.max()))
    places = [[0.1, 0.1, 0.1], [0.3, 0.5, 0.2], [0.5, 0.3, 0.4]]
    field = bake.light_field(point_rays=4096)
    points = field.add_points(places)
    expected = field.update().points(points)
    found = bake.to_points(places, rays=4096).matvec(exitance.reshape(-1)).reshape(-1, 3)
    assert found == pytest.approx(expected, rel=0.01)
    # With the bounces of the wrong albedo it is another light.
    dark = bake.to_points(places, rays=4096, reflectance=bake.elements.reflectance * 0.9)
    assert np.abs(dark.matvec(exitance.reshape(-1)).reshape(-1, 3) / expected - 1).min() > 0.02


def test_adjoints_are_exact(bake: patchlight.Bake) -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform(0.05, 0.5, (7, 3))
    lights = [*bake.scene.lights, patchlight.Light.point((0.2, 0.3, 0.2), flux=1.0)]
    chain = bake.lights_to_points(lights, places, skies=[1.0])
    for operator in (bake.operator, bake.to_points(places), chain):
        x = rng.normal(size=operator.shape[1])
        y = rng.normal(size=operator.shape[0])
        forward = y @ operator.matvec(x)
        assert operator.rmatvec(y) @ x == pytest.approx(forward, rel=1e-10)
    columns = chain.dense()
    assert columns @ [1, 2, 3] == pytest.approx(chain.matvec(np.array([1, 2, 3.0])))


def test_light_is_linear_in_the_lights(bake: patchlight.Bake) -> None:
    lamp = bake.scene.lights[0]
    one = bake.update([lamp]).patches
    two = bake.update([lamp * 2.0]).patches
    assert two == pytest.approx(2 * one, rel=1e-5)
    other = patchlight.Light.point((0.2, 0.3, 0.2), lumens=300)
    alone = bake.update([other]).patches
    both = bake.update([lamp, other]).patches
    assert both == pytest.approx(one + alone, rel=1e-3, abs=1e-5)


def test_light_that_was_replaced_is_not_read(bake: patchlight.Bake) -> None:
    light = bake.update()
    bake.update([])
    with pytest.raises(patchlight.InputError, match="replaced by a later update"):
        _ = light.patches
    light = bake.update()
    bake.direct([])
    bake.illuminance([[0.2, 0.2, 0.2]], lights=[])
    assert light.patches.max() > 0


def test_examples_of_the_documentation() -> None:
    import doctest

    from patchlight import _view_factors

    for module in (patchlight, _view_factors):
        found = doctest.testmod(module)
        assert found.attempted > 0 and found.failed == 0


def test_light_at_vertices_texels_and_cubes(bake: patchlight.Bake) -> None:
    light = bake.update()
    vertices = light.vertices()
    assert vertices.shape == (len(bake.scene.vertices), 3) and np.isfinite(vertices).all()
    assert vertices.max() > 0
    texels = light.texels(0.05, direct=False)
    assert texels.ndim == 3 and 0 < texels.max() < 20
    uvs = bake._field("classic").lightmap_uvs(0.05)
    assert np.nanmax(uvs) <= 1
    field = bake.light_field()
    cubes = field.add_points([[0.28, 0.25, 0.28]], kind="cube")
    harmonics = field.add_points([[0.28, 0.25, 0.28]], kind="harmonics")
    light = field.update()
    cube, sh = light.points(cubes)[0], light.points(harmonics)[0]
    assert cube.shape == (6, 3) and sh.shape == (4, 3)
    # Irradiance upwards by the harmonics (Ramamoorthi and Hanrahan 2001) is about the cube's.
    up = np.pi * 0.282095 * sh[0] + 2 * np.pi / 3 * 0.488603 * sh[2]
    assert patchlight.illuminance(up) == pytest.approx(patchlight.illuminance(cube[2]), rel=0.25)


def test_elements_lie_on_their_faces(bake: patchlight.Bake, tmp_path: Path) -> None:
    vertices, faces = bake.scene.vertices, bake.scene.faces
    shuffled = np.random.default_rng(1).permutation(len(faces))
    # Two materials, so that the library's order is another one.
    reflectance = np.where(np.arange(len(faces)) % 2, 0.3, 0.7)
    own = patchlight.Scene(vertices, faces[shuffled], reflectance, lights=bake.scene.lights).bake(100, receivers=False)
    bake.save(tmp_path / "a.bake")
    for found in (bake, own, patchlight.Bake.open(tmp_path / "a.bake")):
        corners = found.scene.vertices[found.scene.faces[found.elements.faces]].astype(float)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        facing = np.abs((normal * found.elements.normals).sum(axis=1))
        apart = np.abs(((found.elements.centroids - corners[:, 0]) * normal).sum(axis=1))
        # The mean of a cluster round an edge lies on neither side of it.
        assert (apart < 0.02).mean() > 0.9 and (facing > 0.99).mean() > 0.8
    assert own.elements.reflectance[:, 0] == pytest.approx(own.element_reflectance(reflectance)[:, 0], abs=1e-5)
    assert np.ptp(own.elements.reflectance[:, 0]) > 0.3


def test_pictures_and_their_parts(bake: patchlight.Bake) -> None:
    full, direct, indirect = (bake.render(size=(64, 64), sub_frames=2, part=part) for part in ("full", "direct", "indirect"))
    assert full.shape == (64, 64, 3)
    assert full == pytest.approx(direct + indirect, rel=1e-4, abs=1e-5)
    from patchlight import plots

    shown = plots.display(full)
    assert shown.dtype == np.uint8 and 20 < shown.mean() < 235


def test_files_keep_bytes(bake: patchlight.Bake, tmp_path: Path) -> None:
    first, second = tmp_path / "a.bake", tmp_path / "b.bake"
    bake.save(first)
    opened = patchlight.Bake.open(first)
    opened.save(second)
    assert first.read_bytes() == second.read_bytes()
    assert opened.update().patches == pytest.approx(bake.update().patches, rel=1e-6)
    first.write_bytes(first.read_bytes()[:-100])
    with pytest.raises(patchlight.FileError, match="a.bake"):
        patchlight.Bake.open(first)
    with pytest.raises(patchlight.FileError, match="missing"):
        patchlight.Scene.load(tmp_path / "missing.obj")


def test_factors_are_reciprocal_and_closed_within_their_noise(bake: patchlight.Bake) -> None:
    assert bake.closure_error < 1e-4
    assert 0 < bake.reciprocity_error < 0.5
    assert bake.energy is not None and abs(bake.energy["balance"]) < 0.05
    assert bake.element_shares.sum(axis=1) == pytest.approx(np.ones(len(bake.patches)))


def test_progress_and_cancellation(cornell: patchlight.Scene) -> None:
    steps: list[tuple[str, int, int]] = []
    cornell.bake(patches=100, receivers=False, progress=lambda *step: steps.append(step))
    assert steps and all(done <= total for _, done, total in steps)

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cornell.bake(patches=2000, progress=stop)


def test_work_leaves_the_interpreter_free(cornell: patchlight.Scene) -> None:
    counted = [0]
    done = threading.Event()

    def count() -> None:
        while not done.wait(0.001):
            counted[0] += 1

    thread = threading.Thread(target=count)
    thread.start()
    cornell.bake(patches=800, receivers=False)
    done.set()
    thread.join()
    assert counted[0] > 5


def test_bands() -> None:
    from patchlight import howell

    (vertices, faces), _ = howell.joined(
        howell.rectangle((0, 0, 0), (0, 0, 1), (1, 0, 0)), howell.rectangle((0, 1, 0), (1, 0, 0), (0, 0, 1))
    )
    bands = np.linspace(0.1, 0.9, 5)
    reflectance = np.tile(bands, (len(faces), 1))
    scene = patchlight.Scene(vertices, faces, reflectance)
    own = scene.bake(patches=100, kind="polygon", receivers=False)
    operator = own.operator
    assert operator.bands == 5
    irradiance = operator.matvec(np.ones(operator.shape[1])).reshape(-1, 5)
    # Even plates: H = F / (1 - ρ F) on the mean, more where more is reflected.
    share = howell.parallel_rectangles(1, 1, 1)
    areas = own.patches.areas
    mean = areas @ irradiance / areas.sum()
    assert mean == pytest.approx(share / (1 - bands * share), rel=0.02)
    assert (np.diff(mean) > 0).all()


@pytest.mark.parametrize("method", ["low_rank", "feedback", "temporal", "multibounce"])
def test_other_methods_find_the_same_light(bake: patchlight.Bake, method: str) -> None:
    expected = bake.update().patches
    field = bake.light_field(method)
    for _ in range(60 if method in ("feedback", "temporal") else 1):
        light = field.update()
    assert light.patches == pytest.approx(expected, abs=0.08 * float(expected.max()))
    with pytest.raises(patchlight.InputError, match="method is"):
        bake.light_field("magic")
