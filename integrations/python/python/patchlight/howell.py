"""Closed forms of view factors, and meshes to compare with them.

Numbers are those of J. R. Howell's *Catalog of Radiation Heat Transfer Configuration Factors*. Lengths are in any unit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ._arrays import Float64

Mesh = tuple[Float64, npt.NDArray[np.int64]]


def parallel_rectangles(a: float, b: float, c: float) -> float:
    """C-11: from a rectangle ``a × b`` to an identical one opposite, at distance ``c``."""
    x, y = a / c, b / c
    p, q = 1 + x * x, 1 + y * y
    return float(
        2 / (np.pi * x * y)
        * (
            np.log(np.sqrt(p * q / (1 + x * x + y * y)))
            + x * np.sqrt(q) * np.arctan(x / np.sqrt(q))
            + y * np.sqrt(p) * np.arctan(y / np.sqrt(p))
            - x * np.arctan(x)
            - y * np.arctan(y)
        )
    )  # fmt: skip


def perpendicular_rectangles(width: float, height: float, length: float) -> float:
    """C-14: from a rectangle ``width × length`` to one ``height × length`` that stands upright on its edge ``length``."""
    h, w = height / length, width / length
    a, b = h * h + w * w, 1 + w * w
    c, d = 1 + h * h, 1 + h * h + w * w
    logs = b * c / d * (w * w * d / (b * a)) ** (w * w) * (h * h * d / (c * a)) ** (h * h)
    return float(
        (w * np.arctan(1 / w) + h * np.arctan(1 / h) - np.sqrt(a) * np.arctan(1 / np.sqrt(a)) + 0.25 * np.log(logs))
        / (np.pi * w)
    )


def offset_parallel_rectangles(
    x: tuple[float, float], y: tuple[float, float], xi: tuple[float, float], eta: tuple[float, float], z: float
) -> float:
    """C-13: from the rectangle ``x × y`` to the one ``xi × eta`` in a parallel plane at distance ``z`` (Ehlert and Smith
    1993)."""
    total = 0.0
    for i, a in enumerate(x):
        for j, b in enumerate(y):
            for k, e in enumerate(eta):
                for m, f in enumerate(xi):
                    u, v = a - f, b - e
                    p, q = np.hypot(u, z), np.hypot(v, z)
                    term = v * p * np.arctan(v / p) + u * q * np.arctan(u / q) - 0.5 * z * z * np.log(u * u + v * v + z * z)
                    total += (-1) ** (i + j + k + m) * term
    return float(total / (2 * np.pi * (x[1] - x[0]) * (y[1] - y[0])))


def coaxial_discs(radius: float, other: float, distance: float) -> float:
    """C-41: from a disc to a coaxial parallel one."""
    r1, r2 = radius / distance, other / distance
    x = 1 + (1 + r2 * r2) / (r1 * r1)
    return float(0.5 * (x - np.sqrt(x * x - 4 * (r2 / r1) ** 2)))


def sphere_to_disc(disc: float, distance: float) -> float:
    """C-124: from a sphere to a coaxial disc of radius ``disc``, its middle at ``distance``; whatever the sphere's radius."""
    return float(0.5 * (1 - 1 / np.sqrt(1 + (disc / distance) ** 2)))


def outer_cylinder_to_inner(inner: float, outer: float, height: float) -> float:
    """C-91: from the inside of the outer of two concentric cylinders to the inner one."""
    r, h = outer / inner, height / inner
    a, b = h * h + r * r - 1, h * h - r * r + 1
    bracket = (
        np.sqrt((a + 2) ** 2 - (2 * r) ** 2) * np.arccos(b / (r * a)) + b * np.arcsin(1 / r) - 0.5 * np.pi * a
    )
    return float((1 - (np.arccos(b / a) - bracket / (2 * h)) / np.pi) / r)


def outer_cylinder_to_itself(inner: float, outer: float, height: float) -> float:
    """C-92: from the inside of the outer of two concentric cylinders to itself."""
    r, h = outer / inner, height / inner
    root = np.sqrt(4 * r * r + h * h)
    first = (4 * (r * r - 1) + (h / r) ** 2 * (r * r - 2)) / (h * h + 4 * (r * r - 1))
    bracket = root / h * np.arcsin(first) - np.arcsin((r * r - 2) / (r * r)) + 0.5 * np.pi * (root / h - 1)
    return float(1 - 1 / r + 2 / (np.pi * r) * np.arctan(2 * np.sqrt(r * r - 1) / h) - h / (2 * np.pi * r) * bracket)


@dataclass(frozen=True)
class Case:
    """A configuration: a mesh, two groups of its facets, and the view factor from the first to the second."""

    name: str
    mesh: Mesh
    receiver: npt.NDArray[np.int64]
    source: npt.NDArray[np.int64]
    expected: float
    obstruction: bool


