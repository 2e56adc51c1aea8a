from collections.abc import Callable
from typing import Any, Protocol, TypedDict, final

import numpy as np
import numpy.typing as npt

__all__ = [
    "Block",
    "FormFactors",
    "Lights",
    "Scene",
    "ambient",
    "assess",
    "corner_irradiance",
    "direct_irradiance",
    "forecast_scene",
    "form_factor",
    "gather",
    "importance",
    "instant",
    "pair_form_factors",
    "places",
    "render",
    "sky_coefficients",
    "solve",
    "solve_hierarchical",
    "solve_scene",
    "solve_states",
    "start_threads",
    "virtual_lights",
]

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]
_Bytes = npt.NDArray[np.uint8]
_Numbers = npt.NDArray[np.uint32]
_Places = npt.NDArray[np.uint64]
_Report = Callable[[int, int], object]
_Point = tuple[float, float, float]
_Viewpoint = tuple[_Point, _Point, _Point, float]

class _Solved(TypedDict):
    radiosity: _Floats
    irradiance: _Floats
    standard_error: _Floats | None
    residuals: _Floats
    unshot: _Floats
    residual: float
    error_estimate: float
    bound: _Floats
    audit: list[_Floats] | None
    failure: str | None

class _SolvedScene(TypedDict):
    radiosity: _Floats
    irradiance: _Floats
    standard_error: _Floats
    error_estimate: float
    sampling_error: float
    discretisation_error: float
    corrected: bool
    patches: int
    rays: int
    segments: int
    residuals: _Floats
    unshot: _Floats
    audit: list[_Floats] | None
    seconds: list[tuple[str, float]]

class _SolvedOnLinks(TypedDict):
    irradiance: _Floats
    error_estimate: float
    vertices: _Floats
    faces: _Ints
    parents: _Ints
    on_faces: _Floats
    leaves: int
    links: int
    segments: int
    stopped: int
    out_of_memory: bool
    residuals: _Floats
    unshot: _Floats
    audit: list[_Floats]

@final
class Scene:
    def __new__(
        cls,
        vertices: _Floats,
        faces: _Ints,
        reflectance: _Floats,
        emission: _Floats,
        mirror: _Floats,
        ior: _Floats,
        both_sides: bool,
    ) -> Scene: ...
    @property
    def vertices(self) -> _Floats: ...
    @property
    def faces(self) -> _Ints: ...
    @property
    def reflectance(self) -> _Floats: ...
    @property
    def emission(self) -> _Floats: ...
    @property
    def materials(self) -> tuple[_Floats, _Floats]: ...
    @property
    def areas(self) -> _Floats: ...
    @property
    def normals(self) -> _Floats: ...
    def subdivide(self, max_edge: float, memory: int) -> tuple[Scene, _Ints]: ...
    def intersect(
        self, origins: _Floats, directions: _Floats, threads: int | None
    ) -> tuple[_Ints, _Floats, _Floats]: ...
    def occluded(self, p: _Floats, q: _Floats, threads: int | None) -> npt.NDArray[np.bool_]: ...

class _Door(Protocol):
    def apply(self, x: _Floats, /) -> _Floats: ...
    def row(self, i: int, /) -> _Floats: ...
    def standard_error(self, x: _Floats, /) -> _Floats: ...
    def sampling_error(self, x: _Floats, draw: int, /) -> _Floats: ...

@final
class Block:
    @staticmethod
    def sampled(
        scene: Scene,
        method: str,
        tolerance: float,
        seed: int,
        first: int,
        last: int,
        memory: int,
        threads: int | None,
        progress: _Report | None,
    ) -> Block: ...
    @property
    def nbytes(self) -> int: ...
    @property
    def entries(self) -> int: ...
    @property
    def error_estimate(self) -> float: ...
    @property
    def rays(self) -> int: ...
    def row_sums(self, threads: int | None) -> _Floats: ...
    def row(self, k: int) -> _Floats: ...
    def apply(self, x: _Floats, threads: int | None) -> _Floats: ...
    def standard_error(self, x: _Floats, threads: int | None) -> _Floats: ...
    def sampling_error(self, x: _Floats, draw: int, before: int, threads: int | None) -> _Floats: ...

