"""Form factors (= view factors, configuration factors, shape factors): of two polygons, and of a whole scene.

F[i, j] is the fraction of what leaves patch i, diffusely, that reaches patch j. Rows emit, columns receive; the rows of
a closed scene sum to 1; A_i F_ij = A_j F_ji. F does not depend on the unit of length.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _core, keep
from .arrays import FloatArray, IntArray, read_only, row_number, seed_number, shaped, thread_count, vectors
from .cache import Cache, folder_of, form_factors_in, kept
from .memory import available_bytes
from .progress import Progress, reporter
from .scene import Scene

if TYPE_CHECKING:
    import scipy.sparse
    import scipy.sparse.linalg

METHODS = ("auto", "analytic", "hierarchical", "monte_carlo", "hemicube")

# What to do about a tolerance that was not met.
_ADVICE = {
    "analytic": "partly hidden patches are too large for it; subdivide the scene or ask for a looser tolerance",
    "hierarchical": "partly hidden patches are too large for it, or the memory too small; ask for a looser tolerance",
    "monte_carlo": 'a patch gets no more than 1,048,576 rays; ask for a looser tolerance or use method="analytic"',
    "hemicube": 'a patch gets no more than 4,194,304 cells; ask for a looser tolerance or use method="analytic"',
}


def form_factor(polygon_a: Any, polygon_b: Any, tolerance: float = 1e-8) -> float:
    """The form factor F_ab from one planar convex polygon to another, with nothing between them.

    Parts of a polygon behind the other one's plane do not count. Polygons may touch.

    Args:
        polygon_a: (k, 3) corners, counter-clockwise seen from the front.
        polygon_b: (l, 3) corners.
        tolerance: relative, in [1e-10, 1). Down to 1e-8 met by 99.9 % of pairs of all kinds, by the rest within a
            factor of 10. At 1e-10 slivers of aspect above 1e4 and sizes in a ratio of 1e6 may be off by 1e-7: rounding.

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
        tolerance: relative, in [1e-10, 1); see :func:`form_factor`.
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
    cache: Cache = None,
) -> FormFactors:
    """The form factors of a scene, occlusion included.

    Args:
        scene: the patches.
        tolerance: bound on sum over j of abs(dF_ij) for every row i, in [1e-10, 1). What was reached is
            ``.error_estimate``.
        method: ``"auto"`` is ``"analytic"``. The last two are for teaching, and as checks that share no formula with
            the others:

            - ``"analytic"``: exact kernels times the visible fraction, reciprocity exact, stored once a pair, and where
              most pairs are hidden only those that are not. Two
              hundredths of the tolerance go to the unoccluded kernels. What blocks is merged to convex bodies; where no
              body stands between two patches nothing is done, where up to eight do their shadows are exact from every
              point and averaged over one of the patches; where more do, or a patch reaches into a body, quasi-random
              segments are cast (at most 65,536 a pair). The work goes where it brings a row inside its tolerance for
              the least.
            - ``"hierarchical"``: links between clusters of patches of all sizes, each as large as the tolerance allows
              (``.links`` shows them), on which factors are linear in position and normal. Reciprocity exact. For a
              loose tolerance and many patches: at 0.1 and 3,328 patches of the Cornell box in half the time of
              ``"analytic"``, at 13,312 in a fifth; below 0.03 it is the slower. A factor may come out slightly
              negative, within the tolerance.
            - ``"monte_carlo"``: random rays, cosine-distributed; F_ij is the fraction that meets the front of j first.
              As many a patch as the expected row error, the sum over j of E abs(dF_ij), asks for, 1,024 to 1,048,576.
              n patches seen alike need about 0.6 n / tolerance^2 of them.
            - ``"hemicube"``: one ray through each cell of hemicubes over points of the patch. Resolution (16 to 512)
              and number of points (1 to 256, quasi-random) are raised, whichever matters more, until half the
              resolution (at other angles) and a quarter of the points (others) change the row by no more than the
              tolerance together, or one evaluation would cast more than 4,194,304 rays. The first measures aliasing,
              the second proximity and visibility.

            Each row of the last two is an estimate for itself, stored sparsely: reciprocity, and with it the energy
            audit of a solution, holds within the errors; row sums say nothing about them, as no ray is lost in a closed
            scene.
        seed: of the segments and rays. The result is the same for any number of threads.
        threads: None for all cores.
        progress: see :mod:`radiosity.progress`.
        cache: a folder in which form factors are kept, one file each, and taken from where the mesh, the method, the
            tolerance and the seed are the same; materials do not matter. None keeps nothing.

    Raises:
        ValueError: an unknown method, a tolerance out of range; for ``"analytic"`` and ``"hierarchical"`` a patch that
            repeats another one, whose light would count twice.
        OSError: ``cache`` cannot be written to.
        MemoryError: the factors would not fit, with the estimate: before any work where nothing can block, else as soon
            as what has been found outgrows the memory.

    Warns:
        UserWarning: the tolerance was not met by as many segments or rays as the method may cast; a file in ``cache``
            is damaged, or could not be written, after which the result is as good as without.

    Sources:
        Hanrahan, Salzman & Aupperle 1991 (hierarchical); Malley 1988 (Monte Carlo); Cohen & Greenberg 1985 (hemicube);
        Baum, Rushmeier & Winget 1989 (its assumptions).
    """
    F = form_factors_as_reached(scene, tolerance, method, seed, threads, progress, folder_of(cache))
    tolerance_missed(F.error_estimate, tolerance, F.method)
    return F


