"""The bench: what error each method reaches in what time, on scenes whose radiosity is known.

Error is the area-weighted RMS over patches and bands of B - reference over that of the reference's B - E,
discretisation included, with the reference's own noise taken off in quadrature (`references.relative_error`). Every
figure comes from a few runs with different seeds, all methods in turn: the error is the RMS of theirs, the seconds are
the median.

The referee is Mitsuba's path tracer, as strong as it gets (`mitsuba.patch_tracer`), on the same patches and cores. Its
error falls like c / sqrt(seconds), so c tells its time to any error: "x Mitsuba" is that time over the method's own.
Building Mitsuba's scene and compiling its kernels are not in its seconds; everything is in ours.
"""

from __future__ import annotations

import csv
import dataclasses
import itertools
import math
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from .arrays import FloatArray
from .form_factors import form_factors
from .mitsuba.patch_tracer import PatchTracer
from .references import NAMES, Reference, load, relative_error
from .scene import Scene
from .solve import solve
from .system import solve_system

__all__ = ["TOLERANCES", "Row", "against", "draw", "referee_constant", "run"]

TOLERANCES = (0.1, 0.03, 0.01, 0.003)
RUNS = 3
# A tolerance is tried where the reference's noise is at most this part of it: an error that meets it can then be told
# from the noise to some 10 %.
LARGEST_NOISE = 0.5

SOLVERS = ("direct", "jacobi", "gauss_seidel", "southwell", "gmres")
# Above so many patches all pairs are no sensible choice, and form factors would take most of the bench's time.
LARGEST_DENSE = 1500
# Below, links would take most of it.
FINEST_LINKS = 0.01
# Row tolerance of the form factors and residual of the solvers, in tolerances of the solution. Errors of single form
# factors average out over a row; the residual is relative to E, which in a room with a small lamp outweighs B - E.
ROW_TOLERANCE = 3.0
RESIDUAL = 0.01

# Methods of `solve`: the name in the table, and what to call it with.
SOLVE: dict[str, dict[str, Any]] = {
    "rays, constant": {"method": "rays", "order": 0},
    "rays, linear": {"method": "rays", "order": 1},
    "hierarchical": {"method": "hierarchical"},
}

REFEREE = "Mitsuba"
REFEREE_PATHS = (1 << 18, 1 << 20, 1 << 22)
# What a scalar variant traces in the same time, about.
SCALAR_SHARE = 16
# Seeds of the referee's runs: other ones than those of the stored references.
FIRST_SEED = 1


@dataclass(frozen=True)
class Measured:
    """One run of one method at one setting."""

    method: str
    tolerance: float | None
    """The tolerance asked for; None for the referee."""
    paths: int | None
    """Paths traced; None for methods that are given a tolerance."""
    seconds: float
    """Wall-clock time, of everything that the method does."""
    solver_seconds: float | None
    """The part of it after the form factors were known; None where there are no stored form factors."""
    radiosity: FloatArray
    error_estimate: float | None
    """What the method says of its own error; None where it says nothing, or only about a part of it."""


@dataclass(frozen=True)
class Row:
    """A line of the table: a method at one setting, over all runs."""

    scene: str
    patches: int
    method: str
    tolerance: float | None
    paths: int | None
    seconds: float
    solver_seconds: float | None
    error: float | None
    """None if it is under the reference's noise."""
    error_estimate: float | None
    noise: float
    """Of the reference."""
    times_mitsuba: float | None
    """Mitsuba's time to the same error over `seconds`; None without Mitsuba, or without an error."""


# Runs one or more methods once, with the seed given.
Contest = Callable[[int], list[Measured]]


