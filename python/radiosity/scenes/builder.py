"""How built-in scenes are put together: polygons, walls and boxes by name and material."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from ..scene import Scene

Point: TypeAlias = Sequence[float]
Lines: TypeAlias = tuple[Sequence[float], Sequence[float], Sequence[float]]


class Builder:
    """Named triangles with their materials; equal positions become one vertex."""

    def __init__(self) -> None:
        self._corners: list[tuple[Point, Point, Point]] = []
        self._names: list[str] = []
        self._reflectance: list[Point] = []
        self._emission: list[Point] = []

    def polygon(
        self, name: str, corners: Sequence[Point], reflectance: Point, emission: Point = (0.0, 0.0, 0.0)
    ) -> None:
        """Add a convex polygon, counter-clockwise seen from its front, as a fan around its first corner."""
        for k in range(1, len(corners) - 1):
            self._corners.append((corners[0], corners[k], corners[k + 1]))
            self._names.append(name)
            self._reflectance.append(reflectance)
            self._emission.append(emission)

    def box(self, name: str, low: Point, high: Point, reflectance: Point, emission: Point = (0.0, 0.0, 0.0)) -> None:
        """Add all six sides of a box, their fronts outwards."""
        lines = ([low[0], high[0]], [low[1], high[1]], [low[2], high[2]])
        for axis in range(3):
            self.wall(name, axis, -1, low[axis], lines, reflectance, emission)
            self.wall(name, axis, +1, high[axis], lines, reflectance, emission)

    def wall(
        self,
        name: str,
        axis: int,
        facing: int,
        at: float,
        lines: Lines,
        reflectance: Point,
        emission: Point = (0.0, 0.0, 0.0),
        hole: Lines | None = None,
    ) -> None:
        """Add a wall across an axis, cut along the lines of the two other axes, its front towards facing * axis.

        Cells whose middle lies within the first and last line of `hole` along every axis are left out.
        """
        first, second = (axis + 1) % 3, (axis + 2) % 3  # their right-handed normal is +axis

        def point(u: float, v: float) -> list[float]:
            place = [at, at, at]
            place[first], place[second] = u, v
            return place

        for u0, u1 in zip(lines[first][:-1], lines[first][1:], strict=True):
            for v0, v1 in zip(lines[second][:-1], lines[second][1:], strict=True):
                middle = point(0.5 * (u0 + u1), 0.5 * (v0 + v1))
                if hole is not None and all(side[0] <= x <= side[-1] for x, side in zip(middle, hole, strict=True)):
                    continue
                corners = [point(u0, v0), point(u1, v0), point(u1, v1), point(u0, v1)]
                self.polygon(name, corners[::facing], reflectance, emission)

    def scene(self, max_edge: float | None) -> Scene:
        """All that was added, subdivided."""
        corners = np.asarray(self._corners, dtype=np.float64).reshape(-1, 3)
        vertices, index = np.unique(corners, axis=0, return_inverse=True)
        scene = Scene(
            vertices,
            index.reshape(-1, 3),
            reflectance=np.asarray(self._reflectance),
            emission=np.asarray(self._emission),
            names=self._names,
        )
        return refined(scene, max_edge)


def refined(scene: Scene, max_edge: float | None) -> Scene:
    """The scene with no edge longer than `max_edge`, if that is given."""
    return scene if max_edge is None else scene.subdivide(max_edge)
