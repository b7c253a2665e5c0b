"""Daylight, and cases of CIE 171:2006 by their closed forms."""

import numpy as np
import pytest

import patchlight
from patchlight import daylight, howell

UP = (0.0, 1.0, 0.0)


def open_box(size: float = 4.0, height: float = 4.0, hole: float | None = None, reflectance: float = 0.5) -> patchlight.Scene:
    """A room whose walls shine inwards, with a square hole in the middle of its ceiling."""
    parts = [
        howell.rectangle((0, 0, 0), (0, 0, size), (size, 0, 0), (4, 4)),
        howell.rectangle((0, 0, 0), (size, 0, 0), (0, height, 0), (4, 4)),
        howell.rectangle((0, 0, size), (0, height, 0), (size, 0, 0), (4, 4)),
        howell.rectangle((0, 0, 0), (0, height, 0), (0, 0, size), (4, 4)),
        howell.rectangle((size, 0, 0), (0, 0, size), (0, height, 0), (4, 4)),
    ]
    if hole is None:
        parts.append(howell.rectangle((0, height, 0), (size, 0, 0), (0, 0, size), (4, 4)))
    else:
        low, high = (size - hole) / 2, (size + hole) / 2
        for x, z, width, depth in ((0, 0, low, size), (high, 0, low, size), (low, 0, hole, low), (low, high, hole, low)):
            parts.append(howell.rectangle((x, height, z), (width, 0, 0), (0, 0, depth)))
    (vertices, faces), _ = howell.joined(*parts)
    return patchlight.Scene(vertices, faces, reflectance)


def test_parts_of_the_sky_fill_the_hemisphere() -> None:
    for division in (1, 2, 4):
        parts = daylight.sky_parts(division)
        assert len(parts) == 144 * division**2 + 2
        assert parts.solid_angles[1:].sum() == pytest.approx(2 * np.pi, rel=1e-6)
        assert (daylight.part_of(parts.directions, division) == np.arange(len(parts))).all()


@pytest.mark.parametrize("kind", [1, 3, 5, 9, 12, 15])
def test_skies_give_the_light_that_is_asked_for(kind: int) -> None:
    parts = daylight.sky_parts(4)
    sky = daylight.cie_sky(kind, (0.3, 0.8, -0.5), 100.0, parts=parts)
    flat = (sky * parts.solid_angles * np.maximum(parts.directions[:, 1], 0)).sum()
    assert flat == pytest.approx(100)


def test_the_overcast_sky_is_three_times_as_bright_at_the_zenith() -> None:
    # CIE type 1: L(0°) / L(90°) of (1 + 4 e^(-0.7/cos Z)).
    sky = daylight.cie_sky(1, (0, 1, 0), 100.0, parts=daylight.sky_parts(8))
    assert sky[-1] / sky[1] == pytest.approx(1 + 4 * np.exp(-0.7), rel=0.02)


def test_perez_has_the_irradiance_and_a_bright_sun() -> None:
    parts = daylight.sky_parts(4)
    sun = np.array([0.5, 0.7, -0.5]) / np.linalg.norm([0.5, 0.7, -0.5])
    sky = daylight.perez_sky(sun, 700, 120, parts=parts)
    assert (sky * parts.solid_angles * np.maximum(parts.directions[:, 1], 0)).sum() == pytest.approx(120)
    assert parts.directions[sky.argmax()] @ sun > 0.97
    assert daylight.perez_sky(sun, 0, 0).max() == 0


def test_suns_stand_where_almanacs_say() -> None:
    # Noon of 21 March in Greenwich, 51.48° N: 38.5° high in the south; 21 June, 61.9°.
    for day, height in ((80, 38.5), (172, 61.96)):
        sun = daylight.sun_position(day, 12.0, 51.48, 0.0, 0.0)
        assert np.degrees(np.arcsin(sun[1])) == pytest.approx(height, abs=0.6)
        assert sun[2] > 0
    morning = daylight.sun_position(80, 8.0, 51.48, 0.0, 0.0)
    assert morning[0] > 0


def test_weather_files_are_read_and_refused(tmp_path: object) -> None:
    from pathlib import Path

    path = Path(str(tmp_path)) / "here.epw"
    head = "LOCATION,Here,-,XX,-,1,52.0,13.0,1.0,34\n" + "X\n" * 7
    row = "2001,6,21,12,60," + ",".join(["0"] * 9) + ",800,100,0,0\n"
    path.write_text(head + row)
    weather = daylight.read_epw(path)
    assert (weather.day[0], weather.hour[0], weather.direct_normal[0]) == (172, 11.5, 800)
    path.write_text(head + "2001,6\n")
    with pytest.raises(patchlight.FileError, match="line 9"):
        daylight.read_epw(path)


