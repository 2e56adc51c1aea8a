"""Scenes from Mitsuba: what of them is diffuse, a mirror or glass, and made of triangles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .variant import is_scalar, mitsuba_with_rgb
from .writing import twice_area_vectors

if TYPE_CHECKING:
    from ..scene import Scene


def from_mitsuba(mi_scene: Any) -> Scene:
    """Return a `Scene` of three bands with the triangles of a `mitsuba.Scene` of an RGB variant.

    Taken over: shapes that are meshes (files, `cube`, `rectangle`), `diffuse` BSDFs, `conductor` without a material (a
    perfect mirror, grey), both also `twosided`, clear `dielectric`, and `area` emitters. Patches come in the order of
    `mi_scene.shapes()` and are named after their shapes. A texture becomes its mean over each triangle (16 points).
    Vertex normals decide which side is the front, as in Mitsuba; the smooth shading they give is left out.

    A `twosided` shape becomes two patches per triangle: the front one, and after all front ones of the shape a
    reversed copy in the same place with the reflectance of the back. Only the front emits, as in Mitsuba.

    Raises:
        ImportError: Mitsuba is not installed.
        ValueError: something else is in the scene (a sphere that is no mesh, a metal, a point light, ...); every such
            shape and light is named. Or no shape at all, or the Mitsuba variant that is set cannot be used.

    """
    from ..scene import Scene

    mi = mitsuba_with_rgb()
    if not isinstance(mi_scene, mi.Scene):
        raise TypeError(f"mi_scene must be a mitsuba.Scene of variant {mi.variant()}, not {type(mi_scene).__name__}")
    shapes = list(mi_scene.shapes())
    problems = [problem for shape in shapes for problem in _shape_problems(mi, shape)]
    problems += [
        f"light {light.id()!r} is a {light.class_name()}: only area emitters have a radiosity"
        for light in mi_scene.emitters()
        if light.class_name() != "AreaLight"
    ]
    if not shapes:
        problems.append("it has no shapes")
    if problems:
        raise ValueError("the Mitsuba scene cannot become a Scene:\n" + "\n".join(f"  {text}" for text in problems))

    vertices: list[npt.NDArray[Any]] = []
    faces: list[npt.NDArray[Any]] = []
    reflectance: list[FloatArray] = []
    emission: list[FloatArray] = []
    mirror: list[FloatArray] = []
    ior: list[FloatArray] = []
    names: list[str] = []
    first = 0
    for shape in shapes:
        points = np.array(shape.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
        triangles = np.array(shape.faces_buffer(), dtype=np.int64).reshape(-1, 3)
        front = _front_faces(shape, points, triangles)
        for side in (1, -1) if _is_twosided(shape) else (1,):
            mirrored, index = _specular(mi, shape, side)
            mirror.append(np.full(len(front), mirrored))
            ior.append(np.full(len(front), index))
            rho, radiance = _face_materials(mi, shape, points, triangles, side)
            if mirrored > 0.0 or index > 0.0:
                rho = np.zeros_like(rho)
            faces.append(first + front[:, ::side])
            reflectance.append(rho)
            emission.append(math.pi * radiance)
            names += [str(shape.id())] * len(front)
        vertices.append(points)
        first += len(points)
    return Scene(
        np.concatenate(vertices),
        np.concatenate(faces),
        reflectance=np.concatenate(reflectance),
        emission=np.concatenate(emission),
        names=names,
        mirror=np.concatenate(mirror),
        ior=np.concatenate(ior),
    )


def _is_twosided(shape: Any) -> bool:
    return str(shape.bsdf().class_name()) == "TwoSidedBRDF"


def _specular(mi: Any, shape: Any, side: int) -> tuple[float, float]:
    """Return what a side of the shape mirrors (0 for none) and its index of refraction (nan for none)."""
    bsdf = shape.bsdf()
    values = mi.traverse(bsdf)
    if bsdf.class_name() == "SmoothDielectric":
        return 0.0, float(np.ravel(values["eta"])[0])
    reflected = _of_side(values, side).get("specular_reflectance.value")
    return (0.0 if reflected is None else float(np.ravel(reflected)[0])), math.nan


def _of_side(values: Any, side: int) -> dict[str, Any]:
    """Return the parameters of the BSDF that a side of a shape has, by their own names."""
    wanted = "brdf_1." if side < 0 and any(key.startswith("brdf_1.") for key, _ in values) else "brdf_0."
    return {
        key.removeprefix(wanted): value
        for key, value in values
        if key.startswith(wanted) or not key.startswith("brdf_")
    }


def _is_mirror(values: Any, side: int) -> bool:
    """Return whether these are parameters of a conductor that reflects alike in all directions and bands."""
    own = _of_side(values, side)
    names = ("eta.value", "k.value", "specular_reflectance.value")
    if not all(name in own for name in names):
        return False
    eta, k, reflected = (np.ravel(own[name]) for name in names)
    # What Mitsuba gives the material "none".
    return bool((eta == 0.0).all() and (k == 1.0).all() and (reflected == reflected[0]).all())


def _is_clear(values: Any) -> bool:
    """Return whether these are parameters of a dielectric that takes nothing from what it reflects and lets through."""
    own = [(key, value) for key, value in values if key.startswith("specular_")]
    return all(key.endswith(".value") and bool((np.ravel(value) == 1.0).all()) for key, value in own)


def _shape_problems(mi: Any, shape: Any) -> list[str]:
    """Say what in this shape has no counterpart in a `Scene`."""
    name = f"shape {shape.id()!r}"
    problems = []
    if not shape.is_mesh():
        problems.append(f"{name} is a {shape.class_name()}, not a mesh: turn it into triangles first")
    bsdf = shape.bsdf()
    sides = int(mi.BSDFFlags.FrontSide) | int(mi.BSDFFlags.BackSide)
    kinds = {int(bsdf.flags(k)) & ~sides for k in range(bsdf.component_count())}
    kind = bsdf.class_name()
    diffuse = kind in ("SmoothDiffuse", "TwoSidedBRDF") and kinds == {int(mi.BSDFFlags.DiffuseReflection)}
    mirror = kind in ("SmoothConductor", "TwoSidedBRDF") and all(_is_mirror(mi.traverse(bsdf), s) for s in (1, -1))
    if kind == "SmoothDielectric" and not _is_clear(mi.traverse(bsdf)):
        problems.append(f"{name} is a dielectric of colour: only one whose specular_... are 1 can be carried")
    if not (diffuse or mirror or kind == "SmoothDielectric"):
        problems.append(
            f"{name} has the BSDF {kind}: only diffuse, conductor of material none (grey), both also twosided, and "
            "dielectric can be carried"
        )
    elif not diffuse and shape.is_emitter():
        problems.append(f"{name} emits and is specular: a mirror or glass has no radiosity of its own")
    if shape.is_medium_transition():
        problems.append(f"{name} bounds a medium: between patches there is only vacuum")
    return problems


def _front_faces(mesh: Any, points: FloatArray, triangles: IntArray) -> IntArray:
    """Return the triangles (n, 3) turned so that the right-hand rule points out of the side Mitsuba shades."""
    turned = np.full(len(triangles), bool(mesh.has_flipped_normals()))
    if mesh.has_vertex_normals() and not mesh.has_face_normals():
        shading = np.array(mesh.vertex_normals_buffer(), dtype=np.float64).reshape(-1, 3)[triangles].sum(axis=1)
        turned ^= np.einsum("ij,ij->i", twice_area_vectors(points[triangles]), shading) < 0.0
    return np.where(turned[:, None], triangles[:, ::-1], triangles)


def _face_materials(
    mi: Any, mesh: Any, points: FloatArray, triangles: IntArray, side: int
) -> tuple[FloatArray, FloatArray]:
    """Return the mean reflectance and the mean emitted radiance (n, 3) of each triangle, on its front or back."""
    import drjit

    places = _sixteen_places()
    count = len(triangles) * len(places)
    face = np.repeat(np.arange(len(triangles)), len(places))
    position = np.einsum("kc,fcx->fkx", places, points[triangles]).reshape(count, 3)
    if mesh.has_vertex_texcoords():
        texture = np.array(mesh.vertex_texcoords_buffer(), dtype=np.float64).reshape(-1, 2)
        uv = np.einsum("kc,fcx->fkx", places, texture[triangles]).reshape(count, 2)
    else:
        uv = np.tile(places[:, 1:], (len(triangles), 1))

    def at(position: Any, uv: Any, face: Any) -> tuple[Any, Any]:
        place = drjit.zeros(mi.SurfaceInteraction3f)
        place.t = 1.0  # finite: there is a surface
        place.p = mi.Point3f(position)
        place.uv = mi.Point2f(uv)
        place.prim_index = mi.UInt32(face)
        place.n = mi.Normal3f(0.0, 0.0, 1.0)
        place.sh_frame = mi.Frame3f(mi.Vector3f(0.0, 0.0, 1.0))
        place.wi = mi.Vector3f(0.0, 0.0, side)
        place.shape = mesh if is_scalar(mi) else mi.ShapePtr(mesh)
        radiance = mesh.emitter().eval(place) if mesh.is_emitter() else mi.Color3f(0.0)
        return mesh.bsdf().eval_diffuse_reflectance(place), radiance

    if is_scalar(mi):
        pairs = [at(*row) for row in zip(position.tolist(), uv.tolist(), face.tolist(), strict=True)]
        values = np.array(pairs, dtype=np.float64).transpose(1, 0, 2)
    else:
        pair = at(position.T.astype(np.float32), uv.T.astype(np.float32), face.astype(np.uint32))
        values = np.stack([np.broadcast_to(np.array(x, dtype=np.float64), (3, count)).T for x in pair])
    rho, radiance = values.reshape(2, len(triangles), len(places), 3).mean(axis=2)
    return rho, radiance


def _sixteen_places() -> FloatArray:
    """Return the barycentric coordinates (16, 3) of the centroids of the 16 equal parts of a triangle."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(4) for j in range(4 - i)]
    upside_down = [(i + 2 / 3, j + 2 / 3) for i in range(3) for j in range(3 - i)]
    second, third = np.array(upright + upside_down).T / 4.0
    return np.stack([1.0 - second - third, second, third], axis=1)
