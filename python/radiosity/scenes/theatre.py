"""A theatre: stage, stepped seats, a balcony, spotlights and ceiling lights."""

from __future__ import annotations

import math
from itertools import pairwise

from ..scene import Scene
from .builder import Builder

# The hall along x from -WIDTH / 2 to WIDTH / 2; y = 0 is the edge of the stage, the audience sits at y > 0; z is up.
_WIDTH, _DEPTH, _HEIGHT = 22.0, 24.0, 11.0
_STAGE_DEPTH, _STAGE_HEIGHT = 9.0, 1.0
_OPENING, _ARCH, _WALL = 14.0, 7.0, 0.2  # of the proscenium: width, height, thickness
_ROWS, _ROW, _RISE = 18, 0.95, 0.16  # number, depth and rise of the rows in the stalls
_BALCONY_ROWS, _BALCONY_Z, _BALCONY_RISE = 6, 5.2, 0.38
_SEAT = 0.56  # from seat to seat

_PLASTER, _CEILING, _WOOD, _DARK = (0.62, 0.56, 0.45), (0.72, 0.69, 0.62), (0.36, 0.22, 0.12), (0.04, 0.04, 0.04)
_VELVET, _CURTAIN, _CLOTH, _CARPET = (0.42, 0.05, 0.06), (0.5, 0.04, 0.05), (0.55, 0.62, 0.72), (0.16, 0.07, 0.07)
_GILT, _LAMP = (0.65, 0.5, 0.2), (0.7, 0.7, 0.7)
_CEILING_LIGHT, _SPOT_LIGHT, _SPOT_BLUE = (95.0, 78.0, 52.0), (5200.0, 4600.0, 3600.0), (1400.0, 2300.0, 4800.0)


def theatre(max_edge: float | None = None) -> Scene:
    """Build a theatre of 22 x 33 x 11 m, z up, for 720 people, with seats of their own.

    The stage is 14 m wide behind a proscenium 7 m high, with curtains, a back cloth, and a table and steps on it.
    Eighteen rows of seats rise towards the back, six more on a balcony. Sixteen panels in the ceiling emit (95, 78, 52)
    W/m^2; ten spotlights, small plates deep in black tubes under the ceiling, emit up to 5,200 W/m^2 towards the
    stage, warm in the middle and blue at the sides. The hall is closed; some light is
    lost on the backs of what stands in it.

    Args:
        max_edge: longest edge in m; None gives the coarsest mesh, 53,548 patches.

    Returns:
        A scene of 3 bands.

    """
    builder = Builder()
    _shell(builder)
    _stage(builder)
    half = _OPENING / 2
    for row in range(_ROWS):
        z, y = row * _RISE, 2.2 + row * _ROW
        _seats(builder, y, z, half + 2.5, gap=0.7)
    for row in range(_BALCONY_ROWS):
        y = _DEPTH - (_BALCONY_ROWS - row) * _ROW
        _seats(builder, y, _BALCONY_Z + row * _BALCONY_RISE, half + 2.5, gap=0.7)
    _lights(builder)
    return builder.scene(max_edge)


def theatre_view() -> dict[str, tuple[float, float, float] | float]:
    """Return origin, target, up and fov (degrees, vertical) of a view from the balcony to the stage."""
    return {"origin": (-5.5, 19.0, 8.6), "target": (0.8, 0.0, 2.2), "up": (0.0, 0.0, 1.0), "fov": 58.0}


