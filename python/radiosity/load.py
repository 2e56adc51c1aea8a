"""Scenes from files and from trimesh meshes.

trimesh reads the meshes. What it drops or rounds is read beside it: the exact colour factors, the emissive strength,
the object names and the order of a glTF file (from its JSON), and the names of an OBJ file's objects.

Patches come out in file order: objects in the order of the file (glTF: nodes depth first, then primitives), and the
triangles of each primitive as stored. Polygons of OBJ and PLY files are cut into triangles by trimesh, which lists the
first halves of a group of quadrilaterals before the second halves. Nothing is merged, dropped or turned over, except
that a mirroring transform reverses the triangles, so that the front stays the front.

Colours become reflectance and emissive colours emission as `radiosity.materials` says; in short:

    glTF       base colour factor x texture x vertex colours (linear); E = pi x emissive factor x emissive strength
    OBJ, MTL   Kd x map_Kd (Kd linear); E = pi x Ke
    PLY        face colours, or the mean of the vertex colours (sRGB)
    STL        no materials

Where a file states no colour, reflectance is 0.5 and emission 0. glTF's own default is a white that reflects all
light. Writers leave it out both for white and for "nobody chose a colour", and no real surface is that white, so a
material without a base colour counts as stating none. A factor that is written, 1.0 included, is kept as it is.

Limits. Every patch has one side, the front, whatever a file says about double-sided materials. Animations, skins,
morph targets and punctual lights are left out.
"""

from __future__ import annotations

import io
import json
import os
import re
import struct
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IntArray
from .materials import DEFAULT_REFLECTANCE, Surface, factors_of_gltf, surface_of_mesh
from .scene import Scene

__all__ = ["from_trimesh", "load"]


@dataclass(frozen=True)
class _Part:
    """One mesh in its place: (v, 3) vertices in m, (f, 3) faces, and the surface of its f patches."""

    name: str
    vertices: FloatArray
    faces: IntArray
    surface: Surface


class MeshError(ValueError):
    """A mesh that cannot become a scene, for a reason that reads well; what goes wrong in a library is reworded."""


def load(path: str | os.PathLike[str]) -> Scene:
    """Load a scene from a file: glb, gltf, obj, ply, stl, or the xml of Mitsuba.

    Args:
        path: the file. Lengths are taken as metres, whatever the file's unit is.

    Returns:
        The scene; `names` holds the object of each patch (the node of a glTF file, the object or group of an OBJ file,
        the solid of an STL file, else the file's name). Bands are R, G, B where the file states any colour, else one.

    Raises:
        FileNotFoundError: no such file.
        IsADirectoryError: `path` is a folder.
        ImportError: a Mitsuba scene, and Mitsuba is not installed.
        ValueError: an unknown extension; a file that is damaged, cut short or empty, or that holds something other
            than triangles or needs an extension that is not supported; values that `Scene` refuses.

    Warns:
        UserWarning: something in the file that bears on light is left out (a missing material file, lights, texture
            transforms).

    """
    file = Path(path)
    if file.is_dir():
        raise IsADirectoryError(f"{file}: is a folder, not a mesh file")
    if not file.exists():
        raise FileNotFoundError(f"{file}: no such file")
    extension = file.suffix.lower()
    if extension == ".xml":
        return _read_mitsuba(file)
    if extension not in _READERS:
        valid = ", ".join([*_READERS, ".xml"])
        raise ValueError(f"{file}: unknown extension {extension or '(none)'}; valid are {valid}")

    kind = extension[1:].upper()
    data = file.read_bytes()
    if not data:
        raise ValueError(f"{file}: the file is empty")
    notes: list[str] = []
    try:
        with warnings.catch_warnings():
            # NumPy before 2.3 only warns when it stops at a word that is no number, and the rest of the mesh is lost.
            warnings.filterwarnings("error", message="string or file could not be read", category=DeprecationWarning)
            parts = _READERS[extension](file, data, notes)
    except MeshError as error:
        raise ValueError(f"{file}: {error}") from error
    except MemoryError:
        raise
    except Exception as error:
        reason = str(error) or "data are missing or have the wrong length"
        raise ValueError(f"{file}: not a valid {kind} mesh: {reason} ({type(error).__name__})") from error
    try:
        scene = _scene(parts)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    for note in notes:
        warnings.warn(f"{file}: {note}", UserWarning, stacklevel=2)
    return scene


def _read_mitsuba(file: Path) -> Scene:
    from .mitsuba import from_mitsuba, variant

    name = variant()
    import mitsuba

    if mitsuba.variant() is None:
        mitsuba.set_variant(name)
    try:
        scene = mitsuba.load_file(str(file))
    except Exception as error:
        raise ValueError(f"{file}: not a valid Mitsuba scene: {error}") from error
    try:
        return from_mitsuba(scene)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


