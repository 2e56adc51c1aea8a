"""Scenes to Mitsuba: triangles, diffuse reflectance, area emitters, mirrors and glass."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray

if TYPE_CHECKING:
    from ..scene import Scene

from .variant import mitsuba_with_rgb

# The distance, in scene sizes, from which a patch is looked at, and by which a patch and its reversed twin are moved
# apart. Well under what Mitsuba's own ray lift ignores (4.5e-5), well over the rounding of a 32-bit coordinate (3e-8).
HAIR = 5e-6


def to_mitsuba(scene: Scene) -> Any:
    """Return the scene as a `mitsuba.Scene`, ready for `mitsuba.render` with a sensor of your own.

    One band becomes grey, three become RGB. Surfaces are one-sided as in `Scene`: a `diffuse` BSDF with the
    reflectance of each patch as the mesh attribute `face_reflectance`, and an `area` emitter of radiance
    emission / pi. A mirror is a `conductor` without a material, glass a `dielectric`. Consecutive patches of equal
    emission and material share a mesh, and the order of patches is kept.

    Coordinates are kept, rounded to 32 bits, with one exception: a patch and its reversed twin in the same place (as
    `sides="both"` makes them) are each moved by 5e-6 of the scene's size along their normals, because a ray could not
    tell which of the two it meets.

    Sets the Mitsuba variant (see `variant`) if none is set.

    Raises:
        ImportError: Mitsuba is not installed.
        ValueError: the scene has neither one band nor three, or the Mitsuba variant that is set cannot be used.

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
    return build(mi, corners, reflectance, emission, specular_of(scene))


def specular_of(scene: Scene) -> FloatArray:
    """Return what each patch mirrors and its index of refraction, (n, 2); 0 where it does neither."""
    return np.stack([scene.mirror, np.nan_to_num(scene.ior)], axis=1)


def build(mi: Any, corners: FloatArray, reflectance: FloatArray, emission: FloatArray, specular: FloatArray) -> Any:
    """Build a Mitsuba scene from triangles (n, 3, 3), reflectance, emission in W/m^2 (n, 3) and `specular_of` (n, 2).

    A mesh for each run of equal emission and material: Mitsuba 3.9 accepts a `mesh_attribute` as the radiance of an
    area light, but its light sampling then silently finds no light.
    """
    bsdf = mi.load_dict({"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "face_reflectance"}})
    areas = 0.5 * np.linalg.norm(twice_area_vectors(corners), axis=1)
    starts = run_starts(emission, specular)
    content: dict[str, Any] = {"type": "scene", "integrator": {"type": "path"}}
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
