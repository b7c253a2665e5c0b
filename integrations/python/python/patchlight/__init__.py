"""Diffuse light transport as matrices.

A *bake* holds everything about a scene that does not shine: patches of its surfaces, the form factors between them, and
receivers. Under it, light is linear: ``irradiance = P T D x`` with powers of lights ``x``, their direct light ``D``, all
bounces ``T``, and points of one's own ``P``. Each is at hand as a matrix or a :class:`scipy.sparse.linalg.LinearOperator`
with its exact adjoint, and an update of all lights takes milliseconds.

>>> import patchlight
>>> scene = patchlight.Scene.load("cornell")
>>> bake = scene.bake(patches=300)
>>> light = bake.update()
>>> light.patches.shape
(300, 3)

Units: metres; irradiance and exitance W/m², radiance W/m²/sr, linear Rec.709 RGB; ``+y`` points upwards, ``-z`` north,
``+x`` east. Photometric quantities (``lux``, ``lumens``, ``candela``, ``nits``) are converted by
:data:`LUMENS_PER_WATT`.
"""

from . import daylight, heat, howell, inverse, plots, terrain
from ._arrays import illuminance
from ._bake import Bake, Camera, Irradiance, LightField, PointSet, Surfaces
from ._core import (
    LUMENS_PER_WATT,
    Cancelled,
    DeviceError,
    FileError,
    InputError,
    OutOfMemoryError,
    PatchlightError,
    UnsupportedError,
    __version__,
)
from ._operators import AllBounces, LightToPoints, PointTransport
from ._scene import Light, Scene, Sky, built_in_scenes
from ._view_factors import ViewFactors, radiosity, view_factors

__all__ = [
    "AllBounces",
    "Bake",
    "Camera",
    "Cancelled",
    "DeviceError",
    "FileError",
    "InputError",
    "Irradiance",
    "LUMENS_PER_WATT",
    "Light",
    "LightField",
    "LightToPoints",
    "OutOfMemoryError",
    "PatchlightError",
    "PointSet",
    "PointTransport",
    "Scene",
    "Sky",
    "Surfaces",
    "UnsupportedError",
    "ViewFactors",
    "__version__",
    "built_in_scenes",
    "daylight",
    "heat",
    "howell",
    "illuminance",
    "inverse",
    "plots",
    "radiosity",
    "terrain",
    "view_factors",
]
