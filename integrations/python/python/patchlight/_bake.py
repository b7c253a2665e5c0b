"""Bakes, the light in them, and their tables as matrices."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse

from . import _core
from ._arrays import Float32, Float64, Progress, Rgb, illuminance, place, showing, vectors
from ._operators import AllBounces, LightToPoints, PointTransport, shares_of
from ._scene import Light, Scene, SkyLike, as_sky

Matrix = Any


@dataclass(frozen=True)
class Camera:
    """A pinhole at ``eye`` that looks at ``target``, m; the vertical field of view in degrees."""

    eye: Rgb
    target: Rgb
    up: Rgb = (0.0, 1.0, 0.0)
    fov_degrees: float = 45.0


@dataclass(frozen=True)
class Surfaces:
    """Patches, or the elements into which they are cut: ``n`` of them.

    Attributes
    ----------
    centroids, normals : ndarray, shape (n, 3)
        Metres; unit normals.
    areas : ndarray, shape (n,)
        m².
    faces : ndarray, shape (n,)
        A face of the scene on which it lies: that of its first sample.
    reflectance : ndarray, shape (n, 3)
    """

    centroids: Float32
    normals: Float32
    areas: Float32
    faces: npt.NDArray[np.uint32]
    reflectance: Float32

    def __len__(self) -> int:
        return len(self.areas)


@dataclass(frozen=True)
class PointSet:
    """Points of a light field, of :meth:`LightField.add_points`."""

    number: int
    kind: str
    count: int


def _csr(parts: tuple[Any, Any, Any, tuple[int, int]]) -> Matrix:
    starts, columns, values, shape = parts
    matrix = sparse.csr_array((values.astype(np.float64), columns, starts), shape=shape)
    matrix.has_sorted_indices = False
    matrix.sort_indices()
    return matrix


class Irradiance:
    """The light of an update: irradiance, W/m², at whatever places are asked for.

    Light at patches, receivers and points of one's own was reflected at least once; at vertices and texels direct light
    is added unless ``direct=False``. Read it before the next update.
    """

    def __init__(self, field: LightField, number: int) -> None:
        self._field = field
        self._number = number

    def _core(self) -> _core.LightField:
        if self._field._number != self._number:
            raise _core.InputError("this light was replaced by a later update; read it before")
        return self._field._core

    @property
    def direct_at_samples(self) -> Float32:
        """Direct irradiance of the bake's samples, ``(samples, 3)``."""
        return self._core().direct()

    @property
    def source(self) -> Float32:
        """First exitance of the patches, ``(patches, 3)``."""
        return self._core().source()

    @property
    def patches(self) -> Float32:
        """Indirect irradiance of the patches, ``(patches, 3)``: all bounces but the last two."""
        return self._core().at_patches()

    @property
    def elements(self) -> Float32:
        """Indirect irradiance of the elements, ``(elements, 3)``: all bounces but the last."""
        return self._core().at_elements()

    @property
    def receivers(self) -> Float32:
        """Indirect irradiance between the receivers, where pictures take theirs from."""
        return self._core().at_receivers()

    def corners(self, *, front: bool = True, direct: bool = True) -> Float32:
        """Irradiance of the corners of the triangles of the bake's scene, ``(triangles, 3, 3)``: corner, RGB."""
        return self._core().at_corners(front, direct).reshape(-1, 3, 3)

    def vertices(self, *, front: bool = True, direct: bool = True) -> Float32:
        """Irradiance of the vertices of the scene, ``(vertices, 3)``: means over the faces round each; 0 where none is
        lit on this side."""
        bake = self._field.bake
        rows, corners, weights = bake._vertex_corners
        values = self.corners(front=front, direct=direct).reshape(-1, 3)[corners]
        lit = weights * (values.sum(axis=1) > 0)
        count = len(bake.scene.vertices)
        sums = np.zeros((count, 3))
        np.add.at(sums, rows, values * lit[:, np.newaxis])
        total = np.bincount(rows, lit, count)
        means: Float32 = (sums / np.maximum(total, 1e-30)[:, np.newaxis]).astype(np.float32)
        return means

    def texels(self, size: float, *, direct: bool = True) -> Float32:
        """A lightmap ``(height, width, 3)`` whose texels are so large, m; :meth:`LightField.lightmap_uvs` says where."""
        return self._core().on_lightmap(size, direct)

    def points(self, points: PointSet) -> Float32:
        """Light of points: ``(n, 3)``, of ambient cubes ``(n, 6, 3)``, of spherical harmonics ``(n, 4, 3)``."""
        values = self._core().at_points(points.number)
        return values if points.kind == "irradiance" else values.reshape(points.count, -1, 3)


