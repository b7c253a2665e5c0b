"""Pictures: colours as they are displayed, false colours (matplotlib), and surfaces in 3D (pyvista)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from . import _core
from ._arrays import illuminance

if TYPE_CHECKING:
    from ._bake import Bake


def display(radiance: npt.ArrayLike, *, stops: float | None = None, tone: str = "agx") -> npt.NDArray[np.uint8]:
    """Bytes ``(height, width, 3)`` of a picture of radiances, for ``matplotlib.pyplot.imshow`` and files.

    ``stops`` is the exposure, by default one that suits the picture; ``tone`` is ``"agx"``, ``"neutral"`` or ``"none"``.
    """
    array = np.ascontiguousarray(radiance, dtype=np.float32)
    if array.ndim != 3 or array.shape[2] != 3:
        raise _core.InputError(f"a picture of the shape {array.shape}; give rows, columns and RGB")
    shown, _ = _core.displayed(array, stops, tone)
    return shown


def false_colours(irradiance: npt.ArrayLike, *, axes: Any = None, most: float | None = None, label: str = "lx") -> Any:
    """Shows a picture ``(height, width, 3)`` of irradiances as illuminance in false colours; returns matplotlib's image."""
    import matplotlib.pyplot as plt

    values = illuminance(irradiance)
    own = plt.gca() if axes is None else axes
    image = own.imshow(values, cmap="viridis", vmin=0, vmax=float(np.percentile(values, 99)) if most is None else most)
    own.set_axis_off()
    own.figure.colorbar(image, ax=own, label=label)
    return image


def as_pyvista(bake: Bake, corners: npt.ArrayLike, name: str = "illuminance") -> Any:
    """A ``pyvista.PolyData`` of the bake's triangles with light at their corners (:meth:`Irradiance.corners`)."""
    import pyvista

    triangles = bake._own_scene.triangles().reshape(-1, 3)
    faces = np.arange(len(triangles)).reshape(-1, 3)
    surface: Any = pyvista.PolyData.from_regular_faces(triangles.tolist(), faces.tolist())
    surface.point_data[name] = illuminance(np.asarray(corners).reshape(-1, 3))
    return surface
