"""Solvers of the radiosity equation B = E + rho F B.

:func:`solve` takes a scene and decides everything; :func:`solve_system` takes any form factors and one named method.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from . import _core
from .arrays import FloatArray, per_patch, read_only, real_array, shaped, thread_count, whole_number
from .form_factors import FormFactors, form_factors_as_reached
from .memory import available_bytes
from .progress import Progress, reporter
from .scene import Scene
from .solution import ConvergenceError, EnergyAudit, Report, Solution, Step

if TYPE_CHECKING:
    import scipy.sparse

OnIteration: TypeAlias = Callable[[int, FloatArray, FloatArray], object]
METHODS = ("auto", "dense")

# Share of the tolerance that the error estimate may use; the rest is for the estimate's own error.
_SAMPLING_SHARE = 0.8
# Row tolerance of the first attempt, in tolerances of the solution. Errors of single form factors average out over a
# row: on the reference scenes a row error of 3 tolerances leaves an error of 0.1 to 0.8 tolerances in B - E.
_FIRST_ROW_TOLERANCE = 3.0
_ATTEMPTS = 6
# Of the iteration: relative to E, and so small that it does not count even where little light is reflected.
_RESIDUAL = 1e-10


def solve_system(
    F: FormFactors | FloatArray | scipy.sparse.sparray,
    emission: Any,
    reflectance: Any,
    method: str = "gauss_seidel",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    on_iteration: OnIteration | None = None,
    threads: int | None = None,
    progress: Progress = True,
) -> Solution:
    """Solves B = E + rho F B, all bands in one pass.

    Args:
        F: a :class:`FormFactors`, an (n, n) array or a SciPy sparse matrix; F[i, j] is the fraction of what leaves i
            that reaches j. A plain matrix has no areas: all patches then weigh the same, and there is no energy audit.
        emission: E, W/m^2; scalar, (b,) or (n, b).
        reflectance: rho in [0, 1]; scalar, (b,) or (n, b).
        method: ``"direct"`` (LU), ``"jacobi"`` (step k is the light after k bounces), ``"gauss_seidel"`` (gathering),
            ``"southwell"`` (progressive refinement, shooting: the largest unshot power first) or ``"gmres"``.
        tolerance: relative residual to reach: ||E + rho F B - B|| <= tolerance ||E|| in every band, with area-weighted
            norms; in (0, 1).
        max_iterations: steps allowed; None for a generous limit. A step is a bounce (jacobi), a sweep (gauss_seidel), a
            shot (southwell), a Krylov vector (gmres) or the factorisation (direct).
        on_iteration: called as ``on_iteration(step, radiosity, unshot)`` after every step, with (n, b) arrays. An
            exception that it raises stops the solver and is passed on.
        threads: None for all cores. The result is the same for any number.
        progress: see :mod:`radiosity.progress`.

    Raises:
        TypeError, ValueError: shapes or values out of range, an unknown method, or a system without finite solution.
        MemoryError: the LU factors would not fit.
        ConvergenceError: the steps ran out; it carries the history and the unfinished solution.

    Sources:
        Goral et al. 1984 (direct); Cohen & Greenberg 1985 (Gauss-Seidel); Cohen et al. 1988 (Southwell); Saad & Schultz
        1986 (GMRES).
    """
    core, scene, segments, row_error = _operator(F)
    n = core.n
    e, rho = per_patch(n, emission=emission, reflectance=reflectance)
    if max_iterations is not None:
        max_iterations = whole_number("max_iterations", max_iterations, 1, 2**62)
    start = perf_counter()
    with reporter(progress, str(method)) as report:
        result = _core.solve(
            core,
            e,
            rho,
            str(method),
            float(tolerance),
            max_iterations,
            available_bytes(),
            on_iteration,
            thread_count(threads),
            report,
        )
    seconds = perf_counter() - start
    history = tuple(Step(float(r), u) for r, u in zip(result["residuals"], result["unshot"], strict=True))
    audit = result["audit"]
    solution = Solution(
        radiosity=read_only(result["radiosity"]),
        irradiance=read_only(result["irradiance"]),
        standard_error=None if result["standard_error"] is None else read_only(result["standard_error"]),
        error_estimate=result["error_estimate"],
        history=history,
        report=Report(
            method=method,
            patches=n,
            bands=e.shape[1],
            steps=len(history),
            residual=result["residual"],
            audit=None if audit is None else EnergyAudit(*audit),
            seconds={"solve": seconds},
            segments=segments,
            row_error=row_error,
        ),
        scene=None if scene is None else _scene_with(scene, rho, e),
    )
    if result["failure"] is not None:
        raise ConvergenceError(result["failure"], solution)
    return solution


def _scene_with(scene: Scene, reflectance: FloatArray, emission: FloatArray) -> Scene:
    """The scene itself if it has these materials, else a copy that has."""
    same = np.array_equal(scene.reflectance, reflectance) and np.array_equal(scene.emission, emission)
    return scene if same else scene.with_materials(reflectance, emission)


def _operator(F: Any) -> tuple[_core.FormFactors, Scene | None, int, float | None]:
    """The core's operator for whatever the user brings, with its scene, segments and row error where known."""
    if isinstance(F, FormFactors):
        return F._core, F.scene, F.segments, F.error_estimate
    if hasattr(F, "tocsr"):
        csr = F.tocsr()
        if csr.shape[0] != csr.shape[1]:
            raise ValueError(f"F must be square, not {csr.shape}")
        start, index = (np.asarray(part, np.int64) for part in (csr.indptr, csr.indices))
        return _core.FormFactors.from_csr(start, index, real_array("F", csr.data)), None, 0, None
    matrix = shaped("F", F, "n", "n")
    if matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"F must be square, not {matrix.shape}")
    return _core.FormFactors.from_array(matrix), None, 0, None


