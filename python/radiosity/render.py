"""Pictures: a camera, the image of a solution, and image files."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _core
from .arrays import FloatArray, real_array, real_number, shaped, thread_count, whole_number
from .files import replacing
from .lights import core_lights
from .memory import available_bytes
from .progress import Progress, reporter
from .solution import Solution

SHADINGS = ("flat", "smooth", "gather")
Point: TypeAlias = tuple[float, float, float]
Viewpoint: TypeAlias = tuple[Point, Point, Point, float]
OnImage: TypeAlias = Callable[[FloatArray, float], object]
FORMATS = (".png", ".exr")
# From a camera to its target, m: lengths are squared, and squares must neither overflow nor vanish.
_DISTANCES = (1e-150, 1e150)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Args:
        origin: (3,) where it stands, m.
        target: (3,) what it looks at, m.
        up: (3,) the direction that is up in the picture: z by default; (0, 1, 0) for most glTF files.
        fov: vertical field of view, degrees, in (0, 180).

    Raises:
        TypeError, ValueError: no three finite numbers, a field of view out of range, a target at the origin, or an up
            along the view.
    """

    origin: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    fov: float = 40.0

    def __post_init__(self) -> None:
        for name in ("origin", "target", "up"):
            point = shaped(f"camera {name}", getattr(self, name), 3)
            if not np.isfinite(point).all():
                raise ValueError(f"camera {name} {tuple(point.tolist())} is not finite")
            object.__setattr__(self, name, tuple(point.tolist()))
        if not (math.isfinite(self.fov) and 0.0 < self.fov < 180.0):
            raise ValueError(f"camera fov {self.fov} is outside (0, 180) degrees")
        view = [there - here for here, there in zip(self.origin, self.target, strict=True)]
        distance = math.hypot(*view)
        if distance == 0.0:
            raise ValueError(f"camera target {self.target} is the same point as its origin")
        low, high = _DISTANCES
        if not low <= distance <= high:
            raise ValueError(f"camera target is {distance:g} m from its origin, outside [{low:g}, {high:g}]")
        # An angle below 1e-9 between up and the view leaves the horizon to rounding.
        up = np.divide(self.up, math.hypot(*self.up) or 1.0)
        if not np.linalg.norm(np.cross(np.divide(view, distance), up)) > 1e-9:
            raise ValueError(f"camera up {self.up} is parallel to the view; choose another, such as (0, 1, 0)")


def render(
    solution: Solution,
    camera: Camera,
    width: int = 512,
    height: int = 512,
    shading: str = "smooth",
    tolerance: float = 0.02,
    seed: int = 0,
    on_image: OnImage | None = None,
    threads: int | None = None,
    progress: Progress = True,
) -> FloatArray:
    """The image of a solution: linear radiance, W/(m^2 sr), averaged over each pixel.

    Args:
        solution: a solution that knows its scene; of ``method="hierarchical"`` its elements are shown.
        camera: the viewpoint.
        width: pixels a row.
        height: rows.
        shading: ``"flat"``, one radiosity a patch as it was solved; ``"smooth"``, the irradiance interpolated between
            the corners of patches that form one surface, so that neither lamps nor paints leak over their borders;
            ``"gather"``, the light that arrives at every pixel (final gather): straight from the lamps and from the
            solution's ``lights``, with sharp and soft shadows as they are, and by rays that carry what the solution
            says of where they end. The patches are no longer seen, and a coarse solution makes a good picture.
        tolerance: of ``"gather"``: relative error from sampling, RMS over the pixels in which no emitter is seen, the
            worst band; in (0, 1). What the solution is wrong by comes on top of it.
        seed: of the quasi-random points of ``"gather"``.
        on_image: of ``"gather"``: called as ``on_image(image, error)`` after every pass, with the picture so far and
            the estimate of its error. An exception that it raises stops the rendering and is passed on.
        threads: None for all cores.
        progress: see :mod:`radiosity.progress`.

    Returns:
        (height, width, b), row 0 on top. Backs of patches and empty space are black.

    Raises:
        ValueError: an unknown shading, an empty image, a camera that sees nothing or only backs (it stands in a wall),
            or a scene with mirrors or glass, which :func:`radiosity.two_pass` draws.
        MemoryError: the image would not fit.

    Sources:
        Gouraud 1971; Cohen & Greenberg 1985, section 7; final gather: Reichert 1992; Lischinski, Tampieri & Greenberg
        1993; Ward, Rubinstein & Clear 1988.
    """
    shown, view = _shown(solution), viewpoint(camera)
    assert shown.scene is not None
    if not shown.scene.is_diffuse:
        patch = int(np.argmax((shown.scene.mirror > 0.0) | (shown.scene.ior > 0.0)))
        kind = "a mirror" if shown.scene.mirror[patch] > 0.0 else "glass"
        raise ValueError(f"patch {patch} is {kind}, and render draws diffuse patches: two_pass draws mirrors and glass")
    if shading not in SHADINGS:
        raise ValueError(f"unknown shading {shading!r}; the shadings are {SHADINGS}")
    if on_image is not None and shading != "gather":
        raise ValueError(f"on_image tells of the passes of shading 'gather'; {shading!r} has none")
    if not 0.0 < real_number("tolerance", tolerance) < 1.0:
        raise ValueError(f"tolerance {tolerance} is outside (0, 1)")
    if shading == "gather":
        return _gathered(shown, view, width, height, tolerance, seed, on_image, threads, progress)
    width, height = _size(width, height)
    with reporter(progress, "render") as report:
        return _core.render(
            shown.scene._core,
            shown.irradiance if shading == "smooth" else shown.radiosity,
            view,
            width,
            height,
            shading == "smooth",
            available_bytes(),
            thread_count(threads),
            report,
        )


