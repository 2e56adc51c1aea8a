"""The extremes, one a row, against everything that computes, one a column: `make extremes`.

    python tests/python/extremes.py [--short] [--rows WORD ...] [--columns NAME ...]

prints a Markdown table and ends with 1 if a cell is wrong. A cell is the error against a closed form, or against the
same scene where it is no extreme; or it is the clear error that is right for that input. Every cell has its time limit:
they run in a process of their own, which is started anew when one takes too long.

`--short` leaves out what takes more than about a second; so does `tests/python/test_extremes.py`.
"""

from __future__ import annotations

import argparse
import functools
import multiprocessing
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import gmres

import radiosity as rad

QUIET = {"progress": False}
SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
# What is asked of the columns, and what their cells must keep.
PAIR, FACTORS, SAMPLED, HEMICUBE, SOLVER, SOLVE, HIERARCHICAL, PICTURE = 1e-8, 1e-2, 2e-2, 5e-2, 1e-6, 0.03, 0.1, 0.01
# Sampled rows reach their tolerance in the mean; the worst of some hundred is up to three times as far off.
CHANCE = 3.0
LIMIT = 60.0
# Rows with more patches have no plain matrix here.
MANY = 2000


@dataclass(frozen=True)
class Row:
    """An extreme: a scene, and what is known of it."""

    scene: rad.Scene
    radiosity: np.ndarray
    """(n, b) the truth, patch by patch."""
    factors: np.ndarray | None = None
    """(n, n) form factors."""
    row_sums: np.ndarray | None = None
    """(n,) sums of the rows of F, where only these are known."""
    pair: tuple[np.ndarray, np.ndarray, float] | None = None
    """Two polygons and their form factor."""
    at_last: np.ndarray | None = None
    """(b,) radiosity at the middle of the last patch, where that is not the patch's."""
    refused: dict[str, str] = field(default_factory=dict)
    """Columns that may refuse this row, and what they say then."""


class Cell(NamedTuple):
    """What stands in a cell, whether it is right, and how long it took."""

    text: str
    right: bool
    seconds: float


def opposite(corners: np.ndarray, height: float) -> np.ndarray:
    """The same polygon at a height, its front down."""
    return corners[::-1] + np.array([0.0, 0.0, height])


# --- What is known ----------------------------------------------------------------------------------------------------


