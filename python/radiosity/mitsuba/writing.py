"""Scenes to Mitsuba: triangles, diffuse reflectance, area emitters, mirrors and glass, lights that are no patches."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray
from ..lights import Light, Sky, SpotLight, Sun, lights_of

if TYPE_CHECKING:
    from ..scene import Scene

from .variant import mitsuba_with_rgb

# The distance, in scene sizes, from which a patch is looked at, and by which a patch and its reversed twin are moved
# apart. Well under what Mitsuba's own ray lift ignores (4.5e-5), well over the rounding of a 32-bit coordinate (3e-8).
HAIR = 5e-6
# Of the image that a sky becomes, odd: one row lies at the horizon. Twice as many columns.
_SKY_ROWS = 1025


def to_mitsuba(scene: Scene, lights: Light | Iterable[Light] = ()) -> Any:
    """Return the scene as a `mitsuba.Scene`, ready for `mitsuba.render` with a sensor of your own.

    One band becomes grey, three become RGB. Surfaces are one-sided as in `Scene`: a `diffuse` BSDF with the
    reflectance of each patch as the mesh attribute `face_reflectance`, and an `area` emitter of radiance
    emission / pi. A mirror is a `conductor` without a material, glass a `dielectric`. Consecutive patches of equal
    emission and material share a mesh, and the order of patches is kept.

    Coordinates are kept, rounded to 32 bits, with one exception: a patch and its reversed twin in the same place (as
    `sides="both"` makes them) are each moved by 5e-6 of the scene's size along their normals, because a ray could not
    tell which of the two it meets.

    Lights become emitters: a `Sun` is `directional`, a constant `Sky` `constant`, every other `Sky` an `envmap` of 32
    bits, a `PointLight` `point`, and a `SpotLight` `spot`. Mitsuba takes one sky, and interpolates between the pixels
    of an `envmap`: each cell of a table becomes several, which blurs its borders.

    Sets the Mitsuba variant (see `variant`) if none is set.

    Raises:
        ImportError: Mitsuba is not installed.
        TypeError: `lights` holds something else.
        ValueError: the scene has neither one band nor three, there is more than one sky, or the Mitsuba variant that is
            set cannot be used.

    """
    if scene.bands not in (1, 3):
        raise ValueError(
            f"Mitsuba's RGB variants have three bands and the scene has {scene.bands}: "
            "give to_mitsuba a Scene with three of them (or one, for grey)"
        )
    mi = mitsuba_with_rgb()
    shape = (scene.n_patches, 3)
    corners = apart(scene.vertices[scene.faces])
    reflectance, emission = np.broadcast_to(scene.reflectance, shape), np.broadcast_to(scene.emission, shape)
    known = lights_of(lights, scene.bands)
    return build(mi, corners, reflectance, emission, specular_of(scene), emitters(mi, known))


def specular_of(scene: Scene) -> FloatArray:
    """Return what each patch mirrors and its index of refraction, (n, 2); 0 where it does neither."""
    return np.stack([scene.mirror, np.nan_to_num(scene.ior)], axis=1)


def build(
    mi: Any,
    corners: FloatArray,
    reflectance: FloatArray,
    emission: FloatArray,
    specular: FloatArray,
    lights: dict[str, Any] | None = None,
) -> Any:
    """Build a Mitsuba scene from triangles (n, 3, 3), reflectance, emission in W/m^2 (n, 3) and `specular_of` (n, 2).

    A mesh for each run of equal emission and material: Mitsuba 3.9 accepts a `mesh_attribute` as the radiance of an
    area light, but its light sampling then silently finds no light.
    """
    bsdf = mi.load_dict({"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "face_reflectance"}})
    areas = 0.5 * np.linalg.norm(twice_area_vectors(corners), axis=1)
    starts = run_starts(emission, specular)
    content: dict[str, Any] = {"type": "scene", "integrator": {"type": "path"}, **(lights or {})}
    for start, stop in zip(starts, [*starts[1:], len(corners)], strict=True):
        properties = mi.Properties()
        properties["bsdf"] = _specular_bsdf(mi, *specular[start]) if specular[start].any() else bsdf
        if emission[start].any():
            properties["emitter"] = mi.load_dict(
                {
                    "type": "area",
                    "radiance": {"type": "rgb", "value": (emission[start] / math.pi).tolist()},
                    # Light sampling in proportion to power.
                    "sampling_weight": float(areas[start:stop].sum() * emission[start].mean()),
                }
            )
        # Leading zeros: Mitsuba sorts shapes by name.
        name = f"patches_{start:09d}"
        content[name] = _mesh(mi, name, corners[start:stop], reflectance[start:stop], properties)
    return mi.load_dict(content)


def emitters(
    mi: Any, lights: tuple[Light, ...], unit: float = 1.0, shift: Any = 0.0, scale: float = 1.0
) -> dict[str, Any]:
    """Return the emitters of lights of one or three bands, as `mitsuba.load_dict` takes them.

    Their strength is divided by `unit`; places x become scale * (x - shift), and what shines from one place then shines
    scale^2 times as much for the same irradiance.
    """
    if sum(isinstance(light, Sky) for light in lights) > 1:
        raise ValueError("Mitsuba takes one sky, and there are several: add their radiances up in one table")
    content: dict[str, Any] = {}
    for k, light in enumerate(lights):
        name = f"light_{k:05d}"
        if isinstance(light, Sky):
            content[name] = _sky(mi, light, unit)
        elif isinstance(light, Sun):
            away = [-x for x in light.towards]
            content[name] = {"type": "directional", "direction": away, "irradiance": _rgb(light.irradiance / unit)}
        else:
            place = scale * (np.asarray(light.position) - shift)
            intensity = _rgb(light.intensity * (scale**2 / unit))
            if isinstance(light, SpotLight):
                # Any direction across the axis will do for up.
                up = np.eye(3)[int(np.argmin(np.abs(light.axis)))]
                matrix = mi.ScalarTransform4f().look_at(place.tolist(), (place + light.axis).tolist(), up.tolist())
                content[name] = {
                    "type": "spot",
                    "to_world": matrix,
                    "intensity": intensity,
                    "cutoff_angle": light.cutoff,
                    "beam_width": light.beam,
                }
            else:
                content[name] = {"type": "point", "position": place.tolist(), "intensity": intensity}
    return content


def _rgb(values: FloatArray) -> dict[str, Any]:
    return {"type": "rgb", "value": np.broadcast_to(values, 3).tolist()}


def _sky(mi: Any, sky: Sky, unit: float) -> dict[str, Any]:
    """Return a `constant` or an `envmap`: its own zenith is +y, its azimuth 0 is -z, clockwise from above."""
    if sky.distribution == "constant":
        return {"type": "constant", "radiance": _rgb(sky.radiance / unit)}
    # Rows of pixels lie at the polar angles pi r / (R - 1), columns in the middle of theirs.
    polar = math.pi * np.arange(_SKY_ROWS) / (_SKY_ROWS - 1)
    if sky.distribution == "overcast":
        up = np.cos(polar)
        # At the horizon, where it ends, half of it.
        bright = np.where(np.abs(up) < 1e-9, 0.5, up > 0.0) * (1.0 + 2.0 * up) / 3.0
        pixels = np.broadcast_to(bright[:, None, None] * sky.radiance, (_SKY_ROWS, 2 * _SKY_ROWS, sky.radiance.size))
    else:
        rows, columns = sky.radiance.shape[:2]
        row = np.minimum((polar / math.pi * rows).astype(int), rows - 1)
        width = columns * max(1, math.ceil(2 * _SKY_ROWS / columns))
        column = np.arange(width) * columns // width
        pixels = sky.radiance[row[:, None], column[None, :]]
    image = np.broadcast_to(pixels / unit, (*pixels.shape[:2], 3)).astype(np.float32)
    up, north = np.asarray(sky.up), np.asarray(sky.north)
    north = unit_vectors((north - (north @ up) * up)[None])[0]
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([np.cross(north, up), up, -north], axis=1)
    bitmap = mi.Bitmap(np.ascontiguousarray(image))
    return {"type": "envmap", "bitmap": bitmap, "to_world": mi.ScalarTransform4f(matrix)}


def _specular_bsdf(mi: Any, mirror: float, ior: float) -> Any:
    if ior > 0.0:
        return mi.load_dict({"type": "dielectric", "int_ior": ior, "ext_ior": 1.0})
    reflected = {"type": "rgb", "value": [mirror] * 3}
    return mi.load_dict({"type": "conductor", "material": "none", "specular_reflectance": reflected})


def run_starts(emission: FloatArray, specular: FloatArray) -> list[int]:
    """Return the first patch of each run of patches with the same emission (n, 3) and `specular_of` (n, 2)."""
    both = np.hstack([emission, specular])
    changes = np.flatnonzero((both[1:] != both[:-1]).any(axis=1)) + 1
    return [0, *changes.tolist()]


def _mesh(mi: Any, name: str, corners: FloatArray, reflectance: FloatArray, properties: Any) -> Any:
    vertices, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    mesh = mi.Mesh(name, len(vertices), len(corners), properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel().astype(np.float32)
    parameters["faces"] = faces.ravel().astype(np.uint32)
    parameters.update()
    mesh.add_attribute("face_reflectance", 3, reflectance.ravel().astype(np.float32))
    return mesh


def twice_area_vectors(corners: FloatArray) -> FloatArray:
    """Return the normals (n, 3) of triangles (n, 3, 3), of length 2 A: the right-hand rule."""
    vectors: FloatArray = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return vectors


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """Return vectors (n, 3) of length 1."""
    unit: FloatArray = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def apart(corners: FloatArray) -> FloatArray:
    """Move triangles (n, 3, 3) that lie in one place a hair along their normals; leave all others as they are.

    The hair grows with the coordinates, so that it survives their rounding to 32 bits.
    """
    _, point = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    _, place, count = np.unique(np.sort(point.reshape(-1, 3), axis=1), axis=0, return_inverse=True, return_counts=True)
    together = count[place.ravel()] > 1
    size = np.ptp(corners.reshape(-1, 3), axis=0).max()
    rounding = float(np.spacing(np.float32(np.abs(corners).max())))
    hair = max(HAIR * size, 4.0 * rounding)
    moved = corners.copy()
    moved[together] += hair * unit_vectors(twice_area_vectors(corners[together]))[:, None, :]
    return moved
