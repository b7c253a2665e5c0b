"""Terrain: hourly fluxes and temperatures on a height field, with light and heat between its slopes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ._arrays import Float64, Progress, vectors
from ._scene import Scene
from ._view_factors import ViewFactors, radiosity, view_factors
from .heat import STEFAN_BOLTZMANN


class Terrain:
    """A height field as two triangles a cell.

    Parameters
    ----------
    heights : array_like, shape (rows, columns)
        Metres; rows go from north to south, columns from west to east.
    spacing : float
        Metres between neighbours.
    albedo, emissivity : float or array_like, shape (facets,)
    rays : int
        From each facet.
    """

    def __init__(
        self,
        heights: npt.ArrayLike,
        spacing: float,
        *,
        albedo: npt.ArrayLike = 0.12,
        emissivity: npt.ArrayLike = 0.95,
        rays: int = 512,
        seed: int = 0,
        progress: Progress = None,
    ) -> None:
        field = np.asarray(heights, dtype=np.float32)
        rows, columns = field.shape
        z, x = np.meshgrid(np.arange(rows) * spacing, np.arange(columns) * spacing, indexing="ij")
        self.vertices = np.stack([x, field, z], axis=-1).reshape(-1, 3).astype(np.float32)
        number = np.arange(rows * columns, dtype=np.uint32).reshape(rows, columns)
        nw, ne, sw, se = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
        self.faces = np.stack([np.stack([nw, sw, se], -1), np.stack([nw, se, ne], -1)], axis=2).reshape(-1, 3)
        self.shape = (rows - 1, columns - 1, 2)
        corners = self.vertices[self.faces]
        twice = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.normals = vectors(twice / np.linalg.norm(twice, axis=1, keepdims=True), "normals")
        self.centroids = vectors(corners.mean(axis=1), "centroids")
        self.factors: ViewFactors = view_factors(
            (self.vertices, self.faces), "rays", rays=rays, seed=seed, progress=progress
        )
        count = len(self.faces)
        self.albedo = np.broadcast_to(np.asarray(albedo, dtype=float), (count,))
        self.emissivity = np.broadcast_to(np.asarray(emissivity, dtype=float), (count,))
        self._scene = Scene(self.vertices, self.faces, 0.5, name="terrain")

    def direct(self, suns: npt.ArrayLike, flux: npt.ArrayLike, *, progress: Progress = None) -> Float64:
        """Direct irradiance, W/m², ``(facets, suns)``, of suns in these directions (towards them) with these fluxes on a
        surface that faces them."""
        towards = vectors(suns, "suns")
        offsets = np.arange(len(self.faces) + 1, dtype=np.uint32)
        callback: Any = progress if callable(progress) else None
        seen = self._scene._core.sun_rows(self.centroids, self.normals, offsets, towards, callback)
        falling: Float64 = seen.astype(float) * np.broadcast_to(np.asarray(flux, dtype=float), (len(towards),))
        return falling

    def absorbed(self, suns: npt.ArrayLike, flux: npt.ArrayLike, *, sky: float = 0.0) -> Float64:
        """Absorbed sunlight, W/m², ``(facets, suns)``, all reflections between slopes included; ``sky`` is the irradiance
        of an open horizontal surface from an even sky."""
        falling = self.direct(suns, flux) + sky * self.factors.sky[:, np.newaxis]
        albedo = np.broadcast_to(self.albedo[:, np.newaxis], falling.shape)
        _, indirect = radiosity(self.factors, albedo * falling, albedo, tolerance=1e-6)
        found: Float64 = (1 - albedo) * (falling + indirect)
        return found

    def equilibrium(
        self, absorbed: npt.ArrayLike, *, internal: float = 0.0, sky_temperature: float = 3.0, iterations: int = 100
    ) -> Float64:
        """Temperatures, K, in the shape of ``absorbed``, of ground that radiates away what it absorbs of sunlight and of
        the heat of slopes around, and ``internal`` W/m² from below."""
        solar = np.asarray(absorbed, dtype=float)
        table = solar.reshape(len(self.faces), -1)
        epsilon = self.emissivity[:, np.newaxis]
        sky = self.factors.sky[:, np.newaxis] * STEFAN_BOLTZMANN * sky_temperature**4
        emitted = table + internal
        for _ in range(iterations):
            leaving = emitted + (1 - epsilon) * (self.factors @ emitted + sky)
            following = table + internal + epsilon * (self.factors @ leaving + sky)
            change = np.abs(following - emitted).max()
            emitted = following
            if change <= 1e-9 * max(emitted.max(), 1e-30):
                break
        kelvins: Float64 = (np.maximum(emitted, 0) / (epsilon * STEFAN_BOLTZMANN)) ** 0.25
        return kelvins.reshape(solar.shape)