def lambert(x: np.ndarray, normal: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """(m,) the form factor from points x (m, 3) to a polygon all of which is before them (Lambert 1760)."""
    towards = polygon[None] - x[:, None]
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    after = np.roll(towards, -1, axis=1)
    across = np.cross(towards, after)
    length = np.linalg.norm(across, axis=2)
    # The angle over its sine: 1 where the edge is seen as a point.
    angle = np.arctan2(length, (towards * after).sum(axis=2))
    ratio = np.divide(angle, length, out=np.ones_like(angle), where=length > 0.0)
    return np.abs((ratio * (across @ normal)).sum(axis=1)) / (2.0 * np.pi)


def parallel_rectangles(a: float, b: float, distance: float) -> float:
    """F of two equal rectangles a x b opposite each other (Howell's catalogue, C-11)."""
    x, y = a / distance, b / distance
    if max(x, y) < 1e-3:
        # The closed form cancels; what follows x y / pi is smaller by x^2.
        return x * y / np.pi
    sx, sy = np.hypot(1.0, x), np.hypot(1.0, y)
    sums = x * sy * np.arctan(x / sy) + y * sx * np.arctan(y / sx) - x * np.arctan(x) - y * np.arctan(y)
    return 2.0 / (np.pi * x * y) * (0.5 * np.log1p(x * x * y * y / (1.0 + x * x + y * y)) + sums)


def evenly_bright(scene: rad.Scene) -> np.ndarray:
    """E / (1 - rho): where all that is seen is as bright, whatever the mesh."""
    return scene.emission / (1.0 - scene.reflectance)


def unoccluded(scene: rad.Scene) -> np.ndarray:
    """(n, n) F of a scene without occlusion, pair by pair: of the kernels that the first column judges."""
    n = scene.n_patches
    corners = scene.vertices[scene.faces]
    i, j = np.indices((n, n)).reshape(2, -1)
    return rad.pair_form_factors(corners[i], corners[j]).reshape(n, n)


def plates(a: np.ndarray, b: np.ndarray, form_factor: float) -> Row:
    """Polygon a emits 1 and is black, b reflects 0.5: B of b is 0.5 F_ba, half by half."""
    scene = rad.Scene(
        np.concatenate([a, b]),
        [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
        reflectance=[[0.0], [0.0], [0.5], [0.5]],
        emission=[[1.0], [1.0], [0.0], [0.0]],
    )
    factors = unoccluded(scene)
    truth = scene.emission + scene.reflectance * (factors @ scene.emission)
    at_last = 0.5 * lambert(scene.centroids[-1:], scene.normals[-1], a)
    return Row(scene, truth, factors, pair=(a, b, form_factor), at_last=at_last)


# --- The rows ---------------------------------------------------------------------------------------------------------


def box_faces() -> tuple[np.ndarray, np.ndarray]:
    """The unit cube, its fronts outside."""
    room = rad.scenes.furnace()
    return room.vertices, room.faces[:, ::-1]


def in_a_room(room: rad.Scene, *bodies: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a room and of what stands in it; the room's last, so that its last patch is looked at."""
    parts = [*bodies, (room.vertices, room.faces)]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = [faces + start for (_, faces), start in zip(parts, starts, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


class Benign(NamedTuple):
    """A room with a box and a glowing ceiling, in two bands, and what is true of it."""

    scene: rad.Scene
    radiosity: np.ndarray
    factors: np.ndarray
    at_last: np.ndarray


@functools.cache
def benign() -> Benign:
    vertices, faces = box_faces()
    low, high = np.array([0.3, 0.25, 0.2]), np.array([0.7, 0.65, 0.6])
    vertices, faces = in_a_room(rad.scenes.furnace(max_edge=0.6), (low + vertices * (high - low), faces))
    ceiling = np.isclose(vertices[faces][:, :, 2], 1.0).all(axis=1)
    scene = rad.Scene(vertices, faces, (0.5, 0.7), np.where(ceiling[:, None], (1.0, 2.0), 0.0))
    # Ten times better than what is asked of any column.
    solution = rad.solve(scene, 2e-3, **QUIET)
    factors = rad.form_factors(scene, 1e-3, **QUIET).toarray()
    gathered = rad.render(solution, look_at_last(scene), 8, 8, "gather", **QUIET)
    return Benign(scene, solution.radiosity, factors, np.pi * gathered.mean(axis=(0, 1)))


def placed(size: float, offset: float, **materials: Any) -> Row:
    """The benign scene elsewhere."""
    base = benign()
    scene = rad.Scene(
        size * base.scene.vertices + offset,
        base.scene.faces,
        materials.get("reflectance", base.scene.reflectance),
        materials.get("emission", base.scene.emission),
    )
    unit = materials.get("unit", np.ones(base.scene.bands))
    pair = (size * SQUARE + offset, size * opposite(SQUARE, 1.0) + offset, parallel_rectangles(1.0, 1.0, 1.0))
    return Row(scene, unit * base.radiosity, base.factors, pair=pair, at_last=unit * base.at_last)


def bands(unit: Any) -> Row:
    unit = np.broadcast_to(unit, 2)
    return placed(1.0, 0.0, emission=unit * benign().scene.emission, unit=unit)


def gap(distance: float) -> Row:
    return plates(SQUARE, opposite(SQUARE, distance), parallel_rectangles(1.0, 1.0, distance))


def wedge(degrees: float) -> Row:
    """Two unit squares that share an edge (Howell C-16): F by Lambert's form integrated over one of them."""
    angle = np.radians(degrees)
    up = np.array([np.cos(angle), 0.0, np.sin(angle)])
    other = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], up + np.array([0.0, 1.0, 0.0]), up])
    # Gauss points in pieces that halve towards every edge: near one the form factor changes over the distance from it.
    nodes, weights = np.polynomial.legendre.leggauss(16)
    ends = np.concatenate([[0.0], 0.5 ** np.arange(31.0, 0.0, -1.0)])
    low, high = ends[:-1, None], ends[1:, None]
    x = (low + (high - low) * 0.5 * (nodes + 1.0)).ravel()
    w = ((high - low) * 0.5 * weights).ravel()
    x, w = np.concatenate([x, 1.0 - x]), np.concatenate([w, w])
    points = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((len(x), len(x)))], axis=2).reshape(-1, 3)
    value = float(np.outer(w, w).ravel() @ lambert(points, np.array([0.0, 0.0, 1.0]), other))
    return plates(SQUARE, other, value)


