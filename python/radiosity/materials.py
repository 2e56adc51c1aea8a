"""Materials of a mesh as reflectance and emission of its patches.

    reflectance  rho = base colour factor * mean texture * mean vertex colour     (linear, per patch and band R, G, B)
    emission     E   = pi * emissive factor * emissive strength * mean texture    (W/m^2)
    mirror       the luminance of rho            of polished metal: metalness 1, roughness at most 0.1, no emission
    ior          that of the material, or 1.5    of clear glass: transmission 1, no metal, roughness at most 0.1

A diffuse surface of radiance L emits E = pi L, and L is what glTF's emissive factor times strength states (in nits,
cd/m^2; here the number is taken as W/(m^2 sr) per band, so that other renderers of the file show the same picture).

A roughness of 0.1 is a microfacet width of 0.01 (its square): a reflection that is blurred by about one degree.

Sources: glTF 2.0 specification (Khronos 2021), section 3.9; KHR_materials_emissive_strength,
KHR_materials_transmission, KHR_materials_ior, KHR_materials_volume; IEC 61966-2-1 (sRGB); ITU-R BT.709 (luminance).

Limits. Every other surface is taken as diffuse, and remarks say so where metal or transmission is stated; the gloss of
other materials, opacity and normal maps are left out. Mirrors are grey, glass is clear. glTF's own default, metal as
rough as can be, is what a material has that states nothing: it is diffuse, without a remark. The mean of
a product of textures and colours is taken as the product of the means. Textures are averaged over a patch from the
box-filtered level at which about 64 texels cover it; they repeat outside [0, 1].
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IntArray

DEFAULT_REFLECTANCE = 0.5
"""Reflectance of a surface whose file states no colour."""

# A mirror or glass is as rough as this at most.
_POLISHED = 0.1

# What counts as all of it: writers round.
_WHOLE = 0.99

# Of glass whose file states none (KHR_materials_ior).
_IOR = 1.5

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

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
        name: of the material.
        is_mirror: whether it is polished metal.
        ior: index of refraction of clear glass.
        remarks: what of it is left out.

    """

    base_colour: tuple[float, ...] | None = None
    emissive: tuple[float, ...] | None = None
    name: str = ""
    is_mirror: bool = False
    ior: float | None = None
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Surface:
    """What a mesh states about its n patches; None where it states nothing.

    Attributes:
        reflectance: (n, 3) linear RGB.
        emission: (n, 3), W/m^2.
        mirror: (n,) what is mirrored, 0 for no mirror.
        ior: (n,) index of refraction, nan for no glass.
        remarks: what of its materials is left out.

    """

    reflectance: FloatArray | None = None
    emission: FloatArray | None = None
    mirror: FloatArray | None = None
    ior: FloatArray | None = None
    remarks: tuple[str, ...] = ()


def srgb_to_linear(values: npt.ArrayLike) -> FloatArray:
    """Convert sRGB values in [0, 1] to linear ones, same shape (IEC 61966-2-1)."""
    encoded = np.asarray(values, dtype=np.float64)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def factors_of_gltf(material: Mapping[str, Any]) -> Factors:
    """Read the exact factors of a glTF material from its JSON.

    trimesh rounds the base colour to 8 bits and drops the extensions, so all are read here.
    """
    extensions = material.get("extensions", {})
    base = material.get("pbrMetallicRoughness", {}).get("baseColorFactor")
    emissive = material.get("emissiveFactor")
    if emissive is not None:
        strength = float(extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0))
        emissive = tuple(float(value) * strength for value in emissive[:3])
    base = None if base is None else tuple(float(value) for value in base[:3])
    return _finished(Factors(base, emissive, material.get("name") or ""), material)


