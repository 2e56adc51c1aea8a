"""Stored scenes with a known radiosity: closed forms for the furnaces, converged Mitsuba references for the rest.

Where each file came from stands in `tests/data/README.md`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import radiosity as rad
from radiosity.references import Reference, relative_error

__all__ = ["NAMES", "Reference", "load", "relative_error"]

FOLDER = Path(__file__).resolve().parents[1] / "data" / "scenes"
NAMES = sorted(file.stem for file in FOLDER.glob("*.npz"))


def load(name: str) -> Reference:
    """Load a stored reference by its file's name without `.npz`; `NAMES` lists them."""
    with np.load(FOLDER / f"{name}.npz") as data:
        scene = rad.Scene(data["vertices"], data["faces"], reflectance=data["reflectance"], emission=data["emission"])
        if "exact" in data:
            return Reference(name, scene, data["exact"], np.zeros_like(data["exact"]))
        return Reference(name, scene, data["radiosity"], data["stderr"])