def two_pass(
    solution: Solution,
    camera: Camera,
    width: int = 512,
    height: int = 512,
    tolerance: float = 0.02,
    seed: int = 0,
    on_image: OnImage | None = None,
    threads: int | None = None,
    progress: Progress = True,
) -> FloatArray:
    """The image of a solution with its mirrors and its glass: linear radiance, W/(m^2 sr), averaged over each pixel.

    The first pass is the solution: the radiosity of the diffuse patches, with what reaches them by way of mirrors and
    glass (extended form factors). The second follows every ray of the camera over mirrors and through glass to the
    diffuse surface that it shows, and gathers there what arrives, as ``render(..., shading="gather")`` does. Where
    nothing is a mirror or glass there is nothing for a second pass, and the picture is that one.

    Lamps in flat mirrors have closed forms, and their light has sharp edges. A caustic, the light of a lamp by
    way of glass or of a bent mirror, is known as an average over patches and drawn no finer: subdivide where it falls.

    Args:
        solution: of :func:`radiosity.solve` by rays; where nothing is a mirror or glass, any.
        camera: the viewpoint.
        width: pixels a row.
        height: rows.
        tolerance: relative error from sampling, RMS over the pixels in which no emitter is seen, the worst band; in
            (0, 1). What the solution is wrong by comes on top of it.
        seed: of the quasi-random points.
        on_image: called as ``on_image(image, error)`` after every pass, as for :func:`radiosity.render`.
        threads: None for all cores.
        progress: see :mod:`radiosity.progress`.

    Returns:
        (height, width, b), row 0 on top. Backs of diffuse patches and of mirrors, and empty space, are black.

    Raises:
        TypeError, ValueError, MemoryError: those of :func:`radiosity.render` for ``"gather"``, without mirrors.

    Sources:
        Wallace, Cohen & Greenberg 1987; Sillion & Puech 1989.
    """
    shown, view = _shown(solution), viewpoint(camera)
    return _gathered(shown, view, width, height, tolerance, seed, on_image, threads, progress)


def _shown(solution: Solution) -> Solution:
    """What a picture of a solution shows, which has a scene."""
    if not isinstance(solution, Solution):
        raise TypeError(f"solution must be a radiosity.Solution, not {type(solution).__name__}")
    if solution.scene is None:
        raise ValueError("this solution was made from a plain matrix and knows no geometry; solve form_factors(scene)")
    shown = solution.as_shown
    assert shown.scene is not None  # elements are those of a scene
    shape = (shown.scene.n_patches, shown.scene.bands)
    if not shown.radiosity.shape == shown.irradiance.shape == shape:
        raise ValueError(f"the solution has shape {shown.radiosity.shape}, and its scene {shape}")
    return shown


def colour_bands(bands: int, what: str) -> None:
    """Refuses numbers of bands that are no colours."""
    if bands not in (1, 3):
        raise ValueError(f"{what} has 1 band (grey) or 3 (RGB), not {bands}; choose bands to show")


def _size(width: int, height: int) -> tuple[int, int]:
    return whole_number("width", width, 1, 1 << 20), whole_number("height", height, 1, 1 << 20)


def viewpoint(camera: Camera) -> Viewpoint:
    """A camera as the core takes it: origin, target, up, field of view; ``TypeError`` for what is none."""
    if not isinstance(camera, Camera):
        raise TypeError(f"camera must be a radiosity.Camera, not {type(camera).__name__}")
    return camera.origin, camera.target, camera.up, float(camera.fov)