def _shell(builder: Builder) -> None:
    """Walls, stepped floor, balcony, ceiling."""
    side, back = _WIDTH / 2, -_STAGE_DEPTH
    x, y, z = 0, 1, 2
    across = [-side, -_OPENING / 2, _OPENING / 2, side]
    along = [0.0, 6.0, 12.0, 18.0, _DEPTH]
    up = [0.0, _STAGE_HEIGHT, _ARCH + _STAGE_HEIGHT, _HEIGHT]
    builder.wall("ceiling", z, -1, _HEIGHT, (across, along, up), _CEILING)
    builder.wall("walls", x, +1, -side, (across, along, up), _PLASTER)
    builder.wall("walls", x, -1, side, (across, along, up), _PLASTER)
    builder.wall("walls", y, -1, _DEPTH, (across, along, up), _PLASTER)
    opening = ([-_OPENING / 2, _OPENING / 2], [0.0], [_STAGE_HEIGHT, _ARCH + _STAGE_HEIGHT])
    builder.wall("proscenium", y, +1, 0.0, (across, along, up), _PLASTER, hole=opening)
    # The opening goes through a wall of 0.2 m; behind it is the stage house, as wide as the hall.
    through = ([-_OPENING / 2, _OPENING / 2], [-_WALL, 0.0], [_STAGE_HEIGHT, _ARCH + _STAGE_HEIGHT])
    builder.wall("proscenium", x, +1, -_OPENING / 2, through, _PLASTER)
    builder.wall("proscenium", x, -1, _OPENING / 2, through, _PLASTER)
    builder.wall("proscenium", z, -1, _ARCH + _STAGE_HEIGHT, through, _PLASTER)
    builder.wall("stage floor", z, +1, _STAGE_HEIGHT, through, _WOOD)
    deep, high = [back, -6.0, -3.0, -_WALL], [_STAGE_HEIGHT, _ARCH + _STAGE_HEIGHT, _HEIGHT]
    builder.wall("stage walls", x, +1, -side, (across, deep, high), _DARK)
    builder.wall("stage walls", x, -1, side, (across, deep, high), _DARK)
    builder.wall("stage walls", z, -1, _HEIGHT, (across, deep, high), _DARK)
    builder.wall("stage walls", y, -1, -_WALL, (across, deep, high), _DARK, hole=through)
    builder.wall("stage walls", y, +1, back, (across, deep, high), _DARK)
    builder.wall("stage floor", z, +1, _STAGE_HEIGHT, (across, deep, high), _WOOD)
    # A gilt frame around the opening.
    for low, top in (
        ((-_OPENING / 2 - 0.5, 0.0, _STAGE_HEIGHT), (-_OPENING / 2, 0.4, _ARCH + _STAGE_HEIGHT)),
        ((_OPENING / 2, 0.0, _STAGE_HEIGHT), (_OPENING / 2 + 0.5, 0.4, _ARCH + _STAGE_HEIGHT)),
        ((-_OPENING / 2 - 0.5, 0.0, _ARCH + _STAGE_HEIGHT), (_OPENING / 2 + 0.5, 0.4, _ARCH + _STAGE_HEIGHT + 0.5)),
    ):
        builder.box("frame", low, top, _GILT)
    # The stalls: a level floor in front, then a step a row.
    builder.wall("floor", z, +1, 0.0, (across, [0.0, 2.0], up), _CARPET)
    for row in range(_ROWS):
        front, rise = 2.0 + row * _ROW, row * _RISE
        end = front + _ROW if row < _ROWS - 1 else _DEPTH
        builder.wall("floor", z, +1, rise, (across, [front, end], up), _CARPET)
        if row:
            builder.wall("floor", y, -1, front, (across, along, [rise - _RISE, rise]), _CARPET)
    # The balcony: steps above, a parapet, and a flat underside.
    front = _DEPTH - _BALCONY_ROWS * _ROW - 0.3
    builder.box("balcony", (-side, front - 0.25, _BALCONY_Z - 0.6), (side, front, _BALCONY_Z + 0.75), _PLASTER)
    builder.wall("balcony", z, -1, _BALCONY_Z - 0.6, (across, [front, _DEPTH], up), _CEILING)
    for row in range(_BALCONY_ROWS):
        start, rise = front + 0.1 + row * _ROW if row else front, _BALCONY_Z + row * _BALCONY_RISE
        end = front + 0.1 + (row + 1) * _ROW if row < _BALCONY_ROWS - 1 else _DEPTH
        builder.wall("balcony", z, +1, rise, (across, [start, end], up), _CARPET)
        if row:
            builder.wall("balcony", y, -1, start, (across, along, [rise - _BALCONY_RISE, rise]), _CARPET)


def _stage(builder: Builder) -> None:
    """Curtains in folds, a back cloth, steps and a table."""
    top = _ARCH + _STAGE_HEIGHT + 1.0
    for sign in (-1.0, 1.0):
        edge = sign * (_OPENING / 2 - 2.2)
        # Eleven folds, seen from both sides.
        places = [(edge + sign * 0.28 * k, -0.6 - 0.22 * (k % 2)) for k in range(12)]
        for (x0, y0), (x1, y1) in pairwise(places):
            sheet = [(x0, y0, _STAGE_HEIGHT), (x1, y1, _STAGE_HEIGHT), (x1, y1, top), (x0, y0, top)]
            builder.polygon("curtains", sheet, _CURTAIN)
            # Cut along the same diagonal as the front: two triangles back to back, not four that overlap.
            builder.polygon("curtains", [sheet[0], *sheet[:0:-1]], _CURTAIN)
    cloth = _STAGE_DEPTH - 0.8
    builder.wall(
        "back cloth", 1, +1, -cloth, ([-9.0, -4.5, 0.0, 4.5, 9.0], [-cloth], [_STAGE_HEIGHT, 5.0, 10.0]), _CLOTH
    )
    for k in range(5):
        low = (-3.5 + 0.25 * k, -8.0 + 0.4 * k, _STAGE_HEIGHT)
        builder.box("steps", low, (3.5 - 0.25 * k, -5.0 - 0.1 * k, _STAGE_HEIGHT + 0.2 * (k + 1)), (0.5, 0.48, 0.44))
    z = _STAGE_HEIGHT
    builder.box("table", (-1.0, -2.9, z + 0.74), (1.0, -1.9, z + 0.8), _WOOD)
    for x in (-0.95, 0.87):
        for y in (-2.85, -2.03):
            builder.box("table", (x, y, z), (x + 0.08, y + 0.08, z + 0.74), _WOOD)