def tolerance_missed(error_estimate: float, tolerance: float, method: str) -> None:
    """Warns the caller's caller where the error is above the tolerance."""
    if error_estimate > tolerance:
        warnings.warn(
            f"the row error of the form factors is about {error_estimate:.2g}, above the tolerance {tolerance:g}: "
            f"{_ADVICE[method]}",
            UserWarning,
            stacklevel=3,
        )


def form_factors_as_reached(
    scene: Scene,
    tolerance: float,
    method: str,
    seed: int,
    threads: int | None,
    progress: Progress,
    folder: Path | None = None,
) -> FormFactors:
    """Like :func:`form_factors`, for callers that judge the error estimate themselves."""
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}")
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; the methods of form_factors are {METHODS}")
    settings = keep.Settings("analytic" if method == "auto" else method, float(tolerance), seed_number(seed), None)
    workers = thread_count(threads)

    def compute() -> FormFactors:
        with reporter(progress, "form factors") as report:
            return FormFactors(_computed(scene, settings, workers, report), scene, settings)

    def load(path: Path) -> FormFactors:
        core, found = keep.read(path, scene, check=True)
        if found != settings:
            raise ValueError(f"{path}: of other settings")
        return FormFactors(core, scene, found)

    if folder is None:
        return compute()
    return kept(
        form_factors_in(folder, scene, method=settings.method, tolerance=settings.tolerance, seed=settings.seed),
        load,
        compute,
        lambda F, path: F.save(path),
        # Links end where the memory does, which may be larger another time.
        lambda F: settings.method != "hierarchical" or F.error_estimate <= settings.tolerance,
    )


def _computed(
    scene: Scene, settings: keep.Settings, threads: int | None, report: Callable[[int, int], object] | None
) -> _core.FormFactors:
    method, tolerance, seed, _ = settings
    limits = (tolerance, seed, available_bytes(), threads, report)
    if method in ("monte_carlo", "hemicube"):
        return _core.FormFactors.sampled(scene._core, method, *limits)
    if method == "hierarchical":
        return _core.FormFactors.hierarchical(scene._core, *limits)
    return _core.FormFactors.dense(scene._core, *limits)


