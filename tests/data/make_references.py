"""Makes the path-traced references of the package, `python/radiosity/data/references/*.npz`, and checks the tracer.

    python tests/data/make_references.py [name ...]

Each is the mean of independent runs of Mitsuba's path tracer (`radiosity.mitsuba.patch_tracer`), as many as bring the
relative standard error under its target. Points of one run are stratified, so that a run has no standard error of its
own; the runs differ in their seed only, and the spread of k of them gives the standard error of their mean, valid
whatever the strata. For a single patch it has the accuracy of k - 1 degrees of freedom (k >= 16: to 18 % or better);
over all patches together it is accurate to a percent.

Last, the tracer is held against the reference of the shipped Cornell box, which was traced without strata (sampler
`independent`): the RMS over patches of difference / standard errors must be near 1.
"""

import sys
from pathlib import Path

import numpy as np

import radiosity as rad
from radiosity.mitsuba.patch_tracer import LARGEST_LAUNCH, PatchTracer
from radiosity.references import load, relative_error, scene_of

FOLDER = Path(__file__).resolve().parents[2] / "python" / "radiosity" / "data" / "references"
# Relative standard error at which to stop. Errors down to about twice that can then be told from the noise.
TARGETS = {"two_rooms": 0.0008, "colonnade": 0.0012, "cornell_fine": 0.002}
FEWEST_RUNS = 16


def traced(scene: rad.Scene, target: float, first_seed: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Radiosity, its standard error and the number of paths, once the relative standard error is under the target."""
    tracer = PatchTracer(scene)
    runs, paths = [], 0
    while True:
        # A little under a launch: the sampler rounds up.
        radiosity, count = tracer(int(0.9 * LARGEST_LAUNCH), seed=first_seed + len(runs))
        runs.append(radiosity)
        paths += count
        if len(runs) < FEWEST_RUNS:
            continue
        mean, standard_error = np.mean(runs, axis=0), np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs))
        noise = relative_error(scene, mean, mean, standard_error)[1]
        if noise <= target:
            print(f"{scene.n_patches} patches: {len(runs)} runs, {paths:,} paths, noise {noise:.3%}", flush=True)
            return mean, standard_error, paths


def main() -> None:
    import mitsuba

    FOLDER.mkdir(exist_ok=True)
    for number, name in enumerate(TARGETS):
        if len(sys.argv) > 1 and name not in sys.argv[1:]:
            continue
        radiosity, standard_error, paths = traced(scene_of(name), TARGETS[name], first_seed=10_000 * (number + 1))
        np.savez_compressed(
            FOLDER / f"{name}.npz",
            radiosity=radiosity.astype(np.float32),
            stderr=standard_error.astype(np.float32),
            mitsuba_version=mitsuba.__version__,
            paths=paths,
        )
        print(f"{name} written", flush=True)

    shipped = load("cornell")
    radiosity, standard_error, _ = traced(shipped.scene, 0.0015, first_seed=1)
    together = np.hypot(standard_error, shipped.standard_error)
    lit = together.min(axis=1) > 0
    z = (radiosity - shipped.radiosity)[lit] / together[lit]
    print(f"against the unstratified reference: RMS of z by band {np.sqrt((z**2).mean(axis=0)).round(3)}, ", end="")
    bias = (shipped.scene.areas @ (radiosity - shipped.radiosity)) / np.sqrt(shipped.scene.areas**2 @ together**2)
    print(f"of the mean {bias.round(2)}")


if __name__ == "__main__":
    main()
