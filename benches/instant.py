"""How good pictures of virtual point lights are, and what they take: the numbers of docs/instant.md.

    python benches/instant.py

Pictures of the Cornell box (38 patches) are 512 x 512 pixels. Against Mitsuba they are averaged to the 128 x 128 of
`tests/data/images/cornell_128.npz`, as in benches/render.py; noise of that reference is 0.7 %.

Maps are held against rays with the same 256 lights, places and paths. "Off" is a pixel that differs by more than 5 % of
the mean of the picture: too dark, where a surface shadows itself (acne) or a shadow is too wide; too bright, where
light leaks. In a convex room rays are never blocked, so that all that maps take away there is acne.
"""

from statistics import mean, median
from time import process_time

import numpy as np
from render import VIEW, error, timed

import radiosity as rad

SEEDS = range(4)


def main() -> None:
    scene = rad.scenes.cornell_box()
    print("lights  compensated: error of each seed          cut: error, share cut   seconds (CPU)")
    for count in (64, 256, 1024, 4096):
        lights = [rad.virtual_lights(scene, count, seed, progress=False) for seed in SEEDS]
        whole = [measured(scene, of, seed) for seed, of in enumerate(lights)]
        cut = [measured(scene, of, seed, compensate=False) for seed, of in enumerate(lights)]
        each = " ".join(f"{error(image):6.2%}" for image, _, _ in whole)
        missing = mean(of.share_cut(VIEW) for of in lights)
        print(
            f"{count:6d}  {each}, mean {error_of(whole):6.2%}   {error_of(cut):6.2%}, {missing:5.2%}   "
            f"{least(whole)}; cut {least(cut)}",
            flush=True,
        )
    for count in (64, 256, 1024):
        lights = [rad.virtual_lights(scene, count, seed, progress=False) for seed in SEEDS]
        line = []
        for times in (5, 10, 20, 40, 80):
            bound = times / scene.areas.sum()
            found = error_of([measured(scene, of, seed, bound=bound) for seed, of in enumerate(lights)])
            line.append(f"{times}: {found:.2%}")
        print(f"{count} lights, error by bound times area: {', '.join(line)}", flush=True)
    maps(scene)
    large()


def large() -> None:
    """Pictures of 1,024 x 1,024 pixels by rays and by maps."""
    try:
        for name in ("cornell_box", "gallery", "theatre"):
            large_of(name, getattr(rad.scenes, name)(), rad.Camera(**getattr(rad.scenes, f"{name}_view")()))
    except (ImportError, RuntimeError) as problem:
        print(problem)


def large_of(name, scene, camera) -> None:
    """Medians of three, and how far the pictures differ in all but the brightest 3 % of the pixels."""
    lights, images = rad.virtual_lights(scene, 256, progress=False), {}
    for shadows in ("rays", "maps"):
        options = {"lights": lights, "shadows": shadows, "compensate": False, "progress": False}
        runs = [timed(lambda o=options: rad.instant(scene, camera, 1024, 1024, **o)) for _ in range(3)]
        images[shadows] = runs[0][0]
        print(f"{name}, {shadows}: {median(seconds for _, seconds in runs):.1f} s", flush=True)
    brightest = images["rays"].max(axis=2)
    pixels = brightest < np.quantile(brightest, 0.97)
    there, difference = images["rays"][pixels], (images["maps"] - images["rays"])[pixels]
    rms = np.sqrt((difference**2).sum() / (there**2).sum())
    print(f"{name}: maps differ by {rms:.2%} RMS, bias {difference.sum() / there.sum():+.3%}", flush=True)


def measured(scene, lights, seed, **options):
    """The picture, seconds, and CPU seconds."""
    before = process_time()
    image, seconds = timed(lambda: rad.instant(scene, VIEW, lights=lights, seed=seed, progress=False, **options))
    return image, seconds, process_time() - before


def error_of(runs) -> float:
    return mean(error(image) for image, _, _ in runs)


def least(runs) -> str:
    """Seconds of the fastest, and CPU seconds of the least busy run."""
    return f"{min(seconds for _, seconds, _ in runs):.2f} ({min(busy for _, _, busy in runs):.2f})"


def maps(scene) -> None:
    """Maps against rays, by resolution; in the box, and in a convex room."""
    lights = rad.virtual_lights(scene, 256, progress=False)
    room = rad.scenes.furnace()
    inside = rad.Camera((0.05, 0.1, 0.07), (0.9, 0.8, 0.85), fov=70.0)
    lights_there = rad.virtual_lights(room, 256, progress=False)
    free = rad.instant(room, inside, lights=lights_there, progress=False)
    for compensate in (False, True):
        rays, seconds, busy = measured(scene, lights, 0, compensate=compensate)
        print(f"256 lights by rays, compensate={compensate}: {seconds:.2f} s ({busy:.2f} CPU)")
        try:
            measured(scene, lights, 0, shadows="maps", resolution=16)  # the device is made
        except (ImportError, RuntimeError) as problem:
            print(problem)
            return
        image, seconds, busy = measured(scene, lights, 0, shadows="maps", compensate=compensate)
        print(f"256 lights by maps of 1024, compensate={compensate}: {seconds:.2f} s ({busy:.2f} CPU)", flush=True)
    pixels = rays.max(axis=2) < 0.5
    level = 0.05 * rays[pixels].mean()
    for resolution in (256, 512, 1024, 2048):
        image, seconds, busy = measured(scene, lights, 0, shadows="maps", resolution=resolution)
        difference = (image - rays)[pixels]
        rms = np.sqrt((difference**2).sum() / (rays[pixels] ** 2).sum())
        bias = difference.sum() / rays[pixels].sum()
        dark, bright = (difference.min(axis=1) < -level).mean(), (difference.max(axis=1) > level).mean()
        there = rad.instant(room, inside, lights=lights_there, shadows="maps", resolution=resolution, progress=False)
        acne = there / free - 1.0
        print(
            f"maps of {resolution:4d}: {seconds:5.2f} s ({busy:5.2f} CPU); RMS {rms:.2%}, bias {bias:+.3%}, off: "
            f"{dark:.2%} too dark, {bright:.2%} too bright; convex room: mean {acne.mean():+.4%}, "
            f"{(acne < -0.05).mean():.3%} of the pixels off, least {acne.min():+.1%}",
            flush=True,
        )


if __name__ == "__main__":
    main()
