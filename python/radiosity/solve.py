"""Solvers of the radiosity equation B = E + rho F B.

:func:`solve` takes a scene and decides everything; :func:`radiosity.solve_system` takes any form factors and one named
method.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Iterable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from . import _core
from .arrays import FloatArray, IntArray, read_only, real_number, seed_number, thread_count
from .cache import Cache, folder_of, is_of, kept, solution_in
from .form_factors import form_factors_as_reached
from .glass import glass_hints
from .lights import Light, core_lights, direct_irradiance, in_chosen_bands, lights_of, spectra, told
from .memory import available_bytes
from .progress import Progress, reporter
from .report import listed
from .save import load_solution, save
from .scene import Scene
from .solution import EnergyAudit, Forecast, Report, Solution, Step, System
from .system import solve_system

METHODS = ("auto", "dense", "rays", "hierarchical")

# Share of the tolerance that the error estimate may use; the rest is for the estimate's own error.
_SAMPLING_SHARE = 0.8
# Row tolerance of the first attempt, in tolerances of the solution. Errors of single form factors average out over a
# row: on the reference scenes a row error of 3 tolerances leaves an error of 0.1 to 0.8 tolerances in B - E.
_FIRST_ROW_TOLERANCE = 3.0
_ATTEMPTS = 6
# Share of the tolerance that H0 may use where it is found before the rest: its error adds to the others in squares.
_STRAIGHT_SHARE = 0.3
# Of the iteration: relative to E, and so small that it does not count even where little light is reflected.
_RESIDUAL = 1e-10


def solve(
    scene: Scene,
    tolerance: float = 0.01,
    method: str = "auto",
    *,
    lights: Light | Iterable[Light] = (),
    order: int = 1,
    refine: bool = True,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = True,
    cache: Cache = None,
) -> Solution:
    """Solves a scene to a tolerance of the true error.

    Args:
        scene: the patches, with their emission and reflectance.
        tolerance: relative error of the patch averages of the reflected radiosity B - E (area-weighted RMS, the worst
            band) against the continuous solution, in (0, 1): sampling and discretisation, the error of a simple
            function on every patch, together. In a band that reflects nothing the irradiance takes the place of B - E.
            It is an error of all patches together: one in deep shadow may be off by more of its own value, and even
            come out slightly negative, within its standard error. Nothing is clipped.
        method: ``"rays"``, light straight from the lamps by closed forms and all other by quasi-random rays; or
            ``"dense"``, form factors of all pairs and GMRES, with one radiosity a patch; or ``"hierarchical"``, links
            between elements that are cut as small, and clusters of patches that are left as large, as the light asks
            for. Its ``.elements`` are the adaptive mesh with its shadows: the tolerance holds on them as a whole, too,
            so that it costs more than patch averages would where patches are coarse. ``"auto"`` is ``"rays"``, which
            reach the same true error sooner in most scenes (``radiosity bench`` compares them).
        lights: light that no patch emits: :class:`Sun`, :class:`Sky`, :class:`PointLight`, :class:`SpotLight`, one or
            several; in scenes without mirrors and glass, and not for ``"hierarchical"``. ``irradiance`` is then
            H0 + F B with what they bring, H0, and the tolerance counts what their shadows do inside a patch.
        order: of the radiosity on a patch that rays find: 1, linear, or 0, constant. No other method looks at it.
        refine: whether rays may follow light below the patches, point by point or on smaller patches, where these are
            too coarse for the tolerance. Patch averages are reported in any case. ``"dense"`` never does,
            ``"hierarchical"`` always.
        seed: of the quasi-random points.
        threads: None for all cores. The result is the same for any number.
        progress: see :mod:`radiosity.progress`.
        cache: a folder in which solutions are kept, one file each, and taken from where mesh, materials, method,
            tolerance and all else that changes the result are the same: bit for bit, with the report of the solve that
            was made, but for its ``.system``. Of ``"dense"`` the form factors are kept, too, for other materials. None
            keeps nothing.

    Raises:
        ValueError: an unknown method, a value out of range, or a scene without finite solution; but for ``"rays"``
            also a patch that repeats another one, whose light would count twice.
        OSError: ``cache`` cannot be written to.
        MemoryError: the solution would not fit, with the estimate: before any work, or before the patches are cut.
            ``"hierarchical"`` raises it when not even the patches fit, and else stops where memory ends and says so.

    Warns:
        UserWarning: there is neither emission nor light; the scene's glass is nothing that light can be followed
            through (as :meth:`Scene.report` has it); or the tolerance was not met, and ``.error_estimate`` says what
            was. A file in ``cache`` is damaged, or could not be written, after which the result is as good as without.

    Sources:
        Keller, "Quasi-Monte Carlo radiosity" 1996; Zatz 1993 (linear radiosity on a patch); Heinrich 2001 (corrections
        by a finer level); Hanrahan, Salzman & Aupperle 1991, Smits, Arvo & Greenberg 1994, Gortler et al. 1993
        (hierarchical). The estimates are described in the crate's module ``accuracy``.
    """
    _check(scene, tolerance, method, order)
    lit = lights_of(lights, scene.bands)
    if lit and method == "hierarchical":
        raise ValueError("method 'hierarchical' takes no lights; use 'rays' or 'dense'")
    if not (scene.emission.any() or (lit and spectra(lit).any())):
        warnings.warn("the scene has no emission: the answer is 0", UserWarning, stacklevel=2)
    if method in ("auto", "rays"):
        for hint in glass_hints(scene, lambda patches: listed(patches, scene.names)):
            warnings.warn(hint, UserWarning, stacklevel=2)
    number, workers, folder = seed_number(seed), thread_count(threads), folder_of(cache)

    def compute() -> Solution:
        distinct, lit_distinct, bands = _distinct_bands(scene, lit)
        if method == "hierarchical":
            solution = _solve_hierarchical(distinct, tolerance, number, workers, progress)
        elif method == "dense":
            solution = _solve_dense(distinct, lit_distinct, tolerance, number, workers, progress, folder)
        else:
            solution = _solve_rays(distinct, lit_distinct, tolerance, order, refine, number, workers, progress)
        return solution if distinct is scene else _in_all_bands(solution, scene, lit, bands)

    if folder is None:
        solution = compute()
    else:
        settings: dict[str, Any] = {
            "method": method,
            "tolerance": float(tolerance),
            "seed": number,
            "lights": told(lit),
        }
        if method in ("auto", "rays"):
            settings |= {"method": "rays", "order": int(order), "refine": bool(refine)}

        def load(path: Path) -> Solution:
            found = load_solution(path)
            if not is_of(found, scene) or told(found.lights) != told(lit):
                raise ValueError(f"{path}: of another scene")
            return dataclasses.replace(found, scene=scene)

        solution = kept(
            solution_in(folder, scene, **settings),
            load,
            compute,
            save,
            # With more memory it may come out better another time.
            lambda solution: not solution.report.out_of_memory,
        )
    if solution.error_estimate > tolerance:
        warnings.warn(
            f"the error is about {solution.error_estimate:.2g}, above the tolerance {tolerance:g}: "
            f"{_reason(solution.report)}",
            UserWarning,
            stacklevel=2,
        )
    return solution


def _reason(report: Report) -> str:
    """Why a tolerance was not met."""
    if report.out_of_memory:
        return f"{report.links} links used up the memory; use method='rays'"
    if report.links:
        return f"{report.stopped} links end at elements that are too small to be cut; use method='rays'"
    return (
        f"{report.sampling_error:.2g} from sampling, {report.discretisation_error:.2g} from discretisation "
        "(lowered by method='rays' with refine=True, or by scene.subdivide)"
    )


def forecast(
    scene: Scene,
    tolerance: float = 0.01,
    *,
    lights: Light | Iterable[Light] = (),
    order: int = 1,
    refine: bool = True,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = True,
) -> Forecast:
    """What :func:`solve` by rays would take, told from its first rounds of sampling.

    The arguments are those of :func:`solve` with ``method="rays"``, the only one that it knows. The bytes are those
    that it asks for, unless later rounds find the patches too coarse and cut them. The seconds are extrapolated from
    two rounds, which take up to a third of the whole (all of a short one): mostly good to a factor of 1.5, and too low
    by up to 4 where those do not show what is to come.

    Raises:
        ValueError, MemoryError: as :func:`solve`.
    """
    _check(scene, tolerance, "rays", order)
    distinct, lit, _ = _distinct_bands(scene, lights_of(lights, scene.bands))
    with reporter(progress, "forecast") as report:
        seconds, nbytes = _core.forecast_scene(
            distinct._core,
            core_lights(lit, distinct.bands),
            float(tolerance),
            order == 1,
            bool(refine),
            seed_number(seed),
            available_bytes(),
            thread_count(threads),
            report,
        )
    return Forecast(seconds, nbytes)


def _check(scene: Scene, tolerance: float, method: str, order: int) -> None:
    """Refuses what no method could take."""
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}")
    if method not in METHODS:
        raise ValueError(
            f"unknown method {method!r}; the methods of solve are {METHODS}; solvers are chosen in solve_system"
        )
    if not 0.0 < real_number("tolerance", tolerance) < 1.0:
        raise ValueError(f"tolerance {tolerance} is outside (0, 1)")
    if order not in (0, 1):
        raise ValueError(f"order {order!r} is neither 0 (constant on a patch) nor 1 (linear)")


def _distinct_bands(scene: Scene, lights: tuple[Light, ...]) -> tuple[Scene, tuple[Light, ...], IntArray]:
    """Scene and lights in which no two bands are equal, and for every band of ``scene`` its number there."""
    columns = np.vstack([scene.reflectance, scene.emission, *([spectra(lights)] if lights else [])])
    # By their bytes: numpy's `unique` of columns makes a TypeError of Ctrl-C.
    told_apart = [column.tobytes() for column in columns.T]
    first = [b for b, column in enumerate(told_apart) if column not in told_apart[:b]]
    bands = np.array([first.index(told_apart.index(column)) for column in told_apart])
    if len(first) == scene.bands:
        return scene, lights, np.arange(scene.bands)
    chosen = scene.with_materials(scene.reflectance[:, first], scene.emission[:, first])
    return chosen, in_chosen_bands(lights, first), bands


def _in_all_bands(solution: Solution, scene: Scene, lights: tuple[Light, ...], bands: IntArray) -> Solution:
    """The solution of distinct bands as that of a scene that has some of them more than once."""
    report, audit = solution.report, solution.report.audit
    if audit is not None:
        audit = EnergyAudit(*(getattr(audit, part.name)[bands] for part in dataclasses.fields(audit)))
    error = solution.standard_error
    elements = solution.elements
    if elements is not None and elements.scene is not None:
        parent = elements.scene.parent
        fine = elements.scene.with_materials(scene.reflectance[parent], scene.emission[parent])
        elements = _in_all_bands(elements, fine, lights, bands)
    system = solution.system
    if system is not None:
        system = System(system.operator, scene.emission, scene.reflectance)
    return dataclasses.replace(
        solution,
        system=system,
        radiosity=read_only(solution.radiosity[:, bands]),
        irradiance=read_only(solution.irradiance[:, bands]),
        standard_error=None if error is None else read_only(error[:, bands]),
        history=tuple(Step(step.residual, step.unshot[bands]) for step in solution.history),
        report=dataclasses.replace(
            report,
            bands=scene.bands,
            audit=audit,
            bound=None if report.bound is None else read_only(report.bound[bands]),
        ),
        scene=scene,
        elements=elements,
        lights=lights,
    )


def _solve_rays(
    scene: Scene,
    lights: tuple[Light, ...],
    tolerance: float,
    order: int,
    refine: bool,
    seed: int,
    threads: int | None,
    progress: Progress,
) -> Solution:
    with reporter(progress, "rays") as report:
        result = _core.solve_scene(
            scene._core,
            core_lights(lights, scene.bands),
            float(tolerance),
            order == 1,
            bool(refine),
            seed,
            available_bytes(),
            thread_count(threads),
            report,
        )
    history = tuple(Step(float(r), u) for r, u in zip(result["residuals"], result["unshot"], strict=True))
    audit = result["audit"]
    return Solution(
        radiosity=read_only(result["radiosity"]),
        irradiance=read_only(result["irradiance"]),
        standard_error=read_only(result["standard_error"]),
        error_estimate=result["error_estimate"],
        history=history,
        report=Report(
            method="rays",
            patches=scene.n_patches,
            bands=scene.bands,
            steps=len(history),
            residual=history[-1].residual if history else 0.0,
            audit=None if audit is None else EnergyAudit(*audit),
            seconds=dict(result["seconds"]),
            segments=result["segments"],
            rays=result["rays"],
            elements=result["patches"],
            corrected=result["corrected"],
            sampling_error=result["sampling_error"],
            discretisation_error=result["discretisation_error"],
        ),
        scene=scene,
        lights=lights,
    )


def _solve_hierarchical(scene: Scene, tolerance: float, seed: int, threads: int | None, progress: Progress) -> Solution:
    start = perf_counter()
    with reporter(progress, "links") as report:
        result = _core.solve_hierarchical(
            scene._core,
            float(tolerance),
            seed,
            available_bytes(),
            thread_count(threads),
            report,
        )
    history = tuple(Step(float(r), u) for r, u in zip(result["residuals"], result["unshot"], strict=True))
    done = Report(
        method="hierarchical",
        patches=scene.n_patches,
        bands=scene.bands,
        steps=len(history),
        residual=history[-1].residual if history else 0.0,
        audit=EnergyAudit(*result["audit"]),
        seconds={"solve": perf_counter() - start},
        segments=result["segments"],
        elements=result["leaves"],
        links=result["links"],
        stopped=result["stopped"],
        out_of_memory=result["out_of_memory"],
    )
    parent = result["parents"]
    names = None if scene.names is None else tuple(scene.names[p] for p in parent.tolist())
    fine = Scene(result["vertices"], result["faces"], scene.reflectance[parent], scene.emission[parent], names=names)
    fine.parent = read_only(parent)
    coarse = _on_links(scene, result["irradiance"], result["error_estimate"], history, done)
    return dataclasses.replace(
        coarse, elements=_on_links(fine, result["on_faces"], coarse.error_estimate, history, done)
    )


def _on_links(
    scene: Scene, irradiance: FloatArray, error_estimate: float, history: tuple[Step, ...], report: Report
) -> Solution:
    return Solution(
        radiosity=read_only(scene.emission + scene.reflectance * irradiance),
        irradiance=read_only(irradiance),
        standard_error=None,
        error_estimate=error_estimate,
        history=history,
        report=report,
        scene=scene,
    )


def _solve_dense(
    scene: Scene,
    lights: tuple[Light, ...],
    tolerance: float,
    seed: int,
    threads: int | None,
    progress: Progress,
    folder: Path | None,
) -> Solution:
    row_tolerance = _FIRST_ROW_TOLERANCE * tolerance
    straight, noise, emitting = _first_light(scene, lights, tolerance, seed, threads, progress)
    seconds = {"form factors": 0.0, "solve": 0.0}
    segments = 0
    for attempt in range(_ATTEMPTS):
        start = perf_counter()
        F = form_factors_as_reached(scene, max(min(row_tolerance, 0.5), 1e-8), "auto", seed, threads, progress, folder)
        seconds["form factors"] += perf_counter() - start
        segments += F.segments
        solution = solve_system(
            F, emitting.emission, scene.reflectance, "gmres", _RESIDUAL, threads=threads, progress=progress
        )
        seconds["solve"] += solution.report.seconds["solve"]
        reached = solution.error_estimate / (_SAMPLING_SHARE * tolerance)
        if reached <= 1.0 or attempt == _ATTEMPTS - 1 or not np.isfinite(reached):
            break
        row_tolerance /= max(1.25 * reached, 2.0)
    on_patches = solution.error_estimate
    if lights:
        on_patches *= _share_of_bounces(scene, emitting, solution)
        known = np.zeros_like(noise) if solution.standard_error is None else solution.standard_error
        # What bounces of the noise of many patches is smooth, and next to nothing beside that of each.
        noise = scene.reflectance * noise
        on_patches = math.hypot(on_patches, _share(scene, noise, solution.radiosity - scene.emission))
        audit = solution.report.audit
        assert audit is not None  # a scene has areas
        solution = dataclasses.replace(
            solution,
            irradiance=read_only(straight + solution.irradiance),
            standard_error=read_only(np.hypot(known, noise)),
            report=dataclasses.replace(solution.report, audit=_audit_of_all(audit, scene, straight)),
            scene=scene,
            lights=lights,
            # Its emission would hold what the old paint reflects of the lights.
            system=None,
        )
    report = dataclasses.replace(solution.report, seconds=seconds, segments=segments)
    return _assessed(dataclasses.replace(solution, report=report), on_patches, tolerance, seed, threads, progress)


def _first_light(
    scene: Scene, lights: tuple[Light, ...], tolerance: float, seed: int, threads: int | None, progress: Progress
) -> tuple[FloatArray, FloatArray, Scene]:
    """H0, its standard error, and the scene with what it reflects of it among its emission: E + rho H0."""
    if not lights:
        nothing = np.zeros_like(scene.emission)
        return nothing, nothing, scene
    with warnings.catch_warnings():
        # What is not met is found when the solution is assessed.
        warnings.simplefilter("ignore", UserWarning)
        straight, noise = direct_irradiance(
            scene, lights, _STRAIGHT_SHARE * tolerance, seed=seed, threads=threads, progress=progress
        )
    emission = scene.emission + scene.reflectance * straight
    return straight, noise, scene.with_materials(scene.reflectance, emission)


def _audit_of_all(audit: EnergyAudit, scene: Scene, straight: FloatArray) -> EnergyAudit:
    """The audit with what is absorbed of H0 before it has bounced."""
    absorbed = scene.areas @ ((1.0 - scene.reflectance) * straight)
    return dataclasses.replace(audit, emitted=audit.emitted + absorbed, absorbed=audit.absorbed + absorbed)


def _share_of_bounces(scene: Scene, emitting: Scene, solution: Solution) -> float:
    """What an error relative to B - E - rho H0 is relative to B - E."""
    return _share(scene, solution.radiosity - emitting.emission, solution.radiosity - scene.emission)


def _share(scene: Scene, part: FloatArray, whole: FloatArray) -> float:
    """The area-weighted RMS of a part relative to that of the whole, the largest ratio of the bands."""
    sizes = (np.asarray(np.sqrt(scene.areas @ values**2)) for values in (part, whole))
    of_part, of_whole = sizes
    return float(np.max(np.divide(of_part, of_whole, out=np.zeros_like(of_part), where=of_whole > 0.0)))


def _assessed(
    solution: Solution, on_patches: float, tolerance: float, seed: int, threads: int | None, progress: Progress
) -> Solution:
    """A solution with its true error: what is known of it on the patches, and what is found by rays."""
    scene = solution.scene
    assert scene is not None
    start = perf_counter()
    with reporter(progress, "discretisation") as report:
        error, rays = _core.assess(
            scene._core,
            core_lights(solution.lights, scene.bands),
            np.ascontiguousarray(solution.irradiance),
            float(tolerance),
            seed,
            available_bytes(),
            thread_count(threads),
            report,
        )
    discretisation = math.sqrt(max(error**2 - on_patches**2, 0.0))
    return dataclasses.replace(
        solution,
        error_estimate=math.hypot(on_patches, discretisation),
        report=dataclasses.replace(
            solution.report,
            seconds=solution.report.seconds | {"assess": perf_counter() - start},
            rays=rays,
            sampling_error=on_patches,
            discretisation_error=discretisation,
        ),
    )
