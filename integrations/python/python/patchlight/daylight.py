"""Daylight: skies, suns, and a year of hours as one matrix product.

Directions have ``+y`` upwards, ``-z`` north and ``+x`` east. A sky is cut into Tregenza's 145 parts, or Reinhart's
divisions of them; part 0 is what lies below the horizon.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from . import _core
from ._arrays import Float64, Progress, illuminance, showing, vectors
from ._scene import Sky

if TYPE_CHECKING:
    from ._bake import Bake

#: CIE S 011:2003, table 1: a and b of the gradation, c, d and e of the indicatrix.
_CIE_TYPES = (
    (4.0, -0.70, 0, -1.0, 0.0), (4.0, -0.70, 2, -1.5, 0.15), (1.1, -0.8, 0, -1.0, 0.0), (1.1, -0.8, 2, -1.5, 0.15),
    (0.0, -1.0, 0, -1.0, 0.0), (0.0, -1.0, 2, -1.5, 0.15), (0.0, -1.0, 5, -2.5, 0.30), (0.0, -1.0, 10, -3.0, 0.45),
    (-1.0, -0.55, 2, -1.5, 0.15), (-1.0, -0.55, 5, -2.5, 0.30), (-1.0, -0.55, 10, -3.0, 0.45),
    (-1.0, -0.32, 10, -3.0, 0.45), (-1.0, -0.32, 16, -3.0, 0.30), (-1.0, -0.15, 16, -3.0, 0.30),
    (-1.0, -0.15, 24, -2.8, 0.15),
)  # fmt: skip
#: Perez, Seals and Michalsky 1993, table 1: four coefficients of each of a to e, by bins of the sky's clearness.
_PEREZ = np.array([
    [1.3525, -0.2576, -0.2690, -1.4366, -0.7670, 0.0007, 1.2734, -0.1233, 2.8000, 0.6004,
     1.2375, 1.0000, 1.8734, 0.6297, 0.9738, 0.2809, 0.0356, -0.1246, -0.5718, 0.9938],
    [-1.2219, -0.7730, 1.4148, 1.1016, -0.2054, 0.0367, -3.9128, 0.9156, 6.9750, 0.1774,
     6.4477, -0.1239, -1.5798, -0.5081, -1.7812, 0.1080, 0.2624, 0.0672, -0.2190, -0.4285],
    [-1.1000, -0.2515, 0.8952, 0.0156, 0.2782, -0.1812, -4.5000, 1.1766, 24.7219, -13.0812,
     -37.7000, 34.8438, -5.0000, 1.5218, 3.9229, -2.6204, -0.0156, 0.1597, 0.4199, -0.5562],
    [-0.5484, -0.6654, -0.2672, 0.7117, 0.7234, -0.6219, -5.6812, 2.6297, 33.3389, -18.3000,
     -62.2500, 52.0781, -3.5000, 0.0016, 1.1477, 0.1062, 0.4659, -0.3296, -0.0876, -0.0329],
    [-0.6000, -0.3566, -2.5000, 2.3250, 0.2937, 0.0496, -5.6812, 1.8415, 21.0000, -4.7656,
     -21.5906, 7.2492, -3.5000, -0.1554, 1.4062, 0.3988, 0.0032, 0.0766, -0.0656, -0.1294],
    [-1.0156, -0.3670, 1.0078, 1.4051, 0.2875, -0.5328, -3.8500, 3.3750, 14.0000, -0.9999,
     -7.1406, 7.5469, -3.4000, -0.1078, -1.0750, 1.5702, -0.0672, 0.4016, 0.3017, -0.4844],
    [-1.0000, 0.0211, 0.5025, -0.5119, -0.3000, 0.1922, 0.7023, -1.6317, 19.0000, -5.0000,
     1.2438, -1.9094, -4.0000, 0.0250, 0.3844, 0.2656, 1.0468, -0.3788, -2.4517, 1.4656],
    [-1.0500, 0.0289, 0.4260, 0.3590, -0.3250, 0.1156, 0.7781, 0.0025, 31.0625, -14.5000,
     -46.1148, 55.3750, -7.2312, 0.4050, 13.3500, 0.6234, 1.5000, -0.6426, 1.8564, 0.5636],
]).reshape(8, 5, 4)  # fmt: skip
_CLEARNESS = np.array([1.065, 1.23, 1.5, 1.95, 2.8, 4.5, 6.2])
#: Solar constant, W/m².
SOLAR_CONSTANT = 1367.0


@dataclass(frozen=True)
class SkyParts:
    """Parts of a sky.

    Attributes
    ----------
    division : int
        1 for Tregenza's 145 parts, ``m`` for Reinhart's ``144 m² + 1``.
    directions : ndarray, shape (parts, 3)
        Their middles; that of part 0 points downwards.
    solid_angles : ndarray, shape (parts,)
        sr.
    """

    division: int
    directions: Float64
    solid_angles: Float64

    def __len__(self) -> int:
        return len(self.solid_angles)


def sky_parts(division: int = 1) -> SkyParts:
    """The parts of a sky: Tregenza's, each row and azimuth divided ``division`` times as Reinhart does."""
    directions, angles = _core.sky_directions(division)
    return SkyParts(division, directions.astype(float), angles.astype(float))


