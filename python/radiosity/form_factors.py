"""Form factors (= view factors, configuration factors, shape factors): of two polygons, and of a whole scene.

F[i, j] is the fraction of what leaves patch i, diffusely, that reaches patch j. Rows emit, columns receive; the rows of
a closed scene sum to 1; A_i F_ij = A_j F_ji. F does not depend on the unit of length.
"""

from __future__ import annotations

import operator
import warnings
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _core
from .arrays import FloatArray, read_only, real_array, seed_number, shaped, thread_count
from .memory import available_bytes
from .progress import Progress, reporter
from .scene import Scene

if TYPE_CHECKING:
    import scipy.sparse
    import scipy.sparse.linalg

METHODS = ("auto", "analytic")


def form_factor(polygon_a: Any, polygon_b: Any, tolerance: float = 1e-8) -> float:
    """The form factor F_ab from one planar convex polygon to another, with nothing between them.

    Parts of a polygon behind the other one's plane do not count. Polygons may touch.

    Args:
        polygon_a: (k, 3) corners, counter-clockwise seen from the front.
        polygon_b: (l, 3) corners.
        tolerance: relative, in [1e-8, 1). Met by 99.9 % of pairs of all kinds, by the rest within a factor of 3. At
            1e-6 and tighter, slivers of aspect above 1e3 and gaps below 1e-4 of the size may be off by more: rounding.

    Raises:
        ValueError: a polygon that is not planar, not convex, or without area; a tolerance out of range.

    Sources:
        Lambert 1760 (point to polygon); Sparrow 1963 (double contour integral).
    """
    a, b = shaped("polygon_a", polygon_a, "k", 3), shaped("polygon_b", polygon_b, "l", 3)
    return _core.form_factor(a, b, float(tolerance))


def pair_form_factors(
    a: Any, b: Any, tolerance: float = 1e-8, threads: int | None = None, progress: Progress = True
) -> FloatArray:
    """(m,) form factors from triangle ``a[k]`` to triangle ``b[k]``, with nothing between them.

    Args:
        a: (m, 3, 3) corners of the emitting triangles.
        b: (m, 3, 3) corners of the receiving triangles.
        tolerance: relative, in [1e-8, 1).
        threads: None for all cores.
        progress: see :mod:`radiosity.progress`.

    Raises:
        ValueError: shapes that do not fit, a triangle without area (its pair is named), a tolerance out of range.
    """
    first, second = shaped("a", a, "m", 3, 3), shaped("b", b, "m", 3, 3)
    if len(first) != len(second):
        raise ValueError(f"a has {len(first)} triangles and b {len(second)}; they must be as many")
    with reporter(progress, "form factors") as report:
        return _core.pair_form_factors(first, second, float(tolerance), thread_count(threads), report)


def form_factors(
    scene: Scene,
    tolerance: float = 1e-3,
    method: str = "auto",
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = True,
) -> FormFactors:
    """The form factors of a scene, occlusion included.

    Args:
        scene: the patches.
        tolerance: bound on sum over j of abs(dF_ij) for every row i, in [1e-8, 1). Two hundredths of it go to the
            unoccluded kernels; the visibility of partly hidden pairs is sampled by quasi-random segments until the
            errors to be expected in the row add up to less than the rest (or 65,536 segments a pair are spent). What
            was reached is ``.error_estimate``. No segments are cast where nothing can block.
        method: ``"analytic"``, exact kernels times sampled visibility, stored densely; ``"auto"`` chooses.
        seed: of the quasi-random segments. The result is the same for any number of threads.
        threads: None for all cores.
        progress: see :mod:`radiosity.progress`.

    Raises:
        ValueError: an unknown method, a tolerance out of range.
        MemoryError: the dense exchange would not fit, with the estimate; nothing has been computed then.

    Warns:
        UserWarning: the tolerance was not met by 65,536 segments a pair.
    """
    F = form_factors_as_reached(scene, tolerance, method, seed, threads, progress)
    if F.error_estimate > tolerance:
        warnings.warn(
            f"the row error of the form factors is about {F.error_estimate:.2g}, above the tolerance {tolerance:g}: "
            "partly hidden patches are too large for it; subdivide the scene or ask for a looser tolerance",
            UserWarning,
            stacklevel=2,
        )
    return F


