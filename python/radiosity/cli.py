"""The command line: ``radiosity demo`` and ``radiosity bench``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from . import __version__
from .bench import run as run_bench
from .demo import run as run_demo
from .references import NAMES
from .solution import ConvergenceError


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns the exit status: 0, 1 for an error told on stderr, 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(
        prog="radiosity", description="Diffuse light and heat between the surfaces of a 3-D scene."
    )
    parser.add_argument("--version", action="version", version=f"radiosity {__version__}")
    commands = parser.add_subparsers(dest="command", required=True)
    demo = commands.add_parser("demo", help="solve the Cornell box, write its picture, compare with Mitsuba")
    demo.add_argument("-o", "--output", default="out", metavar="FOLDER", help="where the picture goes (default: out)")
    demo.add_argument(
        "--tolerance", type=float, default=0.02, help="relative error asked of the solution (default: 0.02)"
    )
    demo.add_argument("--no-mitsuba", action="store_true", help="do not time Mitsuba even if it is installed")
    bench = commands.add_parser("bench", help="error against seconds of all methods, and of Mitsuba, on known scenes")
    bench.add_argument(
        "-o", "--output", default="out", metavar="FOLDER", help="where bench.csv and bench.png go (default: out)"
    )
    bench.add_argument("--scenes", nargs="+", choices=NAMES, default=NAMES, metavar="NAME", help=", ".join(NAMES))
    bench.add_argument("--no-mitsuba", action="store_true", help="do not race against Mitsuba even if it is installed")
    options = parser.parse_args(arguments)
    try:
        if options.command == "demo":
            print(run_demo(options.output, options.tolerance, not options.no_mitsuba))
        else:
            run_bench(options.output, options.scenes, not options.no_mitsuba)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except (ValueError, MemoryError, OSError, ImportError, ConvergenceError) as error:
        print(f"radiosity: {error}", file=sys.stderr)
        return 1
    return 0
