"""What is wrong with the glass of a scene, where light could not be followed through it as it should.

Glass that hangs together by edges is one body. It is closed, has its front outside (inside if it is a hollow in other
glass) and one index. Nothing diffuse is in it, and a gap is between it and everything else.

    depth(x) = hits from behind - hits from the front, along a ray from x        how many bodies x is in

Whatever touches a body comes to light when its skin is moved outwards by a hair: then it passes through the skin (an
edge of one meets a patch of the other), or lies just below it. A hair is ten times the distance below which a ray
does not hit the surface that it starts on.

Limits. The index of a body within another one, which is relative to that, is taken as it is. What lies in glass that is
open or inside out is not told before that is mended.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IntArray
from .neighbours import connected, examine_edges, position_index

if TYPE_CHECKING:
    from .scene import Scene

__all__ = ["glass_hints"]

_HAIR = 1e-8

# To all sides of any plane, and along no axis or diagonal, in which edges would lie.
_DIRECTIONS = np.array([[0.61, 0.53, 0.59], [0.57, -0.67, -0.49], [-0.63, 0.51, -0.58], [-0.55, -0.47, 0.69]])


def glass_hints(scene: Scene, who: Callable[[IntArray], str]) -> list[str]:
    """Say what is wrong with the glass of a scene and how to mend it; `who` names patches. Without glass it is free."""
    glass = np.flatnonzero(scene.ior > 0.0)
    if not len(glass):
        return []
    corners = scene.vertices[scene.faces]
    skin = corners[glass]
    places = position_index(skin.reshape(-1, 3)).reshape(-1, 3)
    edges = examine_edges(places, scene.areas[glass])
    # Bodies that touch along an edge have it together: whole they are closed, piece by piece they are apart.
    whole = connected(len(glass), *edges.pairs.T)
    piece = connected(len(glass), *edges.pairs[edges.alone].T)

    open_ones: list[IntArray] = []
    outward: list[IntArray] = []
    inward: list[IntArray] = []
    for patches in _groups(whole):
        closed = examine_edges(places[patches], scene.areas[glass[patches]]).closed
        (open_ones if not closed else outward if _volume(skin[patches]) > 0.0 else inward).append(patches)
    hollows: list[IntArray] = []
    if inward and outward:
        firsts = np.array([patches[0] for patches in inward])
        in_glass = _depth(_surface(skin[_all(outward)]), skin[firsts, 0]) > 0
        # In glass, and not in the air of another hollow in it.
        boxes = np.array([[skin[patches].min(axis=(0, 1)), skin[patches].max(axis=(0, 1))] for patches in inward])
        for k, first in enumerate(firsts):
            at = skin[first, 0]
            holders = ((boxes[:, 0] < at) & (at < boxes[:, 1])).all(axis=1)
            holders[k] = False
            if in_glass[k] and holders.any():
                others = _all([*outward, *(inward[m] for m in np.flatnonzero(holders))])
                in_glass[k] = _depth(_surface(skin[others]), at[None])[0] > 0
        hollows = [patches for patches, within in zip(inward, in_glass, strict=True) if within]
        inward = [patches for patches, within in zip(inward, in_glass, strict=True) if not within]

    hints = []

    def tell(patches: IntArray, what: str, remedy: str) -> None:
        if len(patches):
            hints.append(f"{what}: {who(np.sort(patches))}; {remedy}")

    tell(glass[_all(open_ones)], "glass that is no closed body", "light in it goes astray: close its surface")
    tell(glass[_all(inward)], "glass turned inside out", "reverse the corners of its patches: the front is outside")
    mixed = [patches for patches in _groups(piece) if np.ptp(scene.ior[glass[patches]]) > 0.0]
    tell(glass[_all(mixed)], "glass of several indices in one body", "give it one, or make two bodies with a gap")

    hair = _HAIR * float(np.ptp(corners, axis=(0, 1)).max())
    low, high = skin.min(axis=(0, 1)) - 2.0 * hair, skin.max(axis=(0, 1)) + 2.0 * hair
    around = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    near = np.flatnonzero(around & ~(scene.ior > 0.0))
    turned_right = np.sort(_all([*open_ones, *outward, *hollows]))
    moved = _moved_out(skin[turned_right], piece[turned_right], places[turned_right], hair)
    touched, touching = _contacts(moved, piece[turned_right], corners[near], hair)
    at = f" at {who(near[touching])}" if touching.any() else ""
    tell(
        glass[turned_right[touched]],
        "glass that touches or passes through something",
        f"light goes astray there{at}: leave a gap of {10.0 * hair:.1g} m or more",
    )
    sound = _all([*outward, *hollows])
    sound = sound[scene.ior[glass[sound]] != 1.0]  # in glass that bends nothing light is as strong as outside
    dull = near[~touching & (scene.mirror[near] == 0.0)]
    if len(sound) and len(dull):
        tell(
            dull[_depth(_surface(skin[sound]), scene.centroids[dull]) > 0],
            "diffuse patches inside glass",
            "light there is ior^2 times as strong, which is not computed: take them out",
        )
    return hints


def _groups(labels: IntArray) -> list[IntArray]:
    """Return the numbers of those with one label, for each label."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def _all(groups: list[IntArray]) -> IntArray:
    return np.concatenate([*groups, np.empty(0, np.int64)])


