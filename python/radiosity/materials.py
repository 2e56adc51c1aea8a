"""Materials of a mesh as reflectance and emission of its patches.

    reflectance  rho = base colour factor * mean texture * mean vertex colour     (linear, per patch and band R, G, B)
    emission     E   = pi * emissive factor * emissive strength * mean texture    (W/m^2)

A diffuse surface of radiance L emits E = pi L, and L is what glTF's emissive factor times strength states (in nits,
cd/m^2; here the number is taken as W/(m^2 sr) per band, so that other renderers of the file show the same picture).

Sources: glTF 2.0 specification (Khronos 2021), section 3.9; KHR_materials_emissive_strength; IEC 61966-2-1 (sRGB).

Limits. Every surface is taken as diffuse: metalness, roughness, transparency and normal maps are left out. The mean of
a product of textures and colours is taken as the product of the means. Textures are averaged over a patch from the
box-filtered level at which about 64 texels cover it; they repeat outside [0, 1].
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IntArray

DEFAULT_REFLECTANCE = 0.5
"""Reflectance of a surface whose file states no colour."""

# trimesh gives a SimpleMaterial without a diffuse colour this one (RGBA, 8 bits); it then says nothing about the mesh.
_TRIMESH_NO_COLOUR = (102, 102, 102, 255)

# A triangle is sampled at the centroids of its 8 x 8 congruent sub-triangles.
_SPLIT = 8


@dataclass(frozen=True)
class Factors:
    """The constant factors of one material; None where it states nothing.

    Attributes:
        base_colour: linear RGB reflectance in [0, 1].
        emissive: linear RGB radiance, emissive factor times emissive strength, W/(m^2 sr).

    """

    base_colour: tuple[float, ...] | None = None
    emissive: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Surface:
    """What a mesh states about its n patches; None where it states nothing.

    Attributes:
        reflectance: (n, 3) linear RGB.
        emission: (n, 3), W/m^2.

    """

    reflectance: FloatArray | None = None
    emission: FloatArray | None = None


def srgb_to_linear(values: npt.ArrayLike) -> FloatArray:
    """Convert sRGB values in [0, 1] to linear ones, same shape (IEC 61966-2-1)."""
    encoded = np.asarray(values, dtype=np.float64)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def factors_of_gltf(material: Mapping[str, Any]) -> Factors:
    """Read the exact factors of a glTF material from its JSON.

    trimesh rounds the base colour to 8 bits and drops KHR_materials_emissive_strength, so both are read here.
    """
    base = material.get("pbrMetallicRoughness", {}).get("baseColorFactor")
    emissive = material.get("emissiveFactor")
    if emissive is not None:
        extension = material.get("extensions", {}).get("KHR_materials_emissive_strength", {})
        strength = float(extension.get("emissiveStrength", 1.0))
        emissive = tuple(float(value) * strength for value in emissive[:3])
    return Factors(None if base is None else tuple(float(value) for value in base[:3]), emissive)


def surface_of_mesh(mesh: Any, factors: Factors | None = None, *, linear_colours: bool = False) -> Surface:
    """Find reflectance and emission of the patches of a `trimesh.Trimesh`.

    Args:
        mesh: a mesh of n triangles.
        factors: exact factors of its material; without them those of `mesh.visual`, which trimesh keeps in 8 bits.
        linear_colours: whether face and vertex colours are linear (glTF) rather than sRGB (PLY and other files).

    Returns:
        The surface of the n patches.

    Raises:
        ValueError: colours whose number fits neither faces nor vertices, or an unreadable emissive colour.

    """
    visual = mesh.visual
    colours = _colours(mesh, linear_colours)
    if visual.kind != "texture":
        if factors is None:
            factors = Factors()
        return _times_colours(_surface(len(mesh.faces), factors), colours)

    uv = visual.uv
    corners = None if uv is None or len(uv) != len(mesh.vertices) else np.asarray(uv, dtype=np.float64)[mesh.faces]
    selection = getattr(visual, "face_materials", None)
    if factors is None and selection is not None and hasattr(visual.material, "materials"):
        return _mixed_surface(visual.material.materials, np.asarray(selection), corners)
    if factors is None:
        factors = _factors_of_trimesh(visual.material)
    return _times_colours(_textured_surface(len(mesh.faces), factors, visual.material, corners), colours)


def _surface(n: int, factors: Factors) -> Surface:
    def rows(values: tuple[float, ...] | None, scale: float) -> FloatArray | None:
        return None if values is None else np.tile(scale * np.asarray(values, dtype=np.float64), (n, 1))

    return Surface(rows(factors.base_colour, 1.0), rows(factors.emissive, math.pi))


def _textured_surface(n: int, factors: Factors, material: Any, corners: FloatArray | None) -> Surface:
    surface = _surface(n, factors)
    if corners is None:
        return surface
    # A PBRMaterial names its image baseColorTexture, a SimpleMaterial (OBJ) image.
    base_image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    emissive_image = getattr(material, "emissiveTexture", None)
    reflectance, emission = surface.reflectance, surface.emission
    if base_image is not None:
        means = texture_means(base_image, corners)
        reflectance = means if reflectance is None else reflectance * means
    if emission is not None and emissive_image is not None and np.any(emission):
        emission = emission * texture_means(emissive_image, corners)
    return Surface(reflectance, emission)


def _mixed_surface(materials: Any, selection: IntArray, corners: FloatArray | None) -> Surface:
    """Return the surface of a mesh whose patch i has the material `selection[i]`."""
    reflectance = np.full((len(selection), 3), DEFAULT_REFLECTANCE)
    emission = np.zeros((len(selection), 3))
    for k, material in enumerate(materials):
        rows = np.flatnonzero(selection == k)
        part = _textured_surface(
            len(rows), _factors_of_trimesh(material), material, None if corners is None else corners[rows]
        )
        if part.reflectance is not None:
            reflectance[rows] = part.reflectance
        if part.emission is not None:
            emission[rows] = part.emission
    return Surface(reflectance, emission)


def _times_colours(surface: Surface, colours: FloatArray | None) -> Surface:
    if colours is None:
        return surface
    return Surface(colours if surface.reflectance is None else surface.reflectance * colours, surface.emission)


def _factors_of_trimesh(material: Any) -> Factors:
    """Read a trimesh PBRMaterial or SimpleMaterial (OBJ: Kd is the reflectance, Ke the radiance, both linear)."""
    if hasattr(material, "baseColorFactor"):
        base, emissive = material.baseColorFactor, material.emissiveFactor
        return Factors(
            None if base is None else tuple(np.asarray(base, dtype=np.float64)[:3] / 255.0),
            None if emissive is None else tuple(np.asarray(emissive, dtype=np.float64)),
        )
    stated: Mapping[str, Any] = getattr(material, "kwargs", None) or {}
    diffuse = getattr(material, "diffuse", None)
    base_colour = None
    if "kd" in stated:
        base_colour = _rgb("Kd", stated["kd"])
    elif diffuse is not None and tuple(int(value) for value in diffuse) != _TRIMESH_NO_COLOUR:
        base_colour = tuple(np.asarray(diffuse, dtype=np.float64)[:3] / 255.0)
    return Factors(base_colour, _rgb("Ke", stated["ke"]) if "ke" in stated else None)


def _rgb(name: str, value: Any) -> tuple[float, ...]:
    """Return three numbers from what an MTL file states: one or three numbers, as text or not."""
    try:
        numbers = np.asarray(value, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise ValueError(f"material colour {name} {value!r} is not one or three numbers") from None
    if numbers.size not in (1, 3):
        raise ValueError(f"material colour {name} {value!r} is not one or three numbers")
    return tuple(np.broadcast_to(numbers, 3).tolist())


def _colours(mesh: Any, linear: bool) -> FloatArray | None:
    """Return (n, 3) linear face colours, or means of the corners' colours; None without any."""
    visual = mesh.visual
    if visual.kind == "face":
        colours, count, per_face = visual.face_colors, len(mesh.faces), True
    elif visual.kind == "vertex":
        colours, count, per_face = visual.vertex_colors, len(mesh.vertices), False
    elif visual.kind == "texture" and visual.vertex_attributes.get("color", None) is not None:
        # Only glTF gives a mesh both a material and colours; they are linear by its specification.
        colours, count, per_face, linear = visual.vertex_attributes["color"], len(mesh.vertices), False, True
    else:
        return None
    values = np.asarray(colours)
    if values.ndim != 2 or len(values) != count:
        raise ValueError(f"{len(values)} colours do not fit {count} {'triangles' if per_face else 'vertices'}")
    scale = float(np.iinfo(values.dtype).max) if values.dtype.kind in "iu" else 1.0
    rgb = values[:, :3].astype(np.float64) / scale
    if not linear:
        rgb = srgb_to_linear(rgb)
    # The mean over a triangle of what is interpolated linearly between its corners is the mean of the corners.
    return rgb if per_face else rgb[mesh.faces].mean(axis=1)