def _gathered(
    shown: Solution,
    view: Viewpoint,
    width: int,
    height: int,
    tolerance: float,
    seed: int,
    on_image: OnImage | None,
    threads: int | None,
    progress: Progress,
) -> FloatArray:
    assert shown.scene is not None
    if on_image is not None and not callable(on_image):
        raise TypeError(f"on_image must be callable, not {type(on_image).__name__}")
    width, height = _size(width, height)
    with reporter(progress, "render") as report:
        image, reached, passes = _core.gather(
            shown.scene._core,
            core_lights(shown.lights, shown.scene.bands),
            shown.irradiance,
            view,
            width,
            height,
            real_number("tolerance", tolerance),
            whole_number("seed", seed, 0, 2**64 - 1),
            available_bytes(),
            on_image,
            thread_count(threads),
            report,
        )
    if reached > tolerance:
        warnings.warn(
            f"the error from sampling is {reached:.2g} after {passes} passes, above {tolerance:g}",
            UserWarning,
            stacklevel=3,
        )
    return image


def auto_exposure(image: FloatArray) -> float:
    """The factor that brings the brightest of what is no lamp to 0.8: its 95th percentile over the pixels.

    A lamp is what is more than ten times as bright as half of the lit pixels: it may burn out.
    """
    brightness = np.asarray(image).max(axis=-1)
    lit = brightness[brightness > 0]
    return float(0.8 / np.percentile(lit[lit <= 10.0 * np.median(lit)], 95)) if lit.size else 1.0


def shown_radiance(solution: Solution) -> FloatArray:
    """(n, 3, b) radiance at the corners of every patch as smooth pictures show it, W/(m^2 sr)."""
    scene = solution.scene
    assert scene is not None
    corners = _core.corner_irradiance(scene._core, solution.irradiance, None)
    radiance: FloatArray = (scene.emission[:, None] + scene.reflectance[:, None] * corners) / np.pi
    return radiance


def exposure_of(solution: Solution, exposure: float | None) -> float:
    """The exposure asked for, or one that brings what the patches reflect to 0.8: its 95th percentile by area."""
    if exposure is not None:
        return float(exposure)
    assert solution.scene is not None
    reflected = (solution.radiosity - solution.scene.emission).max(axis=1) / np.pi
    order = np.argsort(reflected)
    areas = np.cumsum(np.where(reflected > 0.0, solution.scene.areas, 0.0)[order])
    bright = reflected[order][np.searchsorted(areas, 0.95 * areas[-1])]
    return float(0.8 / bright) if bright > 0.0 else auto_exposure(solution.radiosity / np.pi)


def to_srgb(image: FloatArray, exposure: float | None = None) -> npt.NDArray[np.uint8]:
    """(h, w, b) linear radiance as 8-bit sRGB (IEC 61966-2-1), b = 1 or 3; ``exposure`` as in :func:`save_image`."""
    scaled = np.clip(image * (auto_exposure(image) if exposure is None else exposure), 0.0, 1.0)
    curved = np.where(scaled <= 0.0031308, 12.92 * scaled, 1.055 * scaled ** (1.0 / 2.4) - 0.055)
    return np.round(255.0 * curved).astype(np.uint8)


def save_image(path: str | os.PathLike[str], image: Any, exposure: float | None = None) -> None:
    """Writes an image to a ``.png`` (sRGB, 8 bits) or ``.exr`` (linear, float32; needs the extra ``exr``) file.

    Args:
        path: where to; the ending decides the format. An existing file is replaced only once the new one is whole.
        image: (h, w, b) linear radiance with b = 1 (grey) or 3 (RGB).
        exposure: PNG only: factor from radiance to display, where 1 is white; None chooses one from the picture.

    Raises:
        ValueError: an unknown ending, a wrong shape, numbers that are not finite, an exposure that is not positive.
        OSError: the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"{path}: unknown image format {path.suffix!r}; the formats are {FORMATS}")
    pixels = real_array("image", image)
    if pixels.ndim != 3 or 0 in pixels.shape:
        raise ValueError(f"image must have shape (h, w, b), not {pixels.shape}")
    colour_bands(pixels.shape[2], f"{path}: a picture")
    if not np.isfinite(pixels).all():
        raise ValueError("image holds values that are not finite")
    if exposure is not None and not (math.isfinite(exposure) and exposure > 0.0):
        raise ValueError(f"exposure {exposure} is not a positive number")
    with replacing(path) as temporary:
        if path.suffix.lower() == ".png":
            _write_png(temporary, to_srgb(pixels, exposure))
        else:
            _write_exr(temporary, pixels)


def _write_png(path: str, pixels: npt.NDArray[np.uint8]) -> None:
    from PIL import Image

    Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels).save(path, format="PNG")


def _write_exr(path: str, pixels: FloatArray) -> None:
    try:
        import OpenEXR
    except ImportError as error:
        raise ImportError("EXR files need the OpenEXR package: pip install radiosity[exr]") from error
    channels = (
        {"Y": pixels[..., 0]} if pixels.shape[2] == 1 else dict(zip("RGB", np.moveaxis(pixels, 2, 0), strict=True))
    )
    data = {name: np.ascontiguousarray(values, np.float32) for name, values in channels.items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, data) as file:
        try:
            file.write(path)
        except RuntimeError as error:
            raise OSError(str(error)) from error
