"""The rooms: their light is known, from measurement, from closed forms or from a path tracer."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..scene import Scene
from .builder import Builder, Point, refined

_WHITE = (0.725, 0.71, 0.68)
_RED = (0.63, 0.065, 0.05)
_GREEN = (0.14, 0.45, 0.091)
_LAMP = (0.78, 0.78, 0.78)
_LAMP_EMISSION = (17.0 * math.pi, 12.0 * math.pi, 4.0 * math.pi)


def cornell_box(max_edge: float | None = None) -> Scene:
    """Build the Cornell box: white room, red left and green right wall, two white blocks, a lamp in the ceiling.

    Measured dimensions in m (millimetres in the source): about 0.553 wide (x), 0.549 high (y), 0.559 deep (z). The
    camera stands at negative z, where the room is open, and sees the red wall (x = 0.55) on its left; y is up. The
    floor is narrower than the ceiling, so the red wall is no exact plane and consists of two triangles. The floor goes
    on beneath the blocks. The lamp fills a hole of the ceiling and emits (17, 12, 4) pi W/m^2.

    Source: Cornell University Program of Graphics, "The Cornell Box: data" (1998); colours and lamp as commonly
    rendered in RGB.

    Args:
        max_edge: longest edge in m; None gives the coarsest mesh, 38 patches.

    Returns:
        A scene of 3 bands, named "floor", "ceiling", "lamp", "back wall", "right wall", "left wall", "short block" and
        "tall block".

    """
    height, depth = 0.5488, 0.5592
    builder = Builder()
    builder.polygon("floor", [(0.5528, 0, 0), (0, 0, 0), (0, 0, depth), (0.5496, 0, depth)], _WHITE)
    outer = [(0.556, height, 0), (0.556, height, depth), (0, height, depth), (0, height, 0)]
    lamp = [(0.343, height, 0.227), (0.343, height, 0.332), (0.213, height, 0.332), (0.213, height, 0.227)]
    for k in range(4):
        builder.polygon("ceiling", [outer[k], outer[(k + 1) % 4], lamp[(k + 1) % 4], lamp[k]], _WHITE)
    builder.polygon("lamp", lamp, _LAMP, _LAMP_EMISSION)
    builder.polygon(
        "back wall", [(0.5496, 0, depth), (0, 0, depth), (0, height, depth), (0.556, height, depth)], _WHITE
    )
    builder.polygon("right wall", [(0, 0, depth), (0, 0, 0), (0, height, 0), (0, height, depth)], _GREEN)
    builder.polygon("left wall", [(0.5528, 0, 0), (0.5496, 0, depth), (0.556, height, depth), (0.556, height, 0)], _RED)
    _block(builder, "short block", [(0.13, 0.065), (0.082, 0.225), (0.24, 0.272), (0.29, 0.114)], 0.165)
    _block(builder, "tall block", [(0.423, 0.247), (0.265, 0.296), (0.314, 0.456), (0.472, 0.406)], 0.33)
    return builder.scene(max_edge)


def _block(builder: Builder, name: str, foot: Sequence[tuple[float, float]], height: float) -> None:
    """Add the top and the sides of a block on the floor; `foot` runs from z towards x (clockwise seen from above)."""
    builder.polygon(name, [(x, height, z) for x, z in foot], _WHITE)
    for (x0, z0), (x1, z1) in zip(foot, [*foot[1:], foot[0]], strict=True):
        builder.polygon(name, [(x0, 0, z0), (x1, 0, z1), (x1, height, z1), (x0, height, z0)], _WHITE)


def cornell_box_view() -> dict[str, tuple[float, float, float] | float]:
    """Return origin, target, up and fov (degrees, vertical) of the box's classic camera: 35 mm lens, 25 mm film."""
    return {
        "origin": (0.278, 0.273, -0.8),
        "target": (0.278, 0.273, 0.0),
        "up": (0.0, 1.0, 0.0),
        "fov": math.degrees(2.0 * math.atan(0.0125 / 0.035)),
    }


def furnace(
    reflectance: npt.ArrayLike = 0.5,
    emission: npt.ArrayLike = 1.0,
    shape: str = "cube",
    max_edge: float | None = None,
) -> Scene:
    """Build a closed cavity of one material, facing inwards: B = E / (1 - rho) on every patch, H = B.

    Args:
        reflectance: scalar | (b,) | (n, b), below 1.
        emission: scalar | (b,) | (n, b), W/m^2.
        shape: "cube", from (0, 0, 0) to (1, 1, 1), 12 patches; or "icosphere", 320 patches with corners on the unit
            sphere around the origin. Subdividing keeps the flat faces.
        max_edge: longest edge in m.

    Returns:
        The scene; its one object is named "furnace".

    Raises:
        ValueError: an unknown shape, or values that `Scene` refuses.

    """
    if shape == "cube":
        corners = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
        # Corner 4x + 2y + z; each face counter-clockwise seen from inside.
        quads = np.array([(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)])
        faces = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    elif shape == "icosphere":
        import trimesh

        sphere = trimesh.creation.icosphere(subdivisions=2)
        corners, faces = np.array(sphere.vertices), np.array(sphere.faces)[:, ::-1]
    else:
        raise ValueError(f"unknown furnace shape {shape!r}; valid are 'cube', 'icosphere'")
    return refined(Scene(corners, faces, reflectance, emission, names=["furnace"] * len(faces)), max_edge)