def _relative(directions: Float64, sun: Float64, gradation: Any, indicatrix: Any) -> Float64:
    zenith = np.clip(directions[..., 1], 0.01, 1.0)
    angle = np.arccos(np.clip(directions @ sun, -1.0, 1.0))
    a, b = gradation
    c, d, e = indicatrix
    falloff = 1 + a * np.exp(b / zenith)
    glow: Float64 = 1 + c * (np.exp(d * angle) - np.exp(d * np.pi / 2)) + e * np.cos(angle) ** 2
    above = directions[..., 1] >= 0
    shape: Float64 = np.where(above, np.maximum(falloff * glow, 0.0), 0.0)
    return shape


def _scaled(parts: SkyParts, shape: Float64, horizontal: float, ground: float) -> Float64:
    """Radiances of parts whose light on a horizontal surface is so much; part 0 is a ground that reflects it."""
    projected = float((shape * parts.solid_angles * np.maximum(parts.directions[:, 1], 0)).sum())
    radiances = shape * (horizontal / projected) if projected > 0 else np.zeros_like(shape)
    radiances[0] = ground * horizontal / np.pi
    return radiances


def cie_sky(
    kind: int,
    sun: npt.ArrayLike,
    horizontal: float,
    *,
    parts: SkyParts | None = None,
    ground: float = 0.0,
) -> Float64:
    """A sky of the CIE general standard (CIE S 011:2003): radiance of each part, W/m²/sr.

    Parameters
    ----------
    kind : int
        1 to 15; 1 is overcast, 5 even, 12 clear.
    sun : array_like, shape (3,)
        Towards the sun.
    horizontal : float
        Irradiance of a horizontal surface from the sky alone, W/m² (or illuminance, lx: then results are cd/m²).
    ground : float
        Reflectance of what lies below the horizon.
    """
    if not 1 <= kind <= 15:
        raise _core.InputError(f"sky type {kind}; the standard has 1 to 15")
    own = sky_parts() if parts is None else parts
    a, b, c, d, e = _CIE_TYPES[kind - 1]
    towards = np.asarray(sun, dtype=float) / np.linalg.norm(sun)
    return _scaled(own, _relative(own.directions, towards, (a, b), (c, d, e)), horizontal, ground)