class LightField:
    """The light of a bake, found anew by each :meth:`update` in milliseconds."""

    def __init__(self, bake: Bake, method: str, epsilon: float, point_rays: int, progress: Progress) -> None:
        self.bake = bake
        self.method = method
        with showing(progress) as callback:
            self._core = _core.LightField(bake._core, method, epsilon, point_rays, callback)
        self._number = -1

    def update(
        self,
        lights: Iterable[Light] | None = None,
        *,
        sky: SkyLike = None,
        emission: npt.ArrayLike | None = None,
    ) -> Irradiance:
        """Finds the light under these lights, this sky and this emission.

        Parameters
        ----------
        lights : iterable of Light, optional
            Default: those of the scene, with its sky.
        sky : Sky or radiance, optional
        emission : array_like, shape (materials, 3), optional
            Radiance of each of :attr:`Scene.materials`, W/m²/sr; default: that of the scene.
        """
        arguments = self.bake._lighting(lights, sky, emission)
        self._number = self._core.update(*arguments)
        return Irradiance(self, self._number)

    def add_points(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike = (0.0, 1.0, 0.0),
        *,
        kind: str = "irradiance",
        progress: Progress = None,
    ) -> PointSet:
        """Adds points whose light every update finds from now on; their rays are traced once, here.

        ``kind`` is ``"irradiance"`` for the normals, ``"cube"`` for six sides (+x, -x, +y, -y, +z, -z), or
        ``"harmonics"`` for radiance as spherical harmonics of degree 1.
        """
        places = vectors(points, "points")
        facing = np.ascontiguousarray(np.broadcast_to(vectors(normals, "normals"), places.shape))
        with showing(progress) as callback:
            number = self._core.add_points(places, facing, kind, callback)
        return PointSet(number, kind, len(places))

    def remove_points(self, points: PointSet) -> None:
        """Removes points; others stay."""
        self._core.remove_points(points.number)

    def lightmap_uvs(self, size: float, *, front: bool = True) -> Float32:
        """Texture coordinates in the lightmap of :meth:`Irradiance.texels`, ``(triangles, 3, 2)``; NaN without a chart."""
        return self._core.lightmap_uvs(size, front).reshape(-1, 3, 2)

    def render(
        self,
        camera: Camera | None = None,
        size: tuple[int, int] = (640, 360),
        *,
        lights: Iterable[Light] | None = None,
        sky: SkyLike = None,
        emission: npt.ArrayLike | None = None,
        sub_frames: int = 16,
        part: str = "full",
    ) -> Float32:
        """A picture ``(height, width, 3)``, radiance in W/m²/sr; :func:`patchlight.plots.display` makes colours of it.

        ``part`` is ``"full"``, ``"direct"`` or ``"indirect"``: what was reflected before it reached what is seen.
        """
        view = self.bake.scene.camera if camera is None else camera
        parts = ("full", "direct", "indirect")
        if part not in parts:
            raise _core.InputError(f"part is {part!r}; it must be one of {', '.join(parts)}")
        arguments = self.bake._lighting(lights, sky, emission)
        pictures = self._core.render(
            *arguments,
            place(view.eye, "eye"),
            place(view.target, "target"),
            place(view.up, "up"),
            view.fov_degrees,
            size,
            sub_frames,
        )
        self._number += 1
        return pictures[parts.index(part)]