def rectangle(corner: Any, edge_a: Any, edge_b: Any, cells: tuple[int, int] = (1, 1)) -> Mesh:
    """A rectangle of two triangles a cell, its front to the side of ``edge_a × edge_b``."""
    s, t = np.meshgrid(np.linspace(0, 1, cells[0] + 1), np.linspace(0, 1, cells[1] + 1), indexing="ij")
    vertices = np.asarray(corner, float) + s[..., None] * np.asarray(edge_a, float) + t[..., None] * np.asarray(edge_b, float)
    return vertices.reshape(-1, 3), _grid_faces(cells[0], cells[1])


def _grid_faces(rows: int, columns: int) -> npt.NDArray[np.int64]:
    number = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    return np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def _chord(radius: float, sides: int) -> float:
    """Radius of the corners of a polygon with the perimeter of a circle's arc: facets lie inside and outside of it."""
    half = np.pi / sides
    return float(radius * half / np.sin(half))


def disc(radius: float, height: float, up: bool, sides: int = 96, hole: float = 0.0) -> Mesh:
    """A disc, or a ring, at a height, as sectors of its own area."""
    angles = 2 * np.pi * np.arange(sides) / sides
    half = np.pi / sides
    own = np.sqrt(half / (np.sin(half) * np.cos(half)))
    ring = np.stack([np.cos(angles), np.zeros(sides), np.sin(angles)], axis=1)
    outer = ring * radius * own + [0, height, 0]
    following = np.roll(np.arange(sides), -1)
    if hole > 0:
        vertices = np.vstack([outer, ring * hole * own + [0, height, 0]])
        k = np.arange(sides)
        faces = np.concatenate([np.stack([k, sides + k, sides + following], 1), np.stack([k, sides + following, following], 1)])
    else:
        vertices = np.vstack([outer, [[0, height, 0]]])
        faces = np.stack([np.arange(sides), np.full(sides, sides), following], axis=1)
    return vertices, faces if up else faces[:, ::-1]


def revolved(profile: npt.ArrayLike, outwards: bool, sides: int = 48) -> Mesh:
    """A surface of revolution about ``y`` of a profile of radii and heights, from below."""
    points = np.asarray(profile, float)
    angles = 2 * np.pi * np.arange(sides) / sides
    vertices = np.stack(
        [points[:, :1] * np.cos(angles), np.repeat(points[:, 1:], sides, 1), points[:, :1] * np.sin(angles)], axis=-1
    ).reshape(-1, 3)
    k = np.arange(sides)
    following = np.roll(k, -1)
    faces = []
    for row in range(len(points) - 1):
        low, high = row * sides, (row + 1) * sides
        if points[row, 0] > 0:
            faces.append(np.stack([low + k, high + following, low + following], 1))
        if points[row + 1, 0] > 0:
            faces.append(np.stack([low + k, high + k, high + following], 1))
    all_faces = np.concatenate(faces)
    return vertices, all_faces if outwards else all_faces[:, ::-1]


def cylinder(radius: float, low: float, high: float, outwards: bool, sides: int = 48, rows: int = 8) -> Mesh:
    """The side of a cylinder."""
    own = _chord(radius, sides)
    heights = np.linspace(low, high, rows + 1)
    return revolved(np.stack([np.full(rows + 1, own), heights], 1), outwards, sides)


def sphere(radius: float, outwards: bool, sides: int = 48, low: float = -0.5, high: float = 0.5) -> Mesh:
    """A sphere, or a zone of it between two latitudes in half turns, with its own area."""
    rows = max(2, round(sides * (high - low) / 2))
    latitude = np.pi * np.linspace(low, high, rows + 1)
    profile = np.stack([np.cos(latitude), np.sin(latitude)], 1)
    profile[np.abs(profile[:, 0]) < 1e-12, 0] = 0
    vertices, faces = revolved(profile, outwards, sides)
    own = 2 * np.pi * (np.sin(latitude[-1]) - np.sin(latitude[0]))
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    return vertices * radius * np.sqrt(own / area), faces


def joined(*meshes: Mesh) -> tuple[Mesh, list[npt.NDArray[np.int64]]]:
    """Meshes as one, and the facets of each."""
    vertices, faces, groups = [], [], []
    first_vertex = first_face = 0
    for own_vertices, own_faces in meshes:
        vertices.append(own_vertices)
        faces.append(np.asarray(own_faces) + first_vertex)
        groups.append(np.arange(first_face, first_face + len(own_faces)))
        first_vertex += len(own_vertices)
        first_face += len(own_faces)
    return (np.vstack(vertices), np.concatenate(faces)), groups