def perez_sky(
    sun: npt.ArrayLike,
    direct_normal: float,
    diffuse_horizontal: float,
    *,
    day: int = 80,
    parts: SkyParts | None = None,
    ground: float = 0.0,
) -> Float64:
    """The all-weather sky of Perez, Seals and Michalsky 1993: radiance of each part, W/m²/sr, without the sun.

    Parameters
    ----------
    sun : array_like, shape (3,)
        Towards the sun.
    direct_normal, diffuse_horizontal : float
        Irradiances, W/m².
    day : int
        Of the year: the distance of the sun.
    ground : float
        Reflectance of what lies below the horizon, lit by sky and sun.
    """
    own = sky_parts() if parts is None else parts
    towards = np.asarray(sun, dtype=float) / np.linalg.norm(sun)
    if diffuse_horizontal <= 0:
        return np.zeros(len(own))
    height = float(np.clip(towards[1], 0.01, 1.0))
    zenith = float(np.arccos(height))
    cube = 1.041 * zenith**3
    clearness = ((diffuse_horizontal + direct_normal) / diffuse_horizontal + cube) / (1 + cube)
    altitude = np.degrees(np.arcsin(height))
    mass = 1 / (height + 0.50572 * (altitude + 6.07995) ** -1.6364)
    brightness = diffuse_horizontal * mass / (SOLAR_CONSTANT * (1 + 0.033 * np.cos(2 * np.pi * day / 365)))
    bin_number = int(np.searchsorted(_CLEARNESS, clearness, side="right"))
    if 1.065 < clearness < 2.8:
        brightness = max(brightness, 0.2)
    x = _PEREZ[bin_number]
    a, b, c, d, e = (r[0] + r[1] * zenith + brightness * (r[2] + r[3] * zenith) for r in x)
    if bin_number == 0:
        c = np.exp((brightness * (x[2, 0] + x[2, 1] * zenith)) ** x[2, 2]) - x[2, 3]
        d = -np.exp(brightness * (x[3, 0] + x[3, 1] * zenith)) + x[3, 2] + brightness * x[3, 3]
    cosines = np.clip(own.directions[..., 1], 0.01, 1.0)
    angle = np.arccos(np.clip(own.directions @ towards, -1.0, 1.0))
    shape = (1 + a * np.exp(b / cosines)) * (1 + c * np.exp(d * angle) + e * np.cos(angle) ** 2)
    shape = np.where(own.directions[:, 1] >= 0, np.maximum(shape, 0), 0)
    radiances = _scaled(own, shape, diffuse_horizontal, ground)
    radiances[0] += ground * direct_normal * max(float(towards[1]), 0.0) / np.pi
    return radiances


def as_map(radiances: npt.ArrayLike, division: int = 1, height: int = 128) -> Sky:
    """A sky of these parts as a map, for pictures and light fields."""
    values = np.asarray(radiances, dtype=float)
    own = sky_parts(division)
    if len(values) != len(own):
        raise _core.InputError(f"{len(values)} radiances for a sky of {len(own)} parts")
    rows = (np.arange(height) + 0.5) / height * np.pi
    columns = ((np.arange(2 * height) + 0.5) / (2 * height) - 0.5) * 2 * np.pi
    altitude, azimuth = np.meshgrid(np.pi / 2 - rows, columns, indexing="ij")
    directions = np.stack(
        [np.cos(altitude) * np.sin(azimuth), np.sin(altitude), -np.cos(altitude) * np.cos(azimuth)], axis=-1
    )
    return Sky.map(values[part_of(directions.reshape(-1, 3), division)].reshape(height, 2 * height))


def part_of(directions: npt.ArrayLike, division: int = 1) -> npt.NDArray[np.intp]:
    """The part of the sky in which each direction lies: 0 below the horizon."""
    unit = np.asarray(directions, dtype=float)
    rows_of = np.repeat([30, 30, 24, 24, 18, 12, 6], division) * division
    counts = np.append(rows_of, 1)
    first = 1 + np.concatenate([[0], np.cumsum(counts)])
    altitude = np.arctan2(unit[:, 1], np.hypot(unit[:, 0], unit[:, 2]))
    row = np.clip((altitude / (np.pi / 2 / (7 * division + 0.5))).astype(int), 0, 7 * division)
    turn = np.arctan2(unit[:, 0], -unit[:, 2]) / (2 * np.pi)
    part = np.floor(turn * counts[row] + 0.5).astype(int) % counts[row]
    return np.where(unit[:, 1] < 0, 0, first[row] + part)


