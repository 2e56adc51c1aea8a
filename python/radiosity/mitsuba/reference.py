"""The path tracer as an independent reference: patch averages of radiosity with their standard errors."""

from __future__ import annotations

import math
import operator
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, seed_number
from ..lights import Light, in_chosen_bands, lights_of, spectra, strength, with_strength

if TYPE_CHECKING:
    from ..scene import Scene

from .variant import is_scalar, mitsuba_for_a_while
from .writing import HAIR, apart, build, emitters, run_starts, specular_of, twice_area_vectors, unit_vectors

# Half of the traced scene's longest side. Mitsuba lifts rays by (1 + max|p|) * 9e-5: at 100 the 1 no longer counts,
# and the lift is 9e-5 of the scene however small, large or far away the scene was.
TRACED_HALF_SIZE = 100.0

# Mitsuba's roulette survives with probability min(throughput, 0.95): beyond this reflectance a surviving path gains
# weight at every bounce, and from sqrt(0.95) = 0.975 on its variance is infinite.
LARGEST_ROULETTE_REFLECTANCE = 0.95
# Roulette begins when a tenth of the light can be left. Mitsuba's own choice, after five bounces, costs a furnace of
# reflectance 0.9 twice the noise; never starting costs the Cornell box twice the time.
LEFT_TO_ROULETTE = 0.1
MITSUBA_ROULETTE_DEPTH = 5
# Without roulette, paths end when what they leave out is less than this part of the brightest radiosity.
TRUNCATED = 1e-4
# Two rays a bounce at 10 million rays a second: a path of this length takes 4 ms.
MOST_BOUNCES = 20_000

# Paths traced at once: about 0.3 GiB, and few enough calls that their fixed cost (0.2 s) does not count.
CHUNK = 1 << 19

# A patch is refused when more than this part of the rays aimed at it reach another one first: its average would be off
# by as much. The few rays of a handful aimed exactly at an edge are let through.
LARGEST_MISSED_PART = 0.01
MISSES_LET_THROUGH = 2


def reference_radiosity(
    scene: Scene,
    paths: int,
    seed: int = 0,
    *,
    lights: Light | Iterable[Light] = (),
    max_bounces: int | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the radiosity of each patch by Mitsuba's path tracer, and its standard error.

    Every patch gets the same number of paths, `paths // n_patches`. A path starts at a uniform random point of its
    patch, with light sampling and cosine directions combined (the `path` integrator), so the mean is an estimate of
    the exact patch average, free of bias to within the truncation and the ray lift below. Errors of different patches
    are independent; those of the bands of one patch are not, because bands share paths. The standard error is that of
    a mean of independent samples: with few paths a patch (under about 100) it is itself uncertain.

    More than three bands are traced three at a time, each three with all the paths. Patches with a reflectance above
    0.95 switch Russian roulette off and paths are cut after so many bounces that less than 1e-4 of the brightest
    radiosity is left out: 916 bounces at reflectance 0.99, and as much slower. The scene is centred and scaled before
    tracing, which does not change B. The same seed and variant give the same numbers.

    Mirrors and glass have no radiosity: 0. Each run of patches with equal emission is an emitter of its own; a thousand
    of them cost about a second per half million paths.

    Args:
        scene: n patches, b bands (any number).
        paths: total number of paths, at least 2 n.
        seed: 0 or more.
        lights: light that no patch emits, as in `radiosity.solve`; at most one sky among it (see `to_mitsuba`).
        max_bounces: cut paths after so many bounces instead, and leave their light out.

    Returns:
        radiosity (n, b) and standard error (n, b), both in W/m^2.

    Raises:
        ImportError: Mitsuba is not installed.
        TypeError: `paths`, `seed` or `max_bounces` is not an integer, or `lights` holds something else.
        ValueError: too few paths; a reflectance so near 1 that paths would need more than 20,000 bounces, with no
            `max_bounces`; or a patch that rays cannot reach because another one lies on it.

    """
    per_patch = paths_per_patch(paths, scene.n_patches)
    seed = seed_number(seed)
    known = lights_of(lights, scene.bands)
    original = scene.vertices[scene.faces]
    corners = centred_and_scaled(original)
    middle, scale = frame(original)
    radiosity = scene.emission.astype(np.float64)
    standard_error = np.zeros_like(radiosity)
    with mitsuba_for_a_while() as mi:
        for first in range(0, scene.bands, 3):
            bands = slice(first, first + 3)
            rho, emission = three_bands(scene.reflectance[:, bands]), three_bands(scene.emission[:, bands])
            # In units of the largest, for 32 bits end at 1e38.
            lit = in_chosen_bands(known, bands)
            unit = max(emission.max(), spectra(lit).max() if lit else 0.0)
            if unit == 0.0:
                continue
            integrator = _path_integrator(mi, float(rho.max()), last_bounce(float(rho.max()), max_bounces))
            specular = specular_of(scene)
            around = emitters(mi, in_three_bands(lit), unit, middle, scale)
            reflected, error = _reflected(
                mi, integrator, corners, rho, emission / unit, specular, around, per_patch, seed
            )
            # A path that begins at a mirror or at glass shows what is seen there.
            reflected[specular.any(axis=1)] = error[specular.any(axis=1)] = 0.0
            width = radiosity[:, bands].shape[1]
            radiosity[:, bands] += unit * reflected[:, :width]
            standard_error[:, bands] = unit * error[:, :width]
    return radiosity, standard_error


def paths_per_patch(paths: int, patches: int) -> int:
    """Return how many of the paths each patch gets, two or more."""
    paths = _integer("paths", paths)
    if paths < 2 * patches:
        raise ValueError(
            f"{paths} paths for {patches} patches: at least {2 * patches} are needed, two for each patch, "
            "or there is no standard error"
        )
    return paths // patches


def _integer(name: str, value: Any) -> int:
    try:
        return operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be an integer, not {type(value).__name__}") from None


def three_bands(values: FloatArray) -> FloatArray:
    """Fill up (n, 1..3) with black bands to (n, 3)."""
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


def centred_and_scaled(corners: FloatArray) -> FloatArray:
    """Return triangles (n, 3, 3) in a box about the origin whose longest side is 2 `TRACED_HALF_SIZE`; twins apart."""
    middle, scale = frame(corners)
    return apart((corners - middle) * scale)


def frame(corners: FloatArray) -> tuple[FloatArray, float]:
    """Return the middle of triangles (n, 3, 3), and what they are multiplied by to be traced."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    return (low + high) / 2.0, float(2.0 * TRACED_HALF_SIZE / (high - low).max())


def in_three_bands(lights: tuple[Light, ...]) -> tuple[Light, ...]:
    """Fill the strengths of lights up with black bands, as `three_bands` does with those of patches."""

    def filled(values: FloatArray) -> FloatArray:
        return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, 3 - values.shape[-1])])

    return tuple(with_strength(light, filled(strength(light))) for light in lights)