def _seats(builder: Builder, y: float, z: float, reach: float, gap: float) -> None:
    """Add a row of seats at depth y that face the stage, from -reach to reach with an aisle in the middle."""
    count = int((reach - gap) / _SEAT)
    for sign in (-1.0, 1.0):
        for k in range(count):
            centre = sign * (gap + (k + 0.5) * _SEAT)
            low, high = centre - 0.5 * _SEAT + 0.04, centre + 0.5 * _SEAT - 0.04
            builder.box("seats", (low, y, z + 0.34), (high, y + 0.46, z + 0.44), _VELVET)
            builder.box("seats", (low, y + 0.46, z + 0.34), (high, y + 0.55, z + 0.92), _VELVET)
            builder.box("seats", (low + 0.06, y + 0.44, z + 0.92), (high - 0.06, y + 0.54, z + 1.02), _VELVET)
            builder.box("armrests", (high - 0.02, y + 0.04, z + 0.62), (high + 0.1, y + 0.5, z + 0.66), _WOOD)
            builder.box("seat legs", (high, y + 0.08, z), (high + 0.08, y + 0.5, z + 0.62), _WOOD)
            builder.box("seat feet", (centre - 0.05, y + 0.2, z), (centre + 0.05, y + 0.3, z + 0.34), _DARK)


def _lights(builder: Builder) -> None:
    """Panels in the ceiling of the hall; spotlights on two bars, aimed at the stage."""
    for x in (-7.5, -2.5, 2.5, 7.5):
        for y in (3.5, 9.0, 14.5, 20.0):
            # A tray 5 mm deep under its rim: in one plane with the rim, or open at the sides, backs would be seen.
            z = _HEIGHT - 0.05
            tray = ([x - 0.6, x + 0.6], [y - 0.6, y + 0.6], [z - 0.005, z + 0.01])
            builder.wall("ceiling lights", 2, -1, z - 0.005, tray, _LAMP, _CEILING_LIGHT)
            for axis, middle in enumerate((x, y)):
                builder.wall("light rims", axis, -1, middle - 0.6, tray, _GILT)
                builder.wall("light rims", axis, +1, middle + 0.6, tray, _GILT)
            builder.box("light rims", (x - 0.66, y - 0.66, z), (x + 0.66, y + 0.66, _HEIGHT - 0.001), _GILT)
    for k, x in enumerate((-6.0, -3.0, 0.0, 3.0, 6.0)):
        for y, aim in ((6.0, -3.0), (7.5, -5.5)):
            light = _SPOT_BLUE if k in (0, 4) else _SPOT_LIGHT
            _spotlight(builder, (x, y, _HEIGHT - 1.0), (0.35 * x, aim, _STAGE_HEIGHT), light)


def _spotlight(
    builder: Builder,
    origin: tuple[float, float, float],
    target: tuple[float, float, float],
    emission: tuple[float, float, float],
) -> None:
    """Add an octagonal tube, black inside, with a bright plate deep in it: light leaves in a cone of 25 degrees."""
    ahead = [t - o for t, o in zip(target, origin, strict=True)]
    length = math.sqrt(sum(a * a for a in ahead))
    w = [a / length for a in ahead]
    # Two directions across; w is never straight up here.
    size = math.hypot(w[0], w[1])
    u = [w[1] / size, -w[0] / size, 0.0]
    v = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]]

    def ring(radius: float, along: float) -> list[list[float]]:
        angles = [k * math.pi / 4 for k in range(8)]
        return [
            [
                o + along * c + radius * (math.cos(t) * a + math.sin(t) * b)
                for o, a, b, c in zip(origin, u, v, w, strict=True)
            ]
            for t in angles
        ]

    back, plate, mouth = ring(0.16, -0.06), ring(0.15, 0.0), ring(0.15, 0.62)
    outside = ring(0.16, 0.62)
    # u, v, w are left-handed or right-handed as it comes: the plate has to face along w.
    normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    turn = 1 if sum(a * b for a, b in zip(normal, w, strict=True)) > 0.0 else -1
    builder.polygon("spotlights", plate[::turn], _LAMP, emission)
    builder.polygon("spotlight tubes", back[::-turn], _DARK)
    for k in range(8):
        after = (k + 1) % 8
        inner = [plate[after], plate[k], mouth[k], mouth[after]]
        outer = [back[k], back[after], outside[after], outside[k]]
        rim = [mouth[k], outside[k], outside[after], mouth[after]]
        for sides in (inner, outer, rim):
            builder.polygon("spotlight tubes", sides[::turn], _DARK)
