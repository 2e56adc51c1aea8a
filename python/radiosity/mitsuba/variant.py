"""Which Mitsuba variant works here, found out before one that does not aborts the process."""

from __future__ import annotations

import contextlib
import ctypes.util
import functools
import logging
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    pass

log = logging.getLogger(__name__)

# The oldest LLVM that can compile Mitsuba's kernels: 14 and 15 abort the whole process ("Cannot select: fminimum").
OLDEST_LLVM = 16

# Where systems and package managers keep LLVM's shared library.
LLVM_PLACES = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib/llvm*/lib*/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/usr/local/llvm*/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
    "C:/Program Files/LLVM/bin/LLVM-C.dll",
    f"{sys.prefix}/lib/libLLVM*.so*",
    f"{sys.prefix}/lib/libLLVM*.dylib",
)

# A kernel with the instruction that old versions cannot compile. The odd number makes it a kernel that no earlier run
# can have left in Dr.Jit's cache on disk, from where it would run without being compiled.
LLVM_PROOF = """
import time
import drjit as dr
from drjit.llvm import Float
odd = time.time_ns() % 1000003 / 7.0
x = dr.maximum(dr.minimum(dr.arange(Float, 16), odd), 1.0)
assert abs(float(dr.sum(x)[0]) - sum(max(min(float(k), odd), 1.0) for k in range(16))) < 1e-3
"""
LLVM_PROOF_SECONDS = 60.0


def variant() -> str:
    """Return the name of the Mitsuba variant that this package uses in this process.

    That is the variant already set with `mitsuba.set_variant`, if it is an RGB one and works; else `llvm_ad_rgb` where
    a usable LLVM is found (about ten times faster); else `scalar_rgb`, which works everywhere.

    Mitsuba's LLVM variants abort the whole Python process when LLVM is too old (14 and 15), so a small kernel is first
    compiled in a process of its own (0.3 s, once per process). `DRJIT_LIBLLVM_PATH` is respected if set; otherwise it
    is set, in this process, to the newest LLVM that passed. Nothing else is changed: the variant itself is set by the
    functions that need it, and by them only if none is set. The choice is logged at level INFO.

    Raises:
        ImportError: Mitsuba is not installed.

    """
    current = _import_mitsuba().variant() or ""
    if current.startswith("llvm") and not _llvm_works(os.environ.get("DRJIT_LIBLLVM_PATH")):
        return "scalar_rgb"  # the library is loaded: too late for a better one
    return str(current) if _is_rgb(current) else _best_variant()


def _import_mitsuba() -> Any:
    try:
        import mitsuba
    except ImportError as error:
        raise ImportError("Mitsuba is not installed: pip install radiosity[mitsuba]") from error
    return mitsuba


def _is_rgb(name: str) -> bool:
    words = name.split("_")
    return "rgb" in words and "polarized" not in words


@functools.cache
def _best_variant() -> str:
    """Return `llvm_ad_rgb` with `DRJIT_LIBLLVM_PATH` set to a library that works, or `scalar_rgb`."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    for library in [chosen] if chosen else _llvm_libraries():
        if _llvm_works(library):
            os.environ["DRJIT_LIBLLVM_PATH"] = library
            log.info("Mitsuba variant llvm_ad_rgb, with %s", library)
            return "llvm_ad_rgb"
    log.info("Mitsuba variant scalar_rgb: no usable LLVM (version %d or later) was found", OLDEST_LLVM)
    return "scalar_rgb"


def _llvm_libraries() -> list[str]:
    """Return LLVM libraries worth trying, newest first, those that do not tell their version last; three at most."""
    versions: dict[str, int] = {}
    for pattern in LLVM_PLACES:
        root = Path(pattern).anchor
        for path in Path(root).glob(pattern[len(root) :]):
            with contextlib.suppress(OSError):
                file = path.resolve(strict=True)
                versions.setdefault(str(file), max(_llvm_version(str(path)), _llvm_version(str(file))))
    by_name = ctypes.util.find_library("LLVM")
    if by_name and by_name not in {Path(file).name for file in versions}:
        versions.setdefault(by_name, _llvm_version(by_name))
    usable = [file for file, version in versions.items() if version >= OLDEST_LLVM or version == 0]
    return sorted(usable, key=lambda file: versions[file], reverse=True)[:3]


def _llvm_version(path: str) -> int:
    """Return the major version that a library's path tells (`libLLVM-19.so`, `libLLVM.so.19.1`, `llvm-19/`), or 0."""
    found = re.search(r"libLLVM(?:-|\.so\.)(\d+)", path) or re.search(r"llvm[-@]?(\d+)[/\\]", path)
    return int(found.group(1)) if found else 0


@functools.cache
def _llvm_works(library: str | None) -> bool:
    """Compile and run a small kernel with this LLVM (None: the one Dr.Jit finds) in a process that may die."""
    if not sys.executable:  # an embedded Python has no interpreter to start
        return False
    environment = os.environ | ({"DRJIT_LIBLLVM_PATH": library} if library else {})
    with tempfile.TemporaryDirectory() as folder:  # where a core dump may fall
        try:
            result = subprocess.run(
                [sys.executable, "-c", LLVM_PROOF],
                env=environment,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=LLVM_PROOF_SECONDS,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            log.info("%s could not be tried: %s", library or "LLVM", error)
            return False
    if result.returncode:
        log.info("%s cannot compile Mitsuba's kernels", library or "LLVM")
    return result.returncode == 0


def is_scalar(mi: Any) -> bool:
    """Tell whether the variant in use computes one number at a time."""
    return str(mi.variant()).startswith("scalar")


def mitsuba_with_rgb() -> Any:
    """Import Mitsuba with an RGB variant set, for objects that the caller will go on using.

    Raises:
        ValueError: the variant that the caller has set is another one, or would abort.

    """
    mi = _import_mitsuba()
    name = variant()
    if mi.variant() is None:
        mi.set_variant(name)
    elif mi.variant() != name:
        why = "its LLVM does not work" if _is_rgb(mi.variant()) else "radiosity needs an RGB one"
        raise ValueError(
            f"Mitsuba variant {mi.variant()!r} is set, but {why}: call mitsuba.set_variant({name!r}) first"
        )
    return mi


@contextlib.contextmanager
def mitsuba_for_a_while() -> Iterator[Any]:
    """Lend Mitsuba with an RGB variant and put back the caller's own (if none was set, ours stays)."""
    mi = _import_mitsuba()
    name = variant()
    if mi.variant() is None:
        mi.set_variant(name)
    with mi.variant_context(name) if mi.variant() != name else contextlib.nullcontext():
        yield mi
