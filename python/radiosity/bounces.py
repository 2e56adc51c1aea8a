"""Every bounce visible: what a solver has after each of its steps, one after the other."""

from __future__ import annotations

import atexit
import contextlib
import math
import queue
import threading
import weakref
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .arrays import FloatArray, per_patch, read_only, whole_number
from .distributed import DistributedFormFactors
from .form_factors import FormFactors, form_factors
from .progress import Progress
from .scene import Scene
from .solution import ConvergenceError, Report, Solution, Step
from .system import OnIteration, solve_system
from .system import ambient as ambient_radiosity

if TYPE_CHECKING:
    import scipy.sparse

__all__ = ["bounces"]

# Methods whose step is a shot.
SHOTS = ("southwell", "overshooting")


def bounces(
    scene_or_F: Scene | FormFactors | DistributedFormFactors | FloatArray | scipy.sparse.sparray,
    emission: Any = None,
    reflectance: Any = None,
    method: str = "jacobi",
    *,
    every: int = 1,
    ambient: bool = False,
    tolerance: float = 1e-3,
    max_iterations: int | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Iterator[Solution]:
    """The solution after each step of a solver, made as it is asked for.

    A step of ``"jacobi"`` is a bounce of all the light: the first shows light straight from the emitters, every
    later one adds a bounce. A step of ``"southwell"`` or ``"overshooting"`` is the shot of one patch, and what it has
    lit counts as lit, though it has not been sent on (Cohen, Chen, Wallace & Greenberg 1988). A step of
    ``"gauss_seidel"`` is a sweep, of ``"gmres"`` a Krylov vector.

    Args:
        scene_or_F: a :class:`Scene`, whose form factors are computed first to a row tolerance of 1e-2; or what
            :func:`solve_system` takes.
        emission: E, W/m^2; scalar, (b,) or (n, b). None for that of the scene.
        reflectance: rho in [0, 1]; scalar, (b,) or (n, b). None for that of the scene.
        method: as in :func:`solve_system`.
        every: yield every so many steps only, and the last one. Each costs a product with F.
        ambient: add the light still under way, spread evenly (:func:`ambient`): for display, as progressive refinement
            was first shown (ibid.). The unshot power in ``.history`` is not changed.
        tolerance: relative residual at which to end, in (0, 1).
        max_iterations: steps allowed; where they run out, the iterator just ends.
        threads: None for all cores.
        progress: see :mod:`radiosity.progress`.

    Yields:
        Solutions, with B = E + rho H where anything is reflected. ``.history`` holds the one step that led to it,
        ``.report.steps`` its number; ``.error_estimate`` is infinite: what an unfinished solution lacks is not
        estimated.

    Raises:
        TypeError, ValueError, MemoryError: as :func:`form_factors` at the call, as :func:`solve_system` at the first
            step.
        ConvergenceError: the method diverged, or used up its own limit of steps.
    """
    every = whole_number("every", every, 1, 2**62)
    F: Any = scene_or_F
    if isinstance(F, Scene):
        F = form_factors(F, tolerance=1e-2, threads=threads, progress=progress)
    scene = F.scene if isinstance(F, (FormFactors, DistributedFormFactors)) else None
    if scene is None and (emission is None or reflectance is None):
        raise ValueError("form factors without a scene need emission and reflectance")
    e, rho = per_patch(
        F.shape[0],
        emission=scene.emission if emission is None and scene is not None else emission,
        reflectance=scene.reflectance if reflectance is None and scene is not None else reflectance,
    )
    areas = scene.areas if scene is not None else np.ones(len(e))

    def solution(step: int, radiosity: FloatArray, unshot: FloatArray) -> Solution:
        size = np.sqrt(areas @ e**2)
        residual = np.divide(np.sqrt(areas @ unshot**2), size, out=np.zeros_like(size), where=size > 0)
        power = areas @ np.abs(unshot)
        largest = float(residual.max())
        arriving = F @ radiosity
        if method in SHOTS or ambient:
            radiosity = e + rho * arriving
        else:
            arriving = np.divide(radiosity - e, rho, out=np.ascontiguousarray(arriving), where=rho > 0)
        if ambient:
            light = ambient_radiosity(areas, unshot, rho)
            radiosity, arriving = radiosity + rho * light, arriving + light
        return Solution(
            radiosity=read_only(radiosity),
            irradiance=read_only(arriving),
            standard_error=None,
            error_estimate=math.inf,
            history=(Step(largest, power),),
            report=Report(method, len(e), e.shape[1], step, largest, None),
            scene=None if scene is None else scene.with_materials(rho, e),
        )

    def steps() -> Iterator[Solution]:
        def solve(give: OnIteration) -> None:
            solve_system(F, e, rho, method, tolerance, max_iterations, give, threads, progress)

        solver = _Solver(every, solve)
        try:
            while (item := solver.taken.get()) is not None:
                if isinstance(item, BaseException):
                    if _ran_out(item, max_iterations):
                        return
                    raise item
                yield solution(*item)
        finally:
            solver.stop(timeout=1.0)

    return steps()


def _ran_out(error: BaseException, max_iterations: int | None) -> bool:
    """Whether the steps that the user allowed are used up: no failure here."""
    return (
        isinstance(error, ConvergenceError)
        and max_iterations is not None
        and error.solution.report.steps >= max_iterations
    )


_Item: TypeAlias = tuple[int, FloatArray, FloatArray]


class _StoppedError(Exception):
    """Nobody asks for further steps."""


class _Solver:
    """A solver in a thread of its own, which waits for every step to be taken from it."""

    def __init__(self, every: int, solve: Callable[[OnIteration], object]) -> None:
        self.taken: queue.Queue[_Item | BaseException | None] = queue.Queue(maxsize=1)
        self._stopped = threading.Event()
        self._every = every
        self._last: _Item | None = None
        self._thread = threading.Thread(target=self._run, args=(solve,), daemon=True)
        _running.add(self)
        self._thread.start()

    def _run(self, solve: Callable[[OnIteration], object]) -> None:
        end: BaseException | None = None
        try:
            solve(self._give)
        except _StoppedError:
            return
        except BaseException as error:  # Whatever it is, it belongs to whoever asks for the next step.
            end = error
        with contextlib.suppress(_StoppedError):
            if self._last is not None and self._last[0] % self._every:
                self._put(self._last)
            self._put(end)

    def _give(self, step: int, radiosity: FloatArray, unshot: FloatArray) -> None:
        self._last = (step, radiosity, unshot)
        if step % self._every == 0:
            self._put(self._last)
        elif self._stopped.is_set():
            raise _StoppedError

    def _put(self, item: _Item | BaseException | None) -> None:
        while not self._stopped.is_set():
            with contextlib.suppress(queue.Full):
                self.taken.put(item, timeout=0.05)
                return
        raise _StoppedError

    def stop(self, timeout: float | None = None) -> None:
        """End at the next step, and wait for that, no longer than ``timeout`` seconds."""
        self._stopped.set()
        self._thread.join(timeout)


# A thread inside the core must not outlive the interpreter.
_running: weakref.WeakSet[_Solver] = weakref.WeakSet()


@atexit.register
def _stop_all() -> None:
    for solver in list(_running):
        solver.stop()
