"""Two-pass pictures of a room with a mirror wall and a glass sphere, against Mitsuba: the numbers of docs/two_pass.md.

    python benches/two_pass.py

Pictures are 512 x 512 pixels, averaged to the 128 x 128 of `tests/data/images/mirror_and_glass_128.npz`; the error is
relative, RMS over pixels, the worst band, noise of that reference taken off in quadrature. Two regions: what shows,
straight or in the mirror, neither lamps nor glass nor the floor within 20 cm of it; and glass and that floor, where the
caustic is.
"""

from pathlib import Path
from time import perf_counter

import numpy as np

import radiosity as rad

REFERENCE = Path(__file__).resolve().parents[1] / "tests" / "data" / "images" / "mirror_and_glass_128.npz"
VIEW = rad.Camera(**rad.scenes.mirror_and_glass_view())


def main() -> None:
    with np.load(REFERENCE) as data:
        truth, noise, beside = data["image"].astype(float), data["stderr"].astype(float), data["beside"]
    regions = {"beside lamps and glass": beside, "glass and floor around it": ~beside & (truth.max(axis=2) < 0.5)}
    for name, pixels in regions.items():
        print(
            f"{name}: {pixels.mean():.0%} of the pixels, the path tracer's noise {relative(noise, truth, pixels):.2%}"
        )
    for max_edge in (0.1, 0.06, 0.03):
        scene = rad.scenes.mirror_and_glass(max_edge)
        start = perf_counter()
        solution = rad.solve(scene, 0.02, progress=False)
        solved = perf_counter() - start
        print(f"{scene.n_patches} patches, solve to 2 %: {solved:.2f} s, {solution.report.rays} rays")
        passes = []
        start = perf_counter()
        rad.two_pass(
            solution,
            VIEW,
            512,
            512,
            tolerance=0.015,
            on_image=lambda image, error, since=start, into=passes: into.append((perf_counter() - since, error, image)),
            progress=False,
        )
        for seconds, estimate, image in passes:
            small = image.reshape(128, 4, 128, 4, 3).mean(axis=(1, 3))
            beside_error, around_error = (
                max(relative(small - truth, truth, pixels) ** 2 - relative(noise, truth, pixels) ** 2, 0.0) ** 0.5
                for pixels in regions.values()
            )
            print(
                f"    picture {seconds:5.2f} s, with the solve {solved + seconds:5.2f} s: estimate {estimate:.2%}, "
                f"off {beside_error:.2%} beside lamps and glass, {around_error:.0%} in glass and around it"
            )


def relative(difference, truth, pixels) -> float:
    return float(np.sqrt((difference[pixels] ** 2).sum(axis=0) / (truth[pixels] ** 2).sum(axis=0)).max())


if __name__ == "__main__":
    main()
