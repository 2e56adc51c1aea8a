"""Results that are kept in a folder and found again: ``cache=`` of :func:`form_factors` and :func:`solve`.

The name of a file is a hash of all that its content follows from: the mesh, for a solution the materials, and every
setting that changes the result; with the versions of the package and of the layouts. What is found is compared with its
checksums, and what is damaged is computed again.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import warnings
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np

from .keep import VERSION as FORM_FACTORS_VERSION
from .npz import AnyArray
from .save import VERSION as SOLUTION_VERSION
from .scene import Scene
from .solution import Solution

Cache: TypeAlias = str | os.PathLike[str] | None
Result = TypeVar("Result")

# What of a scene its solution follows from, beside the settings.
_OF_SOLUTIONS = ("vertices", "faces", "reflectance", "emission", "mirror", "ior")


def folder_of(cache: Cache) -> Path | None:
    """The folder, made if it is not there, once a file could be written to it.

    Raises:
        TypeError: no path.
        OSError: no folder, or none that can be written to.
    """
    if cache is None:
        return None
    if not isinstance(cache, (str, os.PathLike)):
        raise TypeError(f"cache must be None or the path of a folder, not {type(cache).__name__}")
    folder = Path(cache)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Permissions do not tell: root may do everything, and nobody may write to a disk that is mounted to be read.
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        # It would name the temporary file, of which the user knows nothing.
        raise type(error)(error.errno, f"cache cannot be written to ({error.strerror})", str(folder)) from None
    return folder


def form_factors_in(folder: Path, scene: Scene, **settings: Any) -> Path:
    """Where the form factors of a scene are kept."""
    name = _hash(FORM_FACTORS_VERSION, settings, vertices=scene.vertices, faces=scene.faces)
    return folder / f"form-factors-{name}.npz"


def solution_in(folder: Path, scene: Scene, **settings: Any) -> Path:
    """Where a solution of a scene is kept."""
    arrays: dict[str, AnyArray] = {name: getattr(scene, name) for name in _OF_SOLUTIONS}
    # The elements of a solution have names, too.
    return folder / f"solution-{_hash(SOLUTION_VERSION, {**settings, 'names': scene.names}, **arrays)}.npz"


def _hash(layout: int, settings: dict[str, Any], **arrays: AnyArray) -> str:
    """SHA-256 of settings and arrays, the same on any machine; half of its digits, for names that can be read."""
    total = hashlib.sha256()
    # Floating-point numbers are written with as many digits as tell them apart.
    told = {"layout": layout, "radiosity": version("radiosity"), **settings}
    told |= {name: list(array.shape) for name, array in arrays.items()}
    total.update(json.dumps(told, sort_keys=True).encode())
    for _, array in sorted(arrays.items()):
        total.update(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())
    return total.hexdigest()[:32]


def is_of(solution: Solution, scene: Scene) -> bool:
    """Whether a solution is of this very scene, whatever its file is called."""
    own = solution.scene
    return own is not None and all(
        np.array_equal(getattr(own, name), getattr(scene, name), equal_nan=True) for name in _OF_SOLUTIONS
    )


def kept(
    path: Path,
    load: Callable[[Path], Result],
    compute: Callable[[], Result],
    write: Callable[[Result, Path], None],
    may_keep: Callable[[Result], bool],
) -> Result:
    """What the file holds; where there is none, or a damaged one, what is computed, which is then kept."""
    if path.exists():
        try:
            return load(path)
        except (ValueError, OSError) as error:
            warnings.warn(f"{error}: it is not used, and what it held computed again", UserWarning, stacklevel=3)
    result = compute()
    if may_keep(result):
        try:
            write(result, path)
        except (OSError, MemoryError) as error:
            # Of a full disk, most likely: the work is done, and worth more than an error.
            warnings.warn(f"{path}: the result could not be kept ({error})", UserWarning, stacklevel=3)
    return result