def solve(
    scene: Scene,
    tolerance: float = 0.01,
    method: str = "auto",
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = True,
) -> Solution:
    """Form factors and solution of a scene, to a tolerance on the patches as they are.

    Args:
        scene: the patches, with their emission and reflectance.
        tolerance: relative error of the reflected radiosity B - E (area-weighted RMS, the worst band) against the exact
            solution on these patches, in (0, 1). It covers the kernels, the sampled visibility and the iteration. It
            does not cover discretisation, the error of one constant radiosity a patch: on a coarse mesh that is the
            larger part, and a finer one (:meth:`radiosity.Scene.subdivide`) lowers it.
        method: ``"dense"``, all pairs and GMRES; ``"auto"`` chooses.
        seed: of the quasi-random segments.
        threads: None for all cores. The result is the same for any number.
        progress: see :mod:`radiosity.progress`.

    Raises:
        ValueError: an unknown method, a tolerance out of range, or a scene without finite solution.
        MemoryError: the form factors would not fit, with the estimate; nothing has been computed then.

    Warns:
        UserWarning: the scene has no emission; or the tolerance was not met, and ``.error_estimate`` says what was.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}")
    if method not in METHODS:
        raise ValueError(
            f"unknown method {method!r}; the methods of solve are {METHODS}; solvers are chosen in solve_system"
        )
    tolerance = float(tolerance)
    if not 0.0 < tolerance < 1.0:
        raise ValueError(f"tolerance {tolerance} is outside (0, 1)")
    if not scene.emission.any():
        warnings.warn("the scene has no emission: the answer is 0", UserWarning, stacklevel=2)
    row_tolerance = _FIRST_ROW_TOLERANCE * tolerance
    seconds = {"form factors": 0.0, "solve": 0.0}
    segments = 0
    for attempt in range(_ATTEMPTS):
        start = perf_counter()
        F = form_factors_as_reached(scene, max(min(row_tolerance, 0.5), 1e-8), "auto", seed, threads, progress)
        seconds["form factors"] += perf_counter() - start
        segments += F.segments
        solution = solve_system(
            F, scene.emission, scene.reflectance, "gmres", _RESIDUAL, threads=threads, progress=progress
        )
        seconds["solve"] += solution.report.seconds["solve"]
        reached = solution.error_estimate / (_SAMPLING_SHARE * tolerance)
        if reached <= 1.0 or attempt == _ATTEMPTS - 1 or not np.isfinite(reached):
            break
        row_tolerance /= max(1.25 * reached, 2.0)
    if solution.error_estimate > tolerance:
        warnings.warn(
            f"the error of the solution on these patches is about {solution.error_estimate:.2g}, above the tolerance "
            f"{tolerance:g}",
            UserWarning,
            stacklevel=2,
        )
    return dataclasses.replace(
        solution, report=dataclasses.replace(solution.report, seconds=seconds, segments=segments)
    )


def ambient(areas: Any, unshot: Any, reflectance: Any) -> FloatArray:
    """(b,) the ambient radiosity of an unfinished Southwell solution, W/m^2, for display only.

    The light still under way, spread evenly over the scene and followed through all its bounces. Show
    ``radiosity + reflectance * ambient(...)`` in place of a picture that is too dark at first.

    Args:
        areas: (n,) patch areas, m^2.
        unshot: (n, b) unshot radiosity, as ``on_iteration`` receives it.
        reflectance: rho; scalar, (b,) or (n, b).

    Raises:
        ValueError: areas that are not positive, or a mean reflectance of 1, with which the light never dies.

    Source:
        Cohen, Chen, Wallace & Greenberg 1988, section 4.3.
    """
    sizes = shaped("areas", areas, "n")
    shot, rho = per_patch(len(sizes), unshot=unshot, reflectance=reflectance)
    if not (sizes.size and (sizes > 0).all()):
        raise ValueError("areas must hold at least one patch, all of them positive")
    if (sizes @ rho >= sizes.sum()).any():
        raise ValueError("the mean reflectance must be below 1 in every band")
    return _core.ambient(sizes, shot, rho)