def parallel_plates(
    size: float = 1.0,
    gap: float = 1.0,
    reflectance: npt.ArrayLike = 0.5,
    emission: npt.ArrayLike = ((1.0,), (0.0,)),
    max_edge: float | None = None,
) -> Scene:
    """Build two square plates facing each other, the lower one at z = 0 around the z axis.

    Args:
        size: edge of the plates, m.
        gap: distance between them, m.
        reflectance: scalar | (b,) | (2, b), the rows for the lower and the upper plate.
        emission: the same, W/m^2; by default only the lower plate emits.
        max_edge: longest edge in m.

    Returns:
        A scene of 4 patches before subdivision, named "lower plate" and "upper plate".

    Raises:
        ValueError: a size or gap that is not positive and finite, or values that `Scene` refuses.

    """
    for name, value in (("size", size), ("gap", gap)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} {value} is not a positive finite length")
    half = 0.5 * size
    square = [(-half, -half), (half, -half), (half, half), (-half, half)]
    vertices = [(x, y, z) for z in (0.0, gap) for x, y in square]
    faces = [(0, 1, 2), (0, 2, 3), (4, 6, 5), (4, 7, 6)]
    scene = Scene(
        vertices,
        faces,
        reflectance=_per_plate("reflectance", reflectance),
        emission=_per_plate("emission", emission),
        names=["lower plate"] * 2 + ["upper plate"] * 2,
    )
    return refined(scene, max_edge)