@final
class Lights:
    def __new__(
        cls,
        bands: int,
        suns: list[tuple[_Point, list[float]]],
        points: list[tuple[_Point, list[float], tuple[_Point, float, float] | None]],
        skies: list[tuple[str, int, int, _Point, _Point, _Floats]],
    ) -> Lights: ...

@final
class FormFactors:
    @staticmethod
    def dense(
        scene: Scene, tolerance: float, seed: int, memory: int, threads: int | None, progress: _Report | None
    ) -> FormFactors: ...
    @staticmethod
    def sampled(
        scene: Scene,
        method: str,
        tolerance: float,
        seed: int,
        memory: int,
        threads: int | None,
        progress: _Report | None,
    ) -> FormFactors: ...
    @staticmethod
    def hierarchical(
        scene: Scene, tolerance: float, seed: int, memory: int, threads: int | None, progress: _Report | None
    ) -> FormFactors: ...
    def links(self) -> tuple[_Ints, _Ints] | None: ...
    def balance(self, memory: int) -> tuple[FormFactors, float]: ...
    def exchange(self, start: int, stop: int) -> _Floats | None: ...
    def dense_parts(self) -> tuple[tuple[_Places, _Numbers] | None, _Numbers, _Floats, float] | None: ...
    @staticmethod
    def from_dense_parts(
        scene: Scene,
        pattern: tuple[_Places, _Numbers] | None,
        exchange: _Floats,
        pairs: _Numbers,
        standard_errors: _Floats,
        kernel_error: float,
        error_estimate: float,
        segments: int,
    ) -> FormFactors: ...
    def sampled_parts(self) -> tuple[_Places, _Numbers, _Floats, _Numbers | None, _Floats | None] | None: ...
    @staticmethod
    def from_sampled_parts(
        scene: Scene,
        start: _Places,
        index: _Numbers,
        value: _Floats,
        rays: _Numbers | None,
        errors: _Floats | None,
        error_estimate: float,
        segments: int,
    ) -> FormFactors: ...
    def links_parts(self) -> tuple[_Numbers, _Places, _Bytes, _Floats, _Floats, int] | None: ...
    @staticmethod
    def from_links_parts(
        scene: Scene,
        nodes: _Numbers,
        places: _Places,
        visibility: _Bytes,
        exchanges: _Floats,
        matrices: _Floats,
        tree_mark: int,
        error_estimate: float,
        segments: int,
    ) -> FormFactors: ...
    @staticmethod
    def from_array(array: _Floats) -> FormFactors: ...
    @staticmethod
    def from_csr(start: _Ints, index: _Ints, value: _Floats) -> FormFactors: ...
    @staticmethod
    def remote(
        areas: _Floats, row_sums: _Floats, nbytes: int, error_estimate: float, segments: int, door: _Door
    ) -> FormFactors: ...
    @staticmethod
    def dense_forecast(n: int) -> int: ...
    @property
    def n(self) -> int: ...
    @property
    def nbytes(self) -> int: ...
    @property
    def error_estimate(self) -> float: ...
    @property
    def segments(self) -> int: ...
    @property
    def areas(self) -> _Floats | None: ...
    @property
    def row_sums(self) -> _Floats: ...
    @property
    def remainder(self) -> _Floats: ...
    def reciprocity_error(self) -> float | None: ...
    def apply(self, x: _Floats, transposed: bool = False) -> _Floats: ...
    def row(self, i: int) -> _Floats: ...
    def toarray(self) -> _Floats: ...

