"""Write the Cornell box that the package ships: the mesh as a GLB file and its path-traced radiosity beside it.

    python tests/data/make_cornell_glb.py cornell_1004.npz [folder]

The argument is a reference scene: vertices, faces, reflectance, emission, radiosity and stderr per face, and the
version and number of paths of the Mitsuba run that made them (data/README.md). The GLB file has one node, mesh and
material for each object, triangles in the order of the reference, base colours as they are, and the emission as an
emissive factor in [0, 1] times KHR_materials_emissive_strength, which is radiance: emission / pi. The positions are
rounded to 32 bits, which is what glTF stores.

Needs numpy and pygltflib (only here and in tests).
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pygltflib as gltf

HEIGHT, DEPTH = 0.5488, 0.5592
# Middles of the blocks on the floor (x, z), m.
BLOCKS = {"short block": (0.1855, 0.1690), "tall block": (0.3685, 0.3513)}


def objects(triangles: npt.NDArray[np.float64], material: npt.NDArray[np.float64]) -> list[str]:
    """Return the object of each of the (n, 3, 3) triangles, told by its place and its (n, 6) material."""
    names = []
    for corners, (red, green, _, *emission) in zip(triangles, material, strict=True):
        x, _, z = corners.mean(axis=0)
        if any(emission):
            name = "lamp"
        elif red > 2 * green:
            name = "left wall"
        elif green > 2 * red:
            name = "right wall"
        elif np.allclose(corners[:, 1], 0.0):
            name = "floor"
        elif np.allclose(corners[:, 1], HEIGHT):
            name = "ceiling"
        elif np.allclose(corners[:, 2], DEPTH):
            name = "back wall"
        else:
            name = min(BLOCKS, key=lambda block: math.dist(BLOCKS[block], (x, z)))
        names.append(name)
    return names


def gltf_material(name: str, reflectance: list[float], emission: list[float]) -> gltf.Material:
    """Make a rough, non-metallic material: reflectance (3,), emission (3,) in W/m^2."""
    material = gltf.Material(
        name=name,
        pbrMetallicRoughness=gltf.PbrMetallicRoughness(
            baseColorFactor=[*reflectance, 1.0], metallicFactor=0.0, roughnessFactor=1.0
        ),
    )
    strength = max(emission) / math.pi
    if strength > 0.0:
        material.emissiveFactor = [value / math.pi / strength for value in emission]
        material.extensions = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
    return material


def main() -> None:
    """Read the reference scene and write both files."""
    parser = argparse.ArgumentParser(description="Write cornell_box.glb and cornell_box_reference.npz.")
    parser.add_argument("reference", type=Path, help="the reference scene, an npz file")
    data = Path(__file__).parents[1] / "python" / "radiosity" / "data"
    parser.add_argument("folder", type=Path, nargs="?", default=data, help="where to write; default: %(default)s")
    arguments = parser.parse_args()

    with np.load(arguments.reference) as file:
        scene = dict(file)
    vertices, faces = scene["vertices"], scene["faces"]
    material = np.concatenate([scene["reflectance"], scene["emission"]], axis=1)
    names = objects(vertices[faces], material)

    document = gltf.GLTF2(
        asset=gltf.Asset(version="2.0", generator="radiosity tests/data/make_cornell_glb.py"),
        extensionsUsed=["KHR_materials_emissive_strength"],
    )
    blob = bytearray()

    def accessor(array: npt.NDArray[np.generic], target: int, kind: str, component: int) -> int:
        start = len(blob)
        blob.extend(array.tobytes())
        document.bufferViews.append(gltf.BufferView(buffer=0, byteOffset=start, byteLength=array.nbytes, target=target))
        blob.extend(bytes(-len(blob) % 4))
        bounds = array.min(axis=0), array.max(axis=0)
        document.accessors.append(
            gltf.Accessor(
                bufferView=len(document.bufferViews) - 1,
                componentType=component,
                count=len(array),
                type=kind,
                min=np.atleast_1d(bounds[0]).tolist(),
                max=np.atleast_1d(bounds[1]).tolist(),
            )
        )
        return len(document.accessors) - 1

    order = []
    for k, name in enumerate(dict.fromkeys(names)):
        rows = np.array([i for i, other in enumerate(names) if other == name])
        order.append(rows)
        if np.ptp(material[rows], axis=0).any():
            raise SystemExit(f"{name}: more than one material")
        used, indices = np.unique(faces[rows], return_inverse=True)
        document.materials.append(
            gltf_material(name, scene["reflectance"][rows[0]].tolist(), scene["emission"][rows[0]].tolist())
        )
        position = accessor(vertices[used].astype("<f4"), gltf.ARRAY_BUFFER, gltf.VEC3, gltf.FLOAT)
        index = accessor(indices.reshape(-1).astype("<u2"), gltf.ELEMENT_ARRAY_BUFFER, gltf.SCALAR, gltf.UNSIGNED_SHORT)
        primitive = gltf.Primitive(attributes=gltf.Attributes(POSITION=position), indices=index, material=k)
        document.meshes.append(gltf.Mesh(name=name, primitives=[primitive]))
        document.nodes.append(gltf.Node(name=name, mesh=k))
    document.scenes = [gltf.Scene(nodes=list(range(len(document.nodes))))]
    document.scene = 0
    document.buffers = [gltf.Buffer(byteLength=len(blob))]
    document.set_binary_blob(bytes(blob))
    document.save_binary(str(arguments.folder / "cornell_box.glb"))

    rows = np.concatenate(order)
    np.savez_compressed(
        arguments.folder / "cornell_box_reference.npz",
        radiosity=scene["radiosity"][rows],
        stderr=scene["stderr"][rows],
        mitsuba_version=scene["mitsuba_version"],
        paths=scene["paths"],
    )


if __name__ == "__main__":
    main()
