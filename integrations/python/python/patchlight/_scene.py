"""Scenes: surfaces, what they reflect, and what shines."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Union

import numpy as np
import numpy.typing as npt

from . import _core
from ._arrays import Float32, Float64, Progress, place, quantity, rgb, showing, triples, vectors

if TYPE_CHECKING:
    from ._bake import Bake, Camera

_PER_LUMEN = 1.0 / _core.LUMENS_PER_WATT


def built_in_scenes() -> list[str]:
    """Names of the built-in scenes, for :meth:`Scene.load`."""
    return _core.built_in_scenes()


class Light:
    """A light that is no surface: a sun, a point, a spot, a rectangle, or a measured luminaire.

    The constructors take a radiometric quantity (a number or RGB) or a photometric one, with a ``tint``.
    """

    __slots__ = ("_core",)

    def __init__(self, core: _core.Light) -> None:
        self._core = core

    @staticmethod
    def sun(
        direction: npt.ArrayLike,
        irradiance: npt.ArrayLike | None = None,
        *,
        lux: float | None = None,
        tint: npt.ArrayLike | None = None,
    ) -> Light:
        """Parallel light.

        Parameters
        ----------
        direction : array_like, shape (3,)
            The way it travels, from the sun to the ground.
        irradiance : float or RGB, W/m²
            On a surface that faces it.
        lux : float
            The same as illuminance, lx.
        tint : RGB
            Its hue where ``lux`` is given.
        """
        colour = quantity({"irradiance": (irradiance, 1.0), "lux": (lux, _PER_LUMEN)}, tint)
        return Light(_core.Light.sun(place(direction, "direction"), colour))

    @staticmethod
    def point(
        position: npt.ArrayLike,
        intensity: npt.ArrayLike | None = None,
        *,
        flux: npt.ArrayLike | None = None,
        lumens: float | None = None,
        candela: float | None = None,
        tint: npt.ArrayLike | None = None,
    ) -> Light:
        """A point, m, that shines in all directions alike.

        Its ``intensity`` (W/sr), its whole ``flux`` (W), or either as ``candela`` or ``lumens``.
        """
        all_round = 1.0 / (4.0 * np.pi)
        units: dict[str, tuple[npt.ArrayLike | None, float]] = {
            "intensity": (intensity, 1.0),
            "flux": (flux, all_round),
            "lumens": (lumens, all_round * _PER_LUMEN),
            "candela": (candela, _PER_LUMEN),
        }
        return Light(_core.Light.point(place(position, "position"), quantity(units, tint)))

    @staticmethod
    def spot(
        position: npt.ArrayLike,
        direction: npt.ArrayLike,
        angles: tuple[float, float],
        intensity: npt.ArrayLike | None = None,
        *,
        candela: float | None = None,
        tint: npt.ArrayLike | None = None,
    ) -> Light:
        """A point, m, that shines round ``direction``: all of its intensity up to the first half-angle, none beyond the
        second; degrees."""
        inner, outer = (float(np.radians(angle)) for angle in angles)
        if not 0 <= inner <= outer <= np.pi:
            raise _core.InputError(f"angles are {angles}; the first is at most the second, and that at most 180°")
        colour = quantity({"intensity": (intensity, 1.0), "candela": (candela, _PER_LUMEN)}, tint)
        core = _core.Light.spot(place(position, "position"), place(direction, "direction"), inner, outer, colour)
        return Light(core)

    @staticmethod
    def rectangle(
        corner: npt.ArrayLike,
        edges: tuple[npt.ArrayLike, npt.ArrayLike],
        radiance: npt.ArrayLike | None = None,
        *,
        flux: npt.ArrayLike | None = None,
        nits: float | None = None,
        lumens: float | None = None,
        tint: npt.ArrayLike | None = None,
    ) -> Light:
        """A parallelogram from ``corner`` along two edges, m, that shines to the side of ``edges[0] × edges[1]``.

        Its ``radiance`` (W/m²/sr), its whole ``flux`` (W), or either as ``nits`` (cd/m²) or ``lumens``. It hides nothing
        and reflects nothing.
        """
        a, b = (place(edge, "edge") for edge in edges)
        area = float(np.linalg.norm(np.cross(a, b)))
        if area <= 0:
            raise _core.InputError("the edges of the rectangle span no area")
        units: dict[str, tuple[npt.ArrayLike | None, float]] = {
            "radiance": (radiance, 1.0),
            "flux": (flux, 1.0 / (np.pi * area)),
            "nits": (nits, _PER_LUMEN),
            "lumens": (lumens, _PER_LUMEN / (np.pi * area)),
        }
        return Light(_core.Light.rectangle(place(corner, "corner"), a, b, quantity(units, tint)))

    @staticmethod
    def luminaire(
        path: str | os.PathLike[str],
        position: npt.ArrayLike,
        *,
        axis: npt.ArrayLike = (0, -1, 0),
        across: npt.ArrayLike = (1, 0, 0),
        lumens: float | None = None,
        tint: npt.ArrayLike = (1, 1, 1),
        lamp_set: int = 1,
    ) -> Light:
        """A measured luminaire from an IES LM-63 or a EULUMDAT (.ldt) file.

        ``axis`` is its direction γ = 0, ``across`` that of its half-plane C = 0; ``lumens`` replaces the file's flux;
        a EULUMDAT file may have several lamp sets, from 1.
        """
        core = _core.Light.luminaire(
            os.fspath(path),
            place(position, "position"),
            place(axis, "axis"),
            place(across, "across"),
            lumens,
            rgb(tint, "tint"),
            lamp_set,
        )
        return Light(core)

    def __mul__(self, factor: npt.ArrayLike) -> Light:
        """The same light, so many times as bright."""
        return Light(self._core.scaled(rgb(factor, "factor")))

    __rmul__ = __mul__

    def moved(self, position: npt.ArrayLike) -> Light:
        """The same light at another position, m."""
        return Light(self._core.moved(place(position, "position")))

    @property
    def kind(self) -> str:
        """``sun``, ``point``, ``spot``, ``rectangle`` or ``luminaire``."""
        return self._core.kind

    @property
    def position(self) -> Float64:
        """Position, m."""
        return np.array(self._core.position)

    @property
    def direction(self) -> Float64:
        """Unit direction in which it shines."""
        return np.array(self._core.direction)

    @property
    def color(self) -> Float64:
        """Irradiance of a sun, W/m²; radiance of a rectangle, W/m²/sr; radiant intensity of the others, W/sr."""
        return np.array(self._core.color)

    def __repr__(self) -> str:
        return repr(self._core)


class Sky:
    """Light from every direction that sees no geometry."""

    __slots__ = ("_core",)

    def __init__(self, core: _core.Sky) -> None:
        self._core = core

    @staticmethod
    def constant(
        radiance: npt.ArrayLike | None = None, *, nits: float | None = None, tint: npt.ArrayLike | None = None
    ) -> Sky:
        """The same radiance, W/m²/sr or cd/m², from all directions, those below the horizon too."""
        return Sky(_core.Sky.constant(quantity({"radiance": (radiance, 1.0), "nits": (nits, _PER_LUMEN)}, tint)))

    @staticmethod
    def map(radiances: npt.ArrayLike) -> Sky:
        """An equirectangular map of radiances, W/m²/sr, ``(height, width)`` or ``(height, width, 3)``.

        The first row is the zenith; the middle column is north (``-z``), and columns go on eastwards (``+x``).
        """
        array = np.asarray(radiances, dtype=np.float32)
        if array.ndim == 2:
            array = np.repeat(array[:, :, np.newaxis], 3, axis=2)
        if array.ndim != 3:
            raise _core.InputError(f"the map has the shape {array.shape}; give rows, columns and RGB")
        return Sky(_core.Sky.map(np.ascontiguousarray(array)))

    def __mul__(self, factor: npt.ArrayLike) -> Sky:
        """The same sky, so many times as bright."""
        return Sky(self._core.scaled(rgb(factor, "factor")))

    __rmul__ = __mul__

    def __repr__(self) -> str:
        return repr(self._core)


SkyLike = Union[Sky, npt.ArrayLike, None]


def as_sky(sky: SkyLike) -> Sky | None:
    """A sky, or a constant one of so much radiance."""
    if sky is None or isinstance(sky, Sky):
        return sky
    return Sky.constant(sky)


def _per_face(values: npt.ArrayLike, faces: int, name: str) -> Float64:
    """A table of one row a face: from a number, RGB, a value a face, or rows of bands."""
    array = np.asarray(values, dtype=float)
    if array.ndim == 1:
        if array.size == 3 and faces == 3:
            raise _core.InputError(f"{name} of three numbers and three faces: give (1, 3) for RGB, (3, 1) for a value a face")
        array = array.reshape(1, 3) if array.size == 3 else array.reshape(-1, 1)
    elif array.ndim == 0:
        array = array.reshape(1, 1)
    if array.ndim != 2 or array.shape[0] not in (1, faces):
        raise _core.InputError(f"{name} has the shape {array.shape}; give one row, or one for each of {faces} faces")
    return np.broadcast_to(array, (faces, array.shape[1]))


def _as_rgb(bands: Float64) -> Float64:
    """Three channels: RGB as it is, of other numbers of bands their mean."""
    if bands.shape[1] == 3:
        return bands
    return np.repeat(bands.mean(axis=1, keepdims=True), 3, axis=1)


class Scene:
    """Triangles that reflect light diffusely, and lights.

    Parameters
    ----------
    vertices : array_like, shape (n, 3)
        Metres; taken without a copy where they are contiguous single precision.
    faces : array_like, shape (m, 3)
        Vertices of each triangle, counter-clockwise as seen from its front. Both sides reflect; the front alone shines.
    reflectance : array_like
        Diffuse reflectance, 0 to 0.95: a number, RGB, one value a face ``(m,)``, or rows ``(m, bands)``. With one band or
        three, pictures and light fields have it; with others they have the mean, and :attr:`Bake.operator` has them all.
    emission : array_like
        Radiance of the fronts, W/m²/sr, in the same shapes.
    normals : array_like, shape (n, 3), optional
        Smooth normals of the vertices, for pictures.
    lights : iterable of Light
    sky : Sky, or a constant radiance

    Raises
    ------
    InputError
        With the face, the material or the light that makes no sense.
    """

    def __init__(
        self,
        vertices: npt.ArrayLike,
        faces: npt.ArrayLike,
        reflectance: npt.ArrayLike = 0.5,
        emission: npt.ArrayLike = 0.0,
        *,
        normals: npt.ArrayLike | None = None,
        lights: Iterable[Light] = (),
        sky: SkyLike = None,
        name: str = "scene",
    ) -> None:
        positions = vectors(vertices, "vertices")
        corners = triples(faces, "faces")
        albedo = _per_face(reflectance, len(corners), "reflectance")
        radiance = _per_face(emission, len(corners), "emission")
        if ((albedo < 0) | (albedo > 0.95) | ~np.isfinite(albedo)).any():
            face = int(np.argwhere((albedo < 0) | (albedo > 0.95) | ~np.isfinite(albedo))[0][0])
            raise _core.InputError(f"face {face} reflects {albedo[face]}; a surface reflects 0 to 0.95 of the light")
        if ((radiance < 0) | ~np.isfinite(radiance)).any():
            face = int(np.argwhere((radiance < 0) | ~np.isfinite(radiance))[0][0])
            raise _core.InputError(f"face {face} shines with {radiance[face]}; radiance is finite and not negative")
        both = np.hstack([_as_rgb(albedo), _as_rgb(radiance)]).astype(np.float32)
        kinds, of_face = np.unique(both, axis=0, return_inverse=True)
        smooth = None if normals is None else vectors(normals, "normals")
        self._core = _core.Scene.from_arrays(
            positions,
            corners,
            np.ascontiguousarray(of_face.reshape(-1), dtype=np.uint32),
            np.ascontiguousarray(kinds[:, :3]),
            np.ascontiguousarray(kinds[:, 3:]),
            smooth,
            name,
        )
        self._vertices = positions
        self._faces = corners
        self._face_of_source = self._core.face_order()
        self._bands = albedo if albedo.shape[1] not in (1, 3) else None
        #: Lights that are no surfaces.
        self.lights: list[Light] = list(lights)
        #: The sky, or ``None``.
        self.sky: Sky | None = as_sky(sky)

    @classmethod
    def _of(cls, core: _core.Scene) -> Scene:
        scene = cls.__new__(cls)
        scene._core = core
        triangles = core.triangles().reshape(-1, 3)
        scene._vertices, inverse = np.unique(triangles, axis=0, return_inverse=True)
        scene._faces = np.ascontiguousarray(inverse.reshape(-1, 3), dtype=np.uint32)
        sources = core.triangle_sources()
        scene._face_of_source = np.zeros(int(sources.max(initial=0)) + 1, np.uint32)
        scene._face_of_source[sources] = np.arange(len(sources), dtype=np.uint32)
        scene._bands = None
        lights, sky = core.lighting()
        scene.lights = [Light(light) for light in lights]
        scene.sky = Sky(sky)
        return scene

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Scene:
        """A scene file (.toml, .obj, .gltf, .glb), or the built-in scene of that name (:func:`built_in_scenes`).

        Raises
        ------
        FileError
            With the file, the place and the remedy.
        """
        return cls._of(_core.Scene.load(os.fspath(path)))

    @classmethod
    def from_trimesh(cls, mesh: Any, **settings: Any) -> Scene:
        """A scene of a ``trimesh.Trimesh`` or ``trimesh.Scene``; ``settings`` as in :class:`Scene`."""
        if hasattr(mesh, "to_mesh"):
            mesh = mesh.to_mesh()
        return cls(np.asarray(mesh.vertices), np.asarray(mesh.faces), **settings)

    @classmethod
    def from_pyvista(cls, mesh: Any, **settings: Any) -> Scene:
        """A scene of a ``pyvista.DataSet``; ``settings`` as in :class:`Scene`."""
        surface = mesh.extract_surface(algorithm="dataset_surface") if not hasattr(mesh, "regular_faces") else mesh
        surface = surface.triangulate()
        return cls(np.asarray(surface.points), np.asarray(surface.regular_faces), **settings)

    @property
    def name(self) -> str:
        """The file's, or the built-in scene's."""
        return self._core.name

    @property
    def vertices(self) -> Float32:
        """Vertices ``(n, 3)``, m."""
        return self._vertices

    @property
    def faces(self) -> npt.NDArray[np.uint32]:
        """Vertices of each face ``(m, 3)``."""
        return self._faces

    @property
    def materials(self) -> tuple[Float32, Float32]:
        """Reflectance and emitted radiance of each material, ``(k, 3)``; the first is the default one."""
        return self._core.materials()

    @property
    def bounds(self) -> tuple[Float64, Float64]:
        """Least and greatest coordinates, m."""
        low, high = self._core.bounds()
        return np.array(low), np.array(high)

    @property
    def camera(self) -> Camera:
        """The camera of the file, or one that looks at the whole scene."""
        from ._bake import Camera

        view = self._core.view()
        if view is not None:
            return Camera(*view)
        low, high = self.bounds
        middle = 0.5 * (low + high)
        away = float(np.linalg.norm(high - low))
        return Camera(tuple(middle + away * np.array([0.3, 0.4, 1.0])), tuple(middle), (0.0, 1.0, 0.0), 45.0)

    def bake(
        self,
        patches: int = 4000,
        *,
        kind: str = "cluster",
        estimator: str | None = None,
        rays: int = 4096,
        samples: int | None = None,
        sample_rays: int = 8,
        bounces: int | None = None,
        receivers: bool = True,
        receiver_rays: int = 1024,
        most_receivers: int | None = None,
        memory_limit: int | None = None,
        seed: int = 0,
        operators: Iterable[str] = (),
        progress: Progress = None,
    ) -> Bake:
        """Cuts the surfaces into patches, finds their form factors, and places receivers.

        Parameters
        ----------
        patches : int
            About how many.
        kind : {"cluster", "polygon", "voxel", "axis"}
            Clusters of samples of any mesh, or parts of the triangles.
        estimator : {"rays", "contour", "area", "point"}
            Of the form factors; all but ``"rays"`` need polygons.
        rays : int
            Of each patch.
        samples : int, optional
            Of each patch, where its direct light is measured.
        sample_rays : int
            To area lights and to a map of the sky, from each sample.
        bounces : int, optional
            Default: until nothing changes.
        receivers : bool
            Without them there are no pictures and no light at vertices and texels, and the bake takes half the time.
        receiver_rays, most_receivers
            Rays of each receiver, and most receivers.
        memory_limit : int, optional
            Bytes; more is refused before work begins.
        operators : iterable of {"low_rank", "multibounce", "feedback"}
            Made now instead of by the first light field that needs them.
        progress : bool or callable
            See :data:`Progress`. Ctrl-C cancels.

        Returns
        -------
        Bake
        """
        from ._bake import Bake

        if estimator is None:
            estimator = "contour" if kind == "polygon" else "rays"
        with showing(progress) as callback:
            core = _core.Bake.build(
                self._with_lights(),
                patches,
                kind,
                estimator,
                rays,
                samples,
                sample_rays,
                bounces,
                receivers,
                receiver_rays,
                most_receivers,
                memory_limit,
                seed,
                list(operators),
                callback,
            )
        return Bake(core, self)

    def _with_lights(self) -> _core.Scene:
        """The core's scene under the lights of now: a bake spends its rays by them."""
        return self._core.under([light._core for light in self.lights], None if self.sky is None else self.sky._core)

    def direct(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        *,
        lights: Iterable[Light] | None = None,
        sky: SkyLike = None,
        area_rays: int = 64,
        sky_rays: int = 256,
        seed: int = 0,
        progress: Progress = None,
    ) -> Float32:
        """Direct irradiance, W/m², ``(n, 3)``, of points with these normals, by shadow rays.

        Of the scene's lights and sky unless others are given; of surfaces that shine in any case.
        """
        own = self.lights if lights is None else list(lights)
        own_sky = self.sky if lights is None and sky is None else as_sky(sky)
        with showing(progress) as callback:
            return self._core.direct(
                vectors(points, "points"),
                vectors(normals, "normals"),
                [light._core for light in own],
                None if own_sky is None else own_sky._core,
                None,
                area_rays,
                sky_rays,
                seed,
                callback,
            )

    def cast(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> Float32:
        """Distance along each ray to the first surface, m; infinite where there is none."""
        return self._core.cast(vectors(origins, "origins"), vectors(directions, "directions"))

    def __repr__(self) -> str:
        return f"Scene({self.name!r}, {len(self._faces)} faces, {len(self.lights)} lights)"
