"""Scenes to and from Mitsuba 3, and its path tracer as an independent reference for radiosity.

A path tracer solves the same equation as this package by other means, and knows no patches:

    B_i = E_i + 1/A_i * integral over patch i of pi * L(x) dA,      L(x) = light reflected at x, W/(m^2 sr)

so the average of `pi * L` over random points of a patch is its radiosity without any discretisation error, with a
standard error that falls as one over the square root of the number of paths.

What Mitsuba computes in 32 bits has limits, and `reference_radiosity` stays inside them where it can: it centres and
scales the scene (Mitsuba lifts its rays off a surface by about (1 + max|p|) * 9e-5, an absolute length) and does
without Russian roulette where roulette would make the variance infinite. What remains: a gap or a patch thinner than
about 1e-4 of the scene's size is not resolved, and a tiny lamp close to a wall converges so slowly that the standard
error is not to be trusted. Hold such scenes against closed forms.

Mitsuba itself is optional and is imported by the functions that need it: `pip install radiosity[mitsuba]`.
"""

from __future__ import annotations

import contextlib
import ctypes.util
import functools
import logging
import math
import operator
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IntArray, seed_number

if TYPE_CHECKING:
    from .scene import Scene

__all__ = ["from_mitsuba", "reference_radiosity", "to_mitsuba", "variant"]

log = logging.getLogger(__name__)

# The oldest LLVM that can compile Mitsuba's kernels: 14 and 15 abort the whole process ("Cannot select: fminimum").
OLDEST_LLVM = 16

# Where systems and package managers keep LLVM's shared library.
LLVM_PLACES = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib/llvm*/lib*/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/usr/local/llvm*/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
    "C:/Program Files/LLVM/bin/LLVM-C.dll",
    f"{sys.prefix}/lib/libLLVM*.so*",
    f"{sys.prefix}/lib/libLLVM*.dylib",
)

# A kernel with the instruction that old versions cannot compile. The odd number makes it a kernel that no earlier run
# can have left in Dr.Jit's cache on disk, from where it would run without being compiled.
LLVM_PROOF = """
import time
import drjit as dr
from drjit.llvm import Float
odd = time.time_ns() % 1000003 / 7.0
x = dr.maximum(dr.minimum(dr.arange(Float, 16), odd), 1.0)
assert abs(float(dr.sum(x)[0]) - sum(max(min(float(k), odd), 1.0) for k in range(16))) < 1e-3
"""
LLVM_PROOF_SECONDS = 60.0

# Half of the traced scene's longest side. Mitsuba lifts rays by (1 + max|p|) * 9e-5: at 100 the 1 no longer counts,
# and the lift is 9e-5 of the scene however small, large or far away the scene was.
TRACED_HALF_SIZE = 100.0

# The distance, in scene sizes, from which a patch is looked at, and by which a patch and its reversed twin are moved
# apart. Well under what Mitsuba's own ray lift ignores (4.5e-5), well over the rounding of a 32-bit coordinate (3e-8).
HAIR = 5e-6

# Mitsuba's roulette survives with probability min(throughput, 0.95): beyond this reflectance a surviving path gains
# weight at every bounce, and from sqrt(0.95) = 0.975 on its variance is infinite.
LARGEST_ROULETTE_REFLECTANCE = 0.95
# Roulette begins when a tenth of the light can be left. Mitsuba's own choice, after five bounces, costs a furnace of
# reflectance 0.9 twice the noise; never starting costs the Cornell box twice the time.
LEFT_TO_ROULETTE = 0.1
MITSUBA_ROULETTE_DEPTH = 5
# Without roulette, paths end when what they leave out is less than this part of the brightest radiosity.
TRUNCATED = 1e-4
# Two rays a bounce at 10 million rays a second: a path of this length takes 4 ms.
MOST_BOUNCES = 20_000

# Paths traced at once: about 0.3 GiB, and few enough calls that their fixed cost (0.2 s) does not count.
CHUNK = 1 << 19

