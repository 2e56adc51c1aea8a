"""Light that no patch emits: suns, skies, points and spots, and what they bring straight to every patch.

The radiosity equation stays linear: with the irradiance H0 of such lights, occlusion included,

    B = E + rho (H0 + F B)

:func:`radiosity.solve` takes them as ``lights=``; :func:`direct_irradiance` gives H0 alone, and
:func:`sky_coefficients` a matrix that serves every sky.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from . import _core
from .arrays import (
    FloatArray,
    read_only,
    real_array,
    real_number,
    seed_number,
    shaped,
    thread_count,
    whole_number,
)
from .memory import available_bytes
from .progress import Progress, reporter
from .scene import Scene

Vector: TypeAlias = tuple[float, float, float]

DISTRIBUTIONS = ("constant", "overcast", "table")
# Of coordinates, m: lengths are squared, and squares must not overflow.
_FARTHEST = 1e150
# Rows and columns of a table of a sky, and rays of daylight coefficients.
_MOST_CELLS = 1 << 16
_MOST_RAYS = 1 << 24


@dataclass(frozen=True, eq=False)
class Sun:
    """A light so far away that it comes from one direction only.

    Args:
        towards: (3,) the direction in which the sun is seen from the scene, of any length. Its light goes the other
            way.
        irradiance: on a plane across that direction, W/m^2; a scalar or (b,).

    Raises:
        TypeError, ValueError: no direction, or an irradiance that is negative or not finite.
    """

    towards: Vector
    irradiance: Any

    def __post_init__(self) -> None:
        object.__setattr__(self, "towards", _direction("sun towards", self.towards))
        object.__setattr__(self, "irradiance", _spectrum("sun irradiance", self.irradiance))


@dataclass(frozen=True, eq=False)
class Sky:
    """Light from all directions, far away.

    ``"constant"`` is as bright everywhere, below the horizon too: a scene without ground is lit from there.
    ``"overcast"`` is the standard overcast sky of the CIE, L = L_z (1 + 2 sin gamma) / 3 at the height gamma above the
    horizon, and dark below. :meth:`table` makes a sky of cells.

    Args:
        radiance: L, W/(m^2 sr), a scalar or (b,): of an overcast sky that of the zenith, L_z. Of a table
            (rows, columns) or (rows, columns, b).
        distribution: ``"constant"``, ``"overcast"`` or ``"table"``.
        up: (3,) the direction of the zenith, of any length.
        north: (3,) where the azimuth of a table begins; what it has along ``up`` does not count.

    Raises:
        TypeError, ValueError: an unknown distribution, directions that are none or one and the same, or a radiance
            that is negative, not finite or of another shape.

    Source: Moon & Spencer 1942 (overcast).
    """

    radiance: Any
    distribution: str = "constant"
    up: Vector = (0.0, 0.0, 1.0)
    north: Vector = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        if self.distribution not in DISTRIBUTIONS:
            raise ValueError(f"unknown distribution {self.distribution!r} of a sky; there are {DISTRIBUTIONS}")
        up, north = _axes(self.up, self.north, self.distribution == "table")
        object.__setattr__(self, "up", up)
        object.__setattr__(self, "north", north)
        if self.distribution == "table":
            table = real_array("sky radiance", self.radiance)
            table = table[:, :, None] if table.ndim == 2 else table
            if table.ndim != 3 or 0 in table.shape or max(table.shape[:2]) > _MOST_CELLS:
                raise ValueError(
                    f"the radiance of a table of a sky must have shape (rows, columns) or (rows, columns, b), up to "
                    f"{_MOST_CELLS} rows and columns, not {np.shape(self.radiance)}"
                )
            object.__setattr__(self, "radiance", _strength("sky radiance", table))
        else:
            object.__setattr__(self, "radiance", _spectrum("sky radiance", self.radiance))

    @classmethod
    def table(cls, radiance: Any, up: Any = (0.0, 0.0, 1.0), north: Any = (0.0, 1.0, 0.0)) -> Sky:
        """A sky of cells of even radiance: an equirectangular image, such as an environment map.

        Row r of R holds the polar angles from pi r / R to pi (r + 1) / R: row 0 is around the zenith, the last around
        the nadir. Column c of C holds the azimuths from 2 pi c / C to 2 pi (c + 1) / C, counted from ``north`` by east:
        clockwise seen from above. East is ``north`` x ``up``, +x by default.

        Args:
            radiance: (rows, columns) or (rows, columns, b), W/(m^2 sr).
            up: (3,) the direction of the zenith.
            north: (3,) the direction of azimuth 0.

        Raises:
            TypeError, ValueError: as for :class:`Sky`.
        """
        return cls(radiance, "table", up, north)


@dataclass(frozen=True, eq=False)
class PointLight:
    """A light in one place that shines alike in all directions.

    Args:
        position: (3,) where it is, m. It may hang in the scene or outside.
        intensity: W/sr; a scalar or (b,). The power is 4 pi times that.

    Raises:
        TypeError, ValueError: no position, or an intensity that is negative or not finite.
    """

    position: Vector
    intensity: Any

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _position("point light position", self.position))
        object.__setattr__(self, "intensity", _spectrum("point light intensity", self.intensity))


@dataclass(frozen=True, eq=False)
class SpotLight:
    """A light in one place that shines in a cone.

    All of the intensity goes into directions within ``beam`` of the axis; from there it falls linearly with the angle,
    to nothing at ``cutoff``.

    Args:
        position: (3,) where it is, m.
        target: (3,) a point on its axis, m.
        intensity: on the axis, W/sr; a scalar or (b,).
        cutoff: degrees from the axis to the edge of all light, in (0, 180].
        beam: degrees from the axis to the edge of the full beam, in [0, cutoff]; None for three quarters of ``cutoff``.

    Raises:
        TypeError, ValueError: a target at the position, angles out of range, or an intensity that is negative or not
            finite.
    """

    position: Vector
    target: Vector
    intensity: Any
    cutoff: float = 20.0
    beam: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _position("spot light position", self.position))
        object.__setattr__(self, "target", _position("spot light target", self.target))
        if self.position == self.target:
            raise ValueError(f"spot light target {self.target} is the same point as its position")
        cutoff = real_number("spot light cutoff", self.cutoff)
        if not 0.0 < cutoff <= 180.0:
            raise ValueError(f"spot light cutoff {cutoff:g} is outside (0, 180] degrees")
        beam = 0.75 * cutoff if self.beam is None else real_number("spot light beam", self.beam)
        if not 0.0 <= beam <= cutoff:
            raise ValueError(f"spot light beam {beam:g} is outside [0, cutoff = {cutoff:g}] degrees")
        object.__setattr__(self, "cutoff", cutoff)
        object.__setattr__(self, "beam", beam)
        object.__setattr__(self, "intensity", _spectrum("spot light intensity", self.intensity))

    @property
    def axis(self) -> Vector:
        """(3,) the unit vector from the light along its axis."""
        x, y, z = (there - here for here, there in zip(self.position, self.target, strict=True))
        return _direction("spot light axis", (x, y, z))


Light: TypeAlias = Sun | Sky | PointLight | SpotLight
_STRENGTHS = {Sun: "irradiance", Sky: "radiance", PointLight: "intensity", SpotLight: "intensity"}


def direct_irradiance(
    scene: Scene,
    lights: Light | Iterable[Light],
    tolerance: float = 0.01,
    *,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = True,
) -> tuple[FloatArray, FloatArray]:
    """The irradiance H0 that lights bring straight to every patch, with what stands in their way.

    Suns and point lights that nothing hides are exact (cosine; solid angle of the patch over its area); of what is
    hidden in part, and of skies, quasi-random points and directions are taken until the tolerance is met. H0 of several
    lights is the sum of that of each: call it light by light where they are switched or move by themselves.

    Args:
        scene: the patches. What they emit is no part of H0.
        lights: one of :class:`Sun`, :class:`Sky`, :class:`PointLight`, :class:`SpotLight`, or several.
        tolerance: relative error (area-weighted RMS, the worst band) from sampling, in (0, 1).
        seed: of the quasi-random points.
        threads: None for all cores. The result is the same for any number.
        progress: see :mod:`radiosity.progress`.

    Returns:
        H0 (n, b) and its standard error (n, b), patch averages, W/m^2. The error is 0 where nothing can hide a light,
        and also where all samples have agreed: of a patch that is hidden in a corner it may be too small. The tolerance
        is about all patches together.

    Raises:
        TypeError, ValueError: no scene, no light, a light of other bands, values out of range, mirrors or glass.
        MemoryError: the result would not fit.

    Warns:
        UserWarning: the tolerance was not met; the message says what was.

    Source: Van Oosterom & Strackee 1983 (solid angle).
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}")
    known = lights_of(lights, scene.bands)
    if not 0.0 < real_number("tolerance", tolerance) < 1.0:
        raise ValueError(f"tolerance {tolerance} is outside (0, 1)")
    with reporter(progress, "lights") as report:
        values, error, reached = _core.direct_irradiance(
            scene._core,
            core_lights(known, scene.bands),
            float(tolerance),
            seed_number(seed),
            available_bytes(),
            thread_count(threads),
            report,
        )
    if not np.isfinite(values).all():
        patch, band = np.argwhere(~np.isfinite(values))[0].tolist()
        raise ValueError(
            f"patch {patch}: its direct irradiance comes out as {values[patch, band]:g} (band {band}): the lights are "
            "near the limits of floating-point numbers; choose other units"
        )
    if reached > tolerance:
        warnings.warn(
            f"the error of the direct light is about {reached:.2g}, above the tolerance {tolerance:g}",
            UserWarning,
            stacklevel=2,
        )
    return read_only(values), read_only(error)