def from_trimesh(mesh: Any, reflectance: npt.ArrayLike | None = None, emission: npt.ArrayLike | None = None) -> Scene:
    """Make a scene from a `trimesh.Trimesh` or a `trimesh.Scene`.

    The meshes of a `trimesh.Scene` are put in their places, once for every node that shows them, in the order of its
    graph. Face and vertex colours are taken as sRGB, factors of materials as linear; trimesh keeps both in 8 bits and
    drops the emissive strength of glTF files, so a file is better loaded by `radiosity.load`.

    Args:
        mesh: n triangles in all, lengths in m.
        reflectance: scalar | (b,) | (n, b) in [0, 1]; None takes it from the materials, 0.5 where there is none.
        emission: scalar | (b,) | (n, b) in W/m^2; None takes it from the materials (pi times the emissive factor), 0
            where there is none.

    Returns:
        The scene; `names` holds the node (of a single mesh: its metadata's "name", else "mesh") of each patch.

    Raises:
        TypeError: `mesh` is neither a Trimesh nor a trimesh Scene.
        ValueError: no triangles, a node that is no triangle mesh, or values that `Scene` refuses.

    """
    import trimesh

    if isinstance(mesh, trimesh.Trimesh):
        name = str(mesh.metadata.get("name") or "mesh")
        return _scene([_part(name, mesh)], reflectance, emission)
    if not isinstance(mesh, trimesh.Scene):
        raise TypeError(f"expected a trimesh.Trimesh or trimesh.Scene, not {type(mesh).__name__}")
    parts = []
    for node in mesh.graph.nodes_geometry:
        matrix, geometry = mesh.graph[node]
        parts.append(_part(str(node), _triangles(mesh.geometry[geometry], str(node)), matrix=matrix))
    return _scene(parts, reflectance, emission)


def _triangles(geometry: Any, name: str) -> Any:
    """Return the geometry itself if it is a triangle mesh."""
    import trimesh

    if not isinstance(geometry, trimesh.Trimesh):
        raise MeshError(f"{name!r} is a {type(geometry).__name__}: points and lines have no area; keep triangles only")
    return geometry


def _part(name: str, mesh: Any, surface: Surface | None = None, matrix: FloatArray | None = None) -> _Part:
    vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
    if matrix is not None:
        vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        if np.linalg.det(matrix[:3, :3]) < 0.0:
            faces = faces[:, [0, 2, 1]]
    return _Part(name, vertices, faces, surface_of_mesh(mesh) if surface is None else surface)


def _scene(
    parts: Sequence[_Part], reflectance: npt.ArrayLike | None = None, emission: npt.ArrayLike | None = None
) -> Scene:
    """Put all parts into one scene, in their order."""
    if not any(len(part.faces) for part in parts):
        raise MeshError("the mesh is empty: it holds no triangles")
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Scene(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)]),
        reflectance=_joined(parts, "reflectance", DEFAULT_REFLECTANCE) if reflectance is None else reflectance,
        emission=_joined(parts, "emission", 0.0) if emission is None else emission,
        names=[part.name for part in parts for _ in range(len(part.faces))],
    )


def _joined(parts: Sequence[_Part], quantity: str, default: float) -> float | FloatArray:
    """Join to (n, 3) values, the default where a part states none; the default alone, of any bands, where none does."""
    values: list[FloatArray | None] = [getattr(part.surface, quantity) for part in parts]
    if all(value is None for value in values):
        return default
    return np.concatenate(
        [
            np.full((len(part.faces), 3), default) if value is None else value
            for part, value in zip(parts, values, strict=True)
        ]
    )


# ---------------------------------------------------------------------------------------------------------- PLY, STL


def _read_plain(file: Path, data: bytes, notes: list[str]) -> list[_Part]:
    """Read PLY and STL: one mesh, or the solids of a text STL."""
    del notes
    extension = file.suffix.lower()[1:]
    expected, solids = _stl_contents(data) if extension == "stl" else (None, [])
    parts = []
    geometries = _trimesh_scene(file, data).geometry.values()
    titles = solids if len(solids) == len(geometries) else [""] * len(geometries)
    for title, geometry in zip(titles, geometries, strict=True):
        mesh = _triangles(geometry, file.name)
        if extension == "ply":
            _check_ply(mesh)
        parts.append(_part(title or file.stem, mesh))
    found = sum(len(part.faces) for part in parts)
    if expected is not None and found != expected:
        raise MeshError(f"{expected} triangles are announced, but only {found} are there")
    return parts