def last_bounce(largest_reflectance: float, wanted: int | None) -> int | None:
    """Return after how many bounces paths are cut, or None where roulette ends them.

    What k bounces leave out is (diag(rho) F)^(k+1) B <= rho^(k+1) max B.
    """
    if wanted is not None:
        bounces = _integer("max_bounces", wanted)
        if bounces < 1:
            raise ValueError(f"max_bounces is {bounces}: at least one bounce is needed")
        return bounces
    if largest_reflectance <= LARGEST_ROULETTE_REFLECTANCE:
        return None
    bounces = (
        math.ceil(math.log(TRUNCATED) / math.log(largest_reflectance)) if largest_reflectance < 1.0 else sys.maxsize
    )
    if bounces > MOST_BOUNCES:
        raise ValueError(
            f"reflectance {largest_reflectance:g} may need paths of more than {MOST_BOUNCES} bounces: "
            "use a closed form as reference, or give max_bounces to leave out the light of later ones"
        )
    return bounces


def _path_integrator(mi: Any, largest_reflectance: float, bounces: int | None) -> Any:
    if bounces is not None:
        # Mitsuba's depth counts the look at the patch, too. Roulette that would begin where paths end is off.
        return mi.load_dict({"type": "path", "max_depth": bounces + 1, "rr_depth": bounces + 1})
    # Roulette turns what light is left into all or nothing: the later, the less noise and the longer the paths.
    depth = MITSUBA_ROULETTE_DEPTH
    if largest_reflectance > 0.0:
        depth = max(depth, math.ceil(math.log(LEFT_TO_ROULETTE) / math.log(largest_reflectance)))
    return mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": depth})