def form_factors_as_reached(
    scene: Scene, tolerance: float, method: str, seed: int, threads: int | None, progress: Progress
) -> FormFactors:
    """Like :func:`form_factors`, for callers that judge the error estimate themselves."""
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}")
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; the methods of form_factors are {METHODS}")
    with reporter(progress, "form factors") as report:
        core = _core.FormFactors.dense(
            scene._core, float(tolerance), seed_number(seed), available_bytes(), thread_count(threads), report
        )
    return FormFactors(core, scene)


class FormFactors:
    """The form factors of a scene as an operator; made by :func:`form_factors`."""

    scene: Scene
    """The scene that the factors belong to."""

    def __init__(self, core: _core.FormFactors, scene: Scene) -> None:
        self._core = core
        self.scene = scene

    def __repr__(self) -> str:
        return f"FormFactors({self.shape[0]} patches, {self.nbytes} bytes, row error about {self.error_estimate:.2g})"

    @property
    def shape(self) -> tuple[int, int]:
        """(n, n)."""
        return self._core.n, self._core.n

    @property
    def areas(self) -> FloatArray:
        """(n,) areas A, m^2."""
        return self.scene.areas

    @cached_property
    def row_sums(self) -> FloatArray:
        """(n,) sum over j of F_ij; 1 in a closed scene."""
        return read_only(self._core.row_sums)

    @cached_property
    def remainder(self) -> FloatArray:
        """(n,) 1 - row sum: what leaves the scene. Never clipped: small negative values are the sampling error."""
        return read_only(self._core.remainder)

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return self._core.nbytes

    @property
    def error_estimate(self) -> float:
        """Estimate of max_i sum_j abs(dF_ij): the kernels' bound plus one standard error a sampled pair."""
        return self._core.error_estimate

    @property
    def segments(self) -> int:
        """Number of segments cast for visibility."""
        return self._core.segments

    def reciprocity_error(self) -> float:
        """The largest abs(A_i F_ij - A_j F_ji), relative to the largest A_i F_ij. Rounding only, by construction."""
        error = self._core.reciprocity_error()
        assert error is not None  # None is for matrices without areas
        return error

    def __matmul__(self, x: Any) -> FloatArray:
        """F @ x for x of shape (n,) or (n, k): the irradiance that the radiosities x cause."""
        vector = real_array("x", x)
        if vector.ndim not in (1, 2) or vector.shape[0] != self.shape[0]:
            raise ValueError(f"x must have shape ({self.shape[0]},) or ({self.shape[0]}, k), not {vector.shape}")
        columns = np.ascontiguousarray(vector.reshape(len(vector), -1))
        return self._core.apply(columns).reshape(vector.shape)

    def row(self, i: int) -> FloatArray:
        """(n,) row i: where the light of patch i goes. Raises ``IndexError`` when there is no such patch."""
        number = operator.index(i)
        if not 0 <= number < self.shape[0]:
            raise IndexError(f"row {i} is outside 0 .. {self.shape[0]}")
        return self._core.row(number)

    def toarray(self) -> FloatArray:
        """(n, n) plain array; needs 8 n^2 bytes. Raises ``MemoryError`` when they cannot be had."""
        n = self.shape[0]
        if 8 * n * n > available_bytes():
            raise MemoryError(f"a plain array of {n} x {n} form factors needs {8 * n * n} bytes; use @ or row(i)")
        return self._core.toarray()

    def tocsr(self) -> scipy.sparse.csr_array:
        """(n, n) SciPy sparse array. Needs the extra ``scipy``."""
        import scipy.sparse

        return scipy.sparse.csr_array(self.toarray())

    def aslinearoperator(self) -> scipy.sparse.linalg.LinearOperator:
        """SciPy ``LinearOperator`` of shape (n, n) with products from both sides. Needs the extra ``scipy``."""
        import scipy.sparse.linalg

        # Reciprocity gives the transpose for free: F^T = A F A^-1.
        areas = self.areas
        return scipy.sparse.linalg.LinearOperator(
            shape=self.shape,
            dtype=np.float64,
            matvec=lambda x: self @ x.reshape(-1),
            rmatvec=lambda x: areas * (self @ (x.reshape(-1) / areas)),
            matmat=lambda x: self @ x,
        )