def _volume(skin: FloatArray) -> float:
    """Return the signed volume of a closed body, (n, 3, 3) corners."""
    a, b, c = np.moveaxis(skin - skin.mean(axis=(0, 1)), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def _surface(corners: FloatArray) -> Scene:
    """Return a scene to cast rays into, of (n, 3, 3) corners."""
    from .scene import Scene

    return Scene(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), reflectance=0.0)


def _depth(skin: Scene, points: FloatArray) -> IntArray:
    """Return in how many bodies (m, 3) points are: the least that rays in several directions find."""
    least = np.full(len(points), np.iinfo(np.int64).max)
    for direction in _DIRECTIONS:
        depth = np.zeros(len(points), np.int64)
        under_way, origins = np.arange(len(points)), points
        while len(under_way):
            hits = skin.intersect(origins, np.broadcast_to(direction, origins.shape))
            met = hits.patch >= 0
            under_way, patch = under_way[met], hits.patch[met]
            depth[under_way] += np.where(skin.normals[patch] @ direction > 0.0, 1, -1)
            origins = origins[met] + hits.distance[met, None] * direction
        least = np.minimum(least, depth)
    return least


def _moved_out(skin: FloatArray, piece: IntArray, places: IntArray, hair: float) -> FloatArray:
    """Move every corner by a hair along the mean normal of the patches around it, weighted by their angles there."""
    import trimesh

    _, corner = np.unique(np.column_stack([np.repeat(piece, 3), places.reshape(-1)]), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    sums = np.zeros((corner.max(initial=-1) + 1, 3))
    np.add.at(sums, corner, trimesh.triangles.angles(skin)[:, :, None] * _normals(skin)[:, None])
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    moved: FloatArray = skin + hair * np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 0.0)[corner]
    return moved


def _normals(corners: FloatArray) -> FloatArray:
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit: FloatArray = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return unit


def _contacts(
    skin: FloatArray, piece: IntArray, others: FloatArray, hair: float
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Tell which patches of glass, moved out, meet another piece of it or one of the others; and which of those do."""
    touched, touching = np.zeros(len(skin), np.bool_), np.zeros(len(others), np.bool_)
    if len(skin):
        # What was on the skin is now below it, by as much as both were moved.
        owner = np.concatenate([piece, np.full(len(others), -1)])
        patch, met = _met(_surface(np.concatenate([skin, others])), skin, [-3.0 * hair])
        foreign = owner[met] != piece[patch]
        struck = np.concatenate([patch[foreign], met[foreign]])
        touched[struck[struck < len(skin)]] = True
        touching[struck[struck >= len(skin)] - len(skin)] = True
    if len(skin) and len(others):
        patch, met = _met(_surface(skin), others, [-2.0 * hair, 2.0 * hair])
        touching[patch], touched[met] = True, True
    return touched, touching


def _met(surface: Scene, corners: FloatArray, heights: list[float]) -> tuple[IntArray, IntArray]:
    """Return which patches meet which of the surface, along their edges or at these heights above their middles."""
    middles = corners.mean(axis=1)
    # Half of an edge from each end: from there it does not meet the neighbours that share the end.
    edges = [(corners[:, a], 0.5 * (corners[:, b] - corners[:, a])) for a in range(3) for b in range(3) if a != b]
    origins, ways = zip(*edges, *[(middles, height * _normals(corners)) for height in heights], strict=True)
    hits = surface.intersect(np.concatenate(origins), np.concatenate(ways))
    close = (hits.patch >= 0) & (hits.distance <= 1.0)
    return np.tile(np.arange(len(corners)), len(ways))[close], hits.patch[close]
