"""Arrays, quantities and progress, as the extension module takes them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, Union

import numpy as np
import numpy.typing as npt

from . import _core

#: Called with the name of a phase, the steps that are done, and all steps of the phase.
ProgressCallback = Callable[[str, int, int], Any]
#: ``True`` shows a bar (tqdm's where it is installed), a function is called now and then, ``None`` shows nothing.
Progress = Union[bool, ProgressCallback, None]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Rgb = tuple[float, float, float]

#: Luminance of linear Rec.709 RGB.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def vectors(values: npt.ArrayLike, name: str) -> Float32:
    """``values`` as a contiguous array ``(n, 3)``; a copy only where it is none already."""
    array = np.ascontiguousarray(values, dtype=np.float32)
    if array.ndim == 1 and array.size == 3:
        array = array.reshape(1, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        raise _core.InputError(f"{name} has the shape {array.shape}; give rows of x, y and z")
    return array


def triples(values: npt.ArrayLike, name: str) -> npt.NDArray[np.uint32]:
    """Corners of triangles ``(m, 3)``."""
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise _core.InputError(f"{name} has the shape {array.shape}; give rows of three vertex numbers")
    if array.size and (array.min() < 0 or array.max() >= 2**32):
        raise _core.InputError(f"{name} has vertex {array.min() if array.min() < 0 else array.max()}")
    return np.ascontiguousarray(array, dtype=np.uint32)


def rgb(value: npt.ArrayLike, name: str) -> Rgb:
    """A number for all three channels, or one for each."""
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        array = np.full(3, float(array))
    if array.shape != (3,):
        raise _core.InputError(f"{name} has the shape {array.shape}; give one number, or red, green and blue")
    return float(array[0]), float(array[1]), float(array[2])


def place(value: npt.ArrayLike, name: str) -> Rgb:
    """A position or a direction."""
    array = np.asarray(value, dtype=float)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise _core.InputError(f"{name} is {value!r}; give finite x, y and z")
    return float(array[0]), float(array[1]), float(array[2])


def quantity(units: dict[str, tuple[npt.ArrayLike | None, float]], tint: npt.ArrayLike | None) -> Rgb:
    """A quantity in the first unit of ``units``, by the one of them that is given.

    The first is radiometric RGB; the others are ``name: (value, factor)``, white light of so many lumens and the like,
    coloured by ``tint``.
    """
    given = [(name, value, factor) for name, (value, factor) in units.items() if value is not None]
    if len(given) != 1:
        raise _core.InputError(f"give one of {', '.join(units)}; {len(given)} are given")
    name, value, factor = given[0]
    assert value is not None
    colour = np.array(rgb(value, name)) * factor
    if (colour < 0).any() or not np.isfinite(colour).all():
        raise _core.InputError(f"{name} is {value!r}; light is finite and not negative")
    if tint is not None:
        hue = np.array(rgb(tint, "tint"))
        brightness = float(_LUMINANCE @ hue)
        if brightness <= 0:
            raise _core.InputError("a tint of black has no hue")
        colour = hue * (float(_LUMINANCE @ colour) / brightness)
    return float(colour[0]), float(colour[1]), float(colour[2])


def illuminance(irradiance: npt.ArrayLike) -> Float64:
    """Illuminance, lx, of irradiances, W/m²: the last axis is RGB."""
    values: Float64 = np.asarray(irradiance, dtype=float) @ _LUMINANCE * _core.LUMENS_PER_WATT
    return values


class _Bar:
    """A bar a phase."""

    def __init__(self) -> None:
        self.phase: str | None = None
        self.bar: Any = None
        try:
            from tqdm.auto import tqdm

            self.tqdm: Any = tqdm
        except ImportError:
            self.tqdm = None

    def __call__(self, phase: str, done: int, total: int) -> None:
        if self.tqdm is None:
            share = 100 * done // max(total, 1)
            sys.stderr.write(f"\r{phase}: {share} %   ")
            sys.stderr.flush()
            return
        if phase != self.phase:
            self.close()
            self.phase = phase
            self.bar = self.tqdm(total=total, desc=phase, leave=False)
        self.bar.total = total
        self.bar.n = min(done, total)
        self.bar.refresh()

    def close(self) -> None:
        if self.bar is not None:
            self.bar.close()
        elif self.phase is None and self.tqdm is None:
            sys.stderr.write("\r")


class showing:
    """The callback of a ``progress`` argument, for the time of a ``with`` block."""

    def __init__(self, progress: Progress) -> None:
        self.bar = _Bar() if progress is True else None
        self.callback: ProgressCallback | None = self.bar
        if callable(progress):
            self.callback = progress

    def __enter__(self) -> ProgressCallback | None:
        return self.callback

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.close()
