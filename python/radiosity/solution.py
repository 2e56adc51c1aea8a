"""What a solver hands back: the numbers per patch, how far they can be trusted, and what was spent on them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .arrays import FloatArray
from .lights import Light
from .progress import Progress
from .report import counted
from .scene import Scene

if TYPE_CHECKING:
    from .system import Operator


@dataclass(frozen=True)
class Step:
    """One entry of a solver's history."""

    residual: float
    """Relative residual ||E + rho F B - B|| / ||E||, the largest over the bands (area-weighted norms)."""
    unshot: FloatArray
    """(b,) power that has arrived but has not been sent on, W (per m^2 of patch where areas are unknown)."""


@dataclass(frozen=True)
class EnergyAudit:
    """Where the power went, W per band: emitted = absorbed + left + unshot.

    To rounding for form factors, and for rays in a closed scene. In an open scene rays estimate what leaves, from the
    mean radiosity of every patch: the imbalance is the error of that, which coarse patches beside an opening make
    large, and says little of the radiosity.
    """

    emitted: FloatArray
    """(b,) sum of A E, and of A H0 where lights that are no patches bring H0."""
    absorbed: FloatArray
    """(b,) sum of A (1 - rho) H over the diffuse patches, and of what falls on mirrors the part 1 - mirror that they do
    not send back. Glass absorbs nothing."""
    left: FloatArray
    """(b,) what left the scene or met the back of a patch: sum of A B times the remainder."""
    unshot: FloatArray
    """(b,) what the iteration had not yet sent on: sum of A times the residual."""

    @property
    def imbalance(self) -> float:
        """abs(emitted - absorbed - left - unshot) / emitted, the largest over the bands; 0 without emission."""
        with np.errstate(over="ignore", invalid="ignore"):
            gap = np.abs(self.emitted - self.absorbed - self.left - self.unshot)
            return float(np.max(np.divide(gap, self.emitted, out=np.zeros_like(gap), where=self.emitted > 0)))


@dataclass(frozen=True)
class Report:
    """What was done and what it cost. Print it."""

    method: str
    """Name of the solver."""
    patches: int
    """Number of patches n."""
    bands: int
    """Number of bands b."""
    steps: int
    """Steps that the solver took."""
    residual: float
    """Relative residual reached."""
    audit: EnergyAudit | None
    """The energy audit; None for a matrix without areas."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Wall-clock seconds per stage."""
    bound: FloatArray | None = None
    """(b,) how far any patch can be from the exact solution with this very F at most, W/m^2: the largest residual over
    1 - max(rho times row sum) (Neumann's series). Infinite where a patch reflects all that it gathers; None from
    :func:`radiosity.solve` by rays, which has no stored F."""
    segments: int = 0
    """Segments cast for visibility."""
    rays: int = 0
    """Rays cast."""
    elements: int = 0
    """Patches that rays worked on: more than the scene has where those were too coarse. By ``"hierarchical"``: leaves
    of the tree of elements. 0 for other methods."""
    links: int = 0
    """Links between elements; 0 for other methods than ``"hierarchical"``."""
    stopped: int = 0
    """Links that are not good enough, between elements below a thousandth of the scene, which are not cut."""
    out_of_memory: bool = False
    """Whether refinement ended because the memory did."""
    corrected: bool = False
    """Whether rays followed light point by point for one bounce more, to lower the discretisation error."""
    sampling_error: float | None = None
    """Part of the error estimate that sampling leaves (for ``"dense"``: kernels and iteration too); None if unknown."""
    discretisation_error: float | None = None
    """Part of it that discretisation leaves; None if unknown."""
    row_error: float | None = None
    """Estimated largest error of a row of F, sum over j of abs(dF_ij); None for a matrix that the user brought."""

    def __str__(self) -> str:
        patches, bands = counted(self.patches, "patch", "patches"), counted(self.bands, "band", "bands")
        lines = [
            f"{patches}, {bands}, method {self.method}",
            f"steps      {self.steps}, relative residual {self.residual:.2e}",
        ]
        if self.bound is not None:
            worst = "  ".join(f"{value:.1e}" for value in self.bound)
            lines.append(f"bound      no patch is off by more than {worst} W/m^2 with this F")
        if self.row_error is not None:
            lines.append(f"F          row error about {self.row_error:.1e}, {self.segments} segments cast")
        if self.rays:
            lines.append(f"rays       {self.rays} cast, {self.segments} segments")
        if self.links:
            lines.append(f"links      {self.links} over {self.elements} elements, {self.segments} segments cast")
            if self.stopped:
                lines.append(
                    f"stopped    {self.stopped} links at the smallest elements, which are not cut (in the error)"
                )
            if self.out_of_memory:
                lines.append("stopped    the memory was used up")
        elif self.elements > self.patches:
            lines.append(f"refined    {self.elements} patches worked on")
        if self.corrected:
            lines.append("refined    one bounce more was followed point by point")
        if self.sampling_error is not None and self.discretisation_error is not None:
            lines.append(
                f"error      about {math.hypot(self.sampling_error, self.discretisation_error):.2%} of B - E: "
                f"{self.sampling_error:.2%} from sampling, {self.discretisation_error:.2%} from discretisation"
            )
        if self.audit is not None:
            audit = self.audit
            lines += [
                f"emitted    {_watts(audit.emitted)}",
                f"absorbed   {_watts(audit.absorbed)}",
                f"left       {_watts(audit.left)}",
                f"unshot     {_watts(audit.unshot)}",
                f"imbalance  {audit.imbalance:.1e} of what was emitted",
            ]
        lines += [f"{stage:10s} {seconds:.3f} s" for stage, seconds in self.seconds.items()]
        return "\n".join(lines)