# A patch is refused when more than this part of the rays aimed at it reach another one first: its average would be off
# by as much. The few rays of a handful aimed exactly at an edge are let through.
LARGEST_MISSED_PART = 0.01
MISSES_LET_THROUGH = 2


# --- The variant ------------------------------------------------------------------------------------------------------


def variant() -> str:
    """Return the name of the Mitsuba variant that this package uses in this process.

    That is the variant already set with `mitsuba.set_variant`, if it is an RGB one and works; else `llvm_ad_rgb` where
    a usable LLVM is found (about ten times faster); else `scalar_rgb`, which works everywhere.

    Mitsuba's LLVM variants abort the whole Python process when LLVM is too old (14 and 15), so a small kernel is first
    compiled in a process of its own (0.3 s, once per process). `DRJIT_LIBLLVM_PATH` is respected if set; otherwise it
    is set, in this process, to the newest LLVM that passed. Nothing else is changed: the variant itself is set by the
    functions that need it, and by them only if none is set. The choice is logged at level INFO.

    Raises:
        ImportError: Mitsuba is not installed.

    """
    current = _import_mitsuba().variant() or ""
    if current.startswith("llvm") and not _llvm_works(os.environ.get("DRJIT_LIBLLVM_PATH")):
        return "scalar_rgb"  # the library is loaded: too late for a better one
    return str(current) if _is_rgb(current) else _best_variant()


def _import_mitsuba() -> Any:
    try:
        import mitsuba
    except ImportError as error:
        raise ImportError("Mitsuba is not installed: pip install radiosity[mitsuba]") from error
    return mitsuba


def _is_rgb(name: str) -> bool:
    words = name.split("_")
    return "rgb" in words and "polarized" not in words


@functools.cache
def _best_variant() -> str:
    """Return `llvm_ad_rgb` with `DRJIT_LIBLLVM_PATH` set to a library that works, or `scalar_rgb`."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    for library in [chosen] if chosen else _llvm_libraries():
        if _llvm_works(library):
            os.environ["DRJIT_LIBLLVM_PATH"] = library
            log.info("Mitsuba variant llvm_ad_rgb, with %s", library)
            return "llvm_ad_rgb"
    log.info("Mitsuba variant scalar_rgb: no usable LLVM (version %d or later) was found", OLDEST_LLVM)
    return "scalar_rgb"


def _llvm_libraries() -> list[str]:
    """Return LLVM libraries worth trying, newest first, those that do not tell their version last; three at most."""
    versions: dict[str, int] = {}
    for pattern in LLVM_PLACES:
        root = Path(pattern).anchor
        for path in Path(root).glob(pattern[len(root) :]):
            with contextlib.suppress(OSError):
                file = path.resolve(strict=True)
                versions.setdefault(str(file), max(_llvm_version(str(path)), _llvm_version(str(file))))
    by_name = ctypes.util.find_library("LLVM")
    if by_name and by_name not in {Path(file).name for file in versions}:
        versions.setdefault(by_name, _llvm_version(by_name))
    usable = [file for file, version in versions.items() if version >= OLDEST_LLVM or version == 0]
    return sorted(usable, key=lambda file: versions[file], reverse=True)[:3]


def _llvm_version(path: str) -> int:
    """Return the major version that a library's path tells (`libLLVM-19.so`, `libLLVM.so.19.1`, `llvm-19/`), or 0."""
    found = re.search(r"libLLVM(?:-|\.so\.)(\d+)", path) or re.search(r"llvm[-@]?(\d+)[/\\]", path)
    return int(found.group(1)) if found else 0