def form_factor(polygon_a: _Floats, polygon_b: _Floats, tolerance: float) -> float: ...
def pair_form_factors(
    a: _Floats, b: _Floats, tolerance: float, threads: int | None, progress: _Report | None
) -> _Floats: ...
def solve(
    form_factors: FormFactors,
    emission: _Floats,
    reflectance: _Floats,
    method: str,
    tolerance: float,
    max_iterations: int | None,
    memory: int,
    on_iteration: Callable[[int, _Floats, _Floats], Any] | None,
    start: _Floats | None,
    threads: int | None,
    progress: _Report | None,
) -> _Solved: ...
def solve_states(
    form_factors: FormFactors,
    emission: _Floats,
    reflectance: _Floats,
    method: str,
    tolerance: float,
    max_iterations: int | None,
    memory: int,
    threads: int | None,
    progress: _Report | None,
) -> tuple[_Floats, _Floats, int, _Floats, float, str | None]: ...
def importance(
    form_factors: FormFactors,
    reflectance: _Floats,
    weights: _Floats,
    tolerance: float,
    threads: int | None,
    progress: _Report | None,
) -> _Floats: ...
def solve_scene(
    scene: Scene,
    lights: Lights,
    tolerance: float,
    linear: bool,
    refine: bool,
    seed: int,
    memory: int,
    threads: int | None,
    progress: _Report | None,
) -> _SolvedScene: ...
def direct_irradiance(
    scene: Scene,
    lights: Lights,
    tolerance: float,
    seed: int,
    memory: int,
    threads: int | None,
    progress: _Report | None,
) -> tuple[_Floats, _Floats, float]: ...
def sky_coefficients(
    scene: Scene,
    rows: int,
    columns: int,
    up: _Point,
    north: _Point,
    rays: int,
    seed: int,
    memory: int,
    threads: int | None,
    progress: _Report | None,
) -> _Floats: ...
def forecast_scene(
    scene: Scene,
    lights: Lights,
    tolerance: float,
    linear: bool,
    refine: bool,
    seed: int,
    memory: int,
    threads: int | None,
    progress: _Report | None,
) -> tuple[float, int]: ...
def assess(
    scene: Scene,
    lights: Lights,
    irradiance: _Floats,
    tolerance: float,
    seed: int,
    memory: int,
    threads: int | None,
    progress: _Report | None,
) -> tuple[float, int]: ...
def ambient(areas: _Floats, unshot: _Floats, reflectance: _Floats) -> _Floats: ...
def corner_irradiance(scene: Scene, irradiance: _Floats, threads: int | None) -> _Floats: ...
def gather(
    scene: Scene,
    lights: Lights,
    irradiance: _Floats,
    viewpoint: _Viewpoint,
    width: int,
    height: int,
    tolerance: float,
    seed: int,
    memory: int,
    on_image: Callable[[_Floats, float], object] | None,
    threads: int | None,
    progress: _Report | None,
) -> tuple[_Floats, float, int]: ...
def render(
    scene: Scene,
    light: _Floats,
    viewpoint: _Viewpoint,
    width: int,
    height: int,
    smooth: bool,
    memory: int,
    threads: int | None,
    progress: _Report | None,
) -> _Floats: ...
def solve_hierarchical(
    scene: Scene, tolerance: float, seed: int, memory: int, threads: int | None, progress: _Report | None
) -> _SolvedOnLinks: ...
def virtual_lights(
    scene: Scene, count: int, seed: int, memory: int, threads: int | None, progress: _Report | None
) -> tuple[_Floats, _Floats, _Ints, _Ints, _Ints, int, float, float]: ...
def instant(
    scene: Scene,
    positions: _Floats,
    flux: _Floats,
    patch: _Ints,
    bounce: _Ints,
    viewpoint: _Viewpoint,
    width: int,
    height: int,
    bound: float,
    compensate: bool,
    lit: bool,
    seed: int,
    memory: int,
    threads: int | None,
    progress: _Report | None,
) -> tuple[_Floats, float, _Floats]: ...
def places(
    scene: Scene,
    viewpoint: _Viewpoint,
    width: int,
    height: int,
    sample: int,
    seed: int,
    memory: int,
    threads: int | None,
) -> tuple[_Floats, _Ints]: ...
def start_threads() -> None: ...
