"""What a state of light costs among a thousand, other paints from the solution before, and derivatives.

    python benches/relight.py [MAX_EDGE]

prints seconds of one state alone and of one of 1,000, their ratio and how far they differ, method by method; the steps
from the solution before against those from nothing; and an adjoint solve against a solve. The goal is 1/20.
"""

import statistics
import sys
import time

import numpy as np

import radiosity as rad

STATES = 1000
REPEATS = 3
QUIET = {"progress": False}


def seconds(work):
    """Median seconds, and what the last call gave."""
    spent = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        result = work()
        spent.append(time.perf_counter() - start)
    return statistics.median(spent), result


def states(F, scene):
    n, bands = scene.emission.shape
    lit = (scene.emission > 0)[:, :, None]
    emission = np.where(lit, np.random.default_rng(0).uniform(size=(n, bands, STATES)), 0.0)
    print(f"{'method':14s}{'alone, s':>10s}{'of 1,000, ms':>14s}{'ratio':>8s}{'differ by':>11s}")
    for method in ("direct", "gmres", "jacobi", "gauss_seidel"):
        alone, one = seconds(lambda m=method: rad.solve_system(F, emission[:, :, 0], scene.reflectance, m, **QUIET))
        start = time.perf_counter()
        many = rad.solve_system(F, emission, scene.reflectance, method, **QUIET)
        each = (time.perf_counter() - start) / STATES
        off = np.abs(many.radiosity[:, :, 0] - one.radiosity).max() / one.radiosity.max()
        print(f"{method:14s}{alone:10.3f}{each * 1e3:14.2f}{f'1/{alone / each:.0f}':>8s}{off:11.0e}", flush=True)


def paints(F, scene):
    solution = rad.solve_system(F, scene.emission, scene.reflectance, "gmres", **QUIET)
    print(f"\nfrom nothing: {solution.report.steps} steps")
    for part in (0.999, 0.99, 0.9):
        after = solution.update(reflectance=part * scene.reflectance, **QUIET)
        print(f"reflectance times {part}: {after.report.steps} steps from the solution before")


def derivatives(F, scene):
    spent, solution = seconds(lambda: rad.solve_system(F, scene.emission, scene.reflectance, "gmres", 1e-10, **QUIET))
    back, _ = seconds(lambda: solution.vjp(np.ones_like(solution.radiosity), **QUIET))
    print(f"\na solve {spent:.3f} s, all {2 * solution.radiosity.size} derivatives of a scalar {back:.3f} s")


def main():
    scene = rad.scenes.cornell_box(max_edge=float(sys.argv[1]) if sys.argv[1:] else 0.08)
    F = rad.form_factors(scene, 1e-2, **QUIET)
    print(f"{scene}, row error {F.error_estimate:.2g}")
    states(F, scene)
    paints(F, scene)
    derivatives(F, scene)


if __name__ == "__main__":
    main()
