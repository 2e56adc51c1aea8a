"""Makes the path-traced pictures that `render` is held against, `tests/data/images/*.npz`.

    python tests/data/make_image_references.py [cornell] [mirror_and_glass]

Each is the mean of RUNS (or more) independent runs of Mitsuba's path tracer without limit on the bounces, with a box
filter: a pixel is the mean over its square, as in `render`. Their spread gives the standard error of the mean.
"""

import sys
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
    # In the room with mirror and glass paths find the lamp by way of glass only by chance: more runs.
    for name, runs in (("cornell", RUNS), ("mirror_and_glass", 4 * RUNS)):
        if len(sys.argv) == 1 or name in sys.argv[1:]:
            make(name, runs)


def make(name: str, count: int) -> None:
    build = {"cornell": rad.scenes.cornell_box, "mirror_and_glass": rad.scenes.mirror_and_glass}[name]
    scene = rad.mitsuba.to_mitsuba(build())
    import mitsuba as mi

    integrator = mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": 16})
    view = mi.load_dict(sensor(rad.Camera(**rad.scenes.cornell_box_view()), 0))
    total, squares = 0.0, 0.0
    for run in range(count):
        image = np.array(mi.render(scene, sensor=view, integrator=integrator, seed=run + 1, spp=SAMPLES))
        total, squares = total + image, squares + image.astype(float) ** 2
        print(f"run {run + 1} of {count}", flush=True)
    image = total / count
    error = np.sqrt(np.maximum(squares / count - image**2, 0.0) / (count - 1))
    lit = image.max(axis=2) < 1.0  # all but the lamp
    noise = np.sqrt((error[lit] ** 2).sum() / (image[lit] ** 2).sum())
    print(f"{name}: noise {noise:.3%} without the lamp")
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(
        FOLDER / f"{name}_128.npz",
        image=image.astype(np.float32),
        stderr=error.astype(np.float16),
        mitsuba_version=mi.__version__,
    )


if __name__ == "__main__":
    main()
