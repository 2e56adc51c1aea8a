"""The demonstration: from a mesh in a file to a validated picture.

Loads the Cornell box that the package ships, solves it, writes a picture, and holds the numbers against a converged
path tracer: stored results of Mitsuba, and Mitsuba itself, timed, where it is installed.
"""

from __future__ import annotations

import os
from importlib.resources import as_file, files
from pathlib import Path
from time import perf_counter

from . import references
from .load import load
from .mitsuba.patch_tracer import PatchTracer
from .references import Reference, relative_error
from .render import Camera, render, save_image
from .scenes import cornell_box_view
from .solve import solve

# Paths of the run that times Mitsuba: few enough for its noise to be well above that of the stored reference.
_MITSUBA_PATHS = 1 << 20


def run(folder: str | os.PathLike[str], tolerance: float, with_mitsuba: bool) -> str:
    """Runs the demonstration, writes ``cornell_box.png`` into ``folder`` and returns the table.

    Args:
        folder: made if it does not exist.
        tolerance: of :func:`radiosity.solve`.
        with_mitsuba: time Mitsuba, if it is installed.
    """
    started = perf_counter()
    with as_file(files("radiosity") / "data" / "cornell_box.glb") as path:
        scene = load(path)
    loaded = perf_counter()
    solution = solve(scene, tolerance)
    solved = perf_counter()
    image = render(solution, Camera(**cornell_box_view()), 512, 512)  # type: ignore[arg-type]
    picture = Path(folder) / "cornell_box.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    save_image(picture, image)
    finished = perf_counter()

    report = solution.report
    audit = report.audit
    assert audit is not None  # a scene has areas
    reference = references.load("cornell")
    error, noise = relative_error(scene, solution.radiosity, reference.radiosity, reference.standard_error)
    rows = [
        ("patches", f"{scene.n_patches}, {scene.bands} bands"),
        ("load the mesh", f"{loaded - started:.2f} s"),
        ("solve", f"{solved - loaded:.2f} s, {report.rays:,} rays, {report.segments:,} segments to the lamp"),
        ("picture", f"{finished - solved:.2f} s, 512 x 512"),
        ("from file to picture", f"{finished - started:.2f} s"),
        ("energy imbalance", f"{audit.imbalance:.1e} of what is emitted"),
        ("error, estimated", f"{100 * solution.error_estimate:.2f} % of B - E ({100 * tolerance:g} % was asked)"),
        ("error against Mitsuba", f"{100 * error:.2f} % of B - E"),
        ("noise of that reference", f"{100 * noise:.2f} % (stored; taken off in quadrature)"),
        ("Mitsuba to that error", _mitsuba_time(reference, error) if with_mitsuba else "not asked for"),
        ("picture written to", str(picture)),
    ]
    return "\n".join(f"{name:24s} {value}" for name, value in rows)


def _mitsuba_time(reference: Reference, error: float) -> str:
    """What Mitsuba needs for the same error: its error falls like 1 / sqrt(time), so one run tells."""
    try:
        tracer = PatchTracer(reference.scene)
    except ImportError as missing:
        return f"not measured: {missing}"
    paths = _MITSUBA_PATHS if tracer.variant != "scalar_rgb" else _MITSUBA_PATHS // 8
    # The first call compiles the kernels; the second is the one to time.
    tracer(paths, seed=1)
    start = perf_counter()
    estimate, _ = tracer(paths, seed=2)
    seconds = perf_counter() - start
    reached, _ = relative_error(reference.scene, estimate, reference.radiosity, reference.standard_error)
    needed = seconds * (reached / error) ** 2
    return f"{needed:.2f} s ({tracer.variant}; {100 * reached:.2f} % in {seconds:.2f} s, scaled)"
