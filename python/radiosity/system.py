"""Any form factors and one named method: B = E + rho F B, for one state of light or for many at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import index as operator_index
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from . import _core
from .arrays import FloatArray, per_patch, read_only, real_array, shaped, thread_count, whole_number
from .distributed import SOLVERS, DistributedFormFactors
from .form_factors import FormFactors
from .memory import available_bytes
from .progress import Progress, reporter
from .report import counted
from .scene import Scene
from .solution import ConvergenceError, EnergyAudit, Report, Solution, Step, System

if TYPE_CHECKING:
    import scipy.sparse

OnIteration: TypeAlias = Callable[[int, FloatArray, FloatArray], object]


class Operator(NamedTuple):
    """F as the core has it, and what is known of it."""

    core: _core.FormFactors
    scene: Scene | None
    segments: int
    row_error: float | None
    is_at_hand: bool = True
    """Whether it is for more than one solve: one that asks a cluster is not."""


def solve_system(
    F: FormFactors | DistributedFormFactors | FloatArray | scipy.sparse.sparray,
    emission: Any,
    reflectance: Any,
    method: str = "gauss_seidel",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    on_iteration: OnIteration | None = None,
    threads: int | None = None,
    progress: Progress = True,
    *,
    start: Any = None,
) -> Solution:
    """Solves B = E + rho F B, all bands in one pass.

    Args:
        F: a :class:`FormFactors`, an (n, n) array or a SciPy sparse matrix; F[i, j] is the fraction of what leaves i
            that reaches j. A plain matrix has no areas: all patches then weigh the same, and there is no energy audit.
            Or factors of :func:`radiosity.distributed.form_factors`, for ``"jacobi"`` and ``"gmres"``.
        emission: E, W/m^2; scalar, (b,) or (n, b); or (n, b, k), k states of light, which share every product with F,
            and its LU factors: the result is then :class:`Solutions`.
        reflectance: rho in [0, 1]; scalar, (b,) or (n, b).
        method: ``"direct"`` (LU), ``"jacobi"`` (step k is the light after k bounces), ``"gauss_seidel"`` (gathering),
            ``"southwell"`` (progressive refinement, shooting: the largest unshot power first), ``"overshooting"`` (the
            same, with what is going to arrive) or ``"gmres"``.
        tolerance: relative residual to reach: ||E + rho F B - B|| <= tolerance ||E|| in every band, with area-weighted
            norms; in (0, 1).
        max_iterations: steps allowed; None for a generous limit. A step is a bounce (jacobi), a sweep (gauss_seidel), a
            shot (southwell, overshooting), a Krylov vector (gmres) or the factorisation (direct).
        on_iteration: called as ``on_iteration(step, radiosity, unshot)`` after every step, with (n, b) arrays. An
            exception that it raises stops the solver and is passed on. Not for many states.
        threads: None for all cores. The result is the same for any number.
        progress: see :mod:`radiosity.progress`.
        start: (n, b) a radiosity to start from, for ``"gmres"`` and one state: the nearer it is, the fewer steps are
            needed.

    Raises:
        TypeError, ValueError: shapes or values out of range, an unknown method, or a system without finite solution.
        MemoryError: the LU factors would not fit.
        ConnectionError: the workers that hold F are gone.
        ConvergenceError: the steps ran out; it carries the history and the unfinished solution.

    Sources:
        Goral et al. 1984 (direct); Cohen & Greenberg 1985 (Gauss-Seidel); Cohen et al. 1988 (Southwell);
        Feda & Purgathofer 1992 (overshooting); Saad & Schultz 1986 (GMRES).
    """
    operator = operator_of(F, method)
    if np.ndim(emission) == 3:
        if on_iteration is not None or start is not None:
            raise ValueError("on_iteration and start are for one state of light, not for emission of shape (n, b, k)")
        return _solved_states(operator, emission, reflectance, method, tolerance, max_iterations, threads, progress)
    e, rho = per_patch(operator.core.n, emission=emission, reflectance=reflectance)
    return solved(operator, e, rho, method, tolerance, max_iterations, on_iteration, threads, progress, start)


def solved(
    operator: Operator,
    emission: FloatArray,
    reflectance: FloatArray,
    method: str = "gmres",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    on_iteration: OnIteration | None = None,
    threads: int | None = None,
    progress: Progress = True,
    start: Any = None,
) -> Solution:
    """:func:`solve_system` for an operator that the core has, with (n, b) emission and reflectance."""
    core, scene, segments, row_error, is_at_hand = operator
    n, bands = emission.shape
    # What the solution keeps must not change with the caller's arrays.
    emission, reflectance = read_only(emission.copy()), read_only(reflectance.copy())
    if start is not None:
        if method != "gmres":
            raise ValueError(f"method {method!r} cannot start from a radiosity; method='gmres' can")
        start = shaped("start", start, n, bands)
    if max_iterations is not None:
        max_iterations = whole_number("max_iterations", max_iterations, 1, 2**62)
    begin = perf_counter()
    with reporter(progress, str(method)) as report:
        result = _core.solve(
            core,
            emission,
            reflectance,
            str(method),
            float(tolerance),
            max_iterations,
            available_bytes(),
            on_iteration,
            start,
            thread_count(threads),
            report,
        )
    seconds = perf_counter() - begin
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
            bands=bands,
            steps=len(history),
            residual=result["residual"],
            audit=None if audit is None else EnergyAudit(*audit),
            bound=read_only(result["bound"]),
            seconds={"solve": seconds},
            segments=segments,
            row_error=row_error,
        ),
        scene=None if scene is None else scene_with(scene, reflectance, emission),
        system=System(operator, emission, reflectance) if is_at_hand else None,
    )
    if result["failure"] is not None:
        raise ConvergenceError(result["failure"], solution)
    return solution


@dataclass(frozen=True, repr=False, kw_only=True)
class Solutions(Solution):
    """The solutions of k states of light; ``solution[s]`` is one of them, ``len`` their number.

    ``radiosity`` and ``irradiance`` are (n, b, k). ``error_estimate`` is of all states together: the root of the sum of
    their squared errors over that of their reflected radiosities, from random combinations of states (Hutchinson 1990).
    What is a small part of that may be a large one of a dim state: ``solution[s].error_estimate`` is nan, and a solve
    of its own tells it. ``scene`` and ``system`` have the emission of the first state. There is no standard error and
    no history; energy audits are those of ``solution[s]``.
    """

    emission: FloatArray
    """(n, b, k) E, W/m^2."""
    reflectance: FloatArray
    """(n, b) rho."""
    residuals: FloatArray
    """(k,) relative residuals, the largest over the bands."""

    def __len__(self) -> int:
        return len(self.residuals)

    def __getitem__(self, state: int) -> Solution:
        s = range(len(self))[operator_index(state)]
        scene, rho = self.scene, self.reflectance
        e, b, h = (
            read_only(np.ascontiguousarray(values[:, :, s]))
            for values in (self.emission, self.radiosity, self.irradiance)
        )
        audit = None
        if scene is not None and self.system is not None:
            areas, row_sums = scene.areas, self.system.operator.core.row_sums
            audit = EnergyAudit(
                areas @ e, areas @ ((1.0 - rho) * h), (areas * (1.0 - row_sums)) @ b, areas @ (e + rho * h - b)
            )
        return Solution(
            radiosity=b,
            irradiance=h,
            standard_error=None,
            error_estimate=np.nan,
            history=(),
            report=dataclasses.replace(self.report, residual=float(self.residuals[s]), audit=audit),
            scene=None if scene is None else scene_with(scene, rho, e),
            system=None if self.system is None else System(self.system.operator, e, rho),
        )

    def __iter__(self) -> Iterator[Solution]:
        return (self[s] for s in range(len(self)))

    @property
    def as_shown(self) -> Solution:
        """Nothing: many states have no one picture. Raises ``ValueError``."""
        raise ValueError(f"{self!r} is of many states of light: take one, solution[s]")

    def __repr__(self) -> str:
        n, bands, states = self.radiosity.shape
        size = (
            f"{counted(n, 'patch', 'patches')}, {counted(bands, 'band', 'bands')}, {counted(states, 'state', 'states')}"
        )
        return f"Solutions({size}, {self.report.method}, error about {self.error_estimate:.2g})"


def _solved_states(
    operator: Operator,
    emission: Any,
    reflectance: Any,
    method: str,
    tolerance: float,
    max_iterations: int | None,
    threads: int | None,
    progress: Progress,
) -> Solutions:
    """:func:`solve_system` for (n, b, k) emission."""
    core, scene, segments, row_error, is_at_hand = operator
    e = shaped("emission", emission, core.n, "b", "k")
    n, bands, states = e.shape
    rho, _ = per_patch(n, reflectance=reflectance, emission=np.zeros((n, bands)))
    bands = rho.shape[1]
    # What the solution keeps must not change with the caller's arrays.
    e, rho = read_only(np.broadcast_to(e, (n, bands, states)).copy()), read_only(rho.copy())
    if max_iterations is not None:
        max_iterations = whole_number("max_iterations", max_iterations, 1, 2**62)
    begin = perf_counter()
    with reporter(progress, str(method)) as report:
        radiosity, irradiance, steps, residuals, error, failure = _core.solve_states(
            core,
            e.reshape(n, -1),
            rho,
            str(method),
            float(tolerance),
            max_iterations,
            available_bytes(),
            thread_count(threads),
            report,
        )
    solution = Solutions(
        radiosity=read_only(radiosity.reshape(e.shape)),
        irradiance=read_only(irradiance.reshape(e.shape)),
        standard_error=None,
        error_estimate=error,
        history=(),
        report=Report(
            method=method,
            patches=n,
            bands=bands,
            steps=steps,
            residual=float(residuals.max()),
            audit=None,
            seconds={"solve": perf_counter() - begin},
            segments=segments,
            row_error=row_error,
        ),
        scene=None if scene is None else scene_with(scene, rho, e[:, :, 0]),
        emission=e,
        residuals=read_only(residuals),
        system=System(operator, e[:, :, 0], rho) if is_at_hand else None,
        reflectance=rho,
    )
    if failure is not None:
        raise ConvergenceError(failure, solution)
    return solution


def scene_with(scene: Scene, reflectance: FloatArray, emission: FloatArray) -> Scene:
    """The scene itself if it has these materials, else a copy that has."""
    same = np.array_equal(scene.reflectance, reflectance) and np.array_equal(scene.emission, emission)
    return scene if same else scene.with_materials(reflectance, emission)


def operator_of(F: Any, method: str = "gmres") -> Operator:
    """The core's operator for whatever the user brings, with its scene, segments and row error where known."""
    if isinstance(F, FormFactors):
        return Operator(F._core, F.scene, F.segments, F.error_estimate)
    if isinstance(F, DistributedFormFactors):
        if method not in SOLVERS:
            raise ValueError(
                f"method {method!r} asks for F patch by patch, which workers would have to answer one at a time; "
                f"the solvers for distributed form factors are {SOLVERS}"
            )
        return Operator(F._operator(), F.scene, F.segments, F.error_estimate, is_at_hand=False)
    if hasattr(F, "tocsr"):
        csr = F.tocsr()
        if csr.shape[0] != csr.shape[1]:
            raise ValueError(f"F must be square, not {csr.shape}")
        start, index = (np.asarray(part, np.int64) for part in (csr.indptr, csr.indices))
        return Operator(_core.FormFactors.from_csr(start, index, real_array("F", csr.data)), None, 0, None)
    matrix = shaped("F", F, "n", "n")
    if matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"F must be square, not {matrix.shape}")
    return Operator(_core.FormFactors.from_array(matrix), None, 0, None)