def load_form_factors(path: str | os.PathLike[str], scene: Scene, check: bool = True) -> FormFactors:
    """Form factors that :meth:`FormFactors.save` wrote, of the same patches, bit for bit.

    Those of ``"analytic"`` stay in the file, which the system reads as they are used: they take no memory of their own,
    and all processes that load one file share it; where only what is not 0 is kept, it is just the places that are
    read, and take 12 bytes each. The file may be replaced or deleted meanwhile, as :meth:`save` does, but not written
    to in place. Of ``"hierarchical"`` the tree over the patches is built again, which takes a part of the time that the
    links took; ``docs/keeping.md`` describes the file.

    Args:
        path: a ``.npz`` file.
        scene: the scene that the factors are of. Reflectance and emission may be others, since F does not depend on
            them.
        check: whether the numbers that stay in the file are compared with their checksums, for which all of it is read
            once. Without, a large file is open at once, and a damaged number in it goes unnoticed; everything that the
            numbers are found by is checked in any case.

    Raises:
        TypeError: no scene.
        FileNotFoundError: no such file.
        ValueError: no saved form factors, a damaged file, or one of another layout; a scene with other patches, of
            which the first is named.
        MemoryError: sampled rows, links, or the places of what is not 0, would not fit.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}")
    core, settings = keep.read(path, scene, check)
    return FormFactors(core, scene, settings)


@dataclass(frozen=True, repr=False)
class Links:
    """Which blocks of a form-factor matrix are represented by one link each; m links over n patches."""

    order: IntArray
    """(n,) the patches, sorted so that those of every cluster follow each other."""
    ranges: IntArray
    """(m, 2, 2) first and last + 1 place in ``order`` of the two clusters of each link."""
    levels: IntArray
    """(m, 2) levels of the two clusters in the tree; the root, all patches, has level 0."""
    visibility: IntArray
    """(m,) 0 where nothing stands between, which is proven; 1 where no light passes; 2 for all else."""

    @property
    def counts(self) -> IntArray:
        """(levels,) how many links end at each level; every link has two ends."""
        return np.bincount(self.levels.reshape(-1))

    def __repr__(self) -> str:
        per_patch = 2.0 * len(self.levels) / len(self.order)
        return f"Links({len(self.levels)} links, {per_patch:.1f} a patch, levels 0 to {self.levels.max(initial=0)})"


class FormFactors:
    """The form factors of a scene as an operator; made by :func:`form_factors`."""

    scene: Scene
    """The scene that the factors belong to."""
    method: str
    """``"analytic"``, ``"hierarchical"``, ``"monte_carlo"`` or ``"hemicube"``."""
    tolerance: float
    """The tolerance that was asked for."""
    seed: int
    """The seed of segments and rays."""
    balanced_by: float | None
    """How far :meth:`balance` has moved the factors, the largest sum over j of abs(dF_ij); None if it has not."""

    def __init__(self, core: _core.FormFactors, scene: Scene, settings: keep.Settings) -> None:
        self._core = core
        self.scene = scene
        self.method, self.tolerance, self.seed, self.balanced_by = settings

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
        """(n,) 1 - row sum: what leaves the scene, and for sampled rows also what meets backs.

        Never clipped: small negative values are the sampling error.
        """
        return read_only(self._core.remainder)

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return self._core.nbytes

    @property
    def error_estimate(self) -> float:
        """Estimate of max_i sum_j abs(dF_ij).

        Analytic: the kernels' bound plus one standard error a sampled pair. Monte Carlo: the mean to be expected.
        Hemicube: the change from half the resolution plus the change from a quarter of the points.
        Hierarchical: what the links say of themselves, added up over each row.
        Balanced: that of the factors before, plus ``balanced_by``, which is a bound and mostly too high.
        """
        return self._core.error_estimate

    @property
    def segments(self) -> int:
        """Number of segments cast for visibility, or of rays where a method uses rays."""
        return self._core.segments

    @cached_property
    def links(self) -> Links | None:
        """The links of ``"hierarchical"``; None for the other methods."""
        found = self._core.links()
        if found is None:
            return None
        rows, order = found
        return Links(
            order=read_only(order),
            ranges=read_only(np.ascontiguousarray(rows[:, :4].reshape(-1, 2, 2))),
            levels=read_only(np.ascontiguousarray(rows[:, 4:6])),
            visibility=read_only(np.ascontiguousarray(rows[:, 6])),
        )

    def reciprocity_error(self) -> float:
        """The largest abs(A_i F_ij - A_j F_ji), relative to the largest A_i F_ij.

        Analytic and hierarchical: rounding only, by construction. Monte Carlo and hemicube: two errors of sampling.
        """
        error = self._core.reciprocity_error()
        assert error is not None  # None is for matrices without areas
        return error

    def balance(self) -> FormFactors:
        """The factors of a closed scene moved so that every row sums to 1, with reciprocity as exact as before.

        Of all symmetric changes of the pairs that see each other, the one with the least sum of squared relative
        changes. How far it went is ``.balanced_by`` of the result; a scene that needs more than a few row errors is not
        closed. It makes the energy audit of a closed scene exact, not the single factors: errors that are spread
        without a bias stay as they are.

        Raises:
            ValueError: an open scene, with the patch that shows it and its row sum; factors by another method than
                ``"analytic"``.
            MemoryError: the second exchange would not fit.

        Sources:
            van Leersum 1989; Lawson 1995; Vercammen & Froment 1980; Daun, Morton & Howell 2005.
        """
        if self.method != "analytic":
            raise ValueError(
                f"balance moves pairs of patches and keeps reciprocity, for which {self.method!r} stores no pairs; "
                'use form_factors(..., method="analytic")'
            )
        core, moved = self._core.balance(available_bytes())
        # Of factors that have been moved before: as far as both together, at most.
        return FormFactors(
            core, self.scene, keep.Settings(self.method, self.tolerance, self.seed, moved + (self.balanced_by or 0.0))
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes everything to a ``.npz`` file, which :func:`load_form_factors` reads, bit for bit, and numpy too.

        An existing file is replaced only by a whole one. It takes no more bytes than :attr:`nbytes`, 72 a patch for
        the corners, by which scenes are told apart, and some kilobytes.

        Raises:
            ValueError: another ending than ``.npz``.
            OSError: the file cannot be written.
            MemoryError: the arrays of a sparse operator, which are copied, would not fit.
        """
        settings = keep.Settings(self.method, self.tolerance, self.seed, self.balanced_by)
        keep.write(path, self._core, self.scene, settings)

    def __matmul__(self, x: Any) -> FloatArray:
        """F @ x for x of shape (n,) or (n, k): the irradiance that the radiosities x cause."""
        columns, shape = vectors("x", x, self.shape[0])
        # Of no columns there is no product.
        return self._core.apply(columns).reshape(shape) if columns.size else np.zeros(shape)

    def row(self, i: int) -> FloatArray:
        """(n,) row i: where the light of patch i goes. Raises ``IndexError`` when there is no such patch."""
        return self._core.row(row_number(i, self.shape[0]))

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

        def rmatmat(x: Any) -> FloatArray:
            columns = np.ascontiguousarray(x, np.float64).reshape(len(x), -1)
            return self._core.apply(columns, True).reshape(np.shape(x))

        return scipy.sparse.linalg.LinearOperator(
            shape=self.shape,
            dtype=np.float64,
            matvec=lambda x: self @ x.reshape(-1),
            rmatvec=rmatmat,
            matmat=lambda x: self @ x,
            rmatmat=rmatmat,
        )