def _reflected(
    mi: Any,
    integrator: Any,
    corners: FloatArray,
    rho: FloatArray,
    emission: FloatArray,
    specular: FloatArray,
    lights: dict[str, Any],
    per_patch: int,
    seed: int,
) -> tuple[FloatArray, FloatArray]:
    """Return B - E and its standard error, (n, 3) each, from `per_patch` paths for each triangle (n, 3, 3)."""
    patches = len(corners)
    traced = build(mi, corners, rho, emission, specular, lights)
    # Mesh and face in the mesh of each patch, to see whether a ray reached it.
    starts = np.array(run_starts(emission, specular))
    mesh = np.searchsorted(starts, np.arange(patches), side="right") - 1
    face = np.arange(patches) - starts[mesh]
    normals = unit_vectors(twice_area_vectors(corners))
    # What the patch emits itself is in every path: taken off as Mitsuba rounded it, and not estimated.
    own = (emission / math.pi).astype(np.float32).astype(np.float64)

    rng = np.random.default_rng(seed)
    total, squares, reached = np.zeros((patches, 3)), np.zeros((patches, 3)), np.zeros(patches)
    for start in range(0, patches * per_patch, CHUNK):
        patch = np.arange(start, min(start + CHUNK, patches * per_patch)) // per_patch
        # The path begins with a look straight at the patch from a hair above it, so that Mitsuba sees the point as it
        # sees any other: with light sampling and cosine direction, weighted against each other.
        origins = _random_points(rng, corners[patch]) + 2.0 * TRACED_HALF_SIZE * HAIR * normals[patch]
        radiance, hit = _trace(
            mi, traced, integrator, origins, -normals[patch], mesh[patch], face[patch], int(rng.integers(2**32))
        )
        reflected = math.pi * (radiance - own[patch])
        reached += np.bincount(patch, hit, patches)
        for band in range(3):
            total[:, band] += np.bincount(patch, reflected[:, band], patches)
            squares[:, band] += np.bincount(patch, reflected[:, band] ** 2, patches)
    _refuse_hidden(per_patch - reached, per_patch)
    mean = total / per_patch
    # Rounding may leave a negative zero where every path brought the same.
    variance = np.maximum(squares / per_patch - mean**2, 0.0) * (per_patch / (per_patch - 1))
    return mean, np.sqrt(variance / per_patch)


def _random_points(rng: np.random.Generator, corners: FloatArray) -> FloatArray:
    """Return one uniform random point (m, 3) in each triangle (m, 3, 3)."""
    root = np.sqrt(rng.random(len(corners)))[:, None]
    part = rng.random(len(corners))[:, None]
    points: FloatArray = (1.0 - root) * corners[:, 0] + root * ((1.0 - part) * corners[:, 1] + part * corners[:, 2])
    return points


def _trace(
    mi: Any,
    traced: Any,
    integrator: Any,
    origins: FloatArray,
    directions: FloatArray,
    mesh: IntArray,
    face: IntArray,
    seed: int,
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Return the radiance (m, 3) along rays (m, 3), and whether they met the given face (m,) of the given mesh (m,).

    The sampler is `independent`: that of a stratified one would say nothing true about the standard error.
    """
    sampler = mi.load_dict({"type": "independent"})
    if is_scalar(mi):
        return _trace_one_by_one(mi, traced, integrator, sampler, origins, directions, mesh, face, seed)
    import drjit

    sampler.seed(seed, len(origins))
    ray = mi.Ray3f(mi.Point3f(origins.T.astype(np.float32)), mi.Vector3f(directions.T.astype(np.float32)))
    radiance, _, _ = integrator.sample(traced, sampler, ray)
    first = traced.ray_intersect_preliminary(ray)
    aimed_at = drjit.gather(mi.ShapePtr, traced.shapes_dr(), mi.UInt32(mesh.astype(np.uint32)))
    hit = (first.shape == aimed_at) & (first.prim_index == mi.UInt32(face.astype(np.uint32)))
    return np.array(radiance, dtype=np.float64).T, np.array(hit, dtype=np.bool_)


def _trace_one_by_one(
    mi: Any,
    traced: Any,
    integrator: Any,
    sampler: Any,
    origins: FloatArray,
    directions: FloatArray,
    mesh: IntArray,
    face: IntArray,
    seed: int,
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Do what `_trace` does in a scalar variant."""
    sampler.seed(seed, 1)
    shapes = traced.shapes()
    radiance = np.empty((len(origins), 3))
    hit = np.empty(len(origins), dtype=np.bool_)
    rays = zip(origins.tolist(), directions.tolist(), mesh.tolist(), face.tolist(), strict=True)
    for k, (origin, direction, mesh_k, face_k) in enumerate(rays):
        ray = mi.RayDifferential3f(mi.Point3f(origin), mi.Vector3f(direction))
        radiance[k] = integrator.sample(traced, sampler, ray)[0]
        first = traced.ray_intersect_preliminary(ray)
        hit[k] = first.is_valid() and first.shape == shapes[mesh_k] and first.prim_index == face_k
    return radiance, hit


def _refuse_hidden(missed: FloatArray, per_patch: int) -> None:
    """Raise a ValueError that names the patches whose rays met another one first."""
    hidden = np.flatnonzero(missed > MISSES_LET_THROUGH + LARGEST_MISSED_PART * per_patch)
    if len(hidden) == 0:
        return
    lines = [f"  patch {i}: {missed[i] / per_patch:.0%} of the rays aimed at it met another one" for i in hidden[:10]]
    if len(hidden) > 10:
        lines.append(f"  and {len(hidden) - 10} more")
    raise ValueError(
        f"{len(hidden)} patches cannot be seen by Mitsuba: another patch lies on them, or closer in front than "
        f"{HAIR:g} of the scene's size, or they are thinner than rounding allows\n" + "\n".join(lines)
    )
