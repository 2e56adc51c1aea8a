"""Makes the path-traced pictures that `render` is held against, `tests/data/images/*.npz`.

    python tests/data/make_image_references.py

Each is the mean of RUNS independent runs of Mitsuba's path tracer without limit on the bounces, with a box filter: a
pixel is the mean over its square, as in `render`. The spread of the runs gives the standard error of their mean.
"""

from pathlib import Path

import numpy as np

import radiosity as rad

FOLDER = Path(__file__).resolve().parent / "images"
SIZE = 128
RUNS = 24
SAMPLES = 512


def sensor(camera: rad.Camera, seed: int) -> dict:
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov": camera.fov,
        "fov_axis": "y",
        "to_world": mi.ScalarTransform4f().look_at(camera.origin, camera.target, camera.up),
        "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
        "sampler": {"type": "independent", "sample_count": SAMPLES, "seed": seed},
    }


def main() -> None:
    scene = rad.mitsuba.to_mitsuba(rad.scenes.cornell_box())
    import mitsuba as mi

    integrator = mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": 16})
    view = mi.load_dict(sensor(rad.Camera(**rad.scenes.cornell_box_view()), 0))
    runs = []
    for run in range(RUNS):
        runs.append(np.array(mi.render(scene, sensor=view, integrator=integrator, seed=run + 1, spp=SAMPLES)))
        print(f"run {run + 1} of {RUNS}", flush=True)
    image, error = np.mean(runs, axis=0), np.std(runs, axis=0, ddof=1) / np.sqrt(RUNS)
    lit = image.max(axis=2) < 1.0  # all but the lamp
    noise = np.sqrt((error[lit] ** 2).sum() / (image[lit] ** 2).sum())
    print(f"noise {noise:.3%} without the lamp")
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(
        FOLDER / "cornell_128.npz",
        image=image.astype(np.float32),
        stderr=error.astype(np.float16),
        mitsuba_version=mi.__version__,
    )


if __name__ == "__main__":
    main()