def aspect(ratio: float) -> Row:
    thin = SQUARE * [1.0, 1.0 / ratio, 1.0]
    f = parallel_rectangles(1.0, 1.0 / ratio, 1.0 / ratio)
    return plates(thin, opposite(thin, 1.0 / ratio), f)


def seen_from_middle(small: np.ndarray) -> float:
    """F from a small square before SQUARE: that of its middle, but for the square of its size."""
    return float(lambert(small.mean(axis=0)[None], np.array([0.0, 0.0, -1.0]), SQUARE)[0])


def size_ratio(ratio: float) -> Row:
    small = ratio * (SQUARE[::-1] - [0.5, 0.5, 0.0]) + [0.5, 0.5, 0.5]
    return plates(SQUARE, small, seen_from_middle(small) * ratio**2)


def small_emitter(ratio: float) -> Row:
    small = ratio * (SQUARE[::-1] - [0.5, 0.5, 0.0]) + [0.5, 0.5, 1.0]
    return plates(small, SQUARE, seen_from_middle(small))


def distance(far: float) -> Row:
    f = parallel_rectangles(1.0, 1.0, far)
    return plates(SQUARE, opposite(SQUARE, far), f)


def furnace(rho: float, max_edge: float = 0.5) -> Row:
    scene = rad.scenes.furnace(rho, 1.0, max_edge=max_edge)
    # Where light is reflected a million times, only that many bounces will do; and a thousand lights have some hundred.
    refused = {name: "choose another method" for name in ("jacobi", "gauss_seidel", "southwell") if rho > 0.9999}
    refused |= {"instant": "of all light, which is left out"} if rho > 0.9 else {}
    factors = unoccluded(scene) if scene.n_patches <= MANY else None
    return Row(scene, evenly_bright(scene), factors, np.ones(scene.n_patches), refused=refused)


def many_patches() -> Row:
    """As many as have no matrix of all pairs."""
    row = furnace(0.5, max_edge=0.016)
    assert row.scene.n_patches > 90_000
    return replace(row, refused={"analytic": "needs", "direct": "needs", "links": "above the tolerance"})


def one_patch() -> Row:
    scene = rad.Scene(SQUARE[:3], [[0, 1, 2]], 0.5, 1.0)
    return Row(scene, scene.emission, np.zeros((1, 1)))


def two_patches() -> Row:
    """Two triangles opposite each other; F by Gauss points, smooth as it is at that distance."""
    a, b = SQUARE[:3], opposite(SQUARE[:3], 1.0)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    u, v = np.meshgrid(0.5 * (nodes + 1.0), 0.5 * (nodes + 1.0), indexing="ij")
    # (u, u v) fills the triangle (0, 0), (1, 0), (1, 1); du (u dv) over its area of 1/2.
    points = np.stack([u, u * v, np.zeros_like(u)], axis=2).reshape(-1, 3)
    w = (0.25 * np.outer(weights, weights) * 2.0 * u).ravel()
    f = float(w @ lambert(points, np.array([0.0, 0.0, 1.0]), b))
    scene = rad.Scene(np.concatenate([a, b]), [[0, 1, 2], [3, 4, 5]], [[0.0], [0.5]], [[1.0], [0.0]])
    at_last = 0.5 * lambert(scene.centroids[-1:], scene.normals[-1], a)
    truth = np.array([[1.0], [0.5 * f]])
    return Row(scene, truth, np.array([[0.0, f], [f, 0.0]]), pair=(a, b, f), at_last=at_last)


def glowing(vertices: np.ndarray, faces: np.ndarray, exposed: np.ndarray | None = None) -> Row:
    """A closed room in which everything glows alike; of every patch the part that is exposed sees nothing else."""
    scene = rad.Scene(vertices, faces, 0.5, 1.0)
    sums = np.ones(scene.n_patches) if exposed is None else exposed
    truth = scene.emission + sums[:, None] * (evenly_bright(scene) - scene.emission)
    return Row(scene, truth, None, sums)


ROOM = 0.6
SHEET = np.array([[0.2, 0.2, 0.5], [0.8, 0.2, 0.5], [0.8, 0.8, 0.5], [0.2, 0.8, 0.5]])