def _finished(factors: Factors, material: Mapping[str, Any]) -> Factors:
    """Tell from a glTF material whether it is a mirror, clear glass, or taken as diffuse."""
    name = f"material {factors.name!r}" if factors.name else "a material without a name"
    stated = material.get("pbrMetallicRoughness", {})
    metalness, roughness = (float(stated.get(key, 1.0)) for key in ("metallicFactor", "roughnessFactor"))
    texture = "metallicRoughnessTexture" in stated
    extensions = material.get("extensions", {})
    transmission = extensions.get("KHR_materials_transmission", {})
    passed = float(transmission.get("transmissionFactor", 0.0))
    polished = roughness <= _POLISHED and not texture
    lit = factors.emissive is not None and any(factors.emissive)
    look = f"metalness {metalness:g}, roughness {roughness:g}{' times a texture' if texture else ''}"
    emits = ", emission" if lit else ""

    # Metal lets no light through, whatever is stated.
    if passed > 0.0 and metalness < _WHOLE:
        textured = "transmissionTexture" in transmission
        if not polished or lit or textured or passed < _WHOLE or metalness > 1.0 - _WHOLE:
            of = f"transmission {passed:g}{' times a texture' if textured else ''}, {look}{emits}"
            return replace(factors, remarks=(f"{name} is no clear glass ({of}): it is read as diffuse",))
        ior = float(extensions.get("KHR_materials_ior", {}).get("ior", _IOR))
        if ior == 0.0:  # glTF's word for a Fresnel term of 1 everywhere
            return replace(factors, remarks=(f"{name} is no clear glass (ior 0): it is read as diffuse",))
        volume = extensions.get("KHR_materials_volume", {})
        tints = (factors.base_colour, volume.get("attenuationColor") if "attenuationDistance" in volume else None)
        if any(tint is not None and min(tint) < 1.0 for tint in tints) or "baseColorTexture" in stated:
            return replace(factors, ior=ior, remarks=(f"{name} is tinted glass: it is read as clear",))
        return replace(factors, ior=ior)
    if polished and metalness >= _WHOLE and not lit:
        return replace(factors, is_mirror=True)
    if metalness > 0.0 and (roughness < 1.0 or texture):
        return replace(factors, remarks=(f"{name} is no mirror ({look}{emits}): it is read as diffuse",))
    return factors


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
    n = len(mesh.faces)
    if visual.kind != "texture":
        factors = factors or Factors()
        return _specular(n, _times_colours(_surface(n, factors), colours), factors)

    uv = visual.uv
    corners = None if uv is None or len(uv) != len(mesh.vertices) else np.asarray(uv, dtype=np.float64)[mesh.faces]
    selection = getattr(visual, "face_materials", None)
    if factors is None and selection is not None and hasattr(visual.material, "materials"):
        return _mixed_surface(visual.material.materials, np.asarray(selection), corners)
    if factors is None:
        factors = _factors_of_trimesh(visual.material)
    surface = _times_colours(_textured_surface(n, factors, visual.material, corners), colours)
    return _specular(n, surface, factors)


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
    n = len(selection)
    reflectance, emission = np.full((n, 3), DEFAULT_REFLECTANCE), np.zeros((n, 3))
    mirror, remarks = np.zeros(n), list[str]()
    for k, material in enumerate(materials):
        rows = np.flatnonzero(selection == k)
        factors = _factors_of_trimesh(material)
        part = _textured_surface(len(rows), factors, material, None if corners is None else corners[rows])
        part = _specular(len(rows), part, factors)
        for values, stated in ((reflectance, part.reflectance), (emission, part.emission), (mirror, part.mirror)):
            if stated is not None:
                values[rows] = stated
        remarks += part.remarks
    return Surface(reflectance, emission, mirror, remarks=tuple(remarks))


def _specular(n: int, surface: Surface, factors: Factors) -> Surface:
    """Make a mirror or glass of a surface whose material says so; a mirror without a colour sends all light back."""
    if factors.ior is not None:
        return replace(surface, ior=np.full(n, factors.ior), remarks=factors.remarks)
    if not factors.is_mirror:
        return replace(surface, remarks=factors.remarks)
    colour = np.ones((n, 3)) if surface.reflectance is None else surface.reflectance
    low, high = colour.min(axis=1), colour.max(axis=1)
    # Between these also after rounding: grey stays what it is.
    mirror = np.clip(colour @ _LUMINANCE, low, high)
    remarks = factors.remarks
    if (low < high).any():
        remarks += (f"material {factors.name!r} is a mirror of colour: it is read as grey, as bright as it",)
    return replace(surface, mirror=mirror, remarks=remarks)


def _times_colours(surface: Surface, colours: FloatArray | None) -> Surface:
    if colours is None:
        return surface
    return replace(surface, reflectance=colours if surface.reflectance is None else surface.reflectance * colours)


def _factors_of_trimesh(material: Any) -> Factors:
    """Read a trimesh PBRMaterial or SimpleMaterial (OBJ: Kd is the reflectance, Ke the radiance, both linear)."""
    if hasattr(material, "baseColorFactor"):
        base, emissive = material.baseColorFactor, material.emissiveFactor
        keys = ("metallicFactor", "roughnessFactor", "metallicRoughnessTexture")
        finish = {key: value for key in keys if (value := getattr(material, key)) is not None}
        factors = Factors(
            None if base is None else tuple(np.asarray(base, dtype=np.float64)[:3] / 255.0),
            None if emissive is None else tuple(np.asarray(emissive, dtype=np.float64)),
            str(material.name or ""),
        )
        return _finished(factors, {"pbrMetallicRoughness": finish})
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
