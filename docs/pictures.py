"""Draws the pictures of docs/viewing.md, two_pass.md, sky.md and index.md: `python docs/pictures.py [name ...]`."""

import sys
from pathlib import Path
from time import perf_counter

import numpy as np

import radiosity as rad
from radiosity.render import to_srgb

FOLDER = Path(__file__).resolve().parent


def theatre() -> None:
    scene = rad.scenes.theatre()
    solution = timed("theatre, solve to 5 %", lambda: rad.solve(scene, 0.05, progress=False))
    picture("theatre", solution, rad.scenes.theatre_view(), (800, 450), 0.03)


def gallery() -> None:
    solution = timed("gallery, solve to 2 %", lambda: rad.solve(rad.scenes.gallery(), 0.02, progress=False))
    picture("gallery", solution, rad.scenes.gallery_view(), (800, 450), 0.015)


def shadings() -> None:
    """The Cornell box flat, smooth, on adaptive elements, and gathered."""
    from matplotlib.figure import Figure

    scene, camera = rad.scenes.cornell_box(max_edge=0.1), rad.Camera(**rad.scenes.cornell_box_view())
    rays = rad.solve(scene, 0.01, progress=False)
    links = rad.solve(scene, 0.03, "hierarchical", progress=False)
    figure = Figure(figsize=(12.0, 3.3), layout="constrained")
    panels = figure.subplots(1, 4)
    shown = [("flat", rays, "flat"), ("smooth", rays, "smooth"), ("hierarchical, smooth", links, "smooth")]
    for panel, (title, solution, shading) in zip(panels, [*shown, ("gather", rays, "gather")], strict=True):
        start = perf_counter()
        image = rad.render(solution, camera, 400, 400, shading, tolerance=0.01, progress=False)
        seconds = perf_counter() - start
        panel.imshow(to_srgb(image, 4.0))
        panel.set_title(f"{title}: {seconds:.2g} s", fontsize=10)
        panel.set_axis_off()
    figure.savefig(FOLDER / "shadings.png", dpi=100)


def two_pass() -> None:
    """The room with mirror and glass, and Mitsuba's picture of it, which is 128 x 128."""
    from matplotlib.figure import Figure

    scene, camera = rad.scenes.mirror_and_glass(0.03), rad.Camera(**rad.scenes.mirror_and_glass_view())
    solution = timed("mirror and glass, solve to 1 %", lambda: rad.solve(scene, 0.01, progress=False))
    image = timed(
        "mirror and glass, two-pass to 1.5 %",
        lambda: rad.two_pass(solution, camera, 512, 512, tolerance=0.015, progress=False),
    )
    with np.load(FOLDER.parent / "tests" / "data" / "images" / "mirror_and_glass_128.npz") as data:
        traced = data["image"]
    figure = Figure(figsize=(10.0, 5.2), layout="constrained")
    panels = figure.subplots(1, 2)
    for panel, title, shown in zip(
        panels, ("two passes", "path tracer, 49,152 paths a pixel"), (image, traced), strict=True
    ):
        panel.imshow(to_srgb(shown, 3.5), interpolation="nearest")
        panel.set_title(title, fontsize=10)
        panel.set_axis_off()
    figure.savefig(FOLDER / "two_pass.png", dpi=100)


def sky() -> None:
    scene = rad.scenes.city(4.0)
    lights = [rad.Sun((-0.8, -0.2, 0.55), (700, 650, 560)), rad.Sky((60, 70, 90), "overcast")]
    solution = timed("city, solve to 2 %", lambda: rad.solve(scene, 0.02, lights=lights, progress=False))
    picture("sky", solution, rad.scenes.city_view(), (800, 450), 0.02)


def picture(name, solution, view, size, noise) -> None:
    def draw():
        return rad.render(solution, rad.Camera(**view), *size, "gather", tolerance=noise, progress=False)

    image = timed(f"{name}, {size[0]} x {size[1]} pixels gathered to {noise:.1%}", draw)
    rad.save_image(FOLDER / f"{name}.png", image)


def timed(what, work):
    start = perf_counter()
    result = work()
    print(f"{what}: {perf_counter() - start:.1f} s", flush=True)
    return result


if __name__ == "__main__":
    drawings = {"theatre": theatre, "gallery": gallery, "shadings": shadings, "two_pass": two_pass, "sky": sky}
    for name in sys.argv[1:] or drawings:
        drawings[name]()