def sun_position(
    day: npt.ArrayLike, hour: npt.ArrayLike, latitude: float, longitude: float, time_zone: float
) -> Float64:
    """Direction towards the sun, ``(…, 3)``, by Spencer 1971; about 0.3° right.

    Parameters
    ----------
    day : array_like of int
        Of the year, from 1.
    hour : array_like of float
        Local standard time.
    latitude, longitude : float
        Degrees, north and east positive.
    time_zone : float
        Hours ahead of UTC.
    """
    turn = 2 * np.pi * (np.asarray(day, dtype=float) - 1) / 365
    declination = (
        0.006918 - 0.399912 * np.cos(turn) + 0.070257 * np.sin(turn) - 0.006758 * np.cos(2 * turn)
        + 0.000907 * np.sin(2 * turn) - 0.002697 * np.cos(3 * turn) + 0.00148 * np.sin(3 * turn)
    )  # fmt: skip
    equation = 229.18 * (
        0.000075 + 0.001868 * np.cos(turn) - 0.032077 * np.sin(turn) - 0.014615 * np.cos(2 * turn)
        - 0.040849 * np.sin(2 * turn)
    )  # fmt: skip
    solar = np.asarray(hour, dtype=float) + (equation + 4 * (longitude - 15 * time_zone)) / 60
    angle = np.radians(15 * (solar - 12))
    phi = np.radians(latitude)
    up = np.sin(phi) * np.sin(declination) + np.cos(phi) * np.cos(declination) * np.cos(angle)
    west = np.cos(declination) * np.sin(angle)
    south = -np.cos(phi) * np.sin(declination) + np.sin(phi) * np.cos(declination) * np.cos(angle)
    return np.stack(np.broadcast_arrays(-west, up, south), axis=-1)


@dataclass(frozen=True)
class Weather:
    """Hours of a year: ``day`` of the year, local ``hour``, and irradiances, W/m²."""

    latitude: float
    longitude: float
    time_zone: float
    day: Float64
    hour: Float64
    direct_normal: Float64
    diffuse_horizontal: Float64

    def suns(self) -> Float64:
        """Directions towards the sun, ``(hours, 3)``."""
        return sun_position(self.day, self.hour, self.latitude, self.longitude, self.time_zone)


_MONTH_STARTS = np.cumsum([0, 31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30])


def read_epw(path: str | os.PathLike[str]) -> Weather:
    """Weather of an EnergyPlus file (.epw)."""
    with open(path, encoding="utf-8", errors="replace") as file:
        lines = file.read().splitlines()
    head = lines[0].split(",") if lines else []
    if not head or head[0] != "LOCATION" or len(head) < 9:
        raise _core.FileError(f"{os.fspath(path)}, line 1: no LOCATION; give an EnergyPlus weather file")
    rows = []
    for number, line in enumerate(lines[8:], start=9):
        cells = line.split(",")
        if len(cells) < 16:
            raise _core.FileError(f"{os.fspath(path)}, line {number}: {len(cells)} fields, where 16 are needed")
        rows.append([float(cells[k]) for k in (1, 2, 3, 14, 15)])
    table = np.array(rows)
    day = _MONTH_STARTS[table[:, 0].astype(int) - 1] + table[:, 1]
    # An hour of the file ends at its number.
    return Weather(float(head[6]), float(head[7]), float(head[8]), day, table[:, 2] - 0.5, table[:, 3], table[:, 4])


