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


def beside(scene: rad.Scene, camera: rad.Camera) -> np.ndarray:
    """Tell which pixels show, straight or in a mirror, neither lamp nor glass nor what is within 20 cm of its foot.

    Nor have they a neighbour that shows a lamp: a border pixel holds more or less of it. Beside the foot its caustic
    falls on the floor.
    """
    size = 4 * SIZE
    places = (np.arange(size) + 0.5) / size - 0.5
    forward = np.subtract(camera.target, camera.origin)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    scale = 2.0 * np.tan(np.radians(0.5 * camera.fov))
    x, y = np.meshgrid(scale * places, -scale * places)
    directions = (forward + x[..., None] * right + y[..., None] * np.cross(right, forward)).reshape(-1, 3)
    origins = np.tile(np.asarray(camera.origin), (len(directions), 1))
    names, foot = np.array(scene.names), (0.19, 0.0, 0.17)
    has_glass = "glass sphere" in names
    beside, lamp = np.ones(len(directions), dtype=bool), np.zeros(len(directions), dtype=bool)
    for _ in range(2):
        hits = scene.intersect(origins, directions)
        met = hits.patch >= 0
        name = np.where(met, names[hits.patch], "")
        ends = origins + np.where(met, hits.distance, 0.0)[:, None] * directions
        near = has_glass & (name == "floor") & (np.linalg.norm(ends - foot, axis=1) < 0.2)
        beside &= met & ~near & (name != "glass sphere") & (name != "lamp")
        mirrored = name == "mirror"
        normals = scene.normals[hits.patch]
        reflected = directions - 2.0 * (directions * normals).sum(axis=1)[:, None] * normals
        # What is no mirror is looked at once more, which changes nothing.
        origins = np.where(mirrored[:, None], ends, origins)
        directions = np.where(mirrored[:, None], reflected, directions)
        lamp |= name == "lamp"
    own = lamp.reshape(SIZE, 4, SIZE, 4).any(axis=(1, 3))
    for axis in (0, 1):
        own = own | np.roll(own, 1, axis) | np.roll(own, -1, axis)
    return beside.reshape(SIZE, 4, SIZE, 4).all(axis=(1, 3)) & ~own


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
    camera = rad.Camera(**rad.scenes.cornell_box_view())
    view = mi.load_dict(sensor(camera, 0))
    total, squares = 0.0, 0.0
    for run in range(count):
        image = np.array(mi.render(scene, sensor=view, integrator=integrator, seed=run + 1, spp=SAMPLES))
        total, squares = total + image, squares + image.astype(float) ** 2
        print(f"run {run + 1} of {count}", flush=True)
    image = total / count
    error = np.sqrt(np.maximum(squares / count - image**2, 0.0) / (count - 1))
    shown = beside(build(), camera)
    noise = np.sqrt((error[shown] ** 2).sum() / (image[shown] ** 2).sum())
    print(f"{name}: noise {noise:.3%} beside lamps and glass")
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(
        FOLDER / f"{name}_128.npz",
        image=image.astype(np.float32),
        stderr=error.astype(np.float16),
        beside=shown,
        mitsuba_version=mi.__version__,
    )


if __name__ == "__main__":
    main()