def duplicates() -> Row:
    """Six patches twice; rays meet only one of two such patches, and what has no rays says so."""
    room = rad.scenes.furnace(max_edge=ROOM)
    row = glowing(room.vertices, np.concatenate([room.faces[:6], room.faces]))
    methods = ("analytic", "links", *SOLVERS, "hierarchical", "instant")
    return replace(row, refused=dict.fromkeys(methods, "patch 6 repeats patch 0"))


def back_to_back(second: Sequence[Sequence[int]]) -> Row:
    """A sheet of two squares without thickness."""
    sheet = (SHEET, np.array([[0, 1, 2], [0, 2, 3], *second]))
    return glowing(*in_a_room(rad.scenes.furnace(max_edge=ROOM), sheet))


def crossing_boxes() -> Row:
    """A bar through a cube: what of either is inside the other sees only backs, and by symmetry so do both halves."""
    vertices, faces = box_faces()
    low, high = np.array([[0.3, 0.3, 0.3], [0.1, 0.45, 0.45]]), np.array([[0.7, 0.7, 0.7], [0.9, 0.55, 0.55]])
    bodies = [(a + vertices * (b - a), faces) for a, b in zip(low, high, strict=True)]
    room = rad.scenes.furnace(max_edge=ROOM)
    corners, all_faces = in_a_room(room, *bodies)
    exposed = np.ones(len(all_faces))
    across = np.ptp(vertices[faces], axis=1)
    ends = across[:, 0] == 0.0
    exposed[: len(faces)][ends] = 1.0 - 0.1**2 / 0.4**2
    exposed[len(faces) : 2 * len(faces)][~ends] = 0.5
    # A patch half of which is inside another body needs more cells than a hemicube may have.
    return replace(glowing(corners, all_faces, exposed), refused={"hemicube": "above the tolerance"})


def t_junctions() -> Row:
    """One wall in two triangles beside others in many."""
    fine, coarse = rad.scenes.furnace(max_edge=ROOM), rad.scenes.furnace()
    parts = []
    for scene, is_floor in ((coarse, True), (fine, False)):
        on_floor = (scene.vertices[scene.faces][:, :, 2] == 0.0).all(axis=1)
        parts.append((scene.vertices, scene.faces[on_floor == is_floor]))
    offset = len(parts[0][0])
    return glowing(np.concatenate([p[0] for p in parts]), np.concatenate([parts[0][1], parts[1][1] + offset]))


def city(count: int = 4) -> Row:
    """Blocks without floors in squares of ground under a sky, none of whose triangles is joined to another.

    The cracks are 1e-6 of a block wide: the light that goes through them is much less than anybody asks for. Of a
    square, the part under its block is dark, and by symmetry as much of both its triangles.
    """
    rng = np.random.default_rng(0)
    vertices, faces = box_faces()
    corners = vertices[faces[(vertices[faces][:, :, 2] > 0.0).any(axis=1)]]
    blocks, ground, exposed = [], [], []
    for x, y in np.ndindex(count, count):
        size = np.array([*rng.uniform(0.3, 0.7, 2), rng.uniform(0.3, 2.0)]) / count
        middle = (np.array([x, y]) + 0.5) / count
        block = corners * size + [*(middle - 0.5 * size[:2]), 0.0]
        blocks.append(block + 1e-6 / count * rng.uniform(-1.0, 1.0, block.shape))
        square = [*(middle - 0.5 / count), 0.0] + SQUARE / count
        ground.append(square[[[0, 1, 2], [0, 2, 3]]])
        exposed += 2 * [1.0 - size[0] * size[1] * count**2]
    room = rad.scenes.furnace()
    sky = room.vertices[room.faces[(room.vertices[room.faces][:, :, 2] > 0.0).any(axis=1)]]
    triangles = np.concatenate([*blocks, *ground, sky])
    sums = np.concatenate([np.ones(sum(map(len, blocks))), exposed, np.ones(len(sky))])
    row = glowing(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), sums)
    # Patches of the size of streets, partly hidden from each other, need more segments than a pair may have.
    return replace(row, refused=dict.fromkeys(("analytic", "links", "hemicube"), "above the tolerance"))


