"""View factors beside closed forms, and their properties."""

import numpy as np
import pytest

import patchlight
from patchlight import howell

CASES = list(howell.catalogue(48))
# Facets of a side that is a whole rectangle are few: what a row has of rays is all there is.
RAYS = 1 << 19


def rays_of(case: howell.Case) -> int:
    return int(np.clip(RAYS // len(case.mesh[1]), 512, 1 << 16))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_contours_are_within_a_thousandth_of_the_closed_form(case: howell.Case) -> None:
    factors = patchlight.view_factors(case.mesh, "contour", obstruction=case.obstruction, shadow_rays=64)
    assert factors.between(case.receiver, case.source) == pytest.approx(case.expected, rel=1e-3)
    assert factors.reciprocity_error < 1e-12


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_rays_are_within_a_hundredth_of_the_closed_form(case: howell.Case) -> None:
    factors = patchlight.view_factors(case.mesh, "rays", rays=rays_of(case))
    assert factors.between(case.receiver, case.source) == pytest.approx(case.expected, rel=1e-2)
    assert factors.reciprocity_error < 1e-5


def test_a_wrong_mesh_does_not_pass() -> None:
    case = next(case for case in CASES if case.name.startswith("C-41"))
    vertices, faces = case.mesh
    factors = patchlight.view_factors((vertices * [1, 1.02, 1], faces), "contour", obstruction=False)
    assert factors.between(case.receiver, case.source) != pytest.approx(case.expected, rel=1e-3)


def test_the_catalogue_has_fifteen_configurations() -> None:
    assert len({case.name.split()[0] for case in CASES}) >= 15


def test_errors_are_those_that_there_are() -> None:
    box, _ = howell.joined(
        howell.rectangle((0, 0, 0), (0, 0, 1), (1, 0, 0), (6, 6)), howell.rectangle((0, 1, 0), (1, 0, 0), (0, 0, 1), (6, 6))
    )
    exact = patchlight.view_factors(box, "contour", obstruction=False)
    found = patchlight.view_factors(box, "rays", rays=1024)
    apart = np.sqrt(np.asarray((abs(found - exact) ** 2).sum(axis=1)))
    # The stated error is that of random rays; those of a sequence do somewhat better.
    ratio = np.median(apart / found.error)
    assert 0.3 < ratio < 1.5
    closed = found.closure_error
    assert closed < 0.1
    assert found.sky == pytest.approx(exact.sky, abs=0.05)


def test_what_stands_between_hides() -> None:
    plates, groups = howell.joined(
        howell.rectangle((0, 0, 0), (0, 0, 1), (1, 0, 0), (4, 4)),
        howell.rectangle((0, 1, 0), (1, 0, 0), (0, 0, 1), (4, 4)),
        howell.rectangle((-3, 0.5, -3), (7, 0, 0), (0, 0, 7)),
        howell.rectangle((-3, 0.6, -3), (0, 0, 7), (7, 0, 0)),
    )
    for method in ("contour", "rays"):
        hidden = patchlight.view_factors(plates, method)
        assert hidden.between(groups[0], groups[1]) == 0.0
        assert hidden.between(groups[0], groups[2]) == pytest.approx(1.0, abs=0.06)
    seen = patchlight.view_factors(plates, "contour", obstruction=False)
    assert seen.between(groups[0], groups[1]) == pytest.approx(howell.parallel_rectangles(1, 1, 1), rel=1e-3)


def test_radiosity_of_a_closed_grey_sphere() -> None:
    vertices, faces = howell.sphere(1, False, 24)
    factors = patchlight.view_factors((vertices, faces), "contour", obstruction=False)
    # The chords of a polyhedron see a little less than 1.
    factors = factors / factors.sum(axis=1)[:, np.newaxis]
    exitance, irradiance = patchlight.radiosity(factors, np.full(len(faces), 2.0), np.full(len(faces), 0.5))
    assert exitance == pytest.approx(np.full(len(faces), 4.0), rel=1e-6)
    assert irradiance == pytest.approx(np.full(len(faces), 4.0), rel=1e-6)


def test_bad_meshes_are_refused_by_name() -> None:
    flat = ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    with pytest.raises(patchlight.InputError, match="face 0 has no area"):
        patchlight.view_factors(flat)
    with pytest.raises(patchlight.InputError, match="vertex 7 of 3"):
        patchlight.view_factors(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 7]]))
    with pytest.raises(patchlight.InputError, match="method is"):
        patchlight.view_factors(flat, "guess")
    with pytest.raises(patchlight.InputError, match="without obstruction"):
        patchlight.view_factors(CASES[0].mesh, "rays", obstruction=False)


def test_meshes_of_other_packages() -> None:
    trimesh = pytest.importorskip("trimesh")
    pyvista = pytest.importorskip("pyvista")
    box = trimesh.creation.box()
    box.invert()
    inside = patchlight.view_factors(box, "contour")
    assert inside.sum(axis=1) == pytest.approx(np.ones(12), abs=2e-3)
    other = patchlight.view_factors(pyvista.wrap(box), "contour")
    assert other.toarray() == pytest.approx(inside.toarray(), abs=1e-6)
