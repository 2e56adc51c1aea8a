"""Instant radiosity: pictures without a solution, from few virtual point lights (Keller, SIGGRAPH 1997).

    L(x) = (E + rho H) / pi,    H(x) = sum over lights k of Phi_k / pi min(G, c) V,    G = cos_x cos_k / r^2

and what the bound c cuts from G, by short paths (Kollig & Keller 2004). Valid for diffuse surfaces.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

from . import _core
from .arrays import FloatArray, IntArray, read_only, real_number, seed_number, thread_count, whole_number
from .memory import available_bytes
from .progress import Progress, reporter
from .render import Camera, Viewpoint, viewpoint
from .scene import Scene

SHADOWS = ("rays", "maps")
# Pixels each way of the picture from which the share of the light that a bound cuts is taken.
_GLANCE = 64
# Of all light: what may be left out without a word.
_LEFT_OUT = 0.1


@dataclass(frozen=True, repr=False)
class VirtualLights:
    """Virtual point lights of a scene, as :func:`virtual_lights` makes them: m of them, in the order of their bounces.

    A light of flux Phi gives a point at distance r the irradiance Phi / pi cos cos' / r^2. Together, the lights of
    bounce j carry an unbiased estimate of the power that is reflected for the j-th time (emitted, for j = 0).
    """

    scene: Scene
    """The scene that they light."""
    positions: FloatArray
    """(m, 3) where they are, m."""
    flux: FloatArray
    """(m, b) Phi, W."""
    patch: IntArray
    """(m,) the patch that each lies on; it shines to the patch's front."""
    bounce: IntArray
    """(m,) how often its light has been reflected."""
    particles: int
    """How many walks made them."""
    left_out: float
    """The share of all light that further bounces would have, of which there are no lights: exact in a closed room of
    one reflectance, about so elsewhere."""
    bound: float
    """The largest geometry term, 1/m^2, that :func:`instant` lets one of them have unless told otherwise."""
    _sample: IntArray = field(compare=False)

    @property
    def normals(self) -> FloatArray:
        """(m, 3) unit normals: the direction in which each is brightest."""
        return self.scene.normals[self.patch]

    def __len__(self) -> int:
        return len(self.positions)

    def __repr__(self) -> str:
        return (
            f"VirtualLights({len(self)} lights of {self.particles} particles, {self.bounce.max()} bounces, "
            f"{self.flux.sum():.6g} W; {self.left_out:.2g} of all light left out)"
        )

    def share_cut(self, camera: Camera, bound: float | None = None, threads: int | None = None) -> float:
        """The share of the reflected light in a view that a bound cuts: what ``compensate=False`` leaves dark.

        Estimated from 64 x 64 pixels, all bands together.

        Args:
            camera: the viewpoint.
            bound: as of :func:`instant`.
            threads: None for all cores.
        """
        return _instant(self.scene, self, viewpoint(camera), (_GLANCE, _GLANCE), bound, True, True, 0, threads, False)[
            1
        ]