def catalogue(sides: int = 48) -> Iterator[Case]:
    """Configurations with closed forms; curved surfaces have so many sides."""

    def case(name: str, meshes: list[Mesh], expected: float, obstruction: bool = False) -> Case:
        mesh, groups = joined(*meshes)
        return Case(name, mesh, groups[0], groups[min(1, len(groups) - 1)], expected, obstruction)

    def floor(width: float, depth: float) -> Mesh:
        return rectangle((0, 0, 0), (0, 0, depth), (width, 0, 0))

    def ceiling(x: tuple[float, float], z: tuple[float, float], height: float) -> Mesh:
        return rectangle((x[0], height, z[0]), (x[1] - x[0], 0, 0), (0, 0, z[1] - z[0]))

    for width, depth, height in ((1.0, 1.0, 1.0), (2.0, 1.0, 0.5), (1.0, 1.0, 5.0), (4.0, 1.0, 0.2)):
        name = f"C-11 parallel rectangles {width:g} × {depth:g}, apart {height:g}"
        meshes = [floor(width, depth), ceiling((0, width), (0, depth), height)]
        yield case(name, meshes, parallel_rectangles(width, depth, height))
    meshes = [floor(1, 1), ceiling((0.5, 2.0), (-0.5, 0.75), 0.7)]
    expected = offset_parallel_rectangles((0, 1), (0, 1), (0.5, 2.0), (-0.5, 0.75), 0.7)
    yield case("C-13 parallel rectangles, unlike and apart sideways", meshes, expected)
    for width, height, length in ((1.0, 1.0, 1.0), (2.0, 1.0, 1.0), (1.0, 3.0, 0.5)):
        wall = rectangle((0, 0, 0), (0, height, 0), (0, 0, length))
        name = f"C-14 perpendicular rectangles {width:g} and {height:g} at an edge of {length:g}"
        yield case(name, [floor(width, length), wall], perpendicular_rectangles(width, height, length))
    for radius, other, distance in ((1.0, 1.0, 1.0), (0.5, 2.0, 1.0), (1.0, 0.3, 2.0)):
        meshes = [disc(radius, 0, True, 2 * sides), disc(other, distance, False, 2 * sides)]
        yield case(f"C-41 discs {radius:g} and {other:g}, apart {distance:g}", meshes, coaxial_discs(radius, other, distance))
    ring = coaxial_discs(1, 1.5, 1) - coaxial_discs(1, 0.8, 1)
    yield case("C-47 disc to a ring", [disc(1, 0, True, 2 * sides), disc(1.5, 1, False, 2 * sides, 0.8)], ring)
    side = cylinder(1, 0, 2, False, sides, sides // 2)
    end = 1 - coaxial_discs(1, 1, 2)
    yield case("C-79 cylinder: end to side", [disc(1, 0, True, sides), side], end)
    yield case("C-78 cylinder: inside to itself", [side], 1 - 2 * end * np.pi / (4 * np.pi))
    cone = revolved(np.stack([np.linspace(_chord(1, sides), 0, sides // 2 + 1), np.linspace(0, 2, sides // 2 + 1)], 1), False, sides)
    yield case("C-110 cone: inside to itself", [cone], 1 - 1 / np.sqrt(5))
    yield case("C-118 hemisphere: inside to itself", [sphere(1, False, sides, 0, 0.5)], 0.5)
    zones = [sphere(1, False, sides, -0.5, -0.1), sphere(1, False, sides, 0.2, 0.5)]
    yield case("C-119 inside of a sphere: zone to zone", zones, 0.5 * (1 - np.sin(0.2 * np.pi)))
    ball = sphere(0.3, True, sides)
    yield case("C-124 sphere to a disc", [ball, disc(1, 1.2, False, sides)], sphere_to_disc(1, 1.2))
    tube = cylinder(1, -1, 1, False, sides, sides // 2)
    yield case("C-127 sphere in a cylinder", [ball, tube], 1 / np.sqrt(2))
    yield case("C-121 sphere in a sphere", [sphere(0.5, True, sides), sphere(1, False, sides)], 1.0)
    # Silhouettes of a polygon are those of a circle to the square of its sides.
    inner = cylinder(0.5, 0, 1, True, 2 * sides, sides // 12)
    outer = cylinder(1, 0, 1, False, 2 * sides, sides // 12)
    yield case("C-91 outer cylinder to the inner", [outer, inner], outer_cylinder_to_inner(0.5, 1, 1), True)
    mesh, groups = joined(outer, inner)
    yield Case("C-92 outer cylinder to itself", mesh, groups[0], groups[0], outer_cylinder_to_itself(0.5, 1, 1), True)
    shell = sphere(1, False, sides)
    mesh, groups = joined(shell, sphere(0.5, True, sides))
    yield Case("C-122 outer sphere to itself", mesh, groups[0], groups[0], 0.75, True)
