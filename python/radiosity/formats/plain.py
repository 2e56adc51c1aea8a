"""PLY and STL: one mesh, or the solids of a text STL."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from .part import SOLVED, MeshError, Part, part_of, triangles_only, trimesh_scene


def read_plain(file: Path, data: bytes, notes: list[str]) -> list[Part]:
    """Read PLY and STL: one mesh, or the solids of a text STL; `notes` gets what is left out."""
    extension = file.suffix.lower()[1:]
    expected, solids = _stl_contents(data) if extension == "stl" else (None, [])
    parts = []
    geometries = trimesh_scene(file, data, notes).geometry.values()
    titles = solids if len(solids) == len(geometries) else [""] * len(geometries)
    for title, geometry in zip(titles, geometries, strict=True):
        mesh = triangles_only(geometry, file.name)
        if extension == "ply":
            _check_ply(mesh)
        parts.append(part_of(title or file.stem, mesh))
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
    if "radiosity_0" in elements.get("face", {}).get("properties", {}):
        raise MeshError(SOLVED)
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