def run(
    folder: str | os.PathLike[str],
    names: Sequence[str] = NAMES,
    with_mitsuba: bool = True,
    tolerances: Sequence[float] = TOLERANCES,
    runs: int = RUNS,
) -> list[Row]:
    """Measure all methods on the named references, print the tables, write `bench.csv` and `bench.png`.

    Args:
        folder: where the files go; made if it does not exist. The picture needs matplotlib and is left out without.
        names: of `radiosity.references.NAMES`.
        with_mitsuba: race against Mitsuba, if it is installed.
        tolerances: to ask for, where the reference is good enough to check them.
        runs: of every method at every setting.

    Returns:
        The lines of the tables.

    Raises:
        ValueError: an unknown name.

    """
    folder = Path(folder)
    references = [load(name) for name in names]
    folder.mkdir(parents=True, exist_ok=True)
    print(
        "error: RMS of B - reference over that of B - E, discretisation included, the reference's noise taken off in\n"
        f"quadrature; seconds: median of {runs} runs, all methods in turn, {REFEREE} without building its scene and\n"
        "compiling its kernels; x Mitsuba: its seconds to the same error, by its fit, over the method's"
    )
    rows: list[Row] = []
    for reference in references:
        found = _race(reference, with_mitsuba, tolerances, runs)
        print(_table(reference, found), flush=True)
        rows += found
    _write_csv(folder / "bench.csv", rows)
    written = [str(folder / "bench.csv")]
    if rows:
        try:
            draw(folder / "bench.png", rows)
            written.append(str(folder / "bench.png"))
        except ImportError:
            print("no picture: pip install 'radiosity[plot]'")
    print(f"\nwritten: {', '.join(written)}")
    return rows


def _race(reference: Reference, with_mitsuba: bool, tolerances: Sequence[float], runs: int) -> list[Row]:
    scene, noise = reference.scene, reference.noise
    contests: list[Contest] = []
    for tolerance in tolerances:
        if noise > LARGEST_NOISE * tolerance:
            continue
        if scene.n_patches <= LARGEST_DENSE:
            contests.append(_dense(scene, tolerance))
        fine = tolerance < FINEST_LINKS
        methods = {name: keywords for name, keywords in SOLVE.items() if not (fine and name == "hierarchical")}
        contests += [_solve(scene, tolerance, name, keywords) for name, keywords in methods.items()]
    if with_mitsuba:
        try:
            contests += _referee(scene)
        except ImportError as missing:
            print(f"no {REFEREE}: {missing}")
    by_setting: dict[tuple[str, float | None, int | None], list[Measured]] = {}
    for seed in range(runs):
        for contest in contests:
            for measured in contest(seed):
                by_setting.setdefault((measured.method, measured.tolerance, measured.paths), []).append(measured)
    rows = [_row(reference, noise, same) for same in by_setting.values()]
    c = referee_constant(rows)
    order = list(dict.fromkeys(row.method for row in rows))
    return sorted((against(row, c) for row in rows), key=lambda row: order.index(row.method))


def _dense(scene: Scene, tolerance: float) -> Contest:
    """All solvers on the same stored form factors; the time of those counts for each."""

    def contest(seed: int) -> list[Measured]:
        start = perf_counter()
        F = form_factors(scene, min(ROW_TOLERANCE * tolerance, 0.5), seed=seed, progress=False)
        before = perf_counter() - start
        found = []
        for solver in SOLVERS:
            start = perf_counter()
            solution = solve_system(F, scene.emission, scene.reflectance, solver, RESIDUAL * tolerance, progress=False)
            seconds = perf_counter() - start
            # Its error estimate leaves discretisation out.
            found.append(
                Measured(f"dense, {solver}", tolerance, None, before + seconds, seconds, solution.radiosity, None)
            )
        return found

    return contest


def _solve(scene: Scene, tolerance: float, name: str, keywords: dict[str, Any]) -> Contest:
    def contest(seed: int) -> list[Measured]:
        start = perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a tolerance not met: the table shows it
            solution = solve(scene, tolerance, seed=seed, progress=False, **keywords)
        seconds = perf_counter() - start
        return [Measured(name, tolerance, None, seconds, None, solution.radiosity, solution.error_estimate)]

    return contest


