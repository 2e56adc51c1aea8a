"""glTF and GLB: geometry by trimesh; exact factors, names, order and places from the JSON."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..materials import Surface, factors_of_gltf, surface_of_mesh
from .part import SOLVED, MeshError, Part, part_of, triangles_only, trimesh_scene

# Extensions without which a file still shows the same triangles. A file that requires any other one is refused, as the
# glTF specification asks: read without it, its geometry or its colours would be wrong.
_HARMLESS = re.compile(r"KHR_materials_(?!pbrSpecularGlossiness).*|KHR_lights_punctual|KHR_texture_transform")

_MODES = ["points", "lines", "a line loop", "a line strip", "triangles", "a triangle strip", "a triangle fan"]


def read_gltf(file: Path, data: bytes, notes: list[str]) -> list[Part]:
    """Read glTF and GLB: a part for each primitive of each node; `notes` gets what is left out."""
    tree = _gltf_json(data) if file.suffix.lower() == ".glb" else json.loads(data.decode("utf-8-sig"))
    if not isinstance(tree, dict):
        raise MeshError("the JSON is no glTF: it is not an object")
    _check_gltf(tree)
    notes.extend(_gltf_notes(tree))

    materials = tree.get("materials", [])
    primitives = [(m, primitive) for m, mesh in enumerate(tree.get("meshes", [])) for primitive in mesh["primitives"]]
    geometries = list(trimesh_scene(file, data, notes).geometry.values()) if primitives else []
    if len(geometries) != len(primitives):
        raise MeshError(f"it holds {len(primitives)} primitives, but trimesh read {len(geometries)}")
    of_mesh: dict[int, list[tuple[Any, Surface]]] = {}
    for (m, primitive), geometry in zip(primitives, geometries, strict=True):
        mesh = triangles_only(geometry, f"mesh {m}")
        material = {} if primitive.get("material") is None else materials[primitive["material"]]
        notes.extend(note for note in _unread_images(material, mesh) if note not in notes)
        surface = surface_of_mesh(mesh, factors_of_gltf(material), linear_colours=True)
        notes.extend(note for note in surface.remarks if note not in notes)
        of_mesh.setdefault(m, []).append((mesh, surface))
    return [
        part_of(name, mesh, surface, matrix)
        for name, m, matrix in _gltf_instances(tree)
        for mesh, surface in of_mesh.get(m, [])
    ]


def _gltf_json(data: bytes) -> Any:
    """Return the JSON of a GLB file, its first chunk."""
    if len(data) < 20 or data[:4] != b"glTF":
        raise MeshError("not a GLB file: it does not start with the glTF header")
    version, length, chunk, kind = struct.unpack_from("<II I4s", data, 4)
    if version != 2:
        raise MeshError(f"glTF version {version} is not supported; version 2 is")
    if length > len(data):
        raise MeshError(f"the file is cut short: its header announces {length} bytes and it has {len(data)}")
    if kind != b"JSON" or 20 + chunk > length:
        raise MeshError("the GLB file is damaged: its first chunk is not a whole JSON chunk")
    return json.loads(data[20 : 20 + chunk].decode("utf-8"))


def _check_gltf(tree: Mapping[str, Any]) -> None:
    """Refuse what trimesh would read as something else, or leave out."""
    unsupported = [name for name in tree.get("extensionsRequired", []) if not _HARMLESS.fullmatch(name)]
    if unsupported:
        raise MeshError(f"it requires {', '.join(unsupported)}, which is not supported; export it without")
    accessors = tree.get("accessors", [])
    for m, mesh in enumerate(tree.get("meshes", [])):
        if any("_RADIOSITY_0" in primitive["attributes"] for primitive in mesh["primitives"]):
            raise MeshError(SOLVED)
        label = f"mesh {mesh.get('name', m)!r}"
        for k, primitive in enumerate(mesh["primitives"]):
            mode = primitive.get("mode", 4)
            if mode not in (4, 5):
                shape = _MODES[mode] if mode in range(len(_MODES)) else f"of unknown mode {mode}"
                raise MeshError(f"primitive {k} of {label} is {shape}; only triangles are supported")
            used = [primitive["attributes"]["POSITION"], *([primitive["indices"]] if "indices" in primitive else [])]
            if any("sparse" in accessors[index] for index in used):
                raise MeshError(f"primitive {k} of {label} has sparse accessors, which are not supported")
            count = accessors[used[-1]]["count"]
            if mode == 4 and count % 3:
                raise MeshError(f"primitive {k} of {label} has {count} corners, which make no whole triangles")


def _gltf_notes(tree: Mapping[str, Any]) -> Iterator[str]:
    """Name what bears on light and is left out."""
    used = tree.get("extensionsUsed", [])
    if "KHR_lights_punctual" in used:
        yield "point, spot and directional lights are left out: only surfaces emit"
    for m, material in enumerate(tree.get("materials", [])):
        pbr = material.get("pbrMetallicRoughness", {})
        for texture in (pbr.get("baseColorTexture"), material.get("emissiveTexture")):
            if texture and (
                texture.get("texCoord", 0) != 0 or "KHR_texture_transform" in texture.get("extensions", {})
            ):
                yield f"a texture of material {material.get('name', m)!r} is read without its transform or second set"


def _unread_images(material: Mapping[str, Any], mesh: Any) -> Iterator[str]:
    """Name the textures that a material states but that cannot be used."""
    stated = {**material.get("pbrMetallicRoughness", {}), **material}
    uv = getattr(mesh.visual, "uv", None)
    for key in ("baseColorTexture", "emissiveTexture"):
        if key in stated and (uv is None or getattr(mesh.visual.material, key, None) is None):
            why = "has no texture coordinates" if uv is None else "could not be read"
            yield f"the {key} of material {material.get('name', '')!r} {why}: its factor is taken alone"


def _gltf_instances(tree: Mapping[str, Any]) -> Iterator[tuple[str, int, FloatArray]]:
    """Yield name, mesh and (4, 4) world matrix of every node that shows a mesh, depth first in file order."""
    nodes = tree.get("nodes", [])
    scenes = tree.get("scenes")
    if scenes:
        roots = scenes[tree.get("scene", 0)].get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [i for i in range(len(nodes)) if i not in children]
    seen: set[int] = set()
    stack = [(root, np.eye(4)) for root in reversed(roots)]
    while stack:
        i, parent = stack.pop()
        if i in seen:
            raise MeshError(f"node {i} is reached twice: the nodes are no tree")
        seen.add(i)
        node = nodes[i]
        matrix = parent @ _gltf_matrix(node)
        if "mesh" in node:
            mesh = tree["meshes"][node["mesh"]]
            yield str(node.get("name") or mesh.get("name") or f"node {i}"), node["mesh"], matrix
        stack.extend((child, matrix) for child in reversed(node.get("children", [])))


def _gltf_matrix(node: Mapping[str, Any]) -> FloatArray:
    """Return the node's (4, 4) matrix, given whole (column by column) or as translation * rotation * scale."""
    if "matrix" in node:
        return np.asarray(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = np.asarray(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.asarray(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix
