"""View factors between the facets of a mesh, and radiosity with them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse

from . import _core
from ._arrays import Float64, Progress, showing, triples, vectors

#: Facets up to which ``method="auto"`` takes contour sums: there they are no slower than rays.
CONTOUR_FACETS = 1500


class ViewFactors(sparse.csr_array):  # type: ignore[misc]
    """A sparse matrix ``(n, n)``: ``F[i, j]`` is the share of what leaves facet i that arrives at facet j.

    Attributes
    ----------
    areas : ndarray, shape (n,)
        m².
    error : ndarray, shape (n,)
        Standard error of each row, ``√Σ_j σ_ij²``, from the two halves of its rays; 0 where contour sums see no obstacle.
    sky : ndarray, shape (n,)
        Share of each facet's hemisphere that sees no facet at all; of contour sums what is left of 1.
    """

    areas: Float64
    error: Float64
    sky: Float64

    @property
    def closure_error(self) -> float:
        """Greatest ``|Σ_j F_ij + F_i0 - 1|``: beside noise the share of a hemisphere that the backs of facets fill."""
        return float(np.abs(self.sum(axis=1) + self.sky - 1).max())

    @property
    def reciprocity_error(self) -> float:
        """Greatest ``|A_i F_ij - A_j F_ji|`` over the greatest ``A_i F_ij``."""
        products = sparse.diags_array(self.areas) @ sparse.csr_array(self)
        most = abs(products).max()
        return float(abs(products - products.T).max() / most) if most > 0 else 0.0

    def between(self, receiver: Any, source: Any) -> float:
        """The view factor from one group of facets to another: ``Σ A_i F_ij / Σ A_i`` over facet numbers or masks."""
        rows = np.arange(self.shape[0])[receiver]
        columns = np.arange(self.shape[0])[source]
        block = sparse.csr_array(self)[rows][:, columns]
        return float(self.areas[rows] @ block.sum(axis=1) / self.areas[rows].sum())


def _triangles(mesh: Any) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    """Vertices and triangles of whatever a mesh is."""
    if isinstance(mesh, tuple):
        return vectors(mesh[0], "vertices"), triples(mesh[1], "faces")
    if hasattr(mesh, "extract_surface") or hasattr(mesh, "regular_faces"):
        surface = mesh if hasattr(mesh, "regular_faces") else mesh.extract_surface(algorithm="dataset_surface")
        surface = surface.triangulate()
        return vectors(surface.points, "points"), triples(surface.regular_faces, "faces")
    return vectors(mesh.vertices, "vertices"), triples(mesh.faces, "faces")


def view_factors(
    mesh: Any,
    method: str = "auto",
    *,
    rays: int = 4096,
    shadow_rays: int = 32,
    obstruction: bool = True,
    reciprocal: bool = True,
    seed: int = 0,
    progress: Progress = None,
) -> ViewFactors:
    """View factors between all facets of a mesh.

    A facet has one side, from which its corners run counter-clockwise; from behind it is dark, and hides what lies beyond.

    Parameters
    ----------
    mesh : (vertices, faces), Scene, trimesh.Trimesh or pyvista.DataSet
        Triangles.
    method : {"auto", "contour", "rays"}
        Contour sums are exact between facets that see each other whole, and cost n² pairs; rays cost n · ``rays``. ``auto``
        takes contours up to :data:`CONTOUR_FACETS` facets, and where nothing obstructs.
    rays : int
        From each facet, cosine-weighted.
    shadow_rays : int
        Of each pair of contour sums; they find its visible share.
    obstruction : bool
        Without it facets hide nothing; contours only.
    reciprocal : bool
        Of rays: the two estimates of each pair are merged by their precision, so that ``A_i F_ij = A_j F_ji``.

    Returns
    -------
    ViewFactors

    Examples
    --------
    >>> import numpy as np, patchlight
    >>> square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    >>> vertices = np.vstack([square, square + [0, 0, 1]])
    >>> faces = [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]
    >>> factors = patchlight.view_factors((vertices, faces))
    >>> round(factors.between([0, 1], [2, 3]), 4)
    0.1998
    """
    vertices, faces = _triangles(mesh)
    if method not in ("auto", "contour", "rays"):
        raise _core.InputError(f"method is {method!r}; it must be 'auto', 'contour' or 'rays'")
    if method == "auto":
        method = "contour" if len(faces) <= CONTOUR_FACETS or not obstruction else "rays"
    if method == "rays" and not obstruction:
        raise _core.InputError("rays end on the first facet; without obstruction take method='contour'")
    if method == "contour":
        return _by_contours(vertices, faces, shadow_rays if obstruction else 0, seed, progress)
    return _by_rays(vertices, faces, rays, reciprocal, seed, progress)


def _finished(matrix: Any, areas: Float64, error: Float64, sky: Float64 | None) -> ViewFactors:
    made = ViewFactors(matrix)
    made.areas = areas
    made.error = error
    made.sky = np.clip(1 - np.asarray(made.sum(axis=1)), 0, 1) if sky is None else sky
    return made


def _by_contours(vertices: Any, faces: Any, shadow_rays: int, seed: int, progress: Progress) -> ViewFactors:
    with showing(progress) as callback:
        starts, columns, values, errors, areas = _core.by_contours(vertices, faces, shadow_rays, seed, callback)
    n = len(areas)
    inverse = sparse.diags_array(1 / areas)

    def both(entries: Float64) -> Any:
        upper = sparse.csr_array((entries, columns, starts), shape=(n, n))
        return (inverse @ (upper + upper.T)).tocsr()

    squares = both(errors)
    squares.data **= 2
    return _finished(both(values), areas, np.sqrt(np.asarray(squares.sum(axis=1))), None)


def _by_rays(vertices: Any, faces: Any, rays: int, reciprocal: bool, seed: int, progress: Progress) -> ViewFactors:
    with showing(progress) as callback:
        parts, differences, sky, areas = _core.by_rays(vertices, faces, rays, seed, callback)
    starts, columns, values, shape = parts
    index = np.int32 if len(values) < 2**31 else np.int64
    starts = starts.astype(index)
    columns = columns.astype(index, copy=False)

    def matrix(entries: Any) -> Any:
        made = sparse.csr_array((entries, columns, starts), shape=shape)
        return _merged(made, areas) if reciprocal else made

    squares = matrix(differences)
    squares.data **= 2
    error = np.sqrt(np.asarray(squares.sum(axis=1), dtype=float))
    del squares, differences
    return _finished(matrix(values), areas, error, sky.astype(float))


def _merged(factors: Any, areas: Float64) -> Any:
    """``(F_ij + F_ji) / (1/A_i + 1/A_j) / A_i``: the mean of both estimates of a pair by their precisions, for rows of
    equally many rays."""
    both = (factors + factors.T).tocsr()
    rows = np.repeat(np.arange(both.shape[0]), np.diff(both.indptr))
    # 1 / (1/A_i + 1/A_j) / A_i = A_j / (A_i + A_j).
    other = areas[both.indices]
    both.data *= (other / (areas[rows] + other)).astype(both.data.dtype)
    return both


def radiosity(
    factors: Any, emission: npt.ArrayLike, reflectance: npt.ArrayLike, *, tolerance: float = 1e-8
) -> tuple[Float64, Float64]:
    """Exitance and irradiance of facets, W/m²: ``B = E + ρ H``, ``H = F B`` (Goral et al. 1984).

    Parameters
    ----------
    factors : sparse matrix, shape (n, n)
        View factors.
    emission, reflectance : array_like, shape (n,) or (n, bands)
        W/m²; 0 to below 1.
    tolerance : float
        Relative residual.

    Returns
    -------
    exitance, irradiance : ndarray
        In the shape of the emission.
    """
    source = np.asarray(emission, dtype=float)
    albedo = np.broadcast_to(np.asarray(reflectance, dtype=float), source.shape)
    if (albedo < 0).any() or (albedo >= 1).any():
        raise _core.InputError("reflectance must be 0 to below 1")
    tables = source.reshape(len(source), -1), albedo.reshape(len(source), -1)
    bands = [_solved(factors, e, rho, tolerance) for e, rho in zip(tables[0].T, tables[1].T, strict=True)]
    exitance = np.stack(bands, axis=1)
    irradiance = np.asarray(factors @ exitance)
    return exitance.reshape(source.shape), irradiance.reshape(source.shape)


def _solved(factors: Any, source: Float64, albedo: Float64, tolerance: float) -> Float64:
    """``(1 - ρ F) B = E`` by BiCGSTAB, and by bounces where that does not settle."""
    n = len(source)
    system = sparse.linalg.LinearOperator((n, n), matvec=lambda b: b - albedo * (factors @ b), dtype=float)
    found, failed = sparse.linalg.bicgstab(system, source, x0=source.copy(), rtol=tolerance, atol=0.0, maxiter=500)
    if not failed and np.isfinite(found).all():
        return np.asarray(found)
    total = source
    for _ in range(10_000):
        following = source + albedo * (factors @ total)
        change = np.abs(following - total).max()
        total = following
        if change <= tolerance * np.abs(total).max():
            break
    return total
