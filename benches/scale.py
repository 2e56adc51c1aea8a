"""Prints time, memory and error on one machine where n is large: a city, a crater, a theatre of a million triangles.

Every measurement runs in a process of its own, whose peak of memory is that of the work and nothing else. "CPU" is user plus
system time of all threads, divided by two: what two cores that do nothing else would need at least.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import radiosity as rad

Found = dict[str, Any]
QUIET = {"progress": False}


# -------------------------------------------------------------------------------------------------------------- scenes


def city(blocks: int = 9, cell: float = 2.0) -> rad.Scene:
    """Houses of 8 x 8 m on a grid of streets 6 m wide, 4 to 14 m high; every face cut into cells of two triangles.

    Houses are closed boxes; the ground lies around and not beneath them, and everything is open to the sky. With 9 x 9
    houses and cells of 2 m: 22,410 facets. Southern walls emit, as the sun heats them.
    """
    house, street = 8.0, 6.0
    pitch, rng = house + street, np.random.default_rng(22176)
    corners: list[np.ndarray[Any, Any]] = []
    emission: list[np.ndarray[Any, Any]] = []

    def wall(origin: tuple[float, float, float], u: tuple[int, int, int], v: tuple[int, int, int], size: Any) -> None:
        """Two triangles a cell; u x v is the normal."""
        counts = [round(length / cell) for length in size]
        grid = np.stack(np.meshgrid(*[np.arange(count) for count in counts], indexing="ij"), -1).reshape(-1, 2)
        squares = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
        places = cell * (grid[:, None, :] + squares)
        points = np.asarray(origin, float) + places[..., :1] * np.asarray(u) + places[..., 1:] * np.asarray(v)
        triangles = points[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
        corners.append(triangles)
        emission.append(np.full(len(triangles), 100.0 if np.cross(u, v)[1] < 0 else 0.0))

    x, y, z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    down, back, left = (0, 0, -1), (0, -1, 0), (-1, 0, 0)
    for p in range(blocks):
        for q in range(blocks):
            x0, y0 = p * pitch, q * pitch
            h = cell * int(rng.integers(round(4 / cell), round(14 / cell) + 1))
            x1, y1 = x0 + house, y0 + house
            wall((x0, y0, h), x, y, (house, house))
            wall((x0, y1, 0), x, back, (house, house))
            wall((x0, y0, 0), x, z, (house, h))
            wall((x1, y1, 0), left, z, (house, h))
            wall((x1, y0, 0), y, z, (house, h))
            wall((x0, y1, 0), back, z, (house, h))
            # The street in front of it, and the one beside both.
            wall((x0, y1, 0), x, y, (house, street))
            wall((x1, y0, 0), x, y, (street, pitch))
    triangles = np.concatenate(corners)
    vertices, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    light = np.concatenate(emission)[:, None]
    return rad.Scene(vertices, faces.reshape(-1, 3), reflectance=0.3, emission=light)


def crater(rings: int = 32, width: float = 6.24, outermost: int | None = 198) -> rad.Scene:
    """A bowl, part of a sphere five times as wide as it is deep, as Ingersoll et al. (1992) model craters: 6,386 facets.

    Ring r holds about `width` r points; `outermost` of them on the rim make the number of facets.
    """
    counts = [1] + [round(width * r) for r in range(1, rings + 1)]
    if outermost is not None:
        counts[-1] = outermost
    depth, rim = 0.4, 1.0
    radius = 0.5 * (depth + rim**2 / depth)
    rows, vertices, faces = [], [], []
    for r, count in enumerate(counts):
        angle = 2.0 * math.pi * np.arange(count) / count
        polar = math.asin(rim / radius) * r / rings
        rows.append(np.arange(count) + sum(counts[:r]))
        ring = [radius * math.sin(polar) * np.cos(angle), radius * math.sin(polar) * np.sin(angle)]
        vertices.append(np.stack([*ring, np.full(count, -radius * math.cos(polar))], axis=1))
    for inner, outer in zip(rows[:-1], rows[1:], strict=True):
        i, o = 0, 0
        steps = len(inner) if len(inner) > 1 else 0
        while i < steps or o < len(outer):
            a, b = inner[i % len(inner)], outer[o % len(outer)]
            # The next point around on either ring, whichever comes first.
            if o < len(outer) and (i == steps or (o + 1) * len(inner) <= (i + 1) * len(outer)):
                faces.append((a, b, outer[(o + 1) % len(outer)]))
                o += 1
            else:
                faces.append((a, b, inner[(i + 1) % len(inner)]))
                i += 1
    # The sun stands over one half of the bowl.
    scene = rad.Scene(np.concatenate(vertices), np.asarray(faces), reflectance=0.1)
    return scene.with_materials(scene.reflectance, np.where(scene.centroids[:, :1] > 0.0, 1.0, 0.0))
