"""Built-in scenes whose radiosity is known: a closed form, or path tracing long converged, stored with the package.

    reference = radiosity.references.load("cornell")
    solution = radiosity.solve(reference.scene, tolerance=0.01)
    error, noise = relative_error(reference.scene, solution.radiosity, reference.radiosity, reference.standard_error)

    furnace        closed cube of one material: B = E / (1 - rho); smooth light, no shadows, no discretisation error
    cornell        the Cornell box that the package ships, 1,004 patches: a small lamp, soft shadows
    two_rooms      972 patches; half of the scene sees the lamp only through a doorway
    colonnade      588 patches; pillars throw shadows of two colours
    cornell_fine   the Cornell box in 7,936 patches

How each was made stands in `data/README.md` and `data/references/README.md` of the package.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import as_file, files
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from . import scenes
from .arrays import FloatArray, read_only
from .load import load as load_file

if TYPE_CHECKING:
    from .scene import Scene

__all__ = ["NAMES", "Reference", "load", "relative_error", "scene_of"]


@dataclass(frozen=True, eq=False)
class Reference:
    """A scene of n patches and b bands, and its patch averages of radiosity without discretisation error."""

    name: str
    scene: Scene
    radiosity: FloatArray
    """(n, b), W/m^2, emission included."""
    standard_error: FloatArray
    """(n, b), of `radiosity`; 0 where that is a closed form, or the emission alone because nothing is reflected."""

    @property
    def noise(self) -> float:
        """The relative standard error, measured as `relative_error` measures errors."""
        return relative_error(self.scene, self.radiosity, self.radiosity, self.standard_error)[1]


def load(name: str) -> Reference:
    """Return a reference by its name, one of `NAMES`.

    Raises:
        ValueError: an unknown name.

    """
    scene = scene_of(name)
    if name == "furnace":
        radiosity = scene.emission / (1.0 - scene.reflectance)
        return Reference(name, scene, read_only(radiosity), read_only(np.zeros_like(radiosity)))
    file = "cornell_box_reference.npz" if name == "cornell" else f"references/{name}.npz"
    with as_file(files("radiosity") / "data" / file) as path, np.load(path) as data:
        radiosity, standard_error = (data[key].astype(np.float64) for key in ("radiosity", "stderr"))
    return Reference(name, scene, read_only(radiosity), read_only(standard_error))


def scene_of(name: str) -> Scene:
    """Return the scene of a reference alone, its patches in the order of the stored rows."""
    if name not in _SCENES:
        raise ValueError(f"unknown reference {name!r}; valid are {', '.join(map(repr, NAMES))}")
    return _SCENES[name]()


def relative_error(
    scene: Scene, radiosity: FloatArray, reference: FloatArray, standard_error: npt.ArrayLike = 0.0
) -> tuple[float, float]:
    """Return the error of `radiosity` (n, b) and the part of it that is the reference's own noise.

    Both are the area-weighted RMS over patches and bands of dB over that of the reference's B - E: with E left in, a
    bright lamp would hide the error. The error has the noise already taken off, in quadrature, and is negative when
    less than nothing is left: -sqrt(noise^2 - error^2).
    """
    areas = scene.areas[:, None]

    def norm2(values: FloatArray) -> float:
        return float(np.sum(areas * values**2))

    light = norm2(reference - scene.emission)
    noise2 = norm2(np.broadcast_to(np.asarray(standard_error, dtype=np.float64), reference.shape)) / light
    error2 = norm2(radiosity - reference) / light - noise2
    return float(np.copysign(np.sqrt(abs(error2)), error2)), float(np.sqrt(noise2))


def _shipped_cornell_box() -> Scene:
    with as_file(files("radiosity") / "data" / "cornell_box.glb") as path:
        return load_file(path)


_SCENES: dict[str, Callable[[], Scene]] = {
    "furnace": lambda: scenes.furnace(reflectance=(0.3, 0.5, 0.8), emission=(1.0, 1.0, 1.0), max_edge=0.4),
    "cornell": _shipped_cornell_box,
    "two_rooms": lambda: scenes.two_rooms(max_edge=1.05),
    "colonnade": lambda: scenes.colonnade(max_edge=3.0),
    "cornell_fine": lambda: scenes.cornell_box(max_edge=0.035),
}
NAMES = tuple(_SCENES)
