"""Radiative exchange: temperatures and heat flows between diffuse surfaces, grey or in bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sparse

from . import _core
from ._arrays import Float64

#: Stefan-Boltzmann constant, W/m²/K⁴.
STEFAN_BOLTZMANN = 5.670374419e-8
#: Second radiation constant, µm K.
_C2 = 14387.768775


@dataclass(frozen=True)
class Exchange:
    """A steady state.

    Attributes
    ----------
    temperature : ndarray, shape (n,)
        K.
    net_flux : ndarray, shape (n,)
        What each surface gives away by radiation, W/m²: positive where it must be heated.
    radiosity, irradiance : ndarray, shape (n, bands)
        W/m².
    """

    temperature: Float64
    net_flux: Float64
    radiosity: Float64
    irradiance: Float64


def band_fractions(temperature: npt.ArrayLike, edges: npt.ArrayLike) -> Float64:
    """Share of a black body's emission below and between wavelengths ``edges``, µm, and above: ``(n, edges + 1)``.

    By the series of Planck's integral, ``F(0, λT) = 15/π⁴ Σ_k e^(-kx)/k (x³ + 3x²/k + 6x/k² + 6/k³)``, ``x = c₂/λT``.
    """
    kelvins = np.atleast_1d(np.asarray(temperature, dtype=float))
    x = _C2 / (np.asarray(edges, dtype=float)[np.newaxis, :] * np.maximum(kelvins, 1e-9)[:, np.newaxis])
    k = np.arange(1, 100)[:, np.newaxis, np.newaxis]
    with np.errstate(over="ignore", under="ignore"):
        terms = np.exp(-k * x) / k * (x**3 + 3 * x**2 / k + 6 * x / k**2 + 6 / k**3)
    below = 15 / np.pi**4 * terms.sum(axis=0)
    # Few terms do not reach where x is small: there nearly all of it is below.
    below = np.where(x < 0.01, 1 - 15 / np.pi**4 * (x**3 / 3 - x**4 / 8), below)
    ends = np.hstack([np.zeros((len(kelvins), 1)), np.clip(below, 0, 1), np.ones((len(kelvins), 1))])
    return np.diff(ends, axis=1)


def exchange(
    factors: Any,
    emissivity: npt.ArrayLike,
    *,
    temperature: npt.ArrayLike,
    net_flux: npt.ArrayLike | None = None,
    surroundings: float = 0.0,
    edges: npt.ArrayLike | None = None,
    tolerance: float = 1e-9,
) -> Exchange:
    """The steady state of surfaces that exchange heat by radiation alone.

    Of each surface either the temperature is known, or the flux that it gives away (0 of an insulated one).

    Parameters
    ----------
    factors : sparse matrix, shape (n, n)
        View factors; what the rows lack of 1 goes to the surroundings.
    emissivity : array_like, shape (n,) or (n, bands)
        Above 0, at most 1.
    temperature : array_like, shape (n,)
        K; NaN where the flux is known.
    net_flux : array_like, shape (n,), optional
        W/m²; read where the temperature is NaN. Default: insulated.
    surroundings : float
        Temperature, K, of black surroundings.
    edges : array_like, shape (bands - 1,), optional
        Wavelengths between the bands, µm; default: grey.

    Returns
    -------
    Exchange
    """
    known = np.asarray(temperature, dtype=float)
    n = len(known)
    epsilon = np.asarray(emissivity, dtype=float)
    epsilon = np.broadcast_to(epsilon.reshape(n, -1) if epsilon.ndim else epsilon, (n, epsilon.size // n or 1))
    cuts = np.empty(0) if edges is None else np.asarray(edges, dtype=float)
    if epsilon.shape[1] != len(cuts) + 1:
        raise _core.InputError(f"{epsilon.shape[1]} bands of emissivity, and {len(cuts)} wavelengths between bands")
    if (epsilon <= 0).any() or (epsilon > 1).any():
        raise _core.InputError("emissivity must be above 0 and at most 1")
    wanted = np.zeros(n) if net_flux is None else np.asarray(net_flux, dtype=float)
    free = np.isnan(known)
    matrix = sparse.csr_array(factors)
    beyond = np.clip(1 - np.asarray(matrix.sum(axis=1)), 0, None)

    def black(kelvins: Float64) -> Float64:
        return STEFAN_BOLTZMANN * kelvins[:, np.newaxis] ** 4 * band_fractions(kelvins, cuts)

    outside = beyond[:, np.newaxis] * black(np.array([surroundings]))

    def solved(kelvins: Float64) -> tuple[Float64, Float64]:
        emitted = epsilon * black(kelvins)
        bands = range(epsilon.shape[1])
        leaving = np.stack(
            [_solve(matrix, emitted[:, b] + (1 - epsilon[:, b]) * outside[:, b], 1 - epsilon[:, b]) for b in bands], axis=1
        )
        return leaving, matrix @ leaving + outside

    if free.any() and len(cuts) == 0:
        # Grey: linear in the radiosities. A surface of known flux sends what falls on it and that flux.
        own = epsilon[:, 0]
        source = np.where(free, wanted, own * black(np.where(free, 0, known))[:, 0])
        share = np.where(free, 1.0, 1 - own)
        leaving = _solve(matrix, source + share * outside[:, 0], share)
        falling = matrix @ leaving + outside[:, 0]
        net = leaving - falling
        power = np.where(free, leaving + (1 - own) / own * net, STEFAN_BOLTZMANN * np.where(free, 0, known) ** 4)
        kelvins = np.where(free, (np.maximum(power, 0) / STEFAN_BOLTZMANN) ** 0.25, known)
        return Exchange(kelvins, net, leaving[:, np.newaxis], falling[:, np.newaxis])
    kelvins = np.where(free, np.nanmean(known) if not free.all() else 300.0, known)
    for _ in range(500):
        leaving, falling = solved(kelvins)
        net = (leaving - falling).sum(axis=1)
        missing = np.where(free, wanted - net, 0.0)
        scale = STEFAN_BOLTZMANN * kelvins**4
        if not free.any() or np.abs(missing).max() <= tolerance * scale.max():
            break
        # Newton by what a surface alone would send more.
        slope = 4 * STEFAN_BOLTZMANN * kelvins**3 * (epsilon * band_fractions(kelvins, cuts)).sum(axis=1)
        kelvins = np.where(free, np.maximum(kelvins + missing / np.maximum(slope, 1e-30), 1e-3), known)
    return Exchange(kelvins, net, leaving, falling)


def _solve(factors: Any, source: Float64, share: Float64) -> Float64:
    """``J = source + share (F J)``."""
    n = len(source)
    if n <= 3000:
        dense = np.eye(n) - share[:, np.newaxis] * factors.toarray()
        return np.linalg.solve(dense, source)
    system = sparse.linalg.LinearOperator((n, n), matvec=lambda j: j - share * (factors @ j), dtype=float)
    found, failed = sparse.linalg.gmres(system, source, x0=source.copy(), rtol=1e-10, atol=0.0, restart=60, maxiter=200)
    if failed:
        raise _core.InputError("the exchange does not settle: is there a surface whose temperature is known, or an opening?")
    return np.asarray(found)
