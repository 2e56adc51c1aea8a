"""A mesh in its place, on its way from a file or from trimesh into a scene."""

from __future__ import annotations

import io
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, one_per_patch
from ..materials import DEFAULT_REFLECTANCE, Surface, surface_of_mesh
from ..scene import Scene


@dataclass(frozen=True)
class Part:
    """One mesh in its place: (v, 3) vertices in m, (f, 3) faces, and the surface of its f patches."""

    name: str
    vertices: FloatArray
    faces: IntArray
    surface: Surface


SOLVED = "a saved solution: its colours are light, not reflectance; save .npz as well, which load_solution reads"


class MeshError(ValueError):
    """A mesh that cannot become a scene, for a reason that reads well; what goes wrong in a library is reworded."""


def triangles_only(geometry: Any, name: str) -> Any:
    """Return the geometry itself if it is a triangle mesh."""
    import trimesh

    if not isinstance(geometry, trimesh.Trimesh):
        raise MeshError(f"{name!r} is a {type(geometry).__name__}: points and lines have no area; keep triangles only")
    return geometry


def part_of(name: str, mesh: Any, surface: Surface | None = None, matrix: FloatArray | None = None) -> Part:
    """Return a trimesh mesh as a part, moved by `matrix` (4, 4); a mirroring one reverses the triangles."""
    vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
    if matrix is not None:
        vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        if np.linalg.det(matrix[:3, :3]) < 0.0:
            faces = faces[:, [0, 2, 1]]
    return Part(name, vertices, faces, surface_of_mesh(mesh) if surface is None else surface)


def joined_scene(
    parts: Sequence[Part],
    reflectance: npt.ArrayLike | None = None,
    emission: npt.ArrayLike | None = None,
    mirror: npt.ArrayLike | None = None,
    ior: npt.ArrayLike | None = None,
) -> Scene:
    """Put all parts into one scene, in their order; what is given takes the place of their materials."""
    if not any(len(part.faces) for part in parts):
        raise MeshError("the mesh is empty: it holds no triangles")
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    n = sum(len(part.faces) for part in parts)
    # What is told of the surfaces in place of their materials is told of diffuse ones, unless it says otherwise.
    if mirror is None:
        mirror = 0.0 if reflectance is not None else _joined(parts, "mirror", 0.0)
    if ior is None:
        ior = np.nan if reflectance is not None else _joined(parts, "ior", np.nan)
    is_specular = (one_per_patch("mirror", n, mirror) != 0.0) | ~np.isnan(one_per_patch("ior", n, ior))

    def diffuse(quantity: str, default: float) -> float | FloatArray:
        values = _joined(parts, quantity, default)
        return values if isinstance(values, float) else np.where(is_specular[:, None], 0.0, values)

    return Scene(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)]),
        reflectance=diffuse("reflectance", DEFAULT_REFLECTANCE) if reflectance is None else reflectance,
        emission=diffuse("emission", 0.0) if emission is None else emission,
        names=[part.name for part in parts for _ in range(len(part.faces))],
        mirror=mirror,
        ior=ior,
    )


def _joined(parts: Sequence[Part], quantity: str, default: float) -> float | FloatArray:
    """Join to (n, 3) or (n,) values, the default where a part states none; the default alone where none does."""
    values: list[FloatArray | None] = [getattr(part.surface, quantity) for part in parts]
    stated = next((value for value in values if value is not None), None)
    if stated is None:
        return default
    return np.concatenate(
        [
            np.full((len(part.faces), *stated.shape[1:]), default) if value is None else value
            for part, value in zip(parts, values, strict=True)
        ]
    )


def trimesh_scene(file: Path, data: bytes, notes: list[str], **options: Any) -> Any:
    """Let trimesh read the file, vertices and faces as they stand in it; `notes` gets what it logs as left out."""
    import trimesh

    listener = _Listener(notes)
    logger = logging.getLogger("trimesh")
    logger.addHandler(listener)
    try:
        return trimesh.load_scene(
            io.BytesIO(data),
            file_type=file.suffix.lower()[1:],
            resolver=trimesh.resolvers.FilePathResolver(str(file.absolute())),
            process=False,
            **options,
        )
    finally:
        logger.removeHandler(listener)


class _Listener(logging.Handler):
    """Turns what trimesh would log on stderr into notes."""

    def __init__(self, notes: list[str]) -> None:
        super().__init__(logging.WARNING)
        self._notes = notes

    def emit(self, record: logging.LogRecord) -> None:
        self._notes.append(record.getMessage().strip("!"))
