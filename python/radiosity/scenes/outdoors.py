"""Open scenes, which the sun and the sky light: a crater and a few blocks of a city. Neither emits anything."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..arrays import whole_number
from ..scene import Scene
from .builder import Builder, refined

_STREET, _FACADE, _ROOF = (0.2, 0.2, 0.21), (0.6, 0.55, 0.48), (0.35, 0.3, 0.28)
# West and south corner, width, depth and height of the buildings, m.
_BUILDINGS = (
    (-24.0, -24.0, 16.0, 14.0, 12.0),
    (0.0, -24.0, 10.0, 16.0, 24.0),
    (14.0, -22.0, 10.0, 12.0, 9.0),
    (-24.0, -2.0, 12.0, 18.0, 18.0),
    (-4.0, 0.0, 14.0, 8.0, 10.0),
    (16.0, -2.0, 8.0, 24.0, 15.0),
    (-4.0, 14.0, 12.0, 10.0, 21.0),
)


def crater(depth: float = 0.2, rings: int = 12, reflectance: Any = 0.1) -> Scene:
    """Build a bowl-shaped crater of diameter 1 m with its rim at z = 0: a part of a sphere, open to the sky.

    On the inside of a sphere of radius R every form factor is A_j / (4 pi R^2), so what is scattered arrives evenly.
    Under a sun of irradiance E at an elevation e that is, in light and shadow alike,

        F B = E sin e  rho f (1 - f) / (1 - rho f),    f = depth / (2 R),

    and in the shadow there is nothing else (Ingersoll, Svitek & Murray, "Stability of polar frosts in spherical
    bowl-shaped craters on the Moon, Mercury, and Mars", 1992).

    Args:
        depth: in diameters, in (0, 0.5].
        rings: of triangles around the middle; there are 6 rings^2 patches.
        reflectance: as of `Scene`.

    Returns:
        A scene without emission.

    """
    if not (math.isfinite(depth) and 0.0 < depth <= 0.5):
        raise ValueError(f"depth {depth} is outside (0, 0.5] diameters")
    rings = whole_number("rings", rings, 1, 2000)
    radius = (0.25 + depth**2) / (2.0 * depth)
    widest = math.acos((radius - depth) / radius)
    points, faces, first = [(0.0, 0.0, -depth)], [], [0]
    for ring in range(1, rings + 1):
        first.append(len(points))
        polar = widest * ring / rings
        # The rim exactly in its plane.
        height = 0.0 if ring == rings else radius - depth - radius * math.cos(polar)
        for k in range(6 * ring):
            azimuth = math.pi * k / (3.0 * ring)
            level = radius * math.sin(polar)
            points.append((level * math.cos(azimuth), level * math.sin(azimuth), height))
        for sector in range(6):
            for k in range(ring):
                outer = [first[ring] + (sector * ring + k + step) % (6 * ring) for step in (0, 1)]
                inner = [
                    first[ring - 1] + (sector * (ring - 1) + k + step) % max(6 * (ring - 1), 1) for step in (0, -1)
                ]
                faces.append((inner[0], outer[0], outer[1]))
                if k > 0:
                    faces.append((inner[1], outer[0], inner[0]))
    return Scene(np.array(points), np.array(faces), reflectance=reflectance)


def city(max_edge: float | None = None) -> Scene:
    """Build seven buildings of 9 to 24 m on a square of 60 x 60 m, z up, y to the north.

    The ground runs around the buildings, not beneath them. Backs are seen from nowhere above the ground.

    Args:
        max_edge: longest edge in m; None gives the coarsest mesh.

    Returns:
        A scene of 3 bands without emission.

    """
    builder = Builder()
    edges: tuple[list[float], list[float]] = ([-30.0, 30.0], [-30.0, 30.0])
    for x, y, width, depth, _ in _BUILDINGS:
        edges[0].extend((x, x + width))
        edges[1].extend((y, y + depth))
    lines = [sorted(set(values)) for values in edges]
    for x0, x1 in zip(lines[0][:-1], lines[0][1:], strict=True):
        for y0, y1 in zip(lines[1][:-1], lines[1][1:], strict=True):
            if not any(x <= x0 < x + w and y <= y0 < y + d for x, y, w, d, _ in _BUILDINGS):
                builder.polygon("street", [(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)], _STREET)
    for x, y, width, depth, height in _BUILDINGS:
        # Cut where the lines of the ground end at the walls, so that these meet in shared vertices.
        across = [v for v in lines[0] if x <= v <= x + width]
        along = [v for v in lines[1] if y <= v <= y + depth]
        sides = (across, along, [0.0, height])
        builder.wall("facades", 0, -1, x, sides, _FACADE)
        builder.wall("facades", 0, +1, x + width, sides, _FACADE)
        builder.wall("facades", 1, -1, y, sides, _FACADE)
        builder.wall("facades", 1, +1, y + depth, sides, _FACADE)
        builder.wall("roofs", 2, +1, height, sides, _ROOF)
    return refined(builder.scene(None), max_edge)


def city_view() -> dict[str, tuple[float, float, float] | float]:
    """Return origin, target, up and fov (degrees, vertical) of a view from the south-east, above the roofs."""
    return {"origin": (52.0, -62.0, 48.0), "target": (0.0, -2.0, 4.0), "up": (0.0, 0.0, 1.0), "fov": 40.0}
