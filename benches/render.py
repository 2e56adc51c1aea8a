"""What pictures and viewer take, and how far pictures are from Mitsuba's: the numbers of docs/viewing.md.

    python benches/render.py

Pictures of the Cornell box are 512 x 512 pixels, averaged to the 128 x 128 of `tests/data/images/cornell_128.npz`; the
error is relative, RMS over the pixels beside the lamp, the worst band, noise of that reference (0.7 %) included.
"""

from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

import radiosity as rad

REFERENCE = Path(__file__).resolve().parents[1] / "tests" / "data" / "images" / "cornell_128.npz"
VIEW = rad.Camera(**rad.scenes.cornell_box_view())


def main() -> None:
    for max_edge in (0.1, 0.03):
        solution = rad.solve(rad.scenes.cornell_box(max_edge=max_edge), 0.01, progress=False)
        for shading in ("flat", "smooth"):
            seconds = median(timed(lambda s=shading, of=solution: picture(of, s))[1] for _ in range(7))
            print(f"{solution.radiosity.shape[0]:6d} patches, {shading}: {seconds:.3f} s")
    for max_edge in (0.1, 0.05, 0.03):
        scene = rad.scenes.cornell_box(max_edge=max_edge)
        solution, seconds = timed(lambda of=scene: rad.solve(of, 0.01, progress=False))
        print(f"{scene.n_patches:6d} patches, solve to 1 %: {seconds:.2f} s")
        gather(solution)
    scene = rad.scenes.cornell_box(max_edge=0.0155)
    solution = rad.solve(scene, 0.1, "hierarchical", progress=False)
    view, seconds = timed(lambda: rad.show(solution, VIEW))
    elements = solution.as_shown.radiosity.shape[0]
    print(f"viewer of {elements} elements: {len(view.page) / 1e6:.2f} MB, made in {seconds:.2f} s")


def gather(solution: rad.Solution) -> None:
    """Time, estimate and error after each pass, to 1 %."""
    start = perf_counter()
    passes = []
    picture(solution, "gather", 0.01, lambda image, estimate: passes.append((perf_counter() - start, estimate, image)))
    for seconds, estimate, image in passes:
        print(f"       gather {seconds:5.2f} s: estimate {estimate:.2%}, against Mitsuba {error(image):.2%}")


def picture(solution, shading, tolerance=0.02, on_image=None):
    return rad.render(solution, VIEW, 512, 512, shading, tolerance, on_image=on_image, progress=False)


def error(image) -> float:
    with np.load(REFERENCE) as data:
        truth, beside = data["image"].astype(float), data["beside"]
    small = image.reshape(128, 4, 128, 4, 3).mean(axis=(1, 3))
    return float(np.sqrt(((small - truth)[beside] ** 2).sum(axis=0) / (truth[beside] ** 2).sum(axis=0)).max())


def timed(work):
    start = perf_counter()
    result = work()
    return result, perf_counter() - start


if __name__ == "__main__":
    main()