class Bake:
    """What a scene at rest needs: patches, elements, form factors, receivers. Made by :meth:`Scene.bake`."""

    def __init__(self, core: _core.Bake, scene: Scene, *, is_opened: bool = False) -> None:
        self._core = core
        # The scene of a file is that of the bake, cut where something stands on something.
        self._is_opened = is_opened
        #: The scene.
        self.scene = scene
        self._fields: dict[tuple[str, str], LightField] = {}

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Bake:
        """Opens a file of :meth:`save`, or of the program's ``patchlight bake``."""
        core, scene = _core.Bake.open(os.fspath(path))
        return cls(core, Scene._of(scene), is_opened=True)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a file: the same bytes as ``patchlight bake`` with these settings."""
        self._core.save(os.fspath(path))

    # What it consists of.

    @cached_property
    def _sample_faces(self) -> npt.NDArray[np.uint32]:
        """Face on which each sample lies."""
        positions, normals, _, _, _ = self._core.samples()
        triangles = self._own_scene.locate(positions, normals)
        return self._triangle_faces[np.minimum(triangles, len(self._triangle_faces) - 1)]

    @cached_property
    def _own_scene(self) -> _core.Scene:
        return self._core.scene()

    @cached_property
    def _triangle_faces(self) -> npt.NDArray[np.uint32]:
        """Face of the scene that each triangle of the bake is, or is a part of."""
        sources = self._own_scene.triangle_sources()
        if self._is_opened:
            return np.arange(len(sources), dtype=np.uint32)
        return self.scene._face_of_source[sources]

    @cached_property
    def _vertex_corners(self) -> tuple[npt.NDArray[Any], npt.NDArray[Any], Float64]:
        """Vertex, corner and weight of each corner of the bake's triangles that is a vertex of the scene."""
        corners = self._own_scene.triangles().reshape(-1, 3, 3)
        vertices = self.scene.faces[self._triangle_faces]
        places = self.scene.vertices[vertices]
        size = float(np.ptp(self.scene.vertices, axis=0).max())
        apart = np.linalg.norm(corners[:, :, np.newaxis] - places[:, np.newaxis], axis=3)
        triangle, corner, vertex = np.nonzero(apart < 1e-6 * size)
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        return vertices[triangle, vertex].astype(np.int64), 3 * triangle + corner, area[triangle].astype(float)

    @cached_property
    def patches(self) -> Surfaces:
        """The patches."""
        centroids, normals, areas, _, reflectance = self._core.patches()
        return Surfaces(centroids, normals, areas, self.elements.faces[self._core.patch_elements()[:-1]], reflectance)

    @cached_property
    def elements(self) -> Surfaces:
        """The elements into which patches are cut; polygon patches are elements themselves."""
        centroids, normals, areas, _, reflectance = self._core.elements()
        first = self._core.samples()[2][:-1]
        return Surfaces(centroids, normals, areas, self._sample_faces[first], reflectance)

    @cached_property
    def element_shares(self) -> Matrix:
        """Means of elements over patches, ``(patches, elements)``: shares of the area."""
        return shares_of(self._core.patch_elements(), self.elements.areas)

    @property
    def bounces(self) -> int:
        """Bounces of an update."""
        return self._core.bounces

    @property
    def receiver_count(self) -> int:
        """Number of receivers."""
        return self._core.receiver_count

    @cached_property
    def form_factors(self) -> Matrix:
        """Form factors of the patches, :class:`scipy.sparse.csr_array` ``(patches, patches)``: ``F[i, j]`` is the share
        of what leaves patch i that arrives at patch j."""
        return _csr(self._core.form_factors())

    @cached_property
    def element_form_factors(self) -> Matrix:
        """Form factors of the elements, ``(elements, elements)``."""
        return _csr(self._core.element_factors())

    @cached_property
    def sky_factors(self) -> Float64:
        """Share of each patch's hemisphere that sees the sky."""
        shares: Float64 = self.element_shares @ self._core.sky_factor().astype(float)
        return shares

    @property
    def closure_error(self) -> float:
        """Greatest ``|Σ_j F_ij + F_i0 - 1|``: what a patch sends to what no patch owns."""
        return float(np.abs(self.form_factors.sum(axis=1) + self.sky_factors - 1).max())

    @property
    def reciprocity_error(self) -> float:
        """``|A F - (A F)ᵗ| / |A F|`` in the Frobenius norm: the noise of rows that were found each for itself."""
        products = sparse.diags_array(self.patches.areas.astype(float)) @ self.form_factors
        return float(sparse.linalg.norm(products - products.T) / sparse.linalg.norm(products))

    @property
    def energy(self) -> dict[str, Any] | None:
        """The bake's estimates of its own errors: ``balance``, and indirect light beside rays, ``near`` the focus and
        under ``unseen`` light, each a ratio with its standard error."""
        found = self._core.energy()
        return None if found is None else dict(zip(("balance", "near", "unseen"), found, strict=True))

    # Light.

    def _lighting(
        self, lights: Iterable[Light] | None, sky: SkyLike, emission: npt.ArrayLike | None
    ) -> tuple[list[_core.Light], _core.Sky | None, Float32 | None]:
        own = self.scene.lights if lights is None else list(lights)
        own_sky = self.scene.sky if lights is None and sky is None else as_sky(sky)
        radiances = None if emission is None else vectors(emission, "emission")
        return [light._core for light in own], None if own_sky is None else own_sky._core, radiances

    def light_field(
        self,
        method: str = "classic",
        *,
        epsilon: float = 0.01,
        point_rays: int = 1024,
        progress: Progress = None,
    ) -> LightField:
        """The light by a method: ``"classic"`` (a product a bounce), ``"low_rank"`` (all bounces in one product with a
        compressed operator, of relative error ``epsilon``), ``"multibounce"`` (dense), ``"feedback"``, ``"temporal"``."""
        return LightField(self, method, epsilon, point_rays, progress)

    def _field(self, method: str, purpose: str = "update") -> LightField:
        """A field that is kept; those of other purposes leave the light of the last update as it is."""
        key = (method, purpose)
        if key not in self._fields:
            self._fields[key] = self.light_field(method)
        return self._fields[key]

    def update(
        self,
        lights: Iterable[Light] | None = None,
        *,
        sky: SkyLike = None,
        emission: npt.ArrayLike | None = None,
        method: str = "classic",
    ) -> Irradiance:
        """Finds the light under other lights; :meth:`LightField.update` of a field that is kept."""
        return self._field(method).update(lights, sky=sky, emission=emission)

    def render(self, camera: Camera | None = None, size: tuple[int, int] = (640, 360), **settings: Any) -> Float32:
        """A picture; :meth:`LightField.render`, with ``method``."""
        return self._field(settings.pop("method", "classic")).render(camera, size, **settings)

    # Operators.

    def element_reflectance(self, face_values: npt.ArrayLike) -> Float64:
        """Values of the scene's faces, ``(faces, bands)``, at the elements: means over their samples."""
        values = np.asarray(face_values, dtype=float)
        if values.ndim == 1:
            values = values[:, np.newaxis]
        _, _, first, weights, _ = self._core.samples()
        shares = weights.astype(float)[:, np.newaxis]
        starts = first[:-1].astype(np.int64)
        sums: Float64 = np.add.reduceat(shares * values[self._sample_faces], starts, axis=0)
        return sums / np.add.reduceat(shares, starts, axis=0)

    def _reflectance(self, reflectance: npt.ArrayLike | None) -> Float64:
        """Reflectance of the elements, in the bands of the scene or in others."""
        if reflectance is not None:
            values = np.asarray(reflectance, dtype=float)
            values = values[:, np.newaxis] if values.ndim == 1 else values
            if values.shape[0] != len(self.elements):
                raise _core.InputError(f"{values.shape[0]} reflectances for {len(self.elements)} elements")
            return values
        if self.scene._bands is not None:
            return self.element_reflectance(self.scene._bands)
        return self.elements.reflectance.astype(float)

    def all_bounces(self, reflectance: npt.ArrayLike | None = None, *, tolerance: float = 1e-6) -> AllBounces:
        """The operator of all bounces between patches, with another reflectance of the elements, ``(elements, bands)``."""
        albedo = self.element_shares @ self._reflectance(reflectance)
        if reflectance is None and self.scene._bands is None:
            albedo = self.patches.reflectance.astype(float)
        return AllBounces(self.form_factors, albedo, tolerance=tolerance)

    @cached_property
    def operator(self) -> AllBounces:
        """The operator of all bounces between patches, from first exitance to irradiance, in the scene's bands."""
        return self.all_bounces()

    def direct(
        self,
        lights: Iterable[Light] | None = None,
        *,
        sky: SkyLike = None,
        emission: npt.ArrayLike | None = None,
    ) -> Float64:
        """First exitance of the elements that lights give, W/m², ``(elements, 3)``: ``e = ρ H_d``."""
        field = self._field("classic", "direct")
        light = field.update(lights, sky=sky, emission=emission)
        _, _, first, weights, albedo = self._core.samples()
        reflected = albedo.astype(float) * light.direct_at_samples * weights[:, np.newaxis]
        exitance: Float64 = np.add.reduceat(reflected, first[:-1].astype(np.int64), axis=0)
        own_sky = self.scene.sky if lights is None and sky is None else as_sky(sky)
        if own_sky is not None:
            radiance = np.array(own_sky._core.constant_radiance)
            seen = self._core.sky_factor().astype(float)[:, np.newaxis]
            exitance = exitance + self.elements.reflectance * seen * (np.pi * radiance)
        return exitance

    def to_points(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike = (0.0, 1.0, 0.0),
        *,
        rays: int = 1024,
        reflectance: npt.ArrayLike | None = None,
        seed: int = 0,
        progress: Progress = None,
    ) -> PointTransport:
        """From the first exitance of elements to the indirect irradiance of points, with its adjoint."""
        places = vectors(points, "points")
        facing = np.ascontiguousarray(np.broadcast_to(vectors(normals, "normals"), places.shape))
        with showing(progress) as callback:
            rows, _ = self._core.point_rows(places, facing, rays, seed, callback)
        has_own = reflectance is not None or self.scene._bands is not None
        albedo = self._reflectance(reflectance) if has_own else None
        return PointTransport(self, _csr(rows), albedo, self.all_bounces(reflectance))

    def lights_to_points(
        self,
        lights: Iterable[Light],
        points: npt.ArrayLike,
        normals: npt.ArrayLike = (0.0, 1.0, 0.0),
        *,
        skies: Iterable[SkyLike] = (),
        rays: int = 1024,
        seed: int = 0,
        progress: Progress = None,
    ) -> LightToPoints:
        """``H = P T D x`` plus direct light, as one operator: from a factor for each light, then for each of ``skies``,
        to the irradiance of points, RGB."""
        places = vectors(points, "points")
        facing = np.ascontiguousarray(np.broadcast_to(vectors(normals, "normals"), places.shape))
        transport = self.to_points(places, facing, rays=rays, seed=seed, progress=progress)
        sources: list[tuple[list[Light], SkyLike]] = [([light], None) for light in lights]
        sources += [([], sky) for sky in skies]
        dark = np.zeros_like(self.scene.materials[1])
        direct = [self.direct(own, sky=sky, emission=dark) for own, sky in sources]
        at_points = [self.scene.direct(places, facing, lights=own, sky=sky, seed=seed) for own, sky in sources]
        return LightToPoints(transport, np.stack(direct, axis=2), np.stack(at_points, axis=2).astype(float))

    def illuminance(
        self, points: npt.ArrayLike, normals: npt.ArrayLike = (0.0, 1.0, 0.0), *, lights: Iterable[Light] | None = None
    ) -> Float64:
        """Illuminance of points, lx: direct and indirect light under the scene's lights or others."""
        places = vectors(points, "points")
        facing = np.ascontiguousarray(np.broadcast_to(vectors(normals, "normals"), places.shape))
        field = self._field("classic", "direct")
        own = field.add_points(places, facing)
        try:
            indirect = field.update(lights).points(own)
        finally:
            field.remove_points(own)
        return illuminance(indirect + self.scene.direct(places, facing, lights=lights))

    def _core_sky_rows(
        self, points: Any, normals: Any, offsets: Any, rays: int, division: int, seed: int, callback: Any
    ) -> Matrix:
        return _csr(self.scene._core.sky_rows(points, normals, offsets, rays, division, seed, callback))

    def __repr__(self) -> str:
        return f"Bake({self.scene.name!r}, {len(self.patches)} patches, {self.receiver_count} receivers)"