def _stl_contents(data: bytes) -> tuple[int, list[str]]:
    """Count the triangles that an STL file announces, and name the solids of a text one.

    trimesh leaves out what it cannot read of a text file, and takes a binary file cut short for an empty text one.
    """
    header = 84
    if len(data) >= header:
        (count,) = struct.unpack_from("<I", data, header - 4)
        if len(data) == header + 50 * count:
            return int(count), []
    text = data.decode("utf-8", errors="replace")
    if not text.lstrip().lower().startswith("solid"):
        raise MeshError("neither a complete binary STL file nor a text one")
    count = len(re.findall(r"^\s*facet\s", text, re.MULTILINE | re.IGNORECASE))
    return count, re.findall(r"^[ \t]*solid[ \t]*(.*?)\s*$", text, re.MULTILINE | re.IGNORECASE)


def _check_ply(mesh: Any) -> None:
    """Compare with the counts of the header, and give the colour of a quadrilateral to both its halves."""
    elements = mesh.metadata.get("_ply_raw", {})
    vertices = elements.get("vertex", {}).get("length", 0)
    faces = elements.get("face", {}).get("length", 0)
    # trimesh splits vertices that have several texture coordinates, and polygons: both only add.
    if len(mesh.vertices) < vertices or len(mesh.faces) < faces:
        raise MeshError(
            f"the header announces {vertices} vertices and {faces} faces, "
            f"but only {len(mesh.vertices)} and {len(mesh.faces)} are there"
        )
    if mesh.visual.kind == "face" and len(mesh.faces) == 2 * len(mesh.visual.face_colors):
        mesh.visual.face_colors = np.tile(mesh.visual.face_colors, (2, 1))


def _trimesh_scene(file: Path, data: bytes, **options: Any) -> Any:
    """Let trimesh read the file, vertices and faces as they stand in it."""
    import trimesh

    return trimesh.load_scene(
        io.BytesIO(data),
        file_type=file.suffix.lower()[1:],
        resolver=trimesh.resolvers.FilePathResolver(str(file.absolute())),
        process=False,
        **options,
    )


# --------------------------------------------------------------------------------------------------------------- OBJ


def _read_obj(file: Path, data: bytes, notes: list[str]) -> list[_Part]:
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
    scene = _trimesh_scene(file, data, split_objects=True, split_groups=True)
    # trimesh builds the groups from the last to the first.
    for name, geometry in reversed(scene.geometry.items()):
        mesh = _triangles(geometry, name)
        material = getattr(mesh.visual, "material", None)
        if material is not None and materials.get(material.name) and material.image is None:
            notes.append(f"the image of material {material.name!r} could not be read: its colour is taken alone")
        parts.append(_part(_obj_name(file, name, list(materials)), mesh))
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


# -------------------------------------------------------------------------------------------------------------- glTF

# Extensions without which a file still shows the same triangles. A file that requires any other one is refused, as the
# glTF specification asks: read without it, its geometry or its colours would be wrong.
_HARMLESS = re.compile(r"KHR_materials_(?!pbrSpecularGlossiness).*|KHR_lights_punctual|KHR_texture_transform")

_MODES = ["points", "lines", "a line loop", "a line strip", "triangles", "a triangle strip", "a triangle fan"]


def _read_gltf(file: Path, data: bytes, notes: list[str]) -> list[_Part]:
    tree = _gltf_json(data) if file.suffix.lower() == ".glb" else json.loads(data.decode("utf-8-sig"))
    if not isinstance(tree, dict):
        raise MeshError("the JSON is no glTF: it is not an object")
    _check_gltf(tree)
    notes.extend(_gltf_notes(tree))

    materials = tree.get("materials", [])
    primitives = [(m, primitive) for m, mesh in enumerate(tree.get("meshes", [])) for primitive in mesh["primitives"]]
    geometries = list(_trimesh_scene(file, data).geometry.values()) if primitives else []
    if len(geometries) != len(primitives):
        raise MeshError(f"it holds {len(primitives)} primitives, but trimesh read {len(geometries)}")
    of_mesh: dict[int, list[tuple[Any, Surface]]] = {}
    for (m, primitive), geometry in zip(primitives, geometries, strict=True):
        mesh = _triangles(geometry, f"mesh {m}")
        material = {} if primitive.get("material") is None else materials[primitive["material"]]
        notes.extend(note for note in _unread_images(material, mesh) if note not in notes)
        factors = factors_of_gltf(material)
        of_mesh.setdefault(m, []).append((mesh, surface_of_mesh(mesh, factors, linear_colours=True)))
    return [
        _part(name, mesh, surface, matrix)
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


_READERS: dict[str, Callable[[Path, bytes, list[str]], list[_Part]]] = {
    ".glb": _read_gltf,
    ".gltf": _read_gltf,
    ".obj": _read_obj,
    ".ply": _read_plain,
    ".stl": _read_plain,
}
