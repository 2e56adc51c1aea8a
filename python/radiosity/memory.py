"""How much memory a computation may be expected to get."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from . import _core

# What remains for the caller's own arrays and for everything else on the machine.
_SHARE = 0.8
# No limit is known: the largest number that the core understands.
_UNKNOWN = 2**63 - 1


def available_bytes() -> int:
    """Bytes that can be used without swapping, or a very large number where the system does not tell."""
    limits = [limit for limit in (_system(), _container(), _address_space()) if limit is not None]
    return int(_SHARE * max(min(limits), 0)) if limits else _UNKNOWN


def _system() -> int | None:
    """What the machine has left, or all it has where it does not tell what is left."""
    for line in _lines("/proc/meminfo"):
        if line.startswith("MemAvailable:"):
            return 1024 * int(line.split()[1])
    if hasattr(os, "sysconf"):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def _container() -> int | None:
    """What the control group (version 2) of a container has left."""
    limit, used = _lines("/sys/fs/cgroup/memory.max"), _lines("/sys/fs/cgroup/memory.current")
    if limit and used and limit[0].isdecimal():
        return int(limit[0]) - int(used[0])
    return None


def _address_space() -> int | None:
    """What the limit that ``ulimit -v`` sets has left."""
    if sys.platform == "win32":
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    if soft == resource.RLIM_INFINITY:
        return None
    # Each thread takes some tens of MiB of addresses, which are no longer there for work.
    _core.start_threads()
    used = _lines("/proc/self/statm")
    return soft - (int(used[0].split()[0]) * os.sysconf("SC_PAGE_SIZE") if used else 0)


def _lines(path: str) -> list[str]:
    """The lines of a file of the system, none where there is no such file."""
    try:
        return Path(path).read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        return []