def virtual_lights(
    scene: Scene, count: int = 256, seed: int = 0, threads: int | None = None, progress: Progress = True
) -> VirtualLights:
    """Virtual point lights by a quasi-random walk from the emitters.

    Of K particles floor(q^j K) are reflected j times, q being the mean reflectance, and each leaves a light at every
    point that reflects it. K is the largest that makes no more than ``count`` lights. The mesh may be as coarse as the
    shape allows: the lights do not lie on its corners.

    Args:
        scene: the scene.
        count: most lights, 1 or more.
        seed: of the scramble of the Halton sequence.
        threads: None for all cores.
        progress: see :mod:`radiosity.progress`.

    Raises:
        ValueError: no lights asked for, a scene that emits nothing, or one with a patch that repeats another one.
        MemoryError: the lights would not fit.

    Warns:
        UserWarning: more than a tenth of all light is in bounces that have no lights, as in white rooms.

    Source: Keller, "Instant radiosity", 1997, section 3.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}")
    count = whole_number("lights", count, 1, 2**32 - 1)
    with reporter(progress, "lights") as report:
        positions, flux, patch, bounce, sample, particles, left_out, bound = _core.virtual_lights(
            scene._core, count, seed_number(seed), available_bytes(), thread_count(threads), report
        )
    if left_out > _LEFT_OUT:
        warnings.warn(
            f"bounces after the last that has lights carry about {left_out:.0%} of all light, which is left out: more "
            "lights follow it further, and a solution has all of it",
            UserWarning,
            stacklevel=2,
        )
    return VirtualLights(
        scene,
        read_only(positions),
        read_only(flux),
        read_only(patch),
        read_only(bounce),
        particles,
        left_out,
        bound,
        read_only(sample),
    )


def instant(
    scene: Scene,
    camera: Camera,
    width: int = 512,
    height: int = 512,
    lights: int | VirtualLights = 256,
    shadows: str = "rays",
    bound: float | None = None,
    compensate: bool = True,
    resolution: int = 1024,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = True,
) -> FloatArray:
    """The image of a scene that nobody has solved, by virtual point lights: linear radiance, W/(m^2 sr).

    A pixel is the mean over 16 quasi-random places, each of which gets the light of its share of the lights. With fewer
    than 16 lights of a bounce, fewer places count for it.

    Args:
        scene: the scene; a coarse mesh serves as well as a fine one.
        camera: the viewpoint.
        width: pixels a row.
        height: rows.
        lights: how many, at most; or those of :func:`virtual_lights`, which serve any number of views of a scene.
        shadows: ``"rays"``, exact, on the CPU; ``"maps"``, shadow maps on the GPU, which need the extra ``gpu``: one
            hemicube of depths a light. Shadows of maps are off by up to a texel.
        bound: the largest geometry term cos cos' / r^2 of a light, 1/m^2; None for ``VirtualLights.bound``. Without
            one, every light makes a bright spot around it. The lights on a lamp, which are close together, may have a
            larger one, with which none gives a point more than a quarter of the lamp's emission.
        compensate: whether the light that the bound cuts, near edges where surfaces meet, is found by paths: without,
            it is missing, and ``VirtualLights.share_cut`` tells how much.
        resolution: of ``"maps"``: texels along an edge of the hemicube, 16 or more.
        seed: of the lights, the places in the pixels, and the paths.
        threads: None for all cores.
        progress: see :mod:`radiosity.progress`.

    Returns:
        (height, width, b), row 0 on top, pixel averages. Backs of patches and empty space are black. With rays, the
        same bits for any number of threads.

    Raises:
        ValueError: unknown shadows, no lights, lights of another scene, a bound that is not positive, an empty image, a
            scene that emits nothing or has a patch twice, a camera that sees nothing or only backs; of maps, more than
            the device takes.
        MemoryError: the image would not fit.
        ImportError: maps without the package wgpu.
        RuntimeError: maps without a GPU driver.

    Warns:
        UserWarning: see :func:`virtual_lights`.

    Sources:
        Keller 1997; the compensation: Kollig & Keller, "Illumination in the presence of weak singularities", 2004.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}: no solution is needed here")
    view = viewpoint(camera)
    if shadows not in SHADOWS:
        raise ValueError(f"unknown shadows {shadows!r}; there are {SHADOWS}")
    width, height = (whole_number(name, size, 1, 1 << 20) for name, size in (("width", width), ("height", height)))
    if not isinstance(compensate, bool):
        raise TypeError(f"compensate must be True or False, not {type(compensate).__name__}")
    resolution = whole_number("resolution", resolution, 16, 1 << 20)
    seed_number(seed)
    if not isinstance(lights, VirtualLights):
        lights = virtual_lights(scene, lights, seed, threads, progress)
    elif lights.scene is not scene:
        raise ValueError("these lights are of another scene: make them anew with virtual_lights(scene)")
    maps = None
    if shadows == "maps":
        from .shadow_maps import ShadowMaps

        maps = ShadowMaps(lights, (height, width, scene.bands), resolution)
    size, lit = (width, height), maps is None
    image, _, bounds = _instant(scene, lights, view, size, bound, compensate, lit, seed, threads, progress)
    if maps is not None:
        maps.add_light(image, bounds, view, seed, threads, progress)
    return image


def _bound(lights: VirtualLights, bound: float | None) -> float:
    if bound is None:
        return lights.bound
    number = real_number("bound", bound)
    if not number > 0.0:
        raise ValueError(f"bound {bound} is not positive")
    return number


def _instant(
    scene: Scene,
    lights: VirtualLights,
    view: Viewpoint,
    size: tuple[int, int],
    bound: float | None,
    compensate: bool,
    lit: bool,
    seed: int,
    threads: int | None,
    progress: Progress,
) -> tuple[FloatArray, float, FloatArray]:
    """The image, the share of its reflected light that the bound cuts, and the bound of every light.

    Not ``lit``: without what maps add.
    """
    with reporter(progress, "instant") as report:
        return _core.instant(
            scene._core,
            lights.positions,
            lights.flux,
            lights.patch,
            lights.bounce,
            view,
            *size,
            _bound(lights, bound),
            compensate,
            lit,
            seed,
            available_bytes(),
            thread_count(threads),
            report,
        )
