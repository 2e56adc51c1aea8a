"""Numpy arrays at the door: types and shapes checked before the core sees them.

Wrong types raise ``TypeError``, wrong shapes ``ValueError``, both naming the argument and what is expected.
"""

from __future__ import annotations

import operator
from typing import Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
# No machine has more cores, and a thousand idle threads cost a second to start.
MOST_THREADS = 1024

Array = TypeVar("Array", bound=npt.NDArray[Any])


def real_array(name: str, value: Any) -> FloatArray:
    """``value`` as a float64 array of any shape; ``TypeError`` when it does not hold real numbers."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold real numbers, not {array.dtype}")
    return aligned(array.astype(np.float64, copy=False))


def shaped(name: str, value: Any, *shape: int | str) -> FloatArray:
    """``value`` as a contiguous float64 array of ``shape``; a letter stands for any length.

    Raises ``TypeError`` for what is not real numbers and ``ValueError`` for another shape.
    """
    array = real_array(name, value)
    fits = array.ndim == len(shape) and all(
        isinstance(want, str) or want == got for want, got in zip(shape, array.shape, strict=True)
    )
    if not fits:
        expected = ", ".join(str(want) for want in shape) + ("," if len(shape) == 1 else "")
        raise ValueError(f"{name} must have shape ({expected}), not {array.shape}")
    return np.ascontiguousarray(array)


def triangle_indices(name: str, value: Any) -> IntArray:
    """``value`` as an (n, 3) int64 array; ``TypeError`` when it does not hold integers."""
    array = np.asarray(value)
    if array.dtype.kind not in "iu":
        # An empty list has no type of its own; the core says that the scene is empty.
        if array.size == 0:
            return np.empty((0, 3), np.int64)
        raise TypeError(f"{name} must hold integers, not {array.dtype}")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (n, 3): three vertex indices a triangle, not {array.shape}")
    return np.ascontiguousarray(aligned(array), np.int64)


def per_patch(n: int, **quantities: Any) -> list[FloatArray]:
    """The named quantities, each broadcast to one (n, b) shape.

    A scalar holds for all patches and bands, a 1-D array (b,) is one value a band, a 2-D array (n, b) one row a patch.
    Raises ``ValueError`` when the quantities do not agree on the number of bands.
    """
    arrays = []
    for name, value in quantities.items():
        array = real_array(name, value)
        if array.ndim > 2 or (array.ndim == 2 and array.shape[0] != n) or 0 in array.shape[-1:]:
            raise ValueError(
                f"{name} must be a scalar, (b,) one a band, or ({n}, b) one row a patch, not {array.shape}"
            )
        arrays.append(array)
    widths = [array.shape[-1] if array.ndim else 1 for array in arrays]
    bands = max(widths)
    if any(width not in (1, bands) for width in widths):
        told = ", ".join(f"{name} has {width}" for name, width in zip(quantities, widths, strict=True))
        raise ValueError(f"the quantities disagree on the number of bands: {told}")
    return [np.ascontiguousarray(np.broadcast_to(array, (n, bands))) for array in arrays]


def one_per_patch(name: str, n: int, value: Any) -> FloatArray:
    """``value`` as (n,), from a scalar or one number a patch; ``ValueError`` for other shapes."""
    array = real_array(name, value)
    if array.shape not in ((), (n,)):
        raise ValueError(f"{name} must be a scalar or ({n},), one a patch, not {array.shape}")
    return np.ascontiguousarray(np.broadcast_to(array, (n,)))


def vectors(name: str, value: Any, n: int) -> tuple[FloatArray, tuple[int, ...]]:
    """``value`` of shape (n,) or (n, k) as a contiguous (n, k), and its shape; ``ValueError`` for other shapes."""
    array = real_array(name, value)
    if array.ndim not in (1, 2) or array.shape[0] != n:
        raise ValueError(f"{name} must have shape ({n},) or ({n}, k), not {array.shape}")
    return np.ascontiguousarray(array.reshape(n, -1)), array.shape


def row_number(i: int, n: int) -> int:
    """``i`` as the number of one of n rows; ``IndexError`` when there is no such row."""
    number = operator.index(i)
    if not 0 <= number < n:
        raise IndexError(f"row {i} is outside 0 .. {n}")
    return number


def whole_number(name: str, value: Any, least: int, most: int) -> int:
    """``value`` as an int; ``TypeError`` when it is no integer, ``ValueError`` when outside ``least`` .. ``most``."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name} must be an integer, not {type(value).__name__}")
    if not least <= value <= most:
        raise ValueError(f"{name} {value} is outside {least} .. {most}")
    return int(value)


def real_number(name: str, value: Any) -> float:
    """``value`` as a float; ``TypeError`` when it is no real number."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise TypeError(f"{name} must be a number, not {type(value).__name__}")
    return float(value)


def thread_count(threads: int | None) -> int | None:
    """``threads`` if it is None (all cores) or in 1 .. 1024, else ``TypeError`` or ``ValueError``."""
    return None if threads is None else whole_number("threads", threads, 1, MOST_THREADS)


def seed_number(seed: int) -> int:
    """``seed`` if it is an integer in [0, 2^64), else ``TypeError`` or ``ValueError``."""
    return whole_number("seed", seed, 0, 2**64 - 1)


def aligned(array: Array) -> Array:
    """The same array, copied if it lies at an odd address, as in a message: the core reads whole words."""
    return array if array.flags.aligned else array.copy()


def read_only(array: Array) -> Array:
    """The same array, no longer writeable: what a frozen object hands out."""
    array.flags.writeable = False
    return array
