"""Every bounce visible: what a solver has after each of its steps, one after the other."""

from __future__ import annotations

import contextlib
import math
import queue
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import FloatArray, per_patch, read_only, whole_number
from .form_factors import FormFactors, form_factors
from .progress import Progress
from .scene import Scene
from .solution import ConvergenceError, Report, Solution, Step
from .solve import ambient as ambient_radiosity
from .solve import solve_system

if TYPE_CHECKING:
    import scipy.sparse

__all__ = ["bounces"]

# Methods whose step is a shot.
SHOTS = ("southwell", "overshooting")


def bounces(
    scene_or_F: Scene | FormFactors | FloatArray | scipy.sparse.sparray,
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
        TypeError, ValueError, MemoryError: as :func:`form_factors` and :func:`solve_system`, at the first step.
    """
    every = whole_number("every", every, 1, 2**62)
    F: Any = scene_or_F
    if isinstance(F, Scene):
        F = form_factors(F, tolerance=1e-2, threads=threads, progress=progress)
    scene = F.scene if isinstance(F, FormFactors) else None
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
        if method in SHOTS:
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
        # The solver runs in a thread of its own and waits for every step to be taken from it.
        taken: queue.Queue[tuple[int, FloatArray, FloatArray] | BaseException | None] = queue.Queue(maxsize=1)
        stopped = threading.Event()
        last: tuple[int, FloatArray, FloatArray] | None = None

        def give(step: int, radiosity: FloatArray, unshot: FloatArray) -> None:
            nonlocal last
            last = (step, radiosity, unshot)
            if step % every == 0:
                taken.put(last)
            if stopped.is_set():
                raise _StoppedError

        def run() -> None:
            try:
                solve_system(F, e, rho, method, tolerance, max_iterations, give, threads, progress)
            except (_StoppedError, ConvergenceError):
                pass
            except BaseException as error:
                taken.put(error)
                return
            if last is not None and last[0] % every:
                taken.put(last)
            taken.put(None)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        try:
            while (item := taken.get()) is not None:
                if isinstance(item, BaseException):
                    raise item
                yield solution(*item)
        finally:
            stopped.set()
            while thread.is_alive():
                # Room for what it may be waiting to hand over.
                with contextlib.suppress(queue.Empty):
                    taken.get(timeout=0.05)

    return steps()


class _StoppedError(Exception):
    """Nobody asks for further steps."""
