"""Scenes, lights and their units; what is wrong is told with its place."""

from pathlib import Path

import numpy as np
import pytest

import patchlight

SQUARE = ([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]], [[0, 1, 2], [0, 2, 3]])
IES = """IESNA:LM-63-2002
TILT=NONE
1 1000 1 3 1 1 2 0 0 0
1 1 1
0 90 180
0
100 100 0
"""


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        # E = I / d² and the units of each; the last two by their solid angles.
        (patchlight.Light.point((0.5, 2, 0.5), candela=400), 100.0),
        (patchlight.Light.point((0.5, 2, 0.5), lumens=400 * 4 * np.pi), 100.0),
        (patchlight.Light.spot((0.5, 2, 0.5), (0, -1, 0), (20, 30), candela=400), 100.0),
        (patchlight.Light.sun((0, -1, 0), lux=100), 100.0),
        (patchlight.Light.sun((0, -1, -1), lux=100), 100 / np.sqrt(2)),
        (patchlight.Light.rectangle((0.49, 2, 0.49), ((0.02, 0, 0), (0, 0, 0.02)), lumens=np.pi * 400), 100.0),
        (patchlight.Light.rectangle((0.49, 2, 0.49), ((0.02, 0, 0), (0, 0, 0.02)), nits=1e6), 100.0),
    ],
)
def test_illuminance_below_each_light(light: patchlight.Light, expected: float) -> None:
    scene = patchlight.Scene(*SQUARE)
    found = scene.direct([[0.5, 0.0, 0.5]], [[0, 1, 0]], lights=[light], area_rays=256)
    assert patchlight.illuminance(found)[0] == pytest.approx(expected, rel=2e-3)
    twice = scene.direct([[0.5, 0.0, 0.5]], [[0, 1, 0]], lights=[light * 2], area_rays=256)
    assert twice == pytest.approx(2 * found, rel=1e-6)


def test_luminaires(tmp_path: Path) -> None:
    path = tmp_path / "lamp.ies"
    path.write_text(IES)
    scene = patchlight.Scene(*SQUARE)
    light = patchlight.Light.luminaire(path, (0.5, 1, 0.5))
    found = patchlight.illuminance(scene.direct([[0.5, 0, 0.5]], [[0, 1, 0]], lights=[light, light]))[0]
    assert found == pytest.approx(200, rel=0.01)
    path.write_text(IES.replace("0 90 180", "0 180 90"))
    with pytest.raises(patchlight.FileError, match=r"lamp\.ies"):
        patchlight.Light.luminaire(path, (0.5, 1, 0.5))


def test_a_constant_sky_over_a_plane() -> None:
    scene = patchlight.Scene(*SQUARE, sky=patchlight.Sky.constant(nits=1000))
    found = patchlight.illuminance(scene.direct([[0.5, 0, 0.5]], [[0, 1, 0]]))[0]
    assert found == pytest.approx(1000 * np.pi, rel=2e-3)
    white = patchlight.Sky.map(np.full((16, 32), 1000 / patchlight.LUMENS_PER_WATT))
    found = patchlight.illuminance(scene.direct([[0.5, 0, 0.5]], [[0, 1, 0]], sky=white, sky_rays=1024))[0]
    assert found == pytest.approx(1000 * np.pi, rel=0.02)


def test_faces_without_area_are_left_out_with_a_warning() -> None:
    vertices, faces = SQUARE
    with pytest.warns(UserWarning, match="1 face"):
        scene = patchlight.Scene(vertices, [*faces, [0, 0, 1]], [[0.2], [0.4], [0.9]])
    own = scene.bake(patches=20, receivers=False)
    assert set(own.patches.faces) <= {0, 1}
    assert own.patches.reflectance[own.patches.faces == 1][0] == pytest.approx([0.4] * 3)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (dict(vertices=[[0, 0]], faces=[[0, 0, 0]]), "rows of x, y and z"),
        (dict(vertices=SQUARE[0], faces=[[0, 1]]), "rows of three vertex numbers"),
        (dict(vertices=SQUARE[0], faces=[[0, 1, 9]]), "face 0 has vertex 9 of 4"),
        (dict(vertices=SQUARE[0], faces=SQUARE[1], reflectance=[0.5, 1.2]), "face 1 reflects"),
        (dict(vertices=SQUARE[0], faces=SQUARE[1], emission=-1), "face 0 shines"),
        (dict(vertices=SQUARE[0], faces=SQUARE[1], reflectance=np.full((5, 3), 0.5)), "one row, or one for each of 2 faces"),
        (dict(vertices=[[0, 0, np.nan]] * 4, faces=SQUARE[1]), "no place|without area|corner"),
    ],
)
def test_bad_scenes_are_refused_with_the_place(arguments: dict[str, object], text: str) -> None:
    with pytest.raises(patchlight.InputError, match=text):
        patchlight.Scene(**arguments)  # type: ignore[arg-type]


def test_bad_lights_are_refused() -> None:
    with pytest.raises(patchlight.InputError, match="give one of irradiance, lux"):
        patchlight.Light.sun((0, -1, 0))
    with pytest.raises(patchlight.InputError, match="2 are given"):
        patchlight.Light.sun((0, -1, 0), 1.0, lux=3)
    with pytest.raises(patchlight.InputError, match="not negative"):
        patchlight.Light.point((0, 0, 0), -1)
    with pytest.raises(patchlight.InputError, match="span no area"):
        patchlight.Light.rectangle((0, 0, 0), ((1, 0, 0), (2, 0, 0)), 1.0)
    with pytest.raises(patchlight.InputError, match="finite x, y and z"):
        patchlight.Light.sun((0, np.inf, 0), 1.0)


def test_arrays_are_taken_without_a_copy() -> None:
    from patchlight._arrays import triples, vectors

    vertices = np.zeros((5, 3), np.float32)
    faces = np.zeros((5, 3), np.uint32)
    assert vectors(vertices, "") is vertices or np.shares_memory(vectors(vertices, ""), vertices)
    assert np.shares_memory(triples(faces, ""), faces)


def test_rays() -> None:
    scene = patchlight.Scene(*SQUARE)
    found = scene.cast([[0.5, 2, 0.5], [5, 2, 5]], [[0, -1, 0], [0, -1, 0]])
    assert found[0] == pytest.approx(2) and np.isinf(found[1])
    assert "cornell" in patchlight.built_in_scenes()


def test_meshes_of_other_packages() -> None:
    trimesh = pytest.importorskip("trimesh")
    pyvista = pytest.importorskip("pyvista")
    box = trimesh.creation.box()
    for scene in (patchlight.Scene.from_trimesh(box), patchlight.Scene.from_pyvista(pyvista.wrap(box))):
        assert len(scene.faces) == 12
        low, high = scene.bounds
        assert high - low == pytest.approx([1, 1, 1])
