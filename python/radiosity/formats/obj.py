"""OBJ with MTL: groups in file order, materials checked beside trimesh."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from .part import MeshError, Part, part_of, triangles_only, trimesh_scene


def read_obj(file: Path, data: bytes, notes: list[str]) -> list[Part]:
    """Read OBJ: a part for each group and material; `notes` gets what is left out."""
    text = data.decode("utf-8", errors="replace").replace("\r\n", "\n").replace("\\\n", " ")
    corners = [len(line.split()) for line in re.findall(r"^[ \t]*f[ \t]([^#\n]*)", text, re.MULTILINE)]
    others = re.search(r"^[ \t]*(p|l|curv2?|surf)[ \t]", text, re.MULTILINE)
    if others:
        line = text.count("\n", 0, others.start(1)) + 1
        raise MeshError(f"line {line} holds a {others[1]!r} element: only faces have an area; keep faces only")
    first_face = re.search(r"^[ \t]*f[ \t]", text, re.MULTILINE)
    backwards = re.search(r"^[ \t]*f[ \t][^#\n]*-", text, re.MULTILINE)
    # Negative indices count back from the line they stand on; trimesh counts from the end of the file.
    if first_face and backwards and re.search(r"^[ \t]*v[tn]?[ \t]", text[first_face.start() :], re.MULTILINE):
        raise MeshError("negative vertex indices with vertices after the first face are not supported")
    materials = _mtl_materials(file, text, notes)

    parts = []
    scene = trimesh_scene(file, data, notes, split_objects=True, split_groups=True)
    # trimesh builds the groups from the last to the first.
    for name, geometry in reversed(scene.geometry.items()):
        mesh = triangles_only(geometry, name)
        material = getattr(mesh.visual, "material", None)
        if material is not None and materials.get(material.name) and material.image is None:
            notes.append(f"the image of material {material.name!r} could not be read: its colour is taken alone")
        parts.append(part_of(_obj_name(file, name, list(materials)), mesh))
    found, expected = sum(len(part.faces) for part in parts), sum(max(count - 2, 0) for count in corners)
    if found != expected:
        raise MeshError(f"its faces make {expected} triangles, but trimesh read {found}")
    return parts


def _mtl_materials(file: Path, text: str, notes: list[str]) -> dict[str, bool]:
    """Name the materials that trimesh finds (in the first material file only), and whether they have an image."""
    libraries = re.findall(r"^[ \t]*mtllib[ \t]+(.*?)[ \t]*$", text, re.MULTILINE)
    used = dict.fromkeys(re.findall(r"^[ \t]*usemtl[ \t]+(.*?)[ \t]*$", text, re.MULTILINE))
    materials: dict[str, bool] = {}
    if libraries:
        library = file.parent / libraries[0]
        if library.is_file():
            content = library.read_bytes().decode("utf-8", errors="replace")
            _, *blocks = re.split(r"^[ \t]*newmtl[ \t]+(.*?)[ \t]*\r?$", content, flags=re.MULTILINE | re.IGNORECASE)
            for name, block in zip(blocks[::2], blocks[1::2], strict=True):
                materials[name] = re.search(r"^[ \t]*map_Kd[ \t]", block, re.MULTILINE | re.IGNORECASE) is not None
        else:
            notes.append(f"material file {libraries[0]!r} is missing: reflectance 0.5 and emission 0 are taken instead")
            return materials
    missing = [name for name in used if name not in materials]
    if missing:
        notes.append(
            f"materials {', '.join(missing)} are not defined: reflectance 0.5 and emission 0 are taken instead"
        )
    return materials


def _obj_name(file: Path, name: str, materials: Sequence[str]) -> str:
    """Return the object or group of a mesh that trimesh names "object_group_material"."""
    if name == file.name:
        return file.stem
    # trimesh appends the material only when there are several.
    endings = [f"_{material}" for material in materials if name.endswith(f"_{material}")] if len(materials) > 1 else []
    return name.removesuffix(max(endings, key=len)) if endings else name
