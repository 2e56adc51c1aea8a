"""How much memory a computation may be expected to get."""

from __future__ import annotations

import os
import sys
from pathlib import Path

# What remains for the caller's own arrays and for everything else on the machine.
_SHARE = 0.8
# No limit is known: the largest number that the core understands.
_UNKNOWN = 2**63 - 1


def available_bytes() -> int:
    """Bytes that can be used without swapping, or a very large number where the system does not tell."""
    limits = [_address_space()]
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        limits += [1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
    except (OSError, ValueError, IndexError):
        if hasattr(os, "sysconf"):
            limits.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return int(_SHARE * min(limits)) if min(limits) < _UNKNOWN else _UNKNOWN


def _address_space() -> int:
    """The limit that ``ulimit -v`` sets."""
    if sys.platform == "win32":
        return _UNKNOWN
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return _UNKNOWN if soft == resource.RLIM_INFINITY else soft
