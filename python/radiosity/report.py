"""What to know about a scene before solving it: size, light, orientation, holes, doubtful patches, memory.

Patches are neighbours where they share an edge, both ends in exactly the same positions; which vertices a mesh stores
twice does not matter. An edge that two patches run through in opposite directions is consistent; in the same direction,
one of them shows its back where the other shows its front. In a surface that can be oriented, the patches whose
orientation disagrees with the larger area of their connected piece are taken for the flipped ones. The scene is closed
if every edge is run through as often in one direction as in the other.

Limits. A T-junction counts as a hole, because its edges do not match. Patches that overlap without having the same
three corners, or that pass through each other, are found only where one of them is glass. Nothing here is exact for
two pieces that touch at vertices only: they are judged apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from . import _core
from .arrays import IntArray
from .glass import glass_hints
from .neighbours import close_corners, coincident, examine_edges, position_index

if TYPE_CHECKING:
    from .scene import Scene

__all__ = ["Report", "counted", "listed", "report"]

# Rays are cast in 32 bits in a scene scaled to size 2: what is thinner than this, relative to the scene, they can miss.
_THINNEST = 1e-6

# A patch this many times longer than high is a needle: one value cannot describe its light, whatever its area.
_NEEDLE = 100.0

# Nearer than this, relative to the scene, rays take two surfaces for one.
_ONE_PLACE = 1e-9

_LISTED = 10


@dataclass(frozen=True, eq=False)
class Report:
    """Findings about a scene of n patches and b bands; printing it gives a table.

    Attributes:
        n_patches: number of patches.
        bands: number of bands.
        objects: number of different names, 0 if the patches have none.
        both_sides: whether the second half of the patches is the back of the first half; orientation, holes,
            duplicates and coincident pairs then refer to the first half.
        size: extent of the bounding box along x, y and z, m.
        total_area: of all patches, m^2.
        emitted_power: per band, W.
        reflectance_range: smallest and largest reflectance.
        longest_edge: m.
        worst_aspect_ratio: largest ratio of a patch's longest edge to the height above it; 1.15 at best.
        closed: whether the surface has no holes and one orientation.
        faces_outwards: whether the scene is closed and has only backs inside.
        boundary_edges: number of edges that belong to one patch only: the rims of holes, and T-junctions.
        nonmanifold_edges: number of edges that belong to more than two patches.
        inconsistent_edges: number of edges that two patches run through in the same direction.
        flipped_patches: the patches that face the other way than their neighbours.
        degenerate_patches: needles, and patches so thin that rays can miss them.
        duplicate_patches: the patches that repeat the corners and the orientation of an earlier one.
        coincident_pairs: (k, 2), pairs of patches with the same corners that face away from each other.
        dense_bytes: memory that the form factors of :func:`radiosity.form_factors` take at most, but for 16
            bytes a pair of which a part is hidden; less where most patches do not see each other.
        mirrors: number of patches that are mirrors.
        glass: number of patches that are glass.
        hints: what should be looked at, in words.

    """

    n_patches: int
    bands: int
    objects: int
    both_sides: bool
    size: tuple[float, float, float]
    total_area: float
    emitted_power: tuple[float, ...]
    reflectance_range: tuple[float, float]
    longest_edge: float
    worst_aspect_ratio: float
    closed: bool
    faces_outwards: bool
    boundary_edges: int
    nonmanifold_edges: int
    inconsistent_edges: int
    flipped_patches: IntArray
    degenerate_patches: IntArray
    duplicate_patches: IntArray
    coincident_pairs: IntArray
    dense_bytes: int
    mirrors: int
    glass: int
    hints: tuple[str, ...]

    def __str__(self) -> str:
        orientation = "consistent"
        if self.inconsistent_edges:
            orientation = f"{self.inconsistent_edges} edges disagree, {len(self.flipped_patches)} patches flipped"
        elif self.faces_outwards:
            orientation = "consistent, facing outwards"
        holes = f"{self.boundary_edges} edges of one patch only" if self.boundary_edges else "none"
        if self.nonmanifold_edges:
            holes += f"; {self.nonmanifold_edges} edges of more than two patches"
        low, high = self.reflectance_range
        rows = [
            ("size", " x ".join(f"{length:.4g}" for length in self.size) + " m"),
            ("area", f"{self.total_area:.4g} m^2"),
            ("emitted power", _numbers(self.emitted_power) + " W"),
            ("reflectance", f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"),
            ("longest edge", f"{self.longest_edge:.4g} m"),
            ("worst aspect ratio", f"{self.worst_aspect_ratio:.3g}"),
            ("orientation", orientation),
            ("holes", holes),
            ("closed", "yes" if self.closed else "no"),
            ("degenerate patches", _count(len(self.degenerate_patches))),
            ("duplicate patches", _count(len(self.duplicate_patches))),
            ("coincident pairs", _count(len(self.coincident_pairs))),
            ("dense form factors", f"at most {_bytes(self.dense_bytes)}"),
        ]
        if self.mirrors or self.glass:
            rows.insert(4, ("mirrors, glass", f"{self.mirrors:,} and {self.glass:,} patches"))
        title = f"Scene of {counted(self.n_patches, 'patch', 'patches')} in {counted(self.bands, 'band', 'bands')}"
        if self.objects:
            title += f", {counted(self.objects, 'object', 'objects')}"
        if self.both_sides:
            title += ", both sides of each triangle"
        width = max(len(name) for name, _ in rows)
        lines = [title, *(f"  {name:<{width}}  {text}" for name, text in rows)]
        if self.hints:
            lines += ["Look at", *(f"  - {hint}" for hint in self.hints)]
        return "\n".join(lines)


def report(scene: Scene) -> Report:
    """Examine a scene; a million patches take about ten seconds.

    Args:
        scene: n patches.

    Returns:
        The findings.

    """
    n = scene.n_patches
    vertices, faces, areas = scene.vertices, np.asarray(scene.faces, dtype=np.int64), scene.areas
    corners = vertices[faces]
    is_used = np.zeros(len(vertices), dtype=np.bool_)
    is_used[faces] = True
    used = vertices[is_used]
    size = used.max(axis=0) - used.min(axis=0)
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
    height = 2.0 * areas / longest
    degenerate = np.flatnonzero((height < _THINNEST * size.max()) | (longest > _NEEDLE * height))

    places = position_index(vertices)[faces]
    half = n // 2
    both_sides = n % 2 == 0 and bool(np.array_equal(places[half:], places[:half][:, [0, 2, 1]]))
    fronts = places[:half] if both_sides else places
    duplicates, pairs = coincident(fronts)
    if both_sides:  # what is turned round has the same two sides
        duplicates, pairs = np.union1d(duplicates, pairs[:, 1]), pairs[:0]
    kept = np.delete(np.arange(len(fronts)), duplicates)
    edges = examine_edges(fronts[kept], areas[kept])

    middle = used.mean(axis=0)
    a, b, c = np.moveaxis(corners[kept] - middle, 1, 0)
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0

    flipped = kept[edges.flipped]
    with np.errstate(over="ignore"):
        emitted = areas @ scene.emission
    found = Report(
        n_patches=n,
        bands=scene.bands,
        objects=0 if scene.names is None else len(set(scene.names)),
        both_sides=both_sides,
        size=(float(size[0]), float(size[1]), float(size[2])),
        total_area=float(areas.sum()),
        emitted_power=tuple(float(power) for power in emitted),
        reflectance_range=(float(scene.reflectance.min()), float(scene.reflectance.max())),
        longest_edge=float(longest.max()),
        worst_aspect_ratio=float((longest / height).max()),
        closed=edges.closed,
        faces_outwards=edges.closed and volume > 0.0 and not both_sides,
        boundary_edges=edges.boundary,
        nonmanifold_edges=edges.nonmanifold,
        inconsistent_edges=edges.inconsistent,
        flipped_patches=flipped,
        degenerate_patches=degenerate,
        duplicate_patches=duplicates,
        coincident_pairs=pairs,
        dense_bytes=_core.FormFactors.dense_forecast(scene.n_patches),
        mirrors=int(np.count_nonzero(scene.mirror)),
        glass=int(np.count_nonzero(scene.ior > 0.0)),
        hints=(),
    )
    return replace(found, hints=tuple(_hints(scene, found)))


def _hints(scene: Scene, found: Report) -> list[str]:
    def who(patches: IntArray) -> str:
        return listed(patches, scene.names)

    hints = []
    if len(found.flipped_patches):
        hints.append(f"facing the other way than their neighbours: {who(found.flipped_patches)}; reverse their corners")
    elif found.inconsistent_edges:
        hints.append("the surface has one side only, like a Moebius strip: no orientation is consistent")
    if found.faces_outwards:
        hints.append("the closed surface faces outwards: for a room, reverse the corners of all patches")
    if len(found.degenerate_patches):
        hints.append(f"needles, or thinner than rays resolve: {who(found.degenerate_patches)}")
    if len(found.duplicate_patches):
        hints.append(
            f"repeating earlier patches: {who(found.duplicate_patches)}; rays meet only the first, audits of "
            "power count both, and what would count the light of both refuses them"
        )
    close = close_corners(scene.faces, scene.vertices, _ONE_PLACE * max(found.size))
    if len(close):
        hints.append(
            f"corners that nearly, but not quite, are in one place: {who(close)}; rays do not see what lies less than "
            f"{_ONE_PLACE:g} of the scene before them, and light in gaps like that is lost"
        )
    perfect = np.flatnonzero((scene.reflectance == 1.0).any(axis=1))
    if len(perfect):
        hints.append(f"reflecting all light (reflectance 1), as no real surface does: {who(perfect)}")
    hints += glass_hints(scene, who)
    if not any(found.emitted_power):
        hints.append("no patch emits: the solution is zero everywhere")
    return hints


# ---------------------------------------------------------------------------------------------------------------- text


def counted(number: int, one: str, many: str) -> str:
    """Say how many there are: "1 band", "3 bands"."""
    return f"{number:,} {one if number == 1 else many}"


def listed(patches: IntArray, names: Sequence[str] | None) -> str:
    """Name patches, the first few, and their objects: "patches 3, 4, ... (144 in all; floor)"."""
    text = ", ".join(str(i) for i in patches[:_LISTED])
    remarks = []
    if len(patches) > _LISTED:
        text += ", ..."
        remarks.append(f"{len(patches):,} in all")
    if names is not None:
        objects = list(dict.fromkeys(names[i] for i in patches))
        remarks.append(", ".join(objects[:3]) + (", ..." if len(objects) > 3 else ""))
    word = "patch" if len(patches) == 1 else "patches"
    return f"{word} {text}" + (f" ({'; '.join(remarks)})" if remarks else "")


def _numbers(values: Sequence[float]) -> str:
    if len(values) > 6:
        return f"{min(values):.4g} to {max(values):.4g}"
    return ", ".join(f"{value:.4g}" for value in values)


def _count(number: int) -> str:
    return f"{number:,}" if number else "none"


def _bytes(number: float) -> str:
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if number < 1000.0:
            return f"{number:.3g} {unit}"
        number /= 1000.0
    return f"{number:.3g} PB"