def test_cie_171_point_and_area_sources() -> None:
    # CIE 171:2006, 5.2 and 5.3: E = I cos θ / d²; a diffuse square of luminance L by its configuration factor.
    scene = open_box()
    lamp = patchlight.Light.point((2, 3, 2), candela=1000)
    places = np.array([[0.5, 0, 0.5], [2, 0, 2], [3.5, 0, 1]])
    away = np.linalg.norm(places - [2, 3, 2], axis=1)
    found = patchlight.illuminance(scene.direct(places, np.tile(UP, (3, 1)), lights=[lamp]))
    assert found == pytest.approx(1000 * 3 / away**3, rel=1e-3)
    panel = patchlight.Light.rectangle((1.5, 3, 1.5), ((1, 0, 0), (0, 0, 1)), nits=1000)
    found = patchlight.illuminance(scene.direct([[2, 0, 2]], [UP], lights=[panel], area_rays=4096))[0]
    x = 0.5 / 3
    corner = 2 / (2 * np.pi) * x / np.sqrt(1 + x * x) * np.arctan(x / np.sqrt(1 + x * x))
    assert found == pytest.approx(1000 * np.pi * 4 * corner, rel=5e-3)


@pytest.mark.parametrize("reflectance", [0.2, 0.5, 0.8])
def test_cie_171_interreflection_in_a_closed_cube(reflectance: float) -> None:
    # CIE 171:2006, 5.8: a lamp of 10,000 lm in the middle of a cube of 4 m: E = Φ / S · ρ / (1 - ρ) on average.
    scene = open_box(reflectance=reflectance)
    lamp = patchlight.Light.point((2, 2, 2), lumens=10_000)
    scene.lights = [lamp]
    own = scene.bake(patches=600, receivers=False)
    light = own.update()
    areas = own.elements.areas
    mean = areas @ patchlight.illuminance(light.elements) / areas.sum()
    assert mean == pytest.approx(10_000 / 96 * reflectance / (1 - reflectance), rel=0.02)


def test_cie_171_sky_component_below_a_hole_in_the_roof() -> None:
    # CIE 171:2006, 5.9: the light of a sky through an unglazed opening, here by cubature over the opening.
    scene = open_box(height=3.0, hole=1.0, reflectance=0.0)
    own = scene.bake(patches=200, receivers=False)
    places = [[2, 0, 2], [0.6, 0, 2], [3.2, 0, 3.2]]
    found = daylight.coefficients(own, places, division=4, rays=1 << 16)
    parts = found.parts
    for kind in (1, 5, 12):
        sky = daylight.cie_sky(kind, (0.4, 0.8, 0.2), 100.0, parts=parts)
        s = (np.arange(400) + 0.5) / 400 + 1.5
        x, z = np.meshgrid(s, s)
        for place, value in zip(places, found.irradiance(sky)[:, 0, 0], strict=True):
            way = np.stack([x - place[0], np.full_like(x, 3.0), z - place[2]], axis=-1).reshape(-1, 3)
            square = (way**2).sum(axis=1)
            towards = way / np.sqrt(square)[:, np.newaxis]
            exact = (sky[daylight.part_of(towards, 4)] * towards[:, 1] ** 2 / square).mean()
            assert value == pytest.approx(exact, rel=0.03)


def test_coefficients_are_the_light_under_a_sky() -> None:
    scene = open_box(height=3.0, hole=1.5)
    own = scene.bake(patches=400)
    places = np.array([[2, 0.5, 2], [0.7, 0.5, 1.0], [3.0, 1.0, 3.0]])
    found = daylight.coefficients(own, places)
    radiances = daylight.cie_sky(1, UP, 100.0)
    sky = daylight.as_map(radiances)
    field = own.light_field(point_rays=4096)
    points = field.add_points(places)
    indirect = field.update([], sky=sky).points(points)
    direct = scene.direct(places, np.tile(UP, (3, 1)), lights=[], sky=sky, sky_rays=8192)
    assert found.irradiance(radiances)[:, :, 0] == pytest.approx(indirect + direct, rel=0.05)
    sun = np.array([0.2, 0.9, 0.1]) / np.linalg.norm([0.2, 0.9, 0.1])
    light = patchlight.Light.sun(-sun, 1.0)
    indirect = field.update([light], sky=0.0).points(points)
    direct = scene.direct(places, np.tile(UP, (3, 1)), lights=[light])
    assert found.suns([sun])[:, :, 0] == pytest.approx(indirect + direct, rel=0.06, abs=0.002)


def test_a_year_and_its_measures() -> None:
    scene = open_box(height=3.0, hole=1.5)
    own = scene.bake(patches=150, receivers=False)
    weather = daylight.clear_year(52.0, 13.0, 1.0)
    some = slice(24 * 170, 24 * 172)
    weather = daylight.Weather(
        52.0, 13.0, 1.0, *(getattr(weather, name)[some] for name in ("day", "hour", "direct_normal", "diffuse_horizontal"))
    )
    lux = daylight.coefficients(own, [[2, 0.8, 2], [0.5, 0.8, 0.5]], rays=512).annual(weather)
    assert lux.shape == (2, 48)
    assert lux[0, 12] > lux[0, 6] > lux[0, 1] == 0
    hours = daylight.office_hours(weather)
    assert hours.sum() == 20
    assert 0 <= daylight.spatial_autonomy(lux, hours) <= 1
    shares = daylight.useful_illuminance(lux, hours)
    assert sum(shares.values()) == pytest.approx([1, 1])
