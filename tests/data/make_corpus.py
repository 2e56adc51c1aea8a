"""Writes tests/data/corpus/: small sound files of every kind that is read, for tests/python/fuzz.py to damage.

python tests/data/make_corpus.py
"""

import json
import struct
from pathlib import Path

import numpy as np
import trimesh

import radiosity as rad

FOLDER = Path(__file__).parent / "corpus"


def main():
    FOLDER.mkdir(exist_ok=True)
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1.5]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 1], [1, 4, 5]])
    mesh = trimesh.Trimesh(corners, faces, process=False)
    coloured = mesh.copy()
    coloured.visual.face_colors = [[200, 100, 50, 255], [10, 20, 30, 255]] * 2

    (FOLDER / "gltf.glb").write_bytes(_glb(corners, faces))
    (FOLDER / "embedded.gltf").write_text(_gltf(corners, faces), encoding="ascii")
    (FOLDER / "trimesh.glb").write_bytes(trimesh.Scene({"a": coloured, "b": mesh}).export(file_type="glb"))
    (FOLDER / "binary.ply").write_bytes(coloured.export(file_type="ply"))
    (FOLDER / "text.ply").write_bytes(coloured.export(file_type="ply", encoding="ascii"))
    (FOLDER / "binary.stl").write_bytes(mesh.export(file_type="stl"))
    (FOLDER / "text.stl").write_text(mesh.export(file_type="stl_ascii"), encoding="ascii")
    (FOLDER / "materials.mtl").write_text("newmtl red\nKd 0.6 0.1 0.1\nnewmtl lamp\nKd 0 0 0\nKe 3 2 1\n", "ascii")
    lines = ["mtllib materials.mtl", *(f"v {x} {y} {z}" for x, y, z in corners), "vt 0 0", "vt 1 0", "vt 0 1"]
    lines += ["o floor", "usemtl red", "f 1 2 3 4", "g wall", "usemtl lamp", "f 1/1 5/2 2/3", "f -5/1 -2/2 -1/3", ""]
    (FOLDER / "groups.obj").write_text("\n".join(lines), encoding="ascii")
    scene = rad.Scene(corners, faces, 0.5, [[1.0, 0.0], [0.0, 0.0], [0.0, 2.0], [0.0, 0.0]], names=list("abcd"))
    rad.save(rad.solve(scene, 0.3, progress=False), FOLDER / "rays.npz")
    rad.save(rad.solve(scene, 0.5, "hierarchical", progress=False), FOLDER / "hierarchical.npz")
    rad.save(rad.solve_system(np.full((3, 3), 0.3), 1.0, 0.5, progress=False), FOLDER / "matrix.npz")


def _tree(corners, faces, **buffer):
    data = corners.astype("<f4").tobytes() + faces.astype("<u2").tobytes()
    at = 12 * len(corners)
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"name": "top", "children": [1], "translation": [0, 1, 0]},
            {"name": "low", "mesh": 0, "rotation": [0, 0, 0.6, 0.8], "scale": [1, 2, -1]},
        ],
        "meshes": [{"name": "m", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [
            {
                "name": "lamp",
                "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.4, 0.3, 1]},
                "emissiveFactor": [1, 0.5, 0],
                "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}},
            }
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(corners),
                "type": "VEC3",
                "min": corners.min(axis=0).tolist(),
                "max": corners.max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": 5123, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": at},
            {"buffer": 0, "byteOffset": at, "byteLength": len(data) - at},
        ],
        "buffers": [{"byteLength": len(data), **buffer}],
    }
    return tree, data


def _gltf(corners, faces):
    import base64

    _, data = _tree(corners, faces)
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return json.dumps(_tree(corners, faces, uri=uri)[0])


def _glb(corners, faces):
    tree, data = _tree(corners, faces)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


if __name__ == "__main__":
    main()
