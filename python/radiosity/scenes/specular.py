"""A room with a mirror and glass."""

from __future__ import annotations

import numpy as np
import trimesh

from ..scene import Scene
from .builder import refined
from .rooms import cornell_box, cornell_box_view

_SILVER, _GLASS = 0.9, 1.5


def mirror_and_glass(max_edge: float | None = None, facets: int = 3) -> Scene:
    """Build the Cornell box without its blocks, a mirror for its back wall, a glass sphere and a white one in it.

    The mirror reflects 0.9. The sphere in front is glass of index 1.5, the one behind is white (0.7); both have a
    radius of 0.1 m and stand on the floor. See :func:`cornell_box` for the room.

    Args:
        max_edge: longest edge in m; None gives the coarsest mesh.
        facets: the spheres have 20 * 4^facets triangles.

    Returns:
        A scene of 3 bands; "mirror", "glass sphere" and "white sphere" among its names.

    """
    box = cornell_box()
    names = np.array(box.names)
    kept = ~np.isin(names, ("short block", "tall block"))
    ball = trimesh.creation.icosphere(subdivisions=facets, radius=0.1)
    corners, faces = np.array(ball.vertices), np.array(ball.faces)
    first, count, n = len(box.vertices), len(corners), len(faces)
    dark = np.zeros((n, 3))
    is_mirror = names[kept] == "back wall"
    reflectance = np.where(is_mirror[:, None], 0.0, box.reflectance[kept])
    # A hair above the floor, in which the lowest corners would lie.
    glass_at, white_at = np.array([0.19, 0.1001, 0.17]), np.array([0.38, 0.1001, 0.36])
    scene = Scene(
        np.concatenate([box.vertices, corners + glass_at, corners + white_at]),
        np.concatenate([box.faces[kept], first + faces, first + count + faces]),
        reflectance=np.concatenate([reflectance, dark, dark + 0.7]),
        emission=np.concatenate([box.emission[kept], dark, dark]),
        names=[*np.where(is_mirror, "mirror", names[kept]), *["glass sphere"] * n, *["white sphere"] * n],
        mirror=np.concatenate([np.where(is_mirror, _SILVER, 0.0), np.zeros(2 * n)]),
        ior=np.concatenate([np.full(kept.sum(), np.nan), np.full(n, _GLASS), np.full(n, np.nan)]),
    )
    return refined(scene, max_edge)


def mirror_and_glass_view() -> dict[str, tuple[float, float, float] | float]:
    """Return origin, target, up and fov (degrees, vertical) of the view of :func:`cornell_box_view`."""
    return cornell_box_view()
