"""A gallery: two rooms with pictures, plinths and benches under skylights, and a window."""

from __future__ import annotations

import math

from ..scene import Scene
from .builder import Builder, Point

_WALL, _CEILING, _FLOOR, _FRAME = (0.74, 0.73, 0.7), (0.8, 0.8, 0.78), (0.42, 0.28, 0.16), (0.12, 0.09, 0.06)
_STONE, _LEATHER, _GLASS = (0.62, 0.6, 0.57), (0.2, 0.1, 0.07), (0.08, 0.08, 0.08)
_SKY, _DAY = (120.0, 132.0, 150.0), (260.0, 255.0, 240.0)
_PICTURES = (
    (0.62, 0.18, 0.1),
    (0.12, 0.3, 0.55),
    (0.75, 0.6, 0.12),
    (0.1, 0.42, 0.22),
    (0.45, 0.16, 0.5),
    (0.85, 0.83, 0.8),
)


def gallery(max_edge: float | None = None) -> Scene:
    """Build a gallery of two rooms, 10 x 8 and 7 x 8 m, 4.5 m high, z up, with a wide opening between them.

    Each room has a skylight of (120, 132, 150) W/m^2, deep in a shaft of the ceiling; the second has a window to the
    day, (260, 255, 240) W/m^2. Pictures in frames hang on the walls, sculptures of polyhedra stand on plinths, and
    there are benches. The rooms are closed; some light is lost on the backs of what hangs and stands there.

    Args:
        max_edge: longest edge in m; None gives the coarsest mesh, 1,936 patches.

    Returns:
        A scene of 3 bands.

    """
    x, y, z = 0, 1, 2
    builder = Builder()
    height, wall = 4.5, 0.4
    first = ([0.0, 3.0, 7.0, 10.0], [0.0, 2.0, 3.0, 5.0, 6.0, 8.0], [0.0, 1.0, 3.2, height])
    second = ([10.4, 12.9, 14.9, 17.4], [0.0, 2.0, 3.0, 5.0, 6.0, 8.0], [0.0, 1.0, 3.2, height])
    door = ([10.0, 10.4], [2.0, 6.0], [0.0, 3.2])
    window = ([17.4, 17.4 + wall], [2.0, 6.0], [1.0, 3.2])
    for number, (lines, light) in enumerate(((first, (3.0, 7.0)), (second, (12.9, 14.9)))):
        room = f"room {number + 1}"
        skylight = (light, (3.0, 5.0), (height, height + 0.8))
        builder.wall(f"{room} floor", z, +1, 0.0, lines, _FLOOR)
        builder.wall(f"{room} ceiling", z, -1, height, lines, _CEILING, hole=skylight)
        builder.wall(f"{room} walls", y, +1, 0.0, lines, _WALL)
        builder.wall(f"{room} walls", y, -1, 8.0, lines, _WALL)
        builder.wall(f"{room} walls", x, +1, lines[x][0], lines, _WALL, hole=door if number else None)
        builder.wall(f"{room} walls", x, -1, lines[x][-1], lines, _WALL, hole=window if number else door)
        builder.wall("skylights", z, -1, height + 0.8, skylight, _GLASS, emission=_SKY)
        for axis in (x, y):
            builder.wall("skylight shafts", axis, +1, skylight[axis][0], skylight, _CEILING)
            builder.wall("skylight shafts", axis, -1, skylight[axis][1], skylight, _CEILING)
    for name, hole in (("opening", door), ("window", window)):
        builder.wall(name, y, +1, hole[y][0], hole, _WALL)
        builder.wall(name, y, -1, hole[y][1], hole, _WALL)
        builder.wall(name, z, -1, hole[z][1], hole, _WALL)
        builder.wall(name, z, +1, hole[z][0], hole, _FLOOR if name == "opening" else _WALL)
    builder.wall("day", x, -1, 17.4 + wall, window, _GLASS, emission=_DAY)
    # Bars of the window.
    for v in (3.0, 4.0, 5.0):
        builder.box("window", (17.5, v - 0.03, 1.0), (17.56, v + 0.03, 3.2), _FRAME)
    builder.box("window", (17.5, 2.0, 2.07), (17.56, 6.0, 2.13), _FRAME)
    for k, centre in enumerate((1.6, 5.0, 8.4, 12.1, 15.7)):
        _picture(builder, centre, 0.0, +1, 0.7 + 0.15 * (k % 3), 0.9 - 0.12 * (k % 2), k)
        _picture(builder, centre, 8.0, -1, 0.9 - 0.12 * (k % 3), 0.75 + 0.1 * (k % 2), k + 3)
    for k, (u, v) in enumerate(((2.0, 2.2), (2.0, 5.8), (8.0, 2.2), (8.0, 5.8), (12.4, 1.8), (12.4, 6.2))):
        builder.box("plinths", (u - 0.3, v - 0.3, 0.0), (u + 0.3, v + 0.3, 1.05), _CEILING)
        _sculpture(builder, (u, v, 1.05), 0.24 + 0.05 * (k % 3), k)
    for u, v in ((5.0, 4.0), (14.4, 4.0)):
        builder.box("benches", (u - 0.9, v - 0.28, 0.4), (u + 0.9, v + 0.28, 0.5), _LEATHER)
        for foot in (u - 0.75, u + 0.65):
            builder.box("benches", (foot, v - 0.2, 0.0), (foot + 0.1, v + 0.2, 0.4), _FRAME)
    return builder.scene(max_edge)


