"""Form factors as files: everything that they are made of, bit for bit, with the largest array mapped and not read.

One ``.npz`` file, whose arrays ``docs/keeping.md`` describes. F depends on nothing but where the patches are, so the
file keeps their corners, and is refused for a scene whose patches have others: by the first of them. The other arrays
are those of the core's operators, which look at every index before they use it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import _core
from .arrays import FloatArray
from .files import replacing
from .memory import available_bytes
from .npz import AnyArray, Entry, names_in, read_arrays, write_arrays
from .report import counted
from .scene import Scene

# Of the layout of these files.
VERSION = 1
_FORMAT = "radiosity form factors"
# Numbers of the exchange that are copied at once.
_PART = 1 << 20

# Of the arrays that are read: what the core makes of them while they are there, and what it then holds beside them.
_GROWTH = 3
# A node of the tree over the patches, of which there are two a patch, with what is computed from its parts.
_BYTES_OF_NODE = 2000

# The arrays of every method beside ``settings`` and ``corners``: type and shape, with a letter for any length.
_ARRAYS: dict[str, dict[str, tuple[str, tuple[int | str, ...]]]] = {
    "analytic": {
        "exchange": ("f8", ("p",)),
        "pairs": ("u4", ("k", 2)),
        "standard_errors": ("f8", ("k",)),
    },
    "monte_carlo": {
        "start": ("u8", ("s",)),
        "index": ("u4", ("k",)),
        "value": ("f8", ("k",)),
        "rays": ("u4", ("n",)),
    },
    "hemicube": {
        "start": ("u8", ("s",)),
        "index": ("u4", ("k",)),
        "value": ("f8", ("k",)),
        "errors": ("f8", ("k",)),
    },
    "hierarchical": {
        "nodes": ("u4", ("m", 2)),
        "places": ("u8", ("m",)),
        "visibility": ("u1", ("m",)),
        "exchanges": ("f8", ("m", 5)),
        "matrices": ("f8", ("k",)),
    },
}
# Those of "analytic" where only what is not 0 is kept of the exchange.
_SPARSE: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "start": ("u8", ("s",)),
    "column": ("u4", ("e",)),
    "exchange": ("f8", ("e",)),
}


class Settings(NamedTuple):
    """How form factors were computed."""

    method: str
    """One of the methods of :func:`radiosity.form_factors`, not ``"auto"``."""
    tolerance: float
    """As it was asked for."""
    seed: int
    """Of segments and rays."""
    balanced_by: float | None
    """How far they were balanced."""


def write(path: str | os.PathLike[str], core: _core.FormFactors, scene: Scene, settings: Settings) -> None:
    """Writes form factors; an existing file is replaced only by a whole one."""
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise ValueError(f"{path}: form factors are saved as .npz, not {path.suffix!r}")
    more: dict[str, Any] = {}
    arrays: dict[str, AnyArray] = {}
    entries: list[Entry] = []
    if (dense := core.dense_parts()) is not None:
        pattern, arrays["pairs"], arrays["standard_errors"], more["kernel_error"] = dense
        count = core.n * (core.n - 1) // 2
        if pattern is not None:
            arrays["start"], arrays["column"] = pattern
            count = len(arrays["column"])
        entries.append(Entry("exchange", np.dtype("<f8"), (count,), _exchange(core, count)))
    elif (sampled := core.sampled_parts()) is not None:
        arrays["start"], arrays["index"], arrays["value"], rays, errors = sampled
        if rays is not None:
            arrays["rays"] = rays
        if errors is not None:
            arrays["errors"] = errors
    elif (links := core.links_parts()) is not None:
        arrays["nodes"], arrays["places"], arrays["visibility"] = links[:3]
        arrays["exchanges"], arrays["matrices"], more["tree_mark"] = links[3:]
    kept = {
        "format": _FORMAT,
        "version": VERSION,
        "radiosity": version("radiosity"),
        **settings._asdict(),
        "patches": core.n,
        "error_estimate": core.error_estimate,
        "segments": core.segments,
        **more,
    }
    arrays = {"settings": np.array(json.dumps(kept)), "corners": corners_of(scene), **arrays}
    with replacing(path) as temporary:
        write_arrays(temporary, [*(Entry.of(name, array) for name, array in arrays.items()), *entries])


def _exchange(core: _core.FormFactors, count: int) -> Iterator[AnyArray]:
    """The exchange, part by part: the whole may not be there twice."""
    for start in range(0, count, _PART):
        part = core.exchange(start, min(start + _PART, count))
        assert part is not None  # None is for what is not dense
        yield part


def corners_of(scene: Scene) -> FloatArray:
    """(n, 3, 3) corners of the patches, m."""
    return scene.vertices[scene.faces]


def read(path: str | os.PathLike[str], scene: Scene, check: bool) -> tuple[_core.FormFactors, Settings]:
    """Form factors of a scene from a file; see :func:`radiosity.load_form_factors`."""
    path = Path(path)
    names = names_in(path)
    if "settings" not in names:
        hint = " (a saved solution: load_solution reads it)" if "radiosity" in names else ""
        raise ValueError(f"{path}: no saved form factors{hint}; only the files of FormFactors.save can be read again")
    arrays = read_arrays(path, ("exchange",), check)
    try:
        kept = _settings(arrays.pop("settings"))
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: damaged, the settings cannot be read ({error})") from error
    if kept.get("format") != _FORMAT:
        raise ValueError(f"{path}: no saved form factors, but {kept.get('format')!r}")
    if kept.get("version") != VERSION:
        raise ValueError(
            f"{path}: written in layout {kept.get('version')!r} by radiosity {kept.get('radiosity')!r}, and this "
            f"version reads layout {VERSION}: compute the form factors again"
        )
    try:
        settings = _checked(kept)
        _check_arrays(arrays, settings.method, kept["patches"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: damaged, {error}") from error
    check_scene(path, arrays.pop("corners"), scene)
    needed = _GROWTH * sum(array.nbytes for array in arrays.values() if not isinstance(array, np.memmap))
    if settings.method == "hierarchical":
        needed += 2 * _BYTES_OF_NODE * scene.n_patches
    if needed > available_bytes():
        raise MemoryError(f"{path}: these form factors need {needed} bytes more, which cannot be had")
    try:
        core = _operator(scene, settings.method, arrays, kept)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from error
    return core, settings


def _settings(array: AnyArray) -> dict[str, Any]:
    kept = json.loads(str(array))
    if not isinstance(kept, dict):
        raise TypeError("no names and values")
    return kept


def _checked(kept: dict[str, Any]) -> Settings:
    """The settings, if they are what settings may be."""
    method, tolerance, seed, moved = (kept[name] for name in Settings._fields)
    if method not in _ARRAYS:
        raise ValueError(f"unknown method {method!r}")
    for name, value in (("tolerance", tolerance), ("error_estimate", kept["error_estimate"]), ("balanced_by", moved)):
        if value is None and name == "balanced_by":
            continue
        if not isinstance(value, float) or not 0.0 <= value < np.inf:
            raise ValueError(f"{name} {value!r} is not a number from 0")
    for name in ("seed", "segments", "patches", *(("tree_mark",) if method == "hierarchical" else ())):
        if type(kept[name]) is not int or not 0 <= kept[name] < 2**64:
            raise ValueError(f"{name} {kept[name]!r} is outside 0 .. 2^64 - 1")
    return Settings(method, tolerance, seed, moved)


def _check_arrays(arrays: dict[str, AnyArray], method: str, n: int) -> None:
    """Refuses arrays that are missing, too many, or of another type or shape."""
    expected = {"corners": ("f8", (n, 3, 3)), **_ARRAYS[method]}
    if method == "analytic" and ("start" in arrays or "column" in arrays):
        expected |= _SPARSE
    if set(arrays) != set(expected):
        raise ValueError(f"the arrays are {sorted(arrays)}, and should be {sorted(expected)}")
    lengths: dict[int | str, int] = {"n": n, "s": n + 1, "p": n * (n - 1) // 2}
    for name, (kind, shape) in expected.items():
        array = arrays[name]
        fits = array.dtype == np.dtype(kind) and array.ndim == len(shape)
        for want, got in zip(shape, array.shape, strict=False):
            fits = fits and got == (lengths.setdefault(want, got) if isinstance(want, str) else want)
        if not fits:
            told = tuple(lengths.get(length, length) for length in shape)
            raise ValueError(f"{name} is {array.dtype} of shape {array.shape} and not {np.dtype(kind)} of {told}")


def check_scene(origin: object, corners: FloatArray, scene: Scene) -> None:
    """Refuses a scene whose patches are not where those of the file were, by the first that is not."""
    n = len(corners)
    if n != scene.n_patches:
        raise ValueError(
            f"{origin}: it is of {counted(n, 'patch', 'patches')} and the scene has {scene.n_patches}: compute the "
            "form factors again"
        )
    is_mirror, is_glass = scene.mirror > 0.0, scene.ior > 0.0
    if (is_mirror | is_glass).any():
        i = int(np.argmax(is_mirror | is_glass))
        what = "a mirror" if is_mirror[i] else "glass"
        raise ValueError(f"{origin}: patch {i} is {what} now; form factors carry neither mirrors nor glass")
    now = corners_of(scene)
    changed = np.flatnonzero((now != corners).any(axis=(1, 2)))
    if not changed.size:
        return
    i = int(changed[0])
    others = f" ({counted(changed.size, 'patch has', 'patches have')} changed)" if changed.size > 1 else ""
    if sorted(now[i].tolist()) == sorted(corners[i].tolist()):
        what = "has its corners in another order"
    else:
        what = f"was moved, by up to {np.linalg.norm(now[i] - corners[i], axis=1).max():.3g} m"
    raise ValueError(f"{origin}: patch {i} {what}{others}: compute the form factors again")


def _operator(scene: Scene, method: str, arrays: dict[str, AnyArray], kept: dict[str, Any]) -> _core.FormFactors:
    """The core's operator of these arrays."""
    told = (kept["error_estimate"], kept["segments"])
    if method == "analytic":
        pattern = (arrays["start"], arrays["column"]) if "start" in arrays else None
        parts = (pattern, arrays["exchange"], arrays["pairs"], arrays["standard_errors"], float(kept["kernel_error"]))
        return _core.FormFactors.from_dense_parts(scene._core, *parts, *told)
    if method == "hierarchical":
        links = (arrays["nodes"], arrays["places"], arrays["visibility"], arrays["exchanges"], arrays["matrices"])
        return _core.FormFactors.from_links_parts(scene._core, *links, kept["tree_mark"], *told)
    rows = (arrays["start"], arrays["index"], arrays["value"], arrays.get("rays"), arrays.get("errors"))
    return _core.FormFactors.from_sampled_parts(scene._core, *rows, *told)