def ambient(areas: Any, unshot: Any, reflectance: Any) -> FloatArray:
    """(b,) the ambient radiosity of an unfinished Southwell solution, W/m^2, for display only.

    The light still under way, spread evenly over the scene and followed through all its bounces. Show
    ``radiosity + reflectance * ambient(...)`` in place of a picture that is too dark at first.

    Args:
        areas: (n,) patch areas, m^2.
        unshot: (n, b) unshot radiosity, as ``on_iteration`` receives it.
        reflectance: rho; scalar, (b,) or (n, b).

    Raises:
        ValueError: areas that are not positive, values that are not finite, a reflectance outside [0, 1], or one of 1
            in the mean, with which the light never dies.

    Source:
        Cohen, Chen, Wallace & Greenberg 1988, section 4.3.
    """
    sizes = shaped("areas", areas, "n")
    shot, rho = per_patch(len(sizes), unshot=unshot, reflectance=reflectance)
    if not (sizes.size and (sizes > 0).all()):
        raise ValueError("areas must hold at least one patch, all of them positive")
    with np.errstate(over="ignore"):
        total = sizes.sum()
    if not (np.isfinite(total) and np.isfinite(shot).all()):
        raise ValueError("the sum of the areas and unshot must be finite")
    bad = np.argwhere(~((rho >= 0.0) & (rho <= 1.0)))
    if bad.size:
        patch, band = bad[0].tolist()
        raise ValueError(f"patch {patch}: reflectance {rho[patch, band]:g} is outside [0, 1] (band {band})")
    if (sizes @ rho >= total).any():
        raise ValueError("the mean reflectance must be below 1 in every band")
    return _core.ambient(sizes, shot, rho)
