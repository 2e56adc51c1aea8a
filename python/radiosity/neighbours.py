"""Which patches are neighbours: those that share an edge, both ends in exactly the same positions.

Which vertices a mesh stores twice does not matter: corners are numbered by position.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IntArray


def position_index(vertices: FloatArray) -> IntArray:
    """Return for each of the (V, 3) vertices a number that is the same exactly for equal positions."""
    places = vertices + 0.0  # -0.0 and 0.0 are one position
    order = np.lexsort(places.T)
    ordered = places[order]
    new = np.ones(len(places), dtype=np.int64)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    index = np.empty(len(places), dtype=np.int64)
    index[order] = np.cumsum(new) - 1
    return index


def coincident(places: IntArray) -> tuple[IntArray, IntArray]:
    """Find patches with the same three corners.

    Returns:
        Those that repeat an earlier one in the same orientation, and (k, 2) pairs in opposite orientation.

    """
    corners = np.sort(places, axis=1)
    # Even permutations of the sorted corners have one orientation, odd ones the other.
    a, b, c = places.T
    inversions = (a > b).astype(np.int64) + (a > c) + (b > c)
    orientation = inversions % 2
    order = np.lexsort((orientation, corners[:, 2], corners[:, 1], corners[:, 0]))  # stable: earlier patches first
    same = (corners[order][1:] == corners[order][:-1]).all(axis=1)
    turned = orientation[order][1:] != orientation[order][:-1]
    duplicates = np.sort(order[1:][same & ~turned])

    # The first patch of the second orientation follows the last one of the first: pair it with the first one.
    second = np.flatnonzero(same & turned) + 1
    starts = np.flatnonzero(np.concatenate([[True], ~same]))
    first = starts[np.searchsorted(starts, second, side="right") - 1]
    pairs = np.sort(np.column_stack([order[first], order[second]]), axis=1)
    return duplicates, pairs[np.argsort(pairs[:, 0])]


def close_corners(faces: IntArray, vertices: FloatArray, reach: float) -> IntArray:
    """Find patches with a corner nearer to another position than `reach`, but not in it; most of them."""
    used, corners = np.unique(faces, return_inverse=True)
    places, index = np.unique(vertices[used] + 0.0, axis=0, return_inverse=True)
    # Neighbours in space are neighbours along any line; others seldom are, along one that is askew to all meshes.
    order = np.argsort(places @ np.array([0.5421, 0.6387, 0.5459]))
    near = np.linalg.norm(np.diff(places[order], axis=0), axis=1) < reach
    is_close = np.zeros(len(places), dtype=np.bool_)
    is_close[order[1:][near]] = is_close[order[:-1][near]] = True
    return np.flatnonzero(is_close[index.reshape(-1)[corners.reshape(-1, 3)]].any(axis=1))


@dataclass(frozen=True)
class Edges:
    """What the edges of n patches tell.

    Attributes:
        closed: whether every edge is run through as often in one direction as in the other.
        boundary: number of edges of one patch only.
        nonmanifold: number of edges of more than two.
        inconsistent: number of edges that two patches run through in the same direction.
        flipped: (n,) whether a patch faces the other way than the larger area of its connected piece.
        pairs: (k, 2), patches that share an edge, each with the next around it.
        alone: (k,) whether a pair shares its edge with no third patch.

    """

    closed: bool
    boundary: int
    nonmanifold: int
    inconsistent: int
    flipped: npt.NDArray[np.bool_]
    pairs: IntArray
    alone: npt.NDArray[np.bool_]


def examine_edges(places: IntArray, areas: FloatArray) -> Edges:
    """Examine the edges of patches whose corners are numbered by position."""
    start, end = places.reshape(-1), np.roll(places, -1, axis=1).reshape(-1)
    patch = np.repeat(np.arange(len(places)), 3)
    key = np.minimum(start, end) * (places.max() + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.concatenate([[True], key[order][1:] != key[order][:-1]]))
    uses = np.diff(np.append(first, len(key)))
    direction = np.where(start < end, 1, -1)[order]
    balance = np.add.reduceat(direction, first)

    edge = np.repeat(np.arange(len(first)), uses)
    next_to = np.flatnonzero(edge[1:] == edge[:-1])
    pairs = np.column_stack([patch[order[next_to]], patch[order[next_to + 1]]])
    alone = uses[edge[next_to]] == 2
    shared = first[uses == 2]
    left, right = pairs[alone].T
    conflict = direction[shared] == direction[shared + 1]
    inconsistent = int(np.count_nonzero(conflict))
    flipped = _flipped(areas, left, right, conflict) if inconsistent else np.zeros(len(places), dtype=np.bool_)
    return Edges(
        closed=not balance.any(),
        boundary=int(np.count_nonzero(uses == 1)),
        nonmanifold=int(np.count_nonzero(uses > 2)),
        inconsistent=inconsistent,
        flipped=flipped,
        pairs=pairs,
        alone=alone,
    )


def _flipped(
    areas: FloatArray, left: IntArray, right: IntArray, conflict: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    """Tell which patches disagree with the larger area of their connected piece.

    Every patch enters twice, as it is (i) and reversed (i + n). A consistent edge joins i to j and i + n to j + n, a
    conflicting one i to j + n and i + n to j. A piece that can be oriented then falls into two parts, mirror images of
    each other; which part holds a patch as it is tells its side.
    """
    n = len(areas)
    a = np.concatenate([left, left + n])
    b = np.concatenate([right + n * conflict, right + n * ~conflict])
    part = connected(2 * n, a, b)
    piece = np.minimum(part[:n], part[n:])
    side = (part[:n] > part[n:]).astype(np.int64)
    area = np.bincount(2 * piece + side, weights=areas, minlength=4 * n).reshape(-1, 2)[piece]
    orientable = part[:n] != part[n:]
    # Side 0 holds the piece's first patch and wins a tie; sums of areas are equal to rounding only.
    smaller = np.where(area[:, 0] >= area[:, 1] * (1.0 - 1e-9), 1, 0)
    flipped: npt.NDArray[np.bool_] = orientable & (side == smaller)
    return flipped


def connected(n: int, a: IntArray, b: IntArray) -> IntArray:
    """Give each of n nodes the smallest node of its connected component; a-b are the edges.

    Every root that has a smaller neighbour is hung below it, then all paths are shortened to their roots; each round
    at least halves the roots that can still be joined (after Shiloach & Vishkin 1982).
    """
    root = np.arange(n)
    while len(a):
        low, high = np.minimum(root[a], root[b]), np.maximum(root[a], root[b])
        np.minimum.at(root, high, low)
        while True:
            above = root[root]
            if np.array_equal(above, root):
                break
            root = above
        apart = root[a] != root[b]
        a, b = a[apart], b[apart]
    return root