def flipped_wall() -> Row:
    """A room with a wall turned away: as dark as one without it, and the wall sees nothing."""
    room = rad.scenes.furnace(0.5, 1.0, max_edge=ROOM)
    is_wall = (room.vertices[room.faces][:, :, 0] == 0.0).all(axis=1)
    faces = np.where(is_wall[:, None], room.faces[:, ::-1], room.faces)
    scene = rad.Scene(room.vertices, faces, 0.5, 1.0)
    open_room = rad.Scene(room.vertices, room.faces[~is_wall], 0.5, 1.0)
    solution = rad.solve(open_room, 2e-3, **QUIET)
    truth = scene.emission.copy()
    truth[~is_wall] = solution.radiosity
    factors = np.zeros((scene.n_patches, scene.n_patches))
    factors[np.ix_(~is_wall, ~is_wall)] = unoccluded(open_room)
    gathered = rad.render(solution, look_at_last(open_room), 8, 8, "gather", **QUIET)
    return Row(scene, truth, factors, at_last=np.pi * gathered.mean(axis=(0, 1)))


ROWS: dict[str, Callable[[], Row]] = {
    **{f"scale {scale:g}": functools.partial(placed, scale, 0.0) for scale in (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9)},
    **{f"offset {offset:g} sizes": functools.partial(placed, 1.0, offset) for offset in (1e3, 1e6)},
    **{f"gap {d:g}": functools.partial(gap, d) for d in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)},
    **{f"angle {degrees:g} degrees": functools.partial(wedge, degrees) for degrees in (170.0, 90.0, 10.0, 1.0, 0.1)},
    **{f"aspect {ratio:g}": functools.partial(aspect, ratio) for ratio in (1e2, 1e4, 1e6)},
    "size ratio 1e-6": functools.partial(size_ratio, 1e-6),
    "distance 1e6": functools.partial(distance, 1e6),
    **{f"reflectance {rho:g}": functools.partial(furnace, rho) for rho in (0.0, 0.5, 0.99, 0.999, 0.999999)},
    "emitter area 1e-8": functools.partial(small_emitter, 1e-4),
    **{f"emission {emission:g}": functools.partial(bands, emission) for emission in (1e-30, 1e30)},
    "bands 1e12 apart": functools.partial(bands, (1.0, 1e12)),
    "1 patch": one_patch,
    "2 patches": two_patches,
    "100k patches": many_patches,
    "duplicates": duplicates,
    "back to back": functools.partial(back_to_back, [[0, 2, 1], [0, 3, 2]]),
    "back to back, cut otherwise": functools.partial(back_to_back, [[0, 3, 1], [1, 3, 2]]),
    "boxes through each other": crossing_boxes,
    "T-junctions": t_junctions,
    "city with cracks": city,
    "wall turned away": flipped_wall,
}


# --- The columns ------------------------------------------------------------------------------------------------------


def relative(found: np.ndarray, truth: np.ndarray, areas: np.ndarray) -> float:
    """The error of all patches together, sqrt(sum A dx^2 / sum A x^2), of the worst band; of (n, b) each."""
    worst = 0.0
    for x, t in zip(found.T, truth.T, strict=True):
        unit = np.abs(t).max() or 1.0
        size = np.sqrt(areas @ (t / unit) ** 2)
        worst = max(worst, float(np.sqrt(areas @ ((x - t) / unit) ** 2) / (size or 1.0)))
    return worst


def pair_form_factors(row: Row) -> float | None:
    """Relative error of the form factor of two polygons, whole and in triangles."""
    if row.pair is None:
        return None
    a, b, truth = row.pair
    first, second = (np.stack([corners[[0, k, k + 1]] for k in range(1, len(corners) - 1)]) for corners in (a, b))
    own = np.linalg.norm(np.cross(first[:, 1] - first[:, 0], first[:, 2] - first[:, 0]), axis=1)
    k = len(first)
    pairs = rad.pair_form_factors(np.repeat(first, k, axis=0), np.tile(second, (k, 1, 1))).reshape(k, k)
    whole, parts = rad.form_factor(a, b), float(own @ pairs.sum(axis=1)) / float(own.sum())
    return max(abs(whole / truth - 1.0), abs(parts / truth - 1.0))


def form_factors(method: str, tolerance: float) -> Callable[[Row], float]:
    """The largest sum_j abs(dF_ij), or what of it the sums of rows show."""

    def column(row: Row) -> float:
        F = rad.form_factors(row.scene, tolerance, method, **QUIET)
        if row.factors is not None:
            return float(np.abs(F.toarray() - row.factors).sum(axis=1).max())
        assert row.row_sums is not None
        return float(np.abs(F.row_sums - row.row_sums).max())

    return column


