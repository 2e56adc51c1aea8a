"""The path tracer at its fastest: patch averages of radiosity without a standard error, for a fair race.

The same average as `reference_radiosity` takes, pi * L over points of a patch, but in one kernel from the point to the
mean, and with the sampler `multijitter` in place of `independent`: the points of a patch, its first directions and its
points on lamps are then stratified. Light sampling is on (the `path` integrator), and roulette begins where Mitsuba
begins it. On the Cornell box that takes a third of the time for the same error. The price: one run has no valid
standard error. Runs with different seeds are independent, though, and their spread is one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray, seed_number

if TYPE_CHECKING:
    from ..scene import Scene

from .reference import (
    MITSUBA_ROULETTE_DEPTH,
    TRACED_HALF_SIZE,
    centred_and_scaled,
    last_bounce,
    paths_per_patch,
    reference_radiosity,
    three_bands,
)
from .variant import is_scalar, mitsuba_for_a_while
from .writing import HAIR, build, specular_of, twice_area_vectors, unit_vectors

# Paths in one kernel: the more, the finer the strata and the fewer fixed costs; 4 million take about 0.2 GiB.
LARGEST_LAUNCH = 1 << 22


class PatchTracer:
    """Mitsuba's own scene and integrator, built once for the patches of a scene of up to three bands.

    Call it with a number of paths and a seed. The first call with a number of paths compiles a kernel for it; later
    ones only run it. Scalar variants have no kernels: there, `reference_radiosity` does the work.

    Raises:
        ImportError: Mitsuba is not installed.
        ValueError: more than three bands, or reflectances too near 1 (see `reference_radiosity`).

    """

    def __init__(self, scene: Scene) -> None:
        if scene.bands > 3:
            raise ValueError(f"Mitsuba's RGB variants have three bands and the scene has {scene.bands}")
        self.scene = scene
        self._corners = centred_and_scaled(scene.vertices[scene.faces])
        rho, self._emission = three_bands(scene.reflectance), three_bands(scene.emission)
        with mitsuba_for_a_while() as mi:
            self.variant = str(mi.variant())
            self._traced = build(mi, self._corners, rho, self._emission, specular_of(scene))
            bounces = last_bounce(float(rho.max()), None)
            depth, roulette = (-1, MITSUBA_ROULETTE_DEPTH) if bounces is None else (bounces + 1, bounces + 1)
            self._integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": roulette})
            self._scalar = is_scalar(mi)

    def __call__(self, paths: int, seed: int = 0) -> tuple[FloatArray, int]:
        """Return the radiosity (n, b) in W/m^2, and the number of paths traced.

        Args:
            paths: wanted in all, at least 2 n; the number for each patch is rounded up to a square, a full grid.
            seed: 0 or more.

        """
        scene = self.scene
        wanted = paths_per_patch(paths, scene.n_patches)
        if self._scalar:
            return reference_radiosity(scene, paths, seed)[0], wanted * scene.n_patches
        launches = math.ceil(wanted * scene.n_patches / LARGEST_LAUNCH)
        rng = np.random.default_rng(seed_number(seed))
        total, traced = np.zeros((scene.n_patches, 3)), 0
        with mitsuba_for_a_while() as mi:
            for _ in range(launches):
                radiance, count = self._launch(mi, math.ceil(wanted / launches), int(rng.integers(2**32)))
                total += count * radiance
                traced += count
        # What the patch emits itself is in every path: taken off as Mitsuba rounded it, and not estimated.
        own = (self._emission / math.pi).astype(np.float32)
        reflected = math.pi * (total / traced - own)
        return scene.emission + reflected[:, : scene.bands], traced * scene.n_patches

    def _launch(self, mi: Any, per_patch: int, seed: int) -> tuple[FloatArray, int]:
        """Return the mean radiance (n, 3) of each patch, and the number of paths for each."""
        import drjit

        patches = self.scene.n_patches
        count = (math.isqrt(per_patch - 1) + 1) ** 2
        sampler = mi.load_dict({"type": "multijitter", "sample_count": count})
        sampler.set_samples_per_wavefront(count)  # the strata are those of a patch, not of all paths
        sampler.seed(seed, patches * count)
        patch = drjit.arange(mi.UInt32, patches * count) // count
        a, b, c = (
            drjit.gather(mi.Point3f, mi.Point3f(self._corners[:, k].T.astype(np.float32)), patch) for k in range(3)
        )
        vectors = unit_vectors(twice_area_vectors(self._corners)).T.astype(np.float32)
        normal = drjit.gather(mi.Normal3f, mi.Normal3f(vectors), patch)
        part = mi.warp.square_to_uniform_triangle(sampler.next_2d())
        # The path begins with a look straight at the patch from a hair above it, as in `reference_radiosity`.
        point = a + part.x * (b - a) + part.y * (c - a) + (2.0 * TRACED_HALF_SIZE * HAIR) * normal
        radiance, _, _ = self._integrator.sample(self._traced, sampler, mi.Ray3f(point, -normal))
        drjit.eval(radiance)  # once: each band by itself would trace all paths again
        mean = [np.array(drjit.block_sum(radiance[band], count), dtype=np.float64) / count for band in range(3)]
        return np.stack(mean, axis=1), count
