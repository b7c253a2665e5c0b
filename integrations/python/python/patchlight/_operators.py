"""The chain ``irradiance = P T D x`` as linear operators with exact adjoints.

Of a bake, in the names of radiosity (Goral et al. 1984; elements: Cohen, Greenberg et al. 1986):

- ``e`` first exitance of the elements, W/m²; patches have its mean ``E = S e``;
- all bounces between patches, ``B = E + ρ F B``, and their irradiance ``H = F B``;
- the last two bounces by elements, which are finer: ``b = e + ρ G (e + ρ Sᵗ H)``, with their own form factors ``G``;
- points gather from elements, ``h = P b``.

Vectors are flat: ``n`` patches of ``c`` bands are ``n · c`` numbers, band after band of a patch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse
from scipy.sparse.linalg import LinearOperator

from ._arrays import Float64

if TYPE_CHECKING:
    from ._bake import Bake

Matrix = Any


class _Banded(LinearOperator):  # type: ignore[misc]
    """An operator on tables ``(columns, bands, vectors)`` behind flat vectors."""

    def __init__(self, rows: int, columns: int, bands: int) -> None:
        self.bands = bands
        self._rows = rows
        self._columns = columns
        super().__init__(dtype=np.dtype(np.float64), shape=(rows * bands, columns * bands))

    def _forward(self, table: Float64) -> Float64:
        raise NotImplementedError

    def _backward(self, table: Float64) -> Float64:
        raise NotImplementedError

    def _matmat(self, X: npt.ArrayLike) -> Float64:
        flat = np.asarray(X, dtype=float)
        table = flat.reshape(self._columns, self.bands, -1)
        return self._forward(table).reshape(self._rows * self.bands, -1)

    def _rmatmat(self, X: npt.ArrayLike) -> Float64:
        flat = np.asarray(X, dtype=float)
        table = flat.reshape(self._rows, self.bands, -1)
        return self._backward(table).reshape(self._columns * self.bands, -1)

    def _matvec(self, x: npt.ArrayLike) -> Float64:
        return self._matmat(np.asarray(x).reshape(-1, 1)).reshape(-1)

    def _rmatvec(self, x: npt.ArrayLike) -> Float64:
        return self._rmatmat(np.asarray(x).reshape(-1, 1)).reshape(-1)


def _product(matrix: Matrix, table: Float64) -> Float64:
    """A sparse matrix times a table of any number of axes."""
    flat = matrix @ table.reshape(table.shape[0], -1)
    return np.asarray(flat).reshape(matrix.shape[0], *table.shape[1:])


class AllBounces(_Banded):
    """The operator of all bounces between patches: first exitance to irradiance, W/m², ``H = F (1 - ρ F)⁻¹ E``.

    ``bands`` numbers a patch. The adjoint is exact: both go through the same number of bounces.

    Parameters
    ----------
    factors : sparse matrix, shape (n, n)
        Form factors.
    reflectance : ndarray, shape (n, bands)
    tolerance : float
        Bounces end when the brightest patch of an even source changes by no more than this share.
    """

    def __init__(self, factors: Matrix, reflectance: npt.ArrayLike, *, tolerance: float = 1e-6) -> None:
        albedo = np.asarray(reflectance, dtype=float)
        if albedo.ndim == 1:
            albedo = albedo[:, np.newaxis]
        n = factors.shape[0]
        if albedo.shape[0] != n or factors.shape[1] != n:
            raise ValueError(f"{factors.shape} form factors and the reflectance of {albedo.shape[0]} patches")
        super().__init__(n, n, albedo.shape[1])
        self.form_factors = factors
        self.reflectance = albedo
        self._transposed = factors.T.tocsr()
        self.bounces = self._count(tolerance)

    def _count(self, tolerance: float) -> int:
        """Bounces after which an even source changes nothing any more."""
        change = np.ones((self.reflectance.shape[0], 1))
        albedo = self.reflectance.max(axis=1, keepdims=True)
        whole = change
        for bounce in range(1, 1000):
            change = albedo * _product(self.form_factors, change)
            whole = whole + change
            if change.max() <= tolerance * whole.max():
                return bounce
        return 1000

    def exitance(self, source: Float64) -> Float64:
        """``B = Σ (ρ F)ᵏ E`` of a table ``(n, bands, …)``."""
        albedo = self.reflectance.reshape(*self.reflectance.shape, *[1] * (source.ndim - 2))
        total = source
        for _ in range(self.bounces):
            total = source + albedo * _product(self.form_factors, total)
        return total

    def _exitance_adjoint(self, table: Float64) -> Float64:
        albedo = self.reflectance.reshape(*self.reflectance.shape, *[1] * (table.ndim - 2))
        total = table
        for _ in range(self.bounces):
            total = table + _product(self._transposed, albedo * total)
        return total

    def _forward(self, table: Float64) -> Float64:
        return _product(self.form_factors, self.exitance(table))

    def _backward(self, table: Float64) -> Float64:
        return self._exitance_adjoint(_product(self._transposed, table))


class PointTransport(_Banded):
    """From the first exitance of elements to the indirect irradiance of points, W/m²: all bounces and the last gather.

    Made by :meth:`Bake.to_points`.
    """

    def __init__(self, bake: Bake, rows: Matrix, reflectance: Float64 | None, patch_operator: AllBounces) -> None:
        albedo = bake.elements.reflectance.astype(float) if reflectance is None else reflectance
        super().__init__(rows.shape[0], rows.shape[1], albedo.shape[1])
        self.rows = rows
        self.patches = patch_operator
        self._rows_transposed = rows.T.tocsr()
        self._albedo = albedo[:, :, np.newaxis]
        self._shares = bake.element_shares
        self._spread = (self._shares.T.tocsr() > 0).astype(float)
        self._factors = bake.element_form_factors
        self._factors_transposed = self._factors.T.tocsr()

    def _forward(self, table: Float64) -> Float64:
        of_patches = self.patches._forward(_product(self._shares, table))
        exitance = table + self._albedo * _product(self._spread, of_patches)
        exitance = table + self._albedo * _product(self._factors, exitance)
        return _product(self.rows, exitance)

    def _backward(self, table: Float64) -> Float64:
        gathered = _product(self._rows_transposed, table)
        before = _product(self._factors_transposed, self._albedo * gathered)
        of_patches = _product(self._spread.T.tocsr(), self._albedo * before)
        source = _product(self._shares.T.tocsr(), self.patches._backward(of_patches))
        return gathered + before + source


class LightToPoints(LinearOperator):  # type: ignore[misc]
    """From factors of lights to the whole irradiance of points: ``x ↦ P T D x + D' x``.

    ``x`` has one number a light; results are ``(points · bands,)``. Made by :meth:`Bake.lights_to_points`.

    Attributes
    ----------
    direct : ndarray, shape (elements, bands, lights)
        First exitance that each light alone gives the elements, W/m².
    direct_at_points : ndarray, shape (points, bands, lights)
        Its direct irradiance of the points, W/m².
    """

    def __init__(self, transport: PointTransport, direct: Float64, direct_at_points: Float64) -> None:
        self.transport = transport
        self.direct = direct
        self.direct_at_points = direct_at_points
        rows = transport.shape[0]
        self._flat = direct.reshape(-1, direct.shape[2])
        self._flat_points = direct_at_points.reshape(rows, direct.shape[2])
        super().__init__(dtype=np.dtype(np.float64), shape=(rows, direct.shape[2]))

    def _matmat(self, X: npt.ArrayLike) -> Float64:
        factors = np.asarray(X, dtype=float)
        found: Float64 = self.transport.matmat(self._flat @ factors) + self._flat_points @ factors
        return found

    def _rmatmat(self, X: npt.ArrayLike) -> Float64:
        values = np.asarray(X, dtype=float)
        found: Float64 = self._flat.T @ self.transport.rmatmat(values) + self._flat_points.T @ values
        return found

    def _matvec(self, x: npt.ArrayLike) -> Float64:
        return self._matmat(np.asarray(x).reshape(-1, 1)).reshape(-1)

    def _rmatvec(self, x: npt.ArrayLike) -> Float64:
        return self._rmatmat(np.asarray(x).reshape(-1, 1)).reshape(-1)

    def dense(self) -> Float64:
        """The matrix ``(points · bands, lights)``: a column a light."""
        return self._matmat(np.eye(self.shape[1]))


def shares_of(first: npt.NDArray[np.uint32], areas: npt.NDArray[np.float32]) -> Matrix:
    """Means of elements over patches by area, ``(patches, elements)``."""
    starts = first.astype(np.int64)
    weights = areas.astype(float)
    sums = np.add.reduceat(weights, starts[:-1])
    values = weights / np.repeat(sums, np.diff(starts))
    columns = np.arange(len(areas))
    return sparse.csr_array((values, columns, starts), shape=(len(starts) - 1, len(areas)))
