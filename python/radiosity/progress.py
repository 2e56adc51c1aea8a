"""Progress bars for long work: ``progress=True | False | callable(done, total)``.

``True`` draws a bar in a terminal or a notebook once the work has taken half a second, and nothing elsewhere.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

from tqdm.auto import tqdm

Progress: TypeAlias = bool | Callable[[int, int], object]


@contextmanager
def reporter(progress: Progress, what: str) -> Iterator[Callable[[int, int], object] | None]:
    """The callable that the core reports to, or None; ``what`` stands before the bar."""
    if callable(progress):
        yield progress
        return
    if not isinstance(progress, bool):
        raise TypeError(f"progress must be True, False or a callable(done, total), not {type(progress).__name__}")
    # In a notebook tqdm.auto defines a widget class of its own; elsewhere it hands on the one for terminals.
    in_notebook = tqdm.__module__ == "tqdm.auto"
    if not progress or not (in_notebook or sys.stderr.isatty()):
        yield None
        return
    with tqdm(desc=what, unit_scale=True, delay=0.5, leave=False) as bar:

        def report(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield report