@functools.cache
def _llvm_works(library: str | None) -> bool:
    """Compile and run a small kernel with this LLVM (None: the one Dr.Jit finds) in a process that may die."""
    if not sys.executable:  # an embedded Python has no interpreter to start
        return False
    environment = os.environ | ({"DRJIT_LIBLLVM_PATH": library} if library else {})
    with tempfile.TemporaryDirectory() as folder:  # where a core dump may fall
        try:
            result = subprocess.run(
                [sys.executable, "-c", LLVM_PROOF],
                env=environment,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=LLVM_PROOF_SECONDS,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            log.info("%s could not be tried: %s", library or "LLVM", error)
            return False
    if result.returncode:
        log.info("%s cannot compile Mitsuba's kernels", library or "LLVM")
    return result.returncode == 0


def _mitsuba_with_rgb() -> Any:
    """Import Mitsuba with an RGB variant set, for objects that the caller will go on using.

    Raises:
        ValueError: the variant that the caller has set is another one, or would abort.

    """
    mi = _import_mitsuba()
    name = variant()
    if mi.variant() is None:
        mi.set_variant(name)
    elif mi.variant() != name:
        why = "its LLVM does not work" if _is_rgb(mi.variant()) else "radiosity needs an RGB one"
        raise ValueError(
            f"Mitsuba variant {mi.variant()!r} is set, but {why}: call mitsuba.set_variant({name!r}) first"
        )
    return mi


@contextlib.contextmanager
def _mitsuba_for_a_while() -> Iterator[Any]:
    """Lend Mitsuba with an RGB variant and put back the caller's own (if none was set, ours stays)."""
    mi = _import_mitsuba()
    name = variant()
    if mi.variant() is None:
        mi.set_variant(name)
    with mi.variant_context(name) if mi.variant() != name else contextlib.nullcontext():
        yield mi


# --- Scene to Mitsuba -------------------------------------------------------------------------------------------------


def to_mitsuba(scene: Scene) -> Any:
    """Return the scene as a `mitsuba.Scene`, ready for `mitsuba.render` with a sensor of your own.

    One band becomes grey, three become RGB. Surfaces are one-sided as in `Scene`: a `diffuse` BSDF with the
    reflectance of each patch as the mesh attribute `face_reflectance`, and an `area` emitter of radiance
    emission / pi. Consecutive patches of equal emission share a mesh, and the order of patches is kept.

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
    mi = _mitsuba_with_rgb()
    shape = (scene.n_patches, 3)
    corners = _apart(scene.vertices[scene.faces])
    return _build(mi, corners, np.broadcast_to(scene.reflectance, shape), np.broadcast_to(scene.emission, shape))


def _build(mi: Any, corners: FloatArray, reflectance: FloatArray, emission: FloatArray) -> Any:
    """Build a Mitsuba scene from triangles (n, 3, 3), reflectance (n, 3) and emission (n, 3) in W/m^2.

    A mesh for each run of equal emission: Mitsuba 3.9 accepts a `mesh_attribute` as the radiance of an area light, but
    its light sampling then silently finds no light.
    """
    bsdf = mi.load_dict({"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "face_reflectance"}})
    areas = 0.5 * np.linalg.norm(_twice_area_vectors(corners), axis=1)
    starts = _run_starts(emission)
    content: dict[str, Any] = {"type": "scene", "integrator": {"type": "path"}}
    for start, stop in zip(starts, [*starts[1:], len(corners)], strict=True):
        properties = mi.Properties()
        properties["bsdf"] = bsdf
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


def _run_starts(emission: FloatArray) -> list[int]:
    """Return the first patch of each run of patches with the same emission (n, 3)."""
    changes = np.flatnonzero((emission[1:] != emission[:-1]).any(axis=1)) + 1
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


def _twice_area_vectors(corners: FloatArray) -> FloatArray:
    """Return the normals (n, 3) of triangles (n, 3, 3), of length 2 A: the right-hand rule."""
    vectors: FloatArray = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return vectors


def _unit(vectors: FloatArray) -> FloatArray:
    unit: FloatArray = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def _apart(corners: FloatArray) -> FloatArray:
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
    moved[together] += hair * _unit(_twice_area_vectors(corners[together]))[:, None, :]
    return moved


# --- Mitsuba to Scene -------------------------------------------------------------------------------------------------


def from_mitsuba(mi_scene: Any) -> Scene:
    """Return a `Scene` of three bands with the triangles of a `mitsuba.Scene` of an RGB variant.

    Taken over: shapes that are meshes (files, `cube`, `rectangle`), `diffuse` and `twosided` diffuse BSDFs, `area`
    emitters. Patches come in the order of `mi_scene.shapes()` and are named after their shapes. A texture becomes its
    mean over each triangle (16 points). Vertex normals decide which side is the front, as in Mitsuba; the smooth
    shading they give is left out.

    A `twosided` shape becomes two patches per triangle: the front one, and after all front ones of the shape a
    reversed copy in the same place with the reflectance of the back. Only the front emits, as in Mitsuba.

    Raises:
        ImportError: Mitsuba is not installed.
        ValueError: something else is in the scene (a sphere that is no mesh, a metal, a point light, ...); every such
            shape and light is named. Or no shape at all, or the Mitsuba variant that is set cannot be used.

    """
    from .scene import Scene

    mi = _mitsuba_with_rgb()
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
    names: list[str] = []
    first = 0
    for shape in shapes:
        points = np.array(shape.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
        triangles = np.array(shape.faces_buffer(), dtype=np.int64).reshape(-1, 3)
        front = _front_faces(shape, points, triangles)
        for side in (1, -1) if _is_twosided(shape) else (1,):
            rho, radiance = _face_materials(mi, shape, points, triangles, side)
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
    )


def _is_twosided(shape: Any) -> bool:
    return str(shape.bsdf().class_name()) == "TwoSidedBRDF"


def _shape_problems(mi: Any, shape: Any) -> list[str]:
    """Say what in this shape has no counterpart in a `Scene`."""
    name = f"shape {shape.id()!r}"
    problems = []
    if not shape.is_mesh():
        problems.append(f"{name} is a {shape.class_name()}, not a mesh: turn it into triangles first")
    bsdf = shape.bsdf()
    sides = int(mi.BSDFFlags.FrontSide) | int(mi.BSDFFlags.BackSide)
    kinds = {int(bsdf.flags(k)) & ~sides for k in range(bsdf.component_count())}
    known = bsdf.class_name() in ("SmoothDiffuse", "TwoSidedBRDF")
    if not known or kinds != {int(mi.BSDFFlags.DiffuseReflection)}:
        problems.append(f"{name} has the BSDF {bsdf.class_name()}: only diffuse and twosided diffuse reflect evenly")
    if shape.is_medium_transition():
        problems.append(f"{name} bounds a medium: between patches there is only vacuum")
    return problems


def _front_faces(mesh: Any, points: FloatArray, triangles: IntArray) -> IntArray:
    """Return the triangles (n, 3) turned so that the right-hand rule points out of the side Mitsuba shades."""
    turned = np.full(len(triangles), bool(mesh.has_flipped_normals()))
    if mesh.has_vertex_normals() and not mesh.has_face_normals():
        shading = np.array(mesh.vertex_normals_buffer(), dtype=np.float64).reshape(-1, 3)[triangles].sum(axis=1)
        turned ^= np.einsum("ij,ij->i", _twice_area_vectors(points[triangles]), shading) < 0.0
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
        place.shape = mesh if _is_scalar(mi) else mi.ShapePtr(mesh)
        radiance = mesh.emitter().eval(place) if mesh.is_emitter() else mi.Color3f(0.0)
        return mesh.bsdf().eval_diffuse_reflectance(place), radiance

    if _is_scalar(mi):
        pairs = [at(*row) for row in zip(position.tolist(), uv.tolist(), face.tolist(), strict=True)]
        values = np.array(pairs, dtype=np.float64).transpose(1, 0, 2)
    else:
        pair = at(position.T.astype(np.float32), uv.T.astype(np.float32), face.astype(np.uint32))
        values = np.stack([np.broadcast_to(np.array(x, dtype=np.float64), (3, count)).T for x in pair])
    rho, radiance = values.reshape(2, len(triangles), len(places), 3).mean(axis=2)
    return rho, radiance


def _is_scalar(mi: Any) -> bool:
    return str(mi.variant()).startswith("scalar")


def _sixteen_places() -> FloatArray:
    """Return the barycentric coordinates (16, 3) of the centroids of the 16 equal parts of a triangle."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(4) for j in range(4 - i)]
    upside_down = [(i + 2 / 3, j + 2 / 3) for i in range(3) for j in range(3 - i)]
    second, third = np.array(upright + upside_down).T / 4.0
    return np.stack([1.0 - second - third, second, third], axis=1)


# --- The reference ----------------------------------------------------------------------------------------------------


def reference_radiosity(
    scene: Scene, paths: int, seed: int = 0, *, max_bounces: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the radiosity of each patch by Mitsuba's path tracer, and its standard error.

    Every patch gets the same number of paths, `paths // n_patches`. A path starts at a uniform random point of its
    patch, with light sampling and cosine directions combined (the `path` integrator), so the mean is an estimate of
    the exact patch average, free of bias to within the truncation and the ray lift below. Errors of different patches
    are independent; those of the bands of one patch are not, because bands share paths. The standard error is that of
    a mean of independent samples: with few paths a patch (under about 100) it is itself uncertain.

    More than three bands are traced three at a time, each three with all the paths. Patches with a reflectance above
    0.95 switch Russian roulette off and paths are cut after so many bounces that less than 1e-4 of the brightest
    radiosity is left out: 916 bounces at reflectance 0.99, and as much slower. The scene is centred and scaled before
    tracing, which does not change B. The same seed and variant give the same numbers.

    Each run of patches with equal emission is an emitter of its own; a thousand of them cost about a second per half
    million paths.

    Args:
        scene: n patches, b bands (any number).
        paths: total number of paths, at least 2 n.
        seed: 0 or more.
        max_bounces: cut paths after so many bounces instead, and leave their light out.

    Returns:
        radiosity (n, b) and standard error (n, b), both in W/m^2.

    Raises:
        ImportError: Mitsuba is not installed.
        TypeError: `paths`, `seed` or `max_bounces` is not an integer.
        ValueError: too few paths; a reflectance so near 1 that paths would need more than 20,000 bounces, with no
            `max_bounces`; or a patch that rays cannot reach because another one lies on it.

    """
    per_patch = _paths_per_patch(paths, scene.n_patches)
    seed = seed_number(seed)
    corners = _centred_and_scaled(scene.vertices[scene.faces])
    radiosity = scene.emission.astype(np.float64)
    standard_error = np.zeros_like(radiosity)
    with _mitsuba_for_a_while() as mi:
        for first in range(0, scene.bands, 3):
            bands = slice(first, first + 3)
            rho, emission = _three(scene.reflectance[:, bands]), _three(scene.emission[:, bands])
            # In units of the largest, for 32 bits end at 1e38.
            unit = emission.max()
            if unit == 0.0:
                continue
            integrator = _path_integrator(mi, float(rho.max()), _bounces(float(rho.max()), max_bounces))
            reflected, error = _reflected(mi, integrator, corners, rho, emission / unit, per_patch, seed)
            width = radiosity[:, bands].shape[1]
            radiosity[:, bands] += unit * reflected[:, :width]
            standard_error[:, bands] = unit * error[:, :width]
    return radiosity, standard_error


def _paths_per_patch(paths: int, patches: int) -> int:
    paths = _integer("paths", paths)
    if paths < 2 * patches:
        raise ValueError(
            f"{paths} paths for {patches} patches: at least {2 * patches} are needed, two for each patch, "
            "or there is no standard error"
        )
    return paths // patches


def _integer(name: str, value: Any) -> int:
    try:
        return operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be an integer, not {type(value).__name__}") from None


def _three(values: FloatArray) -> FloatArray:
    """Fill up (n, 1..3) with black bands to (n, 3)."""
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


def _centred_and_scaled(corners: FloatArray) -> FloatArray:
    """Return triangles (n, 3, 3) in a box about the origin whose longest side is 2 `TRACED_HALF_SIZE`; twins apart."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    return _apart((corners - (low + high) / 2.0) * (2.0 * TRACED_HALF_SIZE / (high - low).max()))


def _bounces(largest_reflectance: float, wanted: int | None) -> int | None:
    """Return after how many bounces paths are cut, or None where roulette ends them.

    What k bounces leave out is (diag(rho) F)^(k+1) B <= rho^(k+1) max B.
    """
    if wanted is not None:
        bounces = _integer("max_bounces", wanted)
        if bounces < 1:
            raise ValueError(f"max_bounces is {bounces}: at least one bounce is needed")
        return bounces
    if largest_reflectance <= LARGEST_ROULETTE_REFLECTANCE:
        return None
    bounces = (
        math.ceil(math.log(TRUNCATED) / math.log(largest_reflectance)) if largest_reflectance < 1.0 else sys.maxsize
    )
    if bounces > MOST_BOUNCES:
        raise ValueError(
            f"reflectance {largest_reflectance:g} may need paths of more than {MOST_BOUNCES} bounces: "
            "use a closed form as reference, or give max_bounces to leave out the light of later ones"
        )
    return bounces


def _path_integrator(mi: Any, largest_reflectance: float, bounces: int | None) -> Any:
    if bounces is not None:
        # Mitsuba's depth counts the look at the patch, too. Roulette that would begin where paths end is off.
        return mi.load_dict({"type": "path", "max_depth": bounces + 1, "rr_depth": bounces + 1})
    # Roulette turns what light is left into all or nothing: the later, the less noise and the longer the paths.
    depth = MITSUBA_ROULETTE_DEPTH
    if largest_reflectance > 0.0:
        depth = max(depth, math.ceil(math.log(LEFT_TO_ROULETTE) / math.log(largest_reflectance)))
    return mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": depth})


def _reflected(
    mi: Any, integrator: Any, corners: FloatArray, rho: FloatArray, emission: FloatArray, per_patch: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return B - E and its standard error, (n, 3) each, from `per_patch` paths for each triangle (n, 3, 3)."""
    patches = len(corners)
    traced = _build(mi, corners, rho, emission)
    # Mesh and face in the mesh of each patch, to see whether a ray reached it.
    starts = np.array(_run_starts(emission))
    mesh = np.searchsorted(starts, np.arange(patches), side="right") - 1
    face = np.arange(patches) - starts[mesh]
    normals = _unit(_twice_area_vectors(corners))
    # What the patch emits itself is in every path: taken off as Mitsuba rounded it, and not estimated.
    own = (emission / math.pi).astype(np.float32).astype(np.float64)

    rng = np.random.default_rng(seed)
    total, squares, reached = np.zeros((patches, 3)), np.zeros((patches, 3)), np.zeros(patches)
    for start in range(0, patches * per_patch, CHUNK):
        patch = np.arange(start, min(start + CHUNK, patches * per_patch)) // per_patch
        # The path begins with a look straight at the patch from a hair above it, so that Mitsuba sees the point as it
        # sees any other: with light sampling and cosine direction, weighted against each other.
        origins = _random_points(rng, corners[patch]) + 2.0 * TRACED_HALF_SIZE * HAIR * normals[patch]
        radiance, hit = _trace(
            mi, traced, integrator, origins, -normals[patch], mesh[patch], face[patch], int(rng.integers(2**32))
        )
        reflected = math.pi * (radiance - own[patch])
        reached += np.bincount(patch, hit, patches)
        for band in range(3):
            total[:, band] += np.bincount(patch, reflected[:, band], patches)
            squares[:, band] += np.bincount(patch, reflected[:, band] ** 2, patches)
    _refuse_hidden(per_patch - reached, per_patch)
    mean = total / per_patch
    # Rounding may leave a negative zero where every path brought the same.
    variance = np.maximum(squares / per_patch - mean**2, 0.0) * (per_patch / (per_patch - 1))
    return mean, np.sqrt(variance / per_patch)


def _random_points(rng: np.random.Generator, corners: FloatArray) -> FloatArray:
    """Return one uniform random point (m, 3) in each triangle (m, 3, 3)."""
    root = np.sqrt(rng.random(len(corners)))[:, None]
    part = rng.random(len(corners))[:, None]
    points: FloatArray = (1.0 - root) * corners[:, 0] + root * ((1.0 - part) * corners[:, 1] + part * corners[:, 2])
    return points


def _trace(
    mi: Any,
    traced: Any,
    integrator: Any,
    origins: FloatArray,
    directions: FloatArray,
    mesh: IntArray,
    face: IntArray,
    seed: int,
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Return the radiance (m, 3) along rays (m, 3), and whether they met the given face (m,) of the given mesh (m,).

    The sampler is `independent`: that of a stratified one would say nothing true about the standard error.
    """
    sampler = mi.load_dict({"type": "independent"})
    if _is_scalar(mi):
        return _trace_one_by_one(mi, traced, integrator, sampler, origins, directions, mesh, face, seed)
    import drjit

    sampler.seed(seed, len(origins))
    ray = mi.Ray3f(mi.Point3f(origins.T.astype(np.float32)), mi.Vector3f(directions.T.astype(np.float32)))
    radiance, _, _ = integrator.sample(traced, sampler, ray)
    first = traced.ray_intersect_preliminary(ray)
    aimed_at = drjit.gather(mi.ShapePtr, traced.shapes_dr(), mi.UInt32(mesh.astype(np.uint32)))
    hit = (first.shape == aimed_at) & (first.prim_index == mi.UInt32(face.astype(np.uint32)))
    return np.array(radiance, dtype=np.float64).T, np.array(hit, dtype=np.bool_)


def _trace_one_by_one(
    mi: Any,
    traced: Any,
    integrator: Any,
    sampler: Any,
    origins: FloatArray,
    directions: FloatArray,
    mesh: IntArray,
    face: IntArray,
    seed: int,
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Do what `_trace` does in a scalar variant."""
    sampler.seed(seed, 1)
    shapes = traced.shapes()
    radiance = np.empty((len(origins), 3))
    hit = np.empty(len(origins), dtype=np.bool_)
    rays = zip(origins.tolist(), directions.tolist(), mesh.tolist(), face.tolist(), strict=True)
    for k, (origin, direction, mesh_k, face_k) in enumerate(rays):
        ray = mi.RayDifferential3f(mi.Point3f(origin), mi.Vector3f(direction))
        radiance[k] = integrator.sample(traced, sampler, ray)[0]
        first = traced.ray_intersect_preliminary(ray)
        hit[k] = first.is_valid() and first.shape == shapes[mesh_k] and first.prim_index == face_k
    return radiance, hit


def _refuse_hidden(missed: FloatArray, per_patch: int) -> None:
    """Raise a ValueError that names the patches whose rays met another one first."""
    hidden = np.flatnonzero(missed > MISSES_LET_THROUGH + LARGEST_MISSED_PART * per_patch)
    if len(hidden) == 0:
        return
    lines = [f"  patch {i}: {missed[i] / per_patch:.0%} of the rays aimed at it met another one" for i in hidden[:10]]
    if len(hidden) > 10:
        lines.append(f"  and {len(hidden) - 10} more")
    raise ValueError(
        f"{len(hidden)} patches cannot be seen by Mitsuba: another patch lies on them, or closer in front than "
        f"{HAIR:g} of the scene's size, or they are thinner than rounding allows\n" + "\n".join(lines)
    )
