"""Stored scenes with a known radiosity: closed forms for the furnaces, converged Mitsuba references for the rest.

Where each file came from stands in `tests/data/README.md`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import radiosity as rad
from radiosity.references import Reference, relative_error

__all__ = ["NAMES", "Reference", "error_of_the_worst_band", "load", "relative_error"]

FOLDER = Path(__file__).resolve().parents[1] / "data" / "scenes"
NAMES = sorted(file.stem for file in FOLDER.glob("*.npz"))


def load(name: str) -> Reference:
    """Load a stored reference by its file's name without `.npz`; `NAMES` lists them."""
    with np.load(FOLDER / f"{name}.npz") as data:
        scene = rad.Scene(data["vertices"], data["faces"], reflectance=data["reflectance"], emission=data["emission"])
        if "exact" in data:
            return Reference(name, scene, data["exact"], np.zeros_like(data["exact"]))
        return Reference(name, scene, data["radiosity"], data["stderr"])


def error_of_the_worst_band(reference: Reference, solution: rad.Solution) -> tuple[float, float]:
    """The error that `solve` promises, and the noise of the reference in the same band."""
    scene = reference.scene
    bands = []
    for b in range(scene.bands):
        band = scene.with_materials(scene.reflectance[:, [b]], scene.emission[:, [b]])
        columns = (solution.radiosity, reference.radiosity, reference.standard_error)
        bands.append(relative_error(band, *(values[:, [b]] for values in columns)))
    return max(bands)