def _watts(power: FloatArray) -> str:
    return "  ".join(f"{value:.6g}" for value in power) + " W"


@dataclass(frozen=True, repr=False)
class System:
    """A radiosity equation: B = E + rho F B."""

    operator: Operator
    """F, for the core."""
    emission: FloatArray
    """(n, b) E, W/m^2."""
    reflectance: FloatArray
    """(n, b) rho."""


class Gradient(NamedTuple):
    """Derivatives of a scalar."""

    emission: FloatArray
    """(n, b) to every E, per W/m^2."""
    reflectance: FloatArray
    """(n, b) to every rho."""


@dataclass(frozen=True, repr=False)
class Solution:
    """A solved radiosity equation B = E + rho H, H = H0 + F B, with H0 straight from :attr:`lights`."""

    radiosity: FloatArray
    """(n, b) radiosity B, W/m^2."""
    irradiance: FloatArray
    """(n, b) irradiance H, W/m^2."""
    standard_error: FloatArray | None
    """(n, b) standard error of B from sampling; None for a matrix that the user brought."""
    error_estimate: float
    """Estimated error of the reflected radiosity B - E (area-weighted RMS, relative, the worst band). From
    :func:`radiosity.solve`: against the continuous solution; :attr:`report` tells sampling and discretisation apart.
    From :func:`radiosity.solve_system`, which sees no geometry: against the exact solution *on these patches*, that is
    iteration, kernels and sampled visibility, followed through all bounces. Infinite where the system has hardly any
    solution."""
    history: tuple[Step, ...]
    """One entry a step."""
    report: Report
    """What was done and what it cost."""
    scene: Scene | None
    """The scene with the emission and reflectance that were solved for; None for a matrix that the user brought."""
    system: System | None = None
    """The equation that was solved, where its form factors are at hand: by :func:`radiosity.solve_system` and
    ``method="dense"``. None by other methods, and from a file, a cache or another process."""
    elements: Solution | None = None
    """By ``"hierarchical"``: the same on the leaves of the tree of elements, as a mesh without T-junctions, whose
    ``.scene.parent`` names the patch of each face. None for other methods."""
    lights: tuple[Light, ...] = ()
    """The lights that are no patches, in the bands of the scene."""

    @property
    def as_shown(self) -> Solution:
        """What pictures show: :attr:`elements` where there are any, else the solution itself."""
        return self if self.elements is None else self.elements

    def update(
        self,
        emission: Any = None,
        reflectance: Any = None,
        tolerance: float = 1e-6,
        *,
        max_iterations: int | None = None,
        threads: int | None = None,
        progress: Progress = True,
    ) -> Solution:
        """The solution for other lamps or paints, by GMRES from this one, with the same form factors.

        Args:
            emission: E, W/m^2; scalar, (b,) or (n, b). None keeps it.
            reflectance: rho in [0, 1]; the same. None keeps it.
            tolerance: relative residual, as :func:`radiosity.solve_system` has it. ``.error_estimate`` of the result is
                of that function, too: against the exact solution on these patches.
            max_iterations: steps allowed.
            threads: None for all cores.
            progress: see :mod:`radiosity.progress`.

        Raises:
            ValueError: this solution has no form factors at hand (see :attr:`system`); else as
                :func:`radiosity.solve_system`.
        """
        from .relight import updated

        return updated(self, emission, reflectance, tolerance, max_iterations, threads, progress)

    def vjp(
        self, cotangent: Any, tolerance: float = 1e-10, *, threads: int | None = None, progress: Progress = True
    ) -> Gradient:
        """The derivatives of a scalar l(B) to every emission and reflectance, by one adjoint solve.

        With g = dl/dB:  dl/dE = lambda = (I - rho F)^-T g,  dl/drho = lambda H.  Exact for the discrete system, to the
        tolerances of this and of the solution.

        Args:
            cotangent: (n, b) g, the derivatives of the scalar to the radiosities, of any sign.
            tolerance: relative residual of the adjoint solve, in (0, 1).
            threads: None for all cores.
            progress: see :mod:`radiosity.progress`.

        Returns:
            Gradient: ``.emission`` and ``.reflectance``, (n, b) each.

        Raises:
            ValueError: this solution has no form factors at hand (see :attr:`system`), a wrong shape, a number that is
                not finite.
        """
        from .relight import gradient

        return gradient(self, cotangent, tolerance, threads, progress)

    def __getstate__(self) -> dict[str, Any]:
        # Form factors stay in the process that has them: they may be as large as its memory.
        return {**self.__dict__, "system": None}

    def __repr__(self) -> str:
        n, b = self.radiosity.shape
        size = f"{counted(n, 'patch', 'patches')}, {counted(b, 'band', 'bands')}"
        return f"Solution({size}, {self.report.method}, error about {self.error_estimate:.2g})"


@dataclass(frozen=True)
class Forecast:
    """What a solve would take. Print it."""

    seconds: float
    """Wall-clock seconds."""
    nbytes: int
    """Bytes."""

    def __str__(self) -> str:
        return f"about {self.seconds:.2g} s and {self.nbytes / 2**20:.3g} MiB"


class ConvergenceError(RuntimeError):
    """An iteration used up its steps before it reached its tolerance."""

    solution: Solution
    """What was reached, a usable, unfinished solution."""

    def __init__(self, message: str, solution: Solution) -> None:
        super().__init__(message)
        self.solution = solution

    def __reduce__(self) -> tuple[type[ConvergenceError], tuple[str, Solution]]:
        return type(self), (str(self), self.solution)

    @property
    def history(self) -> tuple[Step, ...]:
        """One entry a step."""
        return self.solution.history
