"""Scenes from files and from trimesh meshes.

trimesh reads the meshes. What it drops or rounds is read beside it: the exact colour factors, the emissive strength,
the object names and the order of a glTF file (from its JSON), and the names of an OBJ file's objects.

Patches come out in file order: objects in the order of the file (glTF: nodes depth first, then primitives), and the
triangles of each primitive as stored. Polygons of OBJ and PLY files are cut into triangles by trimesh, which lists the
first halves of a group of quadrilaterals before the second halves. Nothing is merged, dropped or turned over, except
that a mirroring transform reverses the triangles, so that the front stays the front.

Colours become reflectance and emissive colours emission as `radiosity.materials` says; in short:

    glTF       base colour factor x texture x vertex colours (linear); E = pi x emissive factor x emissive strength;
               polished metal is a mirror, smooth material that lets all light through is glass
    OBJ, MTL   Kd x map_Kd (Kd linear); E = pi x Ke
    PLY        face colours, or the mean of the vertex colours (sRGB)
    STL        no materials

Where a file states no colour, reflectance is 0.5 and emission 0. glTF's own default is a white that reflects all
light. Writers leave it out both for white and for "nobody chose a colour", and no real surface is that white, so a
material without a base colour counts as stating none (as a mirror, it sends back all light). A factor that is written,
1.0 included, is kept as it is.

Limits. Every patch has one side, the front, whatever a file says about double-sided materials. Glass is read as the
skin of a closed body, also where a file means a thin sheet: `Scene.report` tells where it is not closed. Animations,
skins, morph targets and punctual lights are left out.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .formats import read_gltf, read_obj, read_plain
from .formats.part import MeshError, Part, joined_scene, part_of, triangles_only
from .scene import Scene

__all__ = ["from_trimesh", "load"]


def load(path: str | os.PathLike[str]) -> Scene:
    """Load a scene from a file: glb, gltf, obj, ply, stl, or the xml of Mitsuba.

    Args:
        path: the file. Lengths are taken as metres, whatever the file's unit is, and axes as they are: in glTF files
            y is up.

    Returns:
        The scene; `names` holds the object of each patch (the node of a glTF file, the object or group of an OBJ file,
        the solid of an STL file, else the file's name). Bands are R, G, B where the file states any colour, else one.

    Raises:
        FileNotFoundError: no such file.
        IsADirectoryError: `path` is a folder.
        ImportError: a Mitsuba scene, and Mitsuba is not installed.
        ValueError: an unknown extension; a solution that `save` wrote, whose colours are light and no reflectance; a
            file that is damaged, cut short or empty, or that holds something other
            than triangles or needs an extension that is not supported; values that `Scene` refuses.

    Warns:
        UserWarning: something in the file that bears on light is left out (a missing material file, lights, texture
            transforms, the gloss of metal, the tint of mirrors and glass).

    """
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(
            f"path must name a file, not be a {type(path).__name__}; Scene.from_trimesh takes trimesh meshes"
        )
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
        hint = " (load_solution reads saved solutions)" if extension == ".npz" else ""
        raise ValueError(f"{file}: unknown extension {extension or '(none)'}{hint}; valid are {valid}")

    kind = extension[1:].upper()
    data = file.read_bytes()
    if not data:
        raise ValueError(f"{file}: the file is empty")
    notes: list[str] = []
    try:
        # Numbers that are not finite are refused by name when the scene is made: no warning of numpy's tells it better.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
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
        scene = joined_scene(parts)
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


def from_trimesh(
    mesh: Any,
    reflectance: npt.ArrayLike | None = None,
    emission: npt.ArrayLike | None = None,
    mirror: npt.ArrayLike | None = None,
    ior: npt.ArrayLike | None = None,
) -> Scene:
    """Make a scene from a `trimesh.Trimesh` or a `trimesh.Scene`.

    The meshes of a `trimesh.Scene` are put in their places, once for every node that shows them, in the order of its
    graph. Face and vertex colours are taken as sRGB, factors of materials as linear; trimesh keeps both in 8 bits and
    drops the emissive strength of glTF files, so a file is better loaded by `radiosity.load`.

    Args:
        mesh: n triangles in all, lengths in m.
        reflectance: scalar | (b,) | (n, b) in [0, 1]; None takes it from the materials, 0.5 where there is none. Where
            it is given, no material makes a mirror.
        emission: scalar | (b,) | (n, b) in W/m^2; None takes it from the materials (pi times the emissive factor), 0
            where there is none.
        mirror: scalar | (n,) in [0, 1]; None takes it from the materials (polished metal), 0 where there is none.
        ior: scalar | (n,), nan for what is no glass; None for no glass, of which trimesh's materials do not tell.

    Returns:
        The scene; `names` holds the node (of a single mesh: its metadata's "name", else "mesh") of each patch.

    Raises:
        TypeError: `mesh` is neither a Trimesh nor a trimesh Scene.
        ValueError: no triangles, a node that is no triangle mesh, or values that `Scene` refuses.

    Warns:
        UserWarning: a material that is taken and is neither diffuse nor what `radiosity.materials` reads as a mirror.

    """
    import trimesh

    parts = []
    if isinstance(mesh, trimesh.Trimesh):
        parts.append(part_of(str(mesh.metadata.get("name") or "mesh"), mesh))
    elif isinstance(mesh, trimesh.Scene):
        for node in mesh.graph.nodes_geometry:
            matrix, geometry = mesh.graph[node]
            parts.append(part_of(str(node), triangles_only(mesh.geometry[geometry], str(node)), matrix=matrix))
    else:
        raise TypeError(f"expected a trimesh.Trimesh or trimesh.Scene, not {type(mesh).__name__}")
    if reflectance is None and mirror is None:
        for remark in dict.fromkeys(remark for part in parts for remark in part.surface.remarks):
            warnings.warn(remark, UserWarning, stacklevel=2)
    return joined_scene(parts, reflectance, emission, mirror, ior)


_READERS: dict[str, Callable[[Path, bytes, list[str]], list[Part]]] = {
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".obj": read_obj,
    ".ply": read_plain,
    ".stl": read_plain,
}
