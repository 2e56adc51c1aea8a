"""Light anew: what form factors, computed once, are used for again and again.

- other lamps and paints, from the solution before: :meth:`radiosity.Solution.update`
- many states of light at once: :class:`Solutions`, from :func:`radiosity.solve_system`
- from lamps to places, as a small matrix: :func:`transfer`
- derivatives: :meth:`radiosity.Solution.vjp`
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import _core
from .arrays import FloatArray, per_patch, read_only, real_number, shaped, thread_count
from .progress import Progress, reporter
from .solution import Gradient, Solution, System
from .system import Solutions, solved


def _system_of(solution: Solution) -> System:
    if isinstance(solution, Solutions):
        raise ValueError(f"{solution!r} is of many states of light: take one, solution[s]")
    if solution.system is None:
        raise ValueError(
            f"this solution, by method {solution.report.method!r}, has no form factors at hand: those by rays, links "
            "and with lights, and those from clusters, files and other processes, have none; solve_system(F, emission, "
            "reflectance) gives one that has, and with the emission E + rho H0 of direct_irradiance it has lights"
        )
    return solution.system


def updated(
    solution: Solution,
    emission: Any,
    reflectance: Any,
    tolerance: float,
    max_iterations: int | None,
    threads: int | None,
    progress: Progress,
) -> Solution:
    """:meth:`radiosity.Solution.update`."""
    system = _system_of(solution)
    e = system.emission if emission is None else emission
    rho = system.reflectance if reflectance is None else reflectance
    # A solution of one band becomes the start of as many as the new lamps or paints have.
    e, rho, start = per_patch(len(solution.radiosity), emission=e, reflectance=rho, solution=solution.radiosity)
    # Where all is dark or black the answer is known, and what was there before only its rounding.
    is_known = ~(e.any(axis=0) & rho.any(axis=0))
    start = np.where(is_known, e, start)
    return solved(system.operator, e, rho, "gmres", tolerance, max_iterations, None, threads, progress, start)


def gradient(solution: Solution, cotangent: Any, tolerance: float, threads: int | None, progress: Progress) -> Gradient:
    """:meth:`radiosity.Solution.vjp`."""
    system = _system_of(solution)
    g = shaped("cotangent", cotangent, *solution.radiosity.shape)
    rho = system.reflectance
    adjoint = g + importance(system.operator.core, rho, rho * g, tolerance, threads, progress)
    return Gradient(read_only(adjoint), read_only(adjoint * solution.irradiance))


def importance(
    core: _core.FormFactors,
    reflectance: FloatArray,
    weights: FloatArray,
    tolerance: float,
    threads: int | None,
    progress: Progress,
) -> FloatArray:
    """F^T (I - rho F^T)^-1 w."""
    if not 0.0 < real_number("tolerance", tolerance) < 1.0:
        raise ValueError(f"tolerance {tolerance} is outside (0, 1)")
    with reporter(progress, "adjoint") as report:
        return _core.importance(core, reflectance, weights, float(tolerance), thread_count(threads), report)
