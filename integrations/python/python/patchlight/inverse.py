"""Inverse lighting: what must shine, or reflect, for wanted light. Light is linear in its sources, and the adjoint gives
the gradient by every reflectance for the price of one more solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear, minimize
from scipy.sparse.linalg import LinearOperator

from ._arrays import Float64
from ._operators import AllBounces


#: Unknowns up to which an operator is made dense, if there are as many points.
FEW = 200


@dataclass(frozen=True)
class Solution:
    """What was found.

    Attributes
    ----------
    x : ndarray
        Factors of lights, or reflectances.
    residual : float
        Root of the mean square of what is missing, in the unit of the target.
    forward, adjoint : int
        Products that it took.
    """

    x: Float64
    residual: float
    forward: int
    adjoint: int


class Counted(LinearOperator):  # type: ignore[misc]
    """An operator that counts the columns it multiplies."""

    def __init__(self, operator: Any) -> None:
        self.operator = operator
        self.forward = 0
        self.adjoint = 0
        super().__init__(dtype=operator.dtype, shape=operator.shape)

    def _matvec(self, x: Any) -> Any:
        self.forward += 1
        return self.operator.matvec(x)

    def _rmatvec(self, x: Any) -> Any:
        self.adjoint += 1
        return self.operator.rmatvec(x)


def least_squares(
    operator: Any,
    target: npt.ArrayLike,
    *,
    bounds: tuple[npt.ArrayLike, npt.ArrayLike] = (0.0, np.inf),
    weights: npt.ArrayLike | None = None,
    damping: float = 0.0,
    tolerance: float = 1e-8,
) -> Solution:
    """The ``x`` within bounds with the least ``|W (A x - target)|² + damping² |x|²``.

    Parameters
    ----------
    operator : LinearOperator, shape (m, n)
        Such as :class:`patchlight.LightToPoints`. Up to :data:`FEW` unknowns a product with each makes it dense;
        beyond, it is multiplied, and its adjoint, and never made dense.
    target : array_like, shape (m,)
        Wanted irradiance, W/m².
    bounds : (lowest, highest)
        Numbers, or one for each light.
    weights : array_like, shape (m,), optional
        How much each point matters.
    """
    counted = Counted(operator)
    rows, columns = counted.shape
    wanted = np.asarray(target, dtype=float).reshape(-1)
    scale = np.ones(rows) if weights is None else np.asarray(weights, dtype=float).reshape(-1)
    if columns <= min(rows, FEW):
        # As many products as there are unknowns, and the rest is small.
        dense = np.vstack([scale[:, np.newaxis] * operator.matmat(np.eye(columns)), damping * np.eye(columns)])
        found = lsq_linear(dense, np.concatenate([scale * wanted, np.zeros(columns)]), bounds, tol=tolerance)
        missing = (dense[:rows] @ found.x) / np.where(scale == 0, 1, scale) - wanted
        return Solution(found.x, float(np.sqrt(np.mean(missing**2))), columns, 0)

    def forward(x: Float64) -> Float64:
        return np.concatenate([scale * counted.matvec(x), damping * np.asarray(x).reshape(-1)])

    def backward(y: Float64) -> Float64:
        y = np.asarray(y).reshape(-1)
        return np.asarray(counted.rmatvec(scale * y[:rows])) + damping * y[rows:]

    system = LinearOperator((rows + columns, columns), matvec=forward, rmatvec=backward, dtype=float)
    right = np.concatenate([scale * wanted, np.zeros(columns)])
    found = lsq_linear(system, right, bounds, tol=tolerance, lsmr_tol="auto", max_iter=200)
    missing = np.asarray(operator.matvec(found.x)) - wanted
    return Solution(found.x, float(np.sqrt(np.mean(missing**2))), counted.forward, counted.adjoint)


def reflectance_gradient(
    operator: AllBounces, direct: npt.ArrayLike, gradient: npt.ArrayLike | Callable[[Float64], Float64]
) -> tuple[Float64, Float64]:
    """Gradient of a function of the patches' irradiance by their reflectance.

    With ``B = ρ (H_d + H)`` and ``H = F B``, a change of ρ changes ``B`` by ``(1 - ρ F)⁻¹ (H_d + H) dρ``; one solution of
    the adjoint gives the derivatives by all ρ.

    Parameters
    ----------
    direct : array_like, shape (n, bands)
        Direct irradiance ``H_d`` of the patches, W/m².
    gradient : array_like, shape (n, bands)
        Derivatives of the function by ``H``, or a function of ``H`` that gives them.

    Returns
    -------
    irradiance, derivatives : ndarray, shape (n, bands)
        ``H``, and the derivatives by ρ.
    """
    own = np.asarray(direct, dtype=float)
    shape = operator.reflectance.shape
    source = operator.reflectance * own
    indirect = np.asarray(operator.matvec(source.reshape(-1))).reshape(shape)
    by_light = gradient(indirect) if callable(gradient) else np.asarray(gradient, dtype=float)
    adjoint = operator._backward(by_light.reshape(*shape, 1)).reshape(shape)
    return indirect, adjoint * (own + indirect)


def reflectances(
    factors: Any,
    direct: npt.ArrayLike,
    target: npt.ArrayLike,
    start: npt.ArrayLike,
    *,
    groups: npt.ArrayLike | None = None,
    weights: npt.ArrayLike | None = None,
    bounds: tuple[float, float] = (0.02, 0.9),
    iterations: int = 200,
) -> Solution:
    """Reflectances for wanted indirect irradiance of the patches, by L-BFGS-B with the adjoint's gradient.

    Parameters
    ----------
    factors : sparse matrix, shape (n, n)
        Form factors.
    direct, target, start : array_like, shape (n, bands)
        Direct irradiance, wanted indirect irradiance, W/m², and first reflectances.
    groups : array_like of int, shape (n,), optional
        Patches of one group have one reflectance; default: each its own.
    weights : array_like, shape (n,), optional
        How much each patch matters; 0 for those whose light is free.
    """
    own = np.asarray(direct, dtype=float)
    wanted = np.asarray(target, dtype=float)
    first = np.asarray(start, dtype=float)
    n, bands = own.shape
    number = np.arange(n) if groups is None else np.unique(np.asarray(groups), return_inverse=True)[1]
    count = int(number.max()) + 1
    scale = np.ones(n) if weights is None else np.asarray(weights, dtype=float)
    scale = scale[:, np.newaxis] / (scale.sum() * bands)
    products = [0, 0]

    def value(x: Float64) -> tuple[float, Float64]:
        operator = AllBounces(factors, x.reshape(count, bands)[number])
        products[0] += 1
        products[1] += 1
        irradiance, derivatives = reflectance_gradient(operator, own, lambda h: 2 * scale * (h - wanted))
        summed = np.zeros((count, bands))
        np.add.at(summed, number, derivatives)
        return float((scale * (irradiance - wanted) ** 2).sum()), summed.reshape(-1)

    members = np.bincount(number, minlength=count)[:, np.newaxis]
    begin = np.zeros((count, bands))
    np.add.at(begin, number, first)
    begin = np.clip(begin / members, *bounds)
    found = minimize(
        value, begin.reshape(-1), jac=True, method="L-BFGS-B", bounds=[bounds] * (count * bands),
        options={"maxiter": iterations},
    )  # fmt: skip
    return Solution(found.x.reshape(count, bands), float(np.sqrt(found.fun)), products[0], products[1])
