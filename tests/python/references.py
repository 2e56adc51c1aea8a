"""Stored scenes with a known radiosity: closed forms for the furnaces, converged Mitsuba references for the rest.

Where each file came from stands in `tests/data/README.md`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import radiosity as rad

FOLDER = Path(__file__).resolve().parents[1] / "data" / "scenes"
NAMES = sorted(file.stem for file in FOLDER.glob("*.npz"))

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Reference:
    """A scene of n patches and 3 bands, and its patch averages of radiosity (n, 3), W/m^2."""

    name: str
    scene: rad.Scene
    radiosity: Array
    standard_error: Array
    """(n, 3), of `radiosity`; 0 where that is a closed form, or the emission alone because nothing is reflected."""


def load(name: str) -> Reference:
    """Load a stored reference by its file's name without `.npz`; `NAMES` lists them."""
    with np.load(FOLDER / f"{name}.npz") as data:
        scene = rad.Scene(data["vertices"], data["faces"], reflectance=data["reflectance"], emission=data["emission"])
        if "exact" in data:
            return Reference(name, scene, data["exact"], np.zeros_like(data["exact"]))
        return Reference(name, scene, data["radiosity"], data["stderr"])


def relative_error(
    scene: rad.Scene, radiosity: Array, reference: Array, standard_error: Array | float = 0.0
) -> tuple[float, float]:
    """Return the error of `radiosity` (n, b) and the part of it that is the reference's own noise.

    Both are the area-weighted RMS over patches and bands of dB over that of B - E: with E left in, a bright lamp would
    hide the error. The error has the noise already taken off, in quadrature, and is negative when less than nothing is
    left: -sqrt(noise^2 - error^2).
    """
    areas = scene.areas[:, None]

    def norm2(x: Array) -> float:
        return float(np.sum(areas * x**2))

    light = norm2(reference - scene.emission)
    noise2 = norm2(np.broadcast_to(standard_error, reference.shape)) / light
    error2 = norm2(radiosity - reference) / light - noise2
    return float(np.copysign(np.sqrt(abs(error2)), error2)), float(np.sqrt(noise2))
