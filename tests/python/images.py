"""The path-traced pictures of tests/data/images, and how far others are from them."""

from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parents[1] / "data" / "images"


def path_traced(name):
    """The picture, its standard error, and the pixels to compare (see make_image_references.py), 128 x 128."""
    with np.load(FOLDER / f"{name}_128.npz") as data:
        return data["image"].astype(float), data["stderr"].astype(float), data["beside"]


def relative_rmse(image, truth, pixels):
    """Of some pixels, the worst band."""
    return np.sqrt(((image - truth)[pixels] ** 2).sum(axis=0) / (truth[pixels] ** 2).sum(axis=0)).max()
