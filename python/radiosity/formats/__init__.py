"""Readers of mesh files, one a format; `radiosity.load` chooses among them."""

from .gltf import read_gltf
from .obj import read_obj
from .plain import read_plain

__all__ = ["read_gltf", "read_obj", "read_plain"]