def sky_coefficients(
    scene: Scene,
    rows: int,
    columns: int,
    *,
    rays: int = 1024,
    up: Any = (0.0, 0.0, 1.0),
    north: Any = (0.0, 1.0, 0.0),
    seed: int = 0,
    threads: int | None = None,
    progress: Progress = True,
) -> FloatArray:
    """The daylight coefficients C of every patch: what each cell of a sky contributes, for any sky of those cells.

    H0 = C @ L with the radiance L of the cells, ``sky.radiance.reshape(rows * columns, b)`` of a :meth:`Sky.table` of
    the same ``up`` and ``north``. C[i, c] is the projected solid angle of what patch i sees of cell c, sr.

    Args:
        scene: the patches.
        rows: of cells, from the zenith to the nadir.
        columns: of cells, around.
        rays: quasi-random rays a patch, each worth pi / rays: a sum over many cells is better than about
            1 / sqrt(rays) of pi.
        up: (3,) the direction of the zenith.
        north: (3,) the direction of azimuth 0.
        seed: of the rays.
        threads: None for all cores. The result is the same for any number.
        progress: see :mod:`radiosity.progress`.

    Returns:
        (n, rows * columns), sr.

    Raises:
        TypeError, ValueError: no scene, values out of range, mirrors or glass.
        MemoryError: the matrix would not fit.

    Source: Tregenza & Waters, "Daylight coefficients", 1983.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}")
    zenith, start = _axes(up, north, True)
    with reporter(progress, "sky") as report:
        return _core.sky_coefficients(
            scene._core,
            whole_number("rows", rows, 1, _MOST_CELLS),
            whole_number("columns", columns, 1, _MOST_CELLS),
            zenith,
            start,
            whole_number("rays", rays, 1, _MOST_RAYS),
            seed_number(seed),
            available_bytes(),
            thread_count(threads),
            report,
        )


def lights_of(lights: Any, bands: int) -> tuple[Light, ...]:
    """The lights as a tuple, their strengths spread over so many bands; ``TypeError`` or ``ValueError`` by number."""
    if isinstance(lights, (Sun, Sky, PointLight, SpotLight)):
        lights = (lights,)
    try:
        known = tuple(lights)
    except TypeError:
        raise TypeError(f"lights must be lights, not {type(lights).__name__}") from None
    for k, light in enumerate(known):
        if not isinstance(light, (Sun, Sky, PointLight, SpotLight)):
            raise TypeError(f"light {k} must be a Sun, Sky, PointLight or SpotLight, not {type(light).__name__}")
        width = strength(light).shape[-1]
        if width not in (1, bands):
            raise ValueError(f"light {k}: its {_STRENGTHS[type(light)]} has {width} bands, and the scene has {bands}")
    return tuple(with_strength(light, _in_bands(strength(light), bands)) for light in known)


def strength(light: Light) -> FloatArray:
    """What a light is measured by, its bands last."""
    values: FloatArray = getattr(light, _STRENGTHS[type(light)])
    return values


def spectra(lights: tuple[Light, ...]) -> FloatArray:
    """(k, b) all spectra of lights of as many bands, of every cell of a sky."""
    return np.vstack([strength(light).reshape(-1, strength(light).shape[-1]) for light in lights])


def told(lights: tuple[Light, ...]) -> list[dict[str, Any]]:
    """All that lights are, as plain numbers and words."""
    return [
        {"kind": type(light).__name__}
        | {part.name: np.asarray(getattr(light, part.name)).tolist() for part in dataclasses.fields(light)}
        for light in lights
    ]


def in_chosen_bands(lights: tuple[Light, ...], bands: Any) -> tuple[Light, ...]:
    """The same lights with some of their bands."""
    return tuple(with_strength(light, strength(light)[..., bands]) for light in lights)


def core_lights(lights: tuple[Light, ...], bands: int) -> _core.Lights:
    """The lights as the core takes them."""
    suns = [(light.towards, light.irradiance.tolist()) for light in lights if isinstance(light, Sun)]
    points: list[tuple[Vector, list[float], tuple[Vector, float, float] | None]] = []
    for light in lights:
        if isinstance(light, PointLight):
            points.append((light.position, light.intensity.tolist(), None))
        elif isinstance(light, SpotLight):
            assert light.beam is not None
            cone = (light.axis, math.radians(light.beam), math.radians(light.cutoff))
            points.append((light.position, light.intensity.tolist(), cone))
    skies = [
        (light.distribution, *_cells(light), light.up, light.north, light.radiance.reshape(-1, bands))
        for light in lights
        if isinstance(light, Sky)
    ]
    return _core.Lights(bands, suns, points, skies)


def _cells(sky: Sky) -> tuple[int, int]:
    """Rows and columns of a sky, 1 each where it is no table."""
    rows, columns = sky.radiance.shape[:2] if sky.distribution == "table" else (1, 1)
    return rows, columns


def _in_bands(values: FloatArray, bands: int) -> FloatArray:
    return np.ascontiguousarray(np.broadcast_to(values, (*values.shape[:-1], bands)))


def with_strength(light: Light, values: FloatArray) -> Light:
    """The same light with another strength."""
    changed: dict[str, Any] = {_STRENGTHS[type(light)]: values}
    return dataclasses.replace(light, **changed)


def _strength(name: str, values: FloatArray) -> FloatArray:
    if not (np.isfinite(values).all() and (values >= 0.0).all()):
        bad = values[~(np.isfinite(values) & (values >= 0.0))][0]
        raise ValueError(f"{name} {bad:g} is outside [0, inf)")
    return read_only(np.array(values, np.float64))


def _spectrum(name: str, value: Any) -> FloatArray:
    values = np.atleast_1d(real_array(name, value))
    if values.ndim != 1 or not values.size:
        raise ValueError(f"{name} must be a scalar or (b,), not of shape {values.shape}")
    return _strength(name, values)


def _position(name: str, value: Any) -> Vector:
    point = shaped(name, value, 3)
    if not (np.abs(point) <= _FARTHEST).all():
        raise ValueError(f"{name} {tuple(point.tolist())} is outside [-{_FARTHEST:g}, {_FARTHEST:g}] m")
    x, y, z = point.tolist()
    return x, y, z


def _direction(name: str, value: Any) -> Vector:
    x, y, z = _position(name, value)
    largest = max(abs(x), abs(y), abs(z))
    if largest == 0.0:
        raise ValueError(f"{name} {(x, y, z)} has no direction")
    if abs(math.hypot(x, y, z) - 1.0) <= 4.0 * np.finfo(float).eps:
        # What is of unit length stays as it is: copies, and what comes back from files, to the bit.
        return x, y, z
    x, y, z = x / largest, y / largest, z / largest
    length = math.hypot(x, y, z)
    return x / length, y / length, z / length


def _axes(up: Any, north: Any, is_table: bool) -> tuple[Vector, Vector]:
    """The unit vectors of zenith and of azimuth 0, which must not be along each other where an azimuth counts."""
    zenith, start = _direction("sky up", up), _direction("sky north", north)
    # An angle below 1e-9 between them leaves the azimuth to rounding.
    if is_table and not np.linalg.norm(np.cross(zenith, start)) > 1e-9:
        raise ValueError(f"sky north {start} is along up; choose another, such as (1, 0, 0)")
    return zenith, start
