"""The command line: ``radiosity solve``, ``render``, ``show``, ``form-factors``, ``bench`` and ``demo``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from . import __version__, scenes
from .arrays import whole_number
from .bench import run as run_bench
from .demo import run as run_demo
from .files import replacing
from .form_factors import METHODS as FORM_FACTOR_METHODS
from .form_factors import form_factors
from .load import load
from .memory import available_bytes
from .references import NAMES
from .render import FORMATS as IMAGE_FORMATS
from .render import SHADINGS, Camera, render, save_image, two_pass
from .save import FORMATS as SOLUTION_FORMATS
from .save import load_solution, save
from .scene import Scene
from .solution import ConvergenceError, Solution
from .solve import METHODS, solve
from .view import UNITS, show

_SCENES = tuple(name for name in scenes.__all__ if not name.endswith("_view"))
_PAGES = (".html", ".htm")
_TOLERANCE = 0.01


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns the exit status: 0, 1 for an error told on stderr, 130 after Ctrl-C."""
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except (ValueError, TypeError, MemoryError, OSError, ImportError, ConvergenceError) as error:
        print(f"radiosity: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="radiosity",
        description="Diffuse light and heat between the surfaces of a 3-D scene.",
        epilog=f"A scene is a file (glb, gltf, obj, ply, stl, Mitsuba xml) or the name of a built-in one: "
        f"{', '.join(_SCENES)}. Where a solution is wanted, a scene is solved first.",
    )
    parser.add_argument("--version", action="version", version=f"radiosity {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[argparse.Namespace], None], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        sub.set_defaults(run=run)
        return sub

    one = command("solve", _solve, "solve a scene and write the solution")
    one.add_argument("scene", help="file or built-in scene")
    one.add_argument("-o", "--output", required=True, metavar="FILE", help=", ".join((*SOLUTION_FORMATS, *_PAGES)))
    _add_solving(one)
    one.add_argument("--lightmap", type=int, metavar="TEXELS", help=".glb: a texture of so many texels each way")

    one = command("render", _render, "make a picture of a solution")
    one.add_argument("scene", metavar="solution", help="solution (.npz), file or built-in scene")
    one.add_argument("-o", "--output", required=True, metavar="FILE", help=", ".join(IMAGE_FORMATS))
    _add_camera(one)
    one.add_argument("--size", nargs=2, type=int, default=(512, 512), metavar=("WIDTH", "HEIGHT"), help="pixels")
    one.add_argument(
        "--shading", choices=SHADINGS, help="default: smooth; with mirrors or glass: gather, in two passes"
    )
    one.add_argument("--noise", type=float, default=0.02, help="gather: relative error from sampling (default: 0.02)")
    one.add_argument("--exposure", type=float, help=".png: factor from radiance to display (default: from the picture)")
    _add_solving(one)

    one = command("show", _show, "open a solution in the browser, or write the page")
    one.add_argument("scene", metavar="solution", help="solution (.npz), file or built-in scene")
    one.add_argument("-o", "--output", metavar="FILE", help="write this page (.html, .htm) instead of opening it")
    one.add_argument("--unit", choices=UNITS, default=UNITS[0], help=f"of false colours (default: {UNITS[0]})")
    _add_camera(one)
    _add_solving(one)

    one = command("form-factors", _form_factors, "compute the form factors of a scene")
    one.add_argument("scene", help="file or built-in scene")
    one.add_argument(
        "-o", "--output", required=True, metavar="FILE", help=".npz: form_factors (n, n), dense; areas (n,)"
    )
    one.add_argument("--tolerance", type=float, default=1e-3, help="of the rows (default: 0.001)")
    one.add_argument("--method", choices=FORM_FACTOR_METHODS, default="auto", help="default: auto")
    _add_common(one)

    one = command("bench", _bench, "error against seconds of all methods, and of Mitsuba, on known scenes")
    one.add_argument(
        "-o", "--output", default="out", metavar="FOLDER", help="where bench.csv and bench.png go (default: out)"
    )
    one.add_argument("--scenes", nargs="+", choices=NAMES, default=NAMES, metavar="NAME", help=", ".join(NAMES))
    one.add_argument("--no-mitsuba", action="store_true", help="do not race against Mitsuba even if it is installed")

    one = command("demo", _demo, "solve the Cornell box, write its picture, compare with Mitsuba")
    one.add_argument("-o", "--output", default="out", metavar="FOLDER", help="where the picture goes (default: out)")
    one.add_argument("--tolerance", type=float, default=0.02, help="relative error of the solution (default: 0.02)")
    one.add_argument("--no-mitsuba", action="store_true", help="do not time Mitsuba even if it is installed")
    return parser


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--max-edge", type=float, metavar="METRES", help="subdivide until no edge is longer")
    parser.add_argument("--seed", type=int, default=0, help="of the random points (default: 0)")
    parser.add_argument("--threads", type=int, help="default: all cores")
    parser.add_argument("--quiet", action="store_true", help="no progress bars and no report")


def _add_solving(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--tolerance", type=float, help=f"relative error of B - E (default: {_TOLERANCE:g})")
    parser.add_argument("--method", choices=METHODS, help="default: auto")
    _add_common(parser)


def _add_camera(parser: argparse.ArgumentParser) -> None:
    for name, text in (
        ("origin", "where the camera stands"),
        ("target", "what it looks at"),
        ("up", "up (default: z, of glTF files y)"),
    ):
        parser.add_argument(f"--{name}", nargs=3, type=float, metavar=("X", "Y", "Z"), help=text)
    parser.add_argument("--fov", type=float, default=None, help="vertical field of view, degrees (default: 40)")


def _solve(options: argparse.Namespace) -> None:
    _check_output(options.output, (*SOLUTION_FORMATS, *_PAGES))
    if options.lightmap is not None and Path(options.output).suffix.lower() != ".glb":
        raise ValueError(f"{options.output}: only .glb files have a lightmap")
    _check_scene(options)
    camera = _camera(options)
    solution = _solved(_scene(options), options)
    if Path(options.output).suffix.lower() in _PAGES:
        show(solution, camera, up=_up(options)).save(options.output)
    else:
        save(solution, options.output, lightmap=options.lightmap)
    _tell(options, f"{solution.report}\nwritten    {options.output}")


def _render(options: argparse.Namespace) -> None:
    _check_output(options.output, IMAGE_FORMATS)
    is_solved = _is_solved(options)
    _check_scene(options)
    camera = _camera(options)
    width, height = (
        whole_number(name, size, 1, 1 << 20) for name, size in zip(("width", "height"), options.size, strict=True)
    )
    if not 0.0 < options.noise < 1.0:
        raise ValueError(f"noise {options.noise} is outside (0, 1)")
    if options.exposure is not None and not 0.0 < options.exposure < float("inf"):
        raise ValueError(f"exposure {options.exposure} is not a positive number")
    if camera is None:
        raise ValueError("say where the camera stands and what it looks at: --origin X Y Z --target X Y Z")
    solution = load_solution(options.scene) if is_solved else None
    scene = _scene(options) if solution is None else solution.scene
    is_specular = scene is not None and not scene.is_diffuse
    shading = options.shading or ("gather" if is_specular else "smooth")
    if is_specular and shading != "gather":
        raise ValueError(f"{options.scene} has mirrors or glass, which only --shading gather draws, in two passes")
    if solution is None:
        assert scene is not None
        solution = _solved(scene, options)
    more = {"seed": options.seed, "threads": options.threads, "progress": not options.quiet}
    if is_specular:
        image = two_pass(solution, camera, width, height, options.noise, **more)
    else:
        image = render(solution, camera, width, height, shading, options.noise, **more)
    save_image(options.output, image, options.exposure)
    _tell(options, f"written    {options.output}")


def _show(options: argparse.Namespace) -> None:
    if options.output is not None:
        _check_output(options.output, _PAGES)
    is_solved = _is_solved(options)
    _check_scene(options)
    up = _up(options)
    camera = _camera(options)
    solution = load_solution(options.scene) if is_solved else _solved(_scene(options), options)
    view = show(solution, camera, unit=options.unit, up=up)
    if options.output is None:
        _tell(options, f"opened     {view.open()}")
    else:
        view.save(options.output)
        _tell(options, f"written    {options.output}")


def _form_factors(options: argparse.Namespace) -> None:
    _check_output(options.output, (".npz",))
    _check_scene(options)
    scene = _scene(options)
    progress = not options.quiet
    # Written densely, whatever the method.
    needed, available = 8 * scene.n_patches**2, available_bytes()
    if needed > available:
        raise MemoryError(
            f"{scene.n_patches} x {scene.n_patches} form factors need {needed / 2**30:.3g} GiB and only "
            f"{available / 2**30:.3g} GiB can be used: use fewer patches"
        )
    F = form_factors(scene, options.tolerance, options.method, options.seed, options.threads, progress)
    with replacing(Path(options.output)) as temporary:
        np.savez_compressed(
            temporary, form_factors=F.toarray(), areas=F.areas, error_estimate=np.float64(F.error_estimate)
        )
    low, high = F.row_sums.min(), F.row_sums.max()
    _tell(options, f"{F}\nrow sums   {low:.6f} to {high:.6f}\nwritten    {options.output}")


def _bench(options: argparse.Namespace) -> None:
    run_bench(options.output, options.scenes, not options.no_mitsuba)


def _demo(options: argparse.Namespace) -> None:
    print(run_demo(options.output, options.tolerance, not options.no_mitsuba))


def _check_output(name: str, endings: Sequence[str]) -> None:
    """Refuses what could not be written, before any work."""
    path = Path(name)
    if path.suffix.lower() not in endings:
        raise ValueError(f"{path}: unknown format {path.suffix!r}; the formats are {', '.join(endings)}")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent}: no such folder")


def _check_scene(options: argparse.Namespace) -> None:
    """Refuses what is neither a file nor built in, before anything is said of cameras and methods."""
    name = options.scene
    if name in _SCENES or Path(name).is_file():
        return
    if Path(name).suffix:
        raise FileNotFoundError(f"{name}: no such file")
    near = get_close_matches(name, _SCENES, 1)
    meant = f"; did you mean {near[0]}?" if near else ""
    raise ValueError(f"{name}: no such file, and no built-in scene, which are {', '.join(_SCENES)}{meant}")


def _scene(options: argparse.Namespace) -> Scene:
    name = options.scene
    scene: Scene = getattr(scenes, name)() if name in _SCENES else load(name)
    return scene if options.max_edge is None else scene.subdivide(options.max_edge)


def _solved(scene: Scene, options: argparse.Namespace) -> Solution:
    return solve(
        scene,
        _TOLERANCE if options.tolerance is None else options.tolerance,
        options.method or "auto",
        seed=options.seed,
        threads=options.threads,
        progress=not options.quiet,
    )


def _is_solved(options: argparse.Namespace) -> bool:
    """Whether a solution is given; refuses what cannot change it."""
    if not options.scene.lower().endswith(".npz"):
        return False
    solving = {"--tolerance": options.tolerance, "--method": options.method, "--max-edge": options.max_edge}
    given = [name for name, value in solving.items() if value is not None]
    if given:
        raise ValueError(f"{options.scene} is solved already: {', '.join(given)} cannot change it")
    return True


def _camera(options: argparse.Namespace) -> Camera | None:
    """The camera asked for; that of a built-in scene that has one; else None."""
    parts = {
        name: value for name in ("origin", "target", "up", "fov") if (value := getattr(options, name, None)) is not None
    }
    if "origin" in parts and "target" in parts:
        return Camera(**{"up": _up(options), **parts})
    if set(parts) - {"up"}:
        raise ValueError("a camera needs both --origin X Y Z and --target X Y Z")
    view = getattr(scenes, f"{options.scene}_view", None) if options.scene in _SCENES else None
    return None if view is None else Camera(**view())


def _up(options: argparse.Namespace) -> tuple[float, float, float]:
    """The direction asked for; y for glTF files, whose rule that is; else z."""
    usual = (0.0, 1.0, 0.0) if options.scene.lower().endswith((".glb", ".gltf")) else (0.0, 0.0, 1.0)
    up = getattr(options, "up", None)
    return usual if up is None else tuple(up)


def _tell(options: argparse.Namespace, text: str) -> None:
    if not options.quiet:
        print(text)