def gallery_view() -> dict[str, tuple[float, float, float] | float]:
    """Return origin, target, up and fov (degrees, vertical) of a view from the first room into the second."""
    return {"origin": (0.5, 1.3, 1.75), "target": (10.0, 4.6, 1.55), "up": (0.0, 0.0, 1.0), "fov": 55.0}


def _picture(builder: Builder, centre: float, at: float, facing: int, width: float, height: float, number: int) -> None:
    """Add a picture of three by three fields in a frame, on a wall across y."""
    low, high = (centre - width, 1.75 - height), (centre + width, 1.75 + height)
    depth = at + 0.06 * facing
    near, far = min(at, depth), max(at, depth)
    for a, b in (
        ((low[0] - 0.07, low[1] - 0.07), (low[0], high[1] + 0.07)),
        ((high[0], low[1] - 0.07), (high[0] + 0.07, high[1] + 0.07)),
        ((low[0], low[1] - 0.07), (high[0], low[1])),
        ((low[0], high[1]), (high[0], high[1] + 0.07)),
    ):
        builder.box("frames", (a[0], near, a[1]), (b[0], far, b[1]), _FRAME)
    across = [low[0] + 2.0 * width * part for part in (0.0, 0.3, 0.72, 1.0)]
    up = [low[1] + 2.0 * height * part for part in (0.0, 0.38, 0.64, 1.0)]
    surface = at + 0.02 * facing
    for i in range(3):
        for k in range(3):
            colour = _PICTURES[(number + 2 * i + 3 * k + i * k) % len(_PICTURES)]
            lines = ([across[i], across[i + 1]], [surface], [up[k], up[k + 1]])
            builder.wall("pictures", 1, facing, surface, lines, colour)


def _sculpture(builder: Builder, foot: Point, radius: float, number: int) -> None:
    """Add a ball of facets, twice subdivided from an octahedron, stretched upwards; it stands on its lowest point."""
    stretch = 1.0 + 0.35 * (number % 3)
    corners = [(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    faces = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4), (1, 0, 5), (2, 1, 5), (3, 2, 5), (0, 3, 5)]
    triangles = [[tuple(map(float, corners[v])) for v in face] for face in faces]
    for _ in range(2):
        finer = []
        for a, b, c in triangles:
            ab, bc, ca = (_unit([p + q for p, q in zip(s, t, strict=True)]) for s, t in ((a, b), (b, c), (c, a)))
            finer += [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        triangles = finer
    height = radius * stretch
    for triangle in triangles:
        placed = [(foot[0] + radius * p, foot[1] + radius * q, foot[2] + height * (1.0 + r)) for p, q, r in triangle]
        builder.polygon("sculptures", placed, _STONE)


def _unit(vector: list[float]) -> tuple[float, ...]:
    size = math.sqrt(sum(x * x for x in vector))
    return tuple(x / size for x in vector)
