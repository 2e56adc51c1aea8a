"""Draws the pictures of docs/instant.md: `python docs/instant.py`."""

from pathlib import Path

import numpy as np

import radiosity as rad
from radiosity.render import to_srgb

FOLDER = Path(__file__).resolve().parent
VIEW = rad.Camera(**rad.scenes.cornell_box_view())
SIZE = 360
EXPOSURE = 4.0


def main() -> None:
    scene = rad.scenes.cornell_box()
    draw_lights(scene)
    draw_bound(scene)
    draw_maps(scene)


def draw_lights(scene) -> None:
    """The picture by number of lights."""
    shown = [(f"{count} lights", picture(scene, rad.virtual_lights(scene, count))) for count in (16, 64, 256, 1024)]
    draw("instant.png", [(title, to_srgb(image, EXPOSURE)) for title, image in shown])


def draw_bound(scene) -> None:
    """256 lights without a bound, bounded, and compensated; and what the bound takes away."""
    lights = rad.virtual_lights(scene, 256)
    unbounded = picture(scene, lights, bound=1e6 * lights.bound, compensate=False)
    cut, whole = (picture(scene, lights, compensate=compensate) for compensate in (False, True))
    share = (whole - cut).sum(axis=2) / whole.sum(axis=2).clip(1e-9)
    draw(
        "instant_bound.png",
        [
            ("no bound: spots", to_srgb(unbounded, EXPOSURE)),
            (f"bounded: {lights.share_cut(VIEW):.1%} is missing", to_srgb(cut, EXPOSURE)),
            ("bounded and compensated", to_srgb(whole, EXPOSURE)),
            ("share cut: black 0, white half", np.uint8(255 * np.clip(2.0 * share, 0.0, 1.0))),
        ],
    )


def draw_maps(scene) -> None:
    """Rays, maps of two resolutions, and where they differ."""
    lights = rad.virtual_lights(scene, 256)
    rays = picture(scene, lights, compensate=False)
    coarse, fine = (
        picture(scene, lights, shadows="maps", resolution=resolution, compensate=False) for resolution in (128, 1024)
    )
    # Sums of the bands against the mean of the picture: what is too dark is blue, what is too bright red.
    level = rays[rays.max(axis=2) < 0.5].sum(axis=1).mean()
    titles = ("maps of 128 less rays: +-10 %", "maps of 1024 less rays: +-10 %")
    differences = [((image - rays).sum(axis=2) / level / 0.1).clip(-1.0, 1.0) for image in (coarse, fine)]
    draw(
        "instant_maps.png",
        [
            ("rays", to_srgb(rays, EXPOSURE)),
            ("maps of 128 texels", to_srgb(coarse, EXPOSURE)),
            *((title, red_and_blue(values)) for title, values in zip(titles, differences, strict=True)),
        ],
    )


def picture(scene, lights, **options):
    return rad.instant(scene, VIEW, SIZE, SIZE, lights, progress=False, **options)


def red_and_blue(values):
    """-1 is blue, 0 white, 1 red."""
    colours = np.stack([1.0 + np.minimum(values, 0.0), 1.0 - np.abs(values), 1.0 - np.maximum(values, 0.0)], axis=2)
    return np.uint8(255 * colours)


def draw(name, panels) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 3.3), layout="constrained")
    for axes, (title, image) in zip(figure.subplots(1, len(panels)), panels, strict=True):
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        axes.set_title(title, fontsize=10)
        axes.set_axis_off()
    figure.savefig(FOLDER / name, dpi=80)


if __name__ == "__main__":
    main()