@functools.lru_cache(maxsize=1)
def system(row_name: str) -> tuple[rad.FormFactors | csr_array, np.ndarray]:
    """Some F of a row, and the B that belongs to it by other libraries."""
    scene = build(row_name).scene
    n = scene.n_patches
    if n > MANY:
        # Whose factors these are does not matter here: 16 at random a row, that sum to less than 1.
        rng = np.random.default_rng(0)
        some = csr_array((rng.random(16 * n) / 16, rng.integers(0, n, 16 * n), np.arange(0, 16 * n + 1, 16)), (n, n))
        one, bands = diags_array(np.ones(n)), zip(scene.reflectance.T, scene.emission.T, strict=True)
        found = [gmres(one - diags_array(rho) @ some, e, rtol=1e-10)[0] for rho, e in bands]
        return some, np.stack(found, axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        F = rad.form_factors(scene, FACTORS, "analytic", **QUIET)
    matrix, bands = F.toarray(), zip(scene.reflectance.T, scene.emission.T, strict=True)
    return F, np.stack([np.linalg.solve(np.eye(n) - rho[:, None] * matrix, e) for rho, e in bands], axis=1)


def solver(method: str) -> Callable[[Row, str], float]:
    def column(row: Row, name: str) -> float:
        F, exact = system(name)
        # ||dB|| is within the residual, which is relative to ||E||, over 1 - rho.
        scene = row.scene
        sizes = [np.sqrt(scene.areas @ x**2) for x in (exact, scene.emission)]
        tolerance = SOLVER * min(1.0, float((1.0 - scene.reflectance.max()) * (sizes[0] / sizes[1]).min()))
        found = rad.solve_system(F, row.scene.emission, row.scene.reflectance, method, tolerance, **QUIET)
        return relative(found.radiosity, exact, row.scene.areas)

    return column


def solve(method: str, tolerance: float) -> Callable[[Row], float]:
    """The error that the tolerance is about: of B - E, or of B where nothing is reflected."""

    def column(row: Row) -> float:
        solution = rad.solve(row.scene, tolerance, method, **QUIET)
        base = row.scene.emission if (row.radiosity != row.scene.emission).any() else 0.0
        return relative(solution.radiosity - base, row.radiosity - base, row.scene.areas)

    return column


def look_at_last(scene: rad.Scene) -> rad.Camera:
    """A look at the middle of the last patch, from half way to what is before it."""
    centre, normal = scene.centroids[-1], scene.normals[-1]
    free = float(scene.intersect(centre[None], normal[None]).distance[0])
    origin = centre + 0.5 * min(free, np.sqrt(scene.areas[-1])) * normal
    return rad.Camera(tuple(origin), tuple(centre), tuple(np.eye(3)[np.argmin(np.abs(normal))]), fov=5.0)


def render(row: Row) -> float:
    """The radiance of every pixel is B / pi of the patch."""
    solution = rad.solve(row.scene, SOLVE, **QUIET)
    image = rad.render(solution, look_at_last(row.scene), 8, 8, "flat", **QUIET)
    truth = solution.radiosity[-1] / np.pi
    return relative(image.reshape(-1, len(truth)), np.tile(truth, (64, 1)), np.ones(64))


def instant(row: Row) -> float:
    """What the mean over many sets of lights is off, less three of its standard errors.

    A single set makes spots, of up to a quarter of the lamp's emission each, wherever its lights stand nearer to what
    is seen than to each other; the mean of all sets is right.
    """
    camera = look_at_last(row.scene)
    sets = [rad.instant(row.scene, camera, 8, 8, 1024, seed=seed, **QUIET).mean(axis=(0, 1)) for seed in range(64)]
    truth = (row.radiosity[-1] if row.at_last is None else row.at_last) / np.pi
    known = truth > 0.0
    found, chance = np.mean(sets, axis=0), np.std(sets, axis=0) / np.sqrt(len(sets))
    return float((np.maximum(np.abs(found - truth) - 3.0 * chance, 0.0)[known] / truth[known]).max())


SOLVERS = ("direct", "jacobi", "gauss_seidel", "southwell", "overshooting", "gmres")
COLUMNS: dict[str, tuple[Callable[..., float | None], float]] = {
    "pair_form_factors": (pair_form_factors, PAIR),
    "analytic": (form_factors("analytic", FACTORS), FACTORS),
    "monte_carlo": (form_factors("monte_carlo", SAMPLED), CHANCE * SAMPLED),
    "hemicube": (form_factors("hemicube", HEMICUBE), HEMICUBE),
    "links": (form_factors("hierarchical", FACTORS), FACTORS),
    **{name: (solver(name), SOLVER) for name in SOLVERS},
    "solve": (solve("rays", SOLVE), SOLVE),
    "hierarchical": (solve("hierarchical", HIERARCHICAL), HIERARCHICAL),
    "render": (render, 1e-9),
    "instant": (instant, PICTURE),
}
# What takes more than about a second.
SLOW_COLUMNS = ("monte_carlo", "hemicube", "hierarchical")
SLOW_ROWS = ("100k patches",)
SLOW_CELLS = {"reflectance 0.999999": ("jacobi", "gauss_seidel", "southwell")}


@functools.lru_cache(maxsize=1)
def build(row_name: str) -> Row:
    return ROWS[row_name]()


def cell(row_name: str, column_name: str) -> Cell:
    """What stands in a cell."""
    row = build(row_name)
    column, asked = COLUMNS[column_name]
    start = perf_counter()
    try:
        with warnings.catch_warnings():
            # A tolerance that is not met is wrong here, said or not.
            warnings.simplefilter("error")
            error = column(row, row_name) if column_name in SOLVERS else column(row)
    except (ValueError, TypeError, MemoryError, RuntimeError, UserWarning) as failure:
        seconds = perf_counter() - start
        text = f"{type(failure).__name__}: {str(failure).splitlines()[0]}"
        wanted = row.refused.get(column_name)
        if wanted is not None and wanted in text:
            return Cell(f'{type(failure).__name__} "{wanted}"', True, seconds)
        return Cell(text, False, seconds)
    seconds = perf_counter() - start
    if error is None:
        return Cell("", True, seconds)
    return Cell(f"{error:.1e}", error <= asked, seconds)


# --- The table --------------------------------------------------------------------------------------------------------


def serve(pipe: Connection) -> None:
    """Answers with cells for names, in a process of its own."""
    while True:
        pipe.send(cell(*pipe.recv()))


class Worker:
    """A process for cells, started anew after one that takes too long or brings it down."""

    def __init__(self) -> None:
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()

    def close(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()

    def cell(self, row_name: str, column_name: str) -> Cell:
        self.pipe.send((row_name, column_name))
        try:
            if self.pipe.poll(LIMIT):
                return self.pipe.recv()
            text = f"> {LIMIT:g} s"
        except EOFError:
            text = "the process ended"
        self.close()
        self._start()
        return Cell(text, False, LIMIT)


def chosen(row: str, short: bool) -> list[str]:
    """The columns to be asked of a row."""
    if not short:
        return list(COLUMNS)
    slow = {*SLOW_COLUMNS, *SLOW_CELLS.get(row, ())}
    return [] if row in SLOW_ROWS else [column for column in COLUMNS if column not in slow]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="without what takes more than about a second")
    parser.add_argument("--rows", nargs="+", default=[""], metavar="WORD", help="only rows with one of these words")
    parser.add_argument("--columns", nargs="+", choices=COLUMNS, metavar="NAME", help="only these columns")
    parser.add_argument("--seconds", action="store_true", help="with the time that each cell takes")
    options = parser.parse_args()
    wanted = {row: chosen(row, options.short) for row in ROWS if any(word in row for word in options.rows)}
    columns = [name for name in options.columns or COLUMNS if any(name in names for names in wanted.values())]
    print("| | " + " | ".join(columns) + " |")
    print("|---|" + "---|" * len(columns))
    print("| to keep | " + " | ".join(f"{COLUMNS[name][1]:g}" for name in columns) + " |", flush=True)
    wrong = 0
    worker = Worker()
    for row, names in wanted.items():
        texts = []
        for column in columns:
            found = worker.cell(row, column) if column in names else Cell("", True, 0.0)
            wrong += not found.right
            text = found.text if found.right else f"**{found.text}**"
            texts.append(f"{text} ({found.seconds:.1f} s)" if options.seconds else text)
        if names:
            print(f"| {row} | " + " | ".join(texts) + " |", flush=True)
    worker.close()
    print(f"\n{wrong} cells are wrong", file=sys.stderr)
    return wrong > 0


if __name__ == "__main__":
    sys.exit(main())