def clear_year(latitude: float, longitude: float, time_zone: float, *, turbidity: float = 3.0) -> Weather:
    """8,760 clear hours without a file: direct light through an atmosphere of this Linke turbidity (Kasten 1996), and a
    diffuse fifth of what it loses. For examples and tests; real weather has clouds."""
    hours = np.arange(8760)
    day = 1 + hours // 24
    hour = hours % 24 + 0.5
    up = np.clip(sun_position(day, hour, latitude, longitude, time_zone)[:, 1], 1e-3, 1)
    mass = 1 / (up + 0.50572 * (np.degrees(np.arcsin(up)) + 6.07995) ** -1.6364)
    depth = 1 / (6.6296 + 1.7513 * mass - 0.1202 * mass**2 + 0.0065 * mass**3 - 0.00013 * mass**4)
    depth = np.where(mass > 20, 1 / (10.4 + 0.718 * mass), depth)
    direct = np.where(up > 1e-3, SOLAR_CONSTANT * np.exp(-0.8662 * turbidity * mass * depth), 0.0)
    diffuse = np.where(up > 1e-3, 0.2 * (SOLAR_CONSTANT - direct) * up + 1e-9, 0.0)
    hour_of_day: Float64 = hour.astype(float)
    return Weather(latitude, longitude, time_zone, day.astype(float), hour_of_day, direct, diffuse)


class DaylightCoefficients:
    """Irradiance of points from each part of a sky, and from suns: everything between is one matrix.

    Attributes
    ----------
    parts : SkyParts
    sky : ndarray, shape (points, 3, parts)
        W/m² for a part of 1 W/m²/sr.
    """

    def __init__(self, bake: Bake, points: Any, normals: Any, division: int, rays: int, seed: int, progress: Progress):
        self._scene = bake.scene
        self.points = vectors(points, "points")
        self.normals = np.ascontiguousarray(np.broadcast_to(vectors(normals, "normals"), self.points.shape))
        self.parts = sky_parts(division)
        count = len(self.points)
        transport = bake.to_points(self.points, self.normals, rays=rays, seed=seed, progress=progress)
        transport.patches = bake.all_bounces(tolerance=1e-4)
        # Bands do not mix: one adjoint product a point has all three.
        units = np.repeat(np.eye(count), 3, axis=0)
        adjoint = transport.rmatmat(units).reshape(-1, 3, count)
        samples, facing, first, weights, albedo = bake._core.samples()
        self._samples = (samples, facing, first)
        own = np.repeat(np.arange(len(first) - 1), np.diff(first.astype(np.int64)).astype(np.int64))
        sums = np.zeros((len(first) - 1, 3))
        np.add.at(sums, own, weights[:, np.newaxis] * albedo)
        #: Irradiance of points for each W/m² of direct light on an element, ``(points, 3, elements)``.
        self.of_elements = np.ascontiguousarray((adjoint * sums[:, :, np.newaxis]).transpose(2, 1, 0))
        with showing(progress) as callback:
            rows = bake._core_sky_rows(samples, facing, first, 256, division, seed, callback)
            direct = bake._core_sky_rows(
                self.points, self.normals, np.arange(count + 1, dtype=np.uint32), max(rays, 4096), division, seed, callback
            )
        flat = self.of_elements.reshape(3 * count, -1)
        indirect = np.asarray((rows.T @ flat.T).T).reshape(count, 3, -1)
        self.sky = indirect + np.asarray(direct.todense())[:, np.newaxis, :]

    def suns(self, directions: npt.ArrayLike, *, progress: Progress = None) -> Float64:
        """Irradiance of points from suns of 1 W/m² in these directions (towards them), ``(points, 3, suns)``."""
        towards = vectors(directions, "directions")
        samples, facing, first = self._samples
        count = len(self.points)
        offsets = np.arange(count + 1, dtype=np.uint32)
        found = np.empty((count, 3, len(towards)))
        flat = self.of_elements.reshape(3 * count, -1)
        core = self._scene._core
        with showing(progress) as callback:
            for begin in range(0, len(towards), 256):
                some = np.ascontiguousarray(towards[begin : begin + 256])
                seen = core.sun_rows(samples, facing, first, some, callback)
                direct = core.sun_rows(self.points, self.normals, offsets, some, callback)
                block = (flat @ seen).reshape(count, 3, -1) + direct[:, np.newaxis, :]
                found[:, :, begin : begin + len(some)] = block
        return found

    def irradiance(self, radiances: npt.ArrayLike) -> Float64:
        """Irradiance of points, W/m², ``(points, 3, skies)``, under skies ``(parts, skies)``: one product."""
        skies = np.asarray(radiances, dtype=float)
        return np.asarray(self.sky @ skies.reshape(len(self.parts), -1))

    def annual(self, weather: Weather, *, ground: float = 0.2, progress: Progress = None) -> Float64:
        """Illuminance of points, lx, ``(points, hours)``, in each hour of a year: the sky of Perez and the sun."""
        towards = weather.suns()
        hours = len(towards)
        skies = np.zeros((len(self.parts), hours))
        lit = np.flatnonzero((towards[:, 1] > 0) & (weather.diffuse_horizontal + weather.direct_normal > 0))
        for hour in lit:
            skies[:, hour] = perez_sky(
                towards[hour],
                float(weather.direct_normal[hour]),
                float(weather.diffuse_horizontal[hour]),
                day=int(weather.day[hour]),
                parts=self.parts,
                ground=ground,
            )
        light = illuminance(np.moveaxis(self.irradiance(skies), 1, 2))
        light[:, lit] += illuminance(np.moveaxis(self.suns(towards[lit], progress=progress), 1, 2)) * weather.direct_normal[lit]
        return light