def _referee(scene: Scene) -> list[Contest]:
    tracer = PatchTracer(scene)
    share = SCALAR_SHARE if tracer.variant.startswith("scalar") else 1

    def of(paths: int) -> Contest:
        def contest(seed: int) -> list[Measured]:
            start = perf_counter()
            radiosity, traced = tracer(paths, FIRST_SEED + seed)
            return [Measured(REFEREE, None, traced, perf_counter() - start, None, radiosity, None)]

        return contest

    contests = [of(max(paths // share, 4 * scene.n_patches)) for paths in REFEREE_PATHS]
    for contest in contests:
        contest(0)  # compiles
    return contests


def _row(reference: Reference, noise: float, same: list[Measured]) -> Row:
    errors = [
        relative_error(reference.scene, measured.radiosity, reference.radiosity, reference.standard_error)[0]
        for measured in same
    ]
    square = float(np.mean([error * abs(error) for error in errors]))
    estimates = [measured.error_estimate for measured in same if measured.error_estimate is not None]
    solver_seconds = [measured.solver_seconds for measured in same if measured.solver_seconds is not None]
    return Row(
        scene=reference.name,
        patches=reference.scene.n_patches,
        method=same[0].method,
        tolerance=same[0].tolerance,
        paths=same[0].paths,
        seconds=median(measured.seconds for measured in same),
        solver_seconds=median(solver_seconds) if solver_seconds else None,
        error=math.sqrt(square) if square > 0.0 else None,
        error_estimate=float(np.sqrt(np.mean(np.square(estimates)))) if estimates else None,
        noise=noise,
        times_mitsuba=None,
    )


def referee_constant(rows: Sequence[Row]) -> float | None:
    """Return c of the referee's error = c / sqrt(seconds), the median over its runs; None without any."""
    values = [row.error * math.sqrt(row.seconds) for row in rows if row.method == REFEREE and row.error is not None]
    return median(values) if values else None


def against(row: Row, c: float | None) -> Row:
    """Return the row with `times_mitsuba` filled in, from the referee's constant c."""
    if c is None or row.error is None:
        return row
    return dataclasses.replace(row, times_mitsuba=(c / row.error) ** 2 / row.seconds)


def _table(reference: Reference, rows: Sequence[Row]) -> str:
    scene = reference.scene
    lines = [f"\n{reference.name}: {scene.n_patches:,} patches, noise of the reference {_percent(reference.noise)}"]
    c = referee_constant(rows)
    if c is not None:
        lines[0] += f"; {REFEREE}: error = {_percent(c)} / sqrt(seconds)"
    head = f"{'method':22s} {'asked':>9s} {'seconds':>9s} {'of it solver':>13s} {'error':>9s} {'estimate':>9s}"
    lines.append(f"{head} {'x Mitsuba':>10s}" if c is not None else head)
    for row in rows:
        asked = f"{row.paths / 1e6:.2f} M" if row.paths is not None else _percent(row.tolerance)
        error = "< " * (row.error is None and row.noise > 0.0) + _percent(row.noise if row.error is None else row.error)
        solver = "" if row.solver_seconds is None else f"{row.solver_seconds:.4f}"
        times = "" if row.times_mitsuba is None else _times(row.times_mitsuba)
        lines.append(
            f"{row.method:22s} {asked:>9s} {row.seconds:9.3f} {solver:>13s} {error:>9s} "
            f"{_percent(row.error_estimate):>9s} {times:>10s}".rstrip()
        )
    return "\n".join(lines)


# What is smaller is printed as 0: the rounding of sums over some thousand patches.
_ROUNDING = 1e-12


def _times(ratio: float) -> str:
    return "> 1000" if ratio > 1000.0 else f"{ratio:.0f}" if ratio >= 10.0 else f"{ratio:.2g}"


def _percent(value: float | None) -> str:
    if value is None:
        return ""
    return f"{100.0 * value:.3g} %" if value > _ROUNDING else "0 %"


def _write_csv(path: Path, rows: Sequence[Row]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(field.name for field in dataclasses.fields(Row))
        writer.writerows(dataclasses.astuple(row) for row in rows)  # None becomes an empty field


# Colours that the colour-blind can tell apart (Okabe & Ito 2008); the solvers share one hue, for they share the form
# factors.
_COLOURS = {
    "dense, direct": "#9ecae1",
    "dense, jacobi": "#6baed6",
    "dense, gauss_seidel": "#4292c6",
    "dense, southwell": "#2171b5",
    "dense, gmres": "#084594",
    "rays, constant": "#e69f00",
    "rays, linear": "#d55e00",
    "hierarchical": "#009e73",
    REFEREE: "#555555",
}
_MARKERS = ("o", "s", "^", "D", "v", "P")


# The lower edge of the picture, in smallest tolerances: errors below are drawn on it.
_LOWER_EDGE = 0.1


def draw(path: Path, rows: Sequence[Row]) -> None:
    """Draw error against seconds: a panel for each scene, a line for each method, a marker for each tolerance."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

    names = list(dict.fromkeys(row.scene for row in rows))
    methods = list(dict.fromkeys(row.method for row in rows))
    tolerances = sorted({row.tolerance for row in rows if row.tolerance is not None}, reverse=True)
    markers = dict(zip(tolerances, itertools.cycle(_MARKERS), strict=False))
    edge = _LOWER_EDGE * min(tolerances, default=min(TOLERANCES))
    seconds = np.array([0.7 * min(row.seconds for row in rows), 1.4 * max(row.seconds for row in rows)])
    columns = min(3, len(names))
    lines = math.ceil(len(names) / columns)
    figure = Figure(figsize=(4.4 * columns, 3.7 * lines + 1.1), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False)
    for panel in panels[:, 0]:
        panel.set_ylabel(f"error of B - E; on the lower edge: under {_percent(edge)}")
    for panel in panels.flat[len(names) :]:
        panel.set_axis_off()
    for panel, name in zip(panels.flat, names, strict=False):
        here = [row for row in rows if row.scene == name]
        panel.set(xscale="log", yscale="log", xlim=seconds, ylim=(0.85 * edge, 2.0 * max(tolerances, default=0.1)))
        panel.set_title(f"{name}, {here[0].patches:,} patches", fontsize=11)
        panel.set_xlabel("seconds")
        panel.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.yaxis.set_minor_locator(NullLocator())
        panel.set_yticks(tolerances, [_percent(tolerance) for tolerance in tolerances])
        panel.grid(color="#cccccc", linewidth=0.7)
        panel.spines[["top", "right"]].set_visible(False)
        panel.axhspan(0.5 * edge, here[0].noise, color="#eeeeee", linewidth=0.0, zorder=0.5)
        c = referee_constant(here)
        if c is not None:
            panel.plot(seconds, c / np.sqrt(seconds), "--", color=_COLOURS[REFEREE], linewidth=1.2)
        for method in methods:
            points = [row for row in here if row.method == method]
            x = [row.seconds for row in points]
            y = [max(row.error or 0.0, edge) for row in points]
            if method != REFEREE:
                panel.plot(x, y, color=_COLOURS[method], linewidth=1.4)
            for row, u, v in zip(points, x, y, strict=True):
                marker = "x" if row.tolerance is None else markers[row.tolerance]
                panel.plot(u, v, marker, color=_COLOURS[method], markersize=5.5, clip_on=False)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=_COLOURS[method], label=method)
        if method != REFEREE
        else Line2D([], [], color=_COLOURS[method], linestyle="--", marker="x", label=f"{method}, c / sqrt(seconds)")
        for method in methods
    ]
    handles += [
        Line2D([], [], color="#777777", linestyle="", marker=marker, label=f"asked: {_percent(tolerance)}")
        for tolerance, marker in markers.items()
    ]
    handles.append(Patch(color="#eeeeee", label="under the noise of the reference"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 2 * columns), frameon=False)
    figure.savefig(path, dpi=130)