def _per_plate(name: str, values: npt.ArrayLike) -> FloatArray:
    """Repeat the rows of (2, b) values for the two triangles of each plate; scalars and (b,) stay as they are."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim < 2:
        return array
    if array.ndim > 2 or len(array) != 2:
        raise ValueError(f"{name} has shape {array.shape}; a scalar, (b,) or (2, b) is needed, a row for each plate")
    return np.repeat(array, 2, axis=0)


def two_rooms(max_edge: float | None = None) -> Scene:
    """Build two rooms with a doorway through the 0.2 m wall between them, and a lamp in the ceiling of the first only.

    Each room is 4 x 4 x 3 m, z up; together they reach from (0, 0, 0) to (8.2, 4, 3) and are closed. The doorway is
    0.8 m wide (y from 3 to 3.8) and 2 m high. The lamp, 1 x 1 m in the ceiling, emits 100 W/m^2 in each of 3 bands.

    Args:
        max_edge: longest edge in m; None gives the coarsest mesh that has shared vertices everywhere, 172 patches.

    Returns:
        A scene of 3 bands; the names begin with "first room", "second room" or "doorway", except "lamp".

    """
    grey, white, red = (0.5, 0.5, 0.5), (0.7, 0.7, 0.7), (0.7, 0.2, 0.2)
    tan, blue, frame = (0.75, 0.6, 0.4), (0.2, 0.3, 0.7), (0.6, 0.6, 0.6)
    # The lines of lamp and door run through all walls of a room, so that these meet in shared vertices.
    first = ([0.0, 1.5, 2.5, 4.0], [0.0, 1.5, 2.5, 3.0, 3.8, 4.0], [0.0, 2.0, 3.0])
    second = ([4.2, 8.2], [0.0, 3.0, 3.8, 4.0], [0.0, 2.0, 3.0])
    lamp, door = ([1.5, 2.5], [1.5, 2.5], [3.0]), ([4.0, 4.2], [3.0, 3.8], [0.0, 2.0])
    x, y, z = 0, 1, 2

    builder = Builder()
    builder.wall("first room floor", z, +1, 0.0, first, grey)
    builder.wall("first room ceiling", z, -1, 3.0, first, white, hole=lamp)
    builder.wall("lamp", z, -1, 3.0, lamp, grey, emission=(100.0, 100.0, 100.0))
    builder.wall("first room walls", y, +1, 0.0, first, white)
    builder.wall("first room walls", y, -1, 4.0, first, white)
    builder.wall("first room red wall", x, +1, 0.0, first, red)
    builder.wall("first room walls", x, -1, 4.0, first, white, hole=door)
    builder.wall("second room floor", z, +1, 0.0, second, grey)
    builder.wall("second room ceiling", z, -1, 3.0, second, tan)
    builder.wall("second room walls", y, +1, 0.0, second, tan)
    builder.wall("second room walls", y, -1, 4.0, second, tan)
    builder.wall("second room blue wall", x, -1, 8.2, second, blue)
    builder.wall("second room walls", x, +1, 4.2, second, tan, hole=door)
    builder.wall("doorway", y, +1, 3.0, door, frame)
    builder.wall("doorway", y, -1, 3.8, door, frame)
    builder.wall("doorway", z, -1, 2.0, door, frame)
    builder.wall("doorway", z, +1, 0.0, door, grey)
    return builder.scene(max_edge)


def colonnade(max_edge: float | None = None) -> Scene:
    """Build a hall with a double row of three pillars each, and two coloured lamps in the ceiling between the rows.

    The hall is 12 x 8 x 4 m, z up, from (0, 0, 0) to (12, 8, 4), and closed. The pillars are regular octagonal prisms
    from floor to ceiling, 0.45 m from axis to corner, at x = 2, 6, 10 and y = 2, 6; floor and ceiling have holes where
    they stand. The lamps, 1 x 1 m around (2, 4) and (10, 4), emit (120, 90, 60) and (60, 90, 120) W/m^2, so that every
    pillar throws shadows of two colours.

    Args:
        max_edge: longest edge in m; None gives the coarsest mesh, 292 patches; 3.0 gives 588.

    Returns:
        A scene of 3 bands, named "floor", "ceiling", "warm lamp", "cool lamp", "walls", "end walls" and "pillars".

    """
    stone, plaster, lamp = (0.5, 0.5, 0.5), (0.75, 0.75, 0.75), (0.6, 0.6, 0.6)
    sandstone, brick = (0.7, 0.6, 0.45), (0.6, 0.3, 0.2)
    height = 4.0
    # Bays: a pillar in the middle of each cell of the first and the last row; the cells between them have the lamps.
    across = ([0.0, 4.0, 8.0, 12.0], [0.0, 3.0, 5.0, 8.0], [0.0, height])
    lamps = {2.0: ("warm lamp", (120.0, 90.0, 60.0)), 10.0: ("cool lamp", (60.0, 90.0, 120.0))}
    x, y = 0, 1

    builder = Builder()
    for x0, x1 in zip(across[x][:-1], across[x][1:], strict=True):
        middle = 0.5 * (x0 + x1)
        for (y0, y1), pillar in (((0.0, 3.0), 2.0), ((5.0, 8.0), 6.0)):
            bay = _rectangle((x0, y0), (x1, y1))
            foot = [
                (middle + 0.45 * math.cos(k * math.pi / 4), pillar + 0.45 * math.sin(k * math.pi / 4)) for k in range(8)
            ]
            _slab_around(builder, "floor", bay, foot, 0.0, +1, stone)
            _slab_around(builder, "ceiling", bay, foot, height, -1, plaster)
            for (u0, v0), (u1, v1) in zip(foot, [*foot[1:], foot[0]], strict=True):
                sides = [(u0, v0, 0.0), (u1, v1, 0.0), (u1, v1, height), (u0, v0, height)]
                builder.polygon("pillars", sides, sandstone)
        nave = _rectangle((x0, 3.0), (x1, 5.0))
        builder.polygon("floor", [(u, v, 0.0) for u, v in nave], stone)
        if middle in lamps:
            name, emission = lamps[middle]
            light = _rectangle((middle - 0.5, 3.5), (middle + 0.5, 4.5))
            builder.polygon(name, [(u, v, height) for u, v in light[::-1]], lamp, emission)
            for k in range(4):
                rim = [nave[k - 1], light[k - 1], light[k], nave[k]]
                builder.polygon("ceiling", [(u, v, height) for u, v in rim], plaster)
        else:
            builder.polygon("ceiling", [(u, v, height) for u, v in nave[::-1]], plaster)
    for axis, name, colour in ((x, "end walls", brick), (y, "walls", plaster)):
        builder.wall(name, axis, +1, 0.0, across, colour)
        builder.wall(name, axis, -1, across[axis][-1], across, colour)
    return builder.scene(max_edge)


def _rectangle(low: tuple[float, float], high: tuple[float, float]) -> list[tuple[float, float]]:
    """Return the corners, counter-clockwise, from the lowest."""
    return [low, (high[0], low[1]), high, (low[0], high[1])]


def _slab_around(
    builder: Builder,
    name: str,
    outer: Sequence[tuple[float, float]],
    foot: Sequence[tuple[float, float]],
    z: float,
    facing: int,
    reflectance: Point,
) -> None:
    """Add a rectangle at height z with an octagonal hole, its front towards facing * z.

    Both run counter-clockwise seen from above, the octagon from +x and the rectangle from its lowest corner: corner k
    of the rectangle lies out beyond corner 2k + 5 of the octagon.
    """
    for k in range(4):
        this, following = outer[k], outer[(k + 1) % 4]
        near, middle, far = (foot[(2 * k + turn) % 8] for turn in (5, 6, 7))
        for corners in ((this, middle, near), (this, following, middle), (following, far, middle)):
            builder.polygon(name, [(u, v, z) for u, v in corners][::facing], reflectance)