def coefficients(
    bake: Bake,
    points: npt.ArrayLike,
    normals: npt.ArrayLike = (0.0, 1.0, 0.0),
    *,
    division: int = 1,
    rays: int = 4096,
    seed: int = 0,
    progress: Progress = None,
) -> DaylightCoefficients:
    """Daylight coefficients of points: all bounces from each part of the sky, from one bake."""
    return DaylightCoefficients(bake, points, normals, division, rays, seed, progress)


def autonomy(lux: npt.ArrayLike, occupied: npt.ArrayLike, *, threshold: float = 300.0) -> Float64:
    """Daylight autonomy: the share of the occupied hours in which each point has so many lx."""
    share: Float64 = (np.asarray(lux)[:, np.asarray(occupied, dtype=bool)] >= threshold).mean(axis=1)
    return share


def spatial_autonomy(lux: npt.ArrayLike, occupied: npt.ArrayLike, *, threshold: float = 300.0, share: float = 0.5) -> float:
    """sDA (IES LM-83-12): the share of the points whose autonomy is at least ``share``."""
    return float((autonomy(lux, occupied, threshold=threshold) >= share).mean())


def useful_illuminance(
    lux: npt.ArrayLike, occupied: npt.ArrayLike, *, limits: Iterable[float] = (100.0, 300.0, 3000.0)
) -> dict[str, Float64]:
    """UDI (Nabil and Mardaljevic 2006): shares of the occupied hours below, supplementary, autonomous and exceeding."""
    low, middle, high = limits
    values = np.asarray(lux)[:, np.asarray(occupied, dtype=bool)]
    return {
        "below": (values < low).mean(axis=1),
        "supplementary": ((values >= low) & (values < middle)).mean(axis=1),
        "autonomous": ((values >= middle) & (values <= high)).mean(axis=1),
        "exceeding": (values > high).mean(axis=1),
    }


def office_hours(weather: Weather, first: float = 8.0, last: float = 18.0) -> npt.NDArray[np.bool_]:
    """Hours of every day between two times."""
    return (weather.hour > first) & (weather.hour < last)