def texture_means(image: Any, corners: FloatArray) -> FloatArray:
    """Average the linear colour of an sRGB image over triangles in texture coordinates.

    Args:
        image: a PIL image.
        corners: (n, 3, 2) u and v of the corners, origin at the lower left, repeated outside [0, 1].

    Returns:
        (n, 3) means in [0, 1].

    """
    levels = [srgb_to_linear(np.asarray(image.convert("RGB"), dtype=np.float64) / 255.0)]
    while max(levels[-1].shape[:2]) > 1:
        levels.append(_halved(levels[-1]))
    height, width = levels[0].shape[:2]

    u, v = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    texels = 0.5 * np.abs(u[0] * v[1] - u[1] * v[0]) * (width * height)
    # Each level has a quarter of the texels of the one before; the samples should be about one texel apart.
    level = np.floor(0.5 * np.log2(np.maximum(texels / _SPLIT**2, 1.0))).astype(np.int64)
    level = np.minimum(level, len(levels) - 1)

    weights = _sample_weights()
    means = np.empty((len(corners), 3))
    chunk = 1 << 14  # bounds the memory of the samples to a few tens of MB
    for k in np.unique(level):
        pixels = levels[k]
        rows = np.flatnonzero(level == k)
        for start in range(0, len(rows), chunk):
            part = rows[start : start + chunk]
            points = np.einsum("sc,ncx->nsx", weights, corners[part])
            x = np.floor(points[..., 0] * pixels.shape[1]).astype(np.int64) % pixels.shape[1]
            y = np.floor((1.0 - points[..., 1]) * pixels.shape[0]).astype(np.int64) % pixels.shape[0]
            means[part] = pixels[y, x].mean(axis=1)
    return means


def _halved(pixels: FloatArray) -> FloatArray:
    """Halve the pixels each way by means of 2 x 2; an odd last row or column counts twice."""
    rows, columns = (size % 2 if size > 1 else 0 for size in pixels.shape[:2])
    even = np.pad(pixels, ((0, rows), (0, columns), (0, 0)), mode="edge")
    if even.shape[0] > 1:
        even = 0.5 * (even[0::2] + even[1::2])
    if even.shape[1] > 1:
        even = 0.5 * (even[:, 0::2] + even[:, 1::2])
    return even


def _sample_weights() -> FloatArray:
    """Return (64, 3) barycentric coordinates of the centroids of a triangle's congruent sub-triangles."""
    upright = [(3 * i + 1, 3 * j + 1) for i in range(_SPLIT) for j in range(_SPLIT - i)]
    inverted = [(3 * i + 2, 3 * j + 2) for i in range(_SPLIT - 1) for j in range(_SPLIT - 1 - i)]
    first_two = np.array(upright + inverted, dtype=np.float64) / (3 * _SPLIT)
    return np.column_stack([first_two, 1.0 - first_two.sum(axis=1)])
