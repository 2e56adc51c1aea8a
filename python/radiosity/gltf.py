"""A solution as binary glTF 2.0: unlit, so that a viewer shows the light that was computed and adds none of its own."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IntArray
from .render import exposure_of, shown_radiance, to_srgb
from .solution import Solution

_FLOAT, _UINT = 5126, 5125
_ARRAYS, _INDICES = 34962, 34963
# Texels around every chart of a lightmap that hold its border once more: filtering must not find the background.
_PADDING = 2


def glb(solution: Solution, exposure: float | None, lightmap: int | None) -> bytes:
    """The file: one colour a patch, or a texture of ``lightmap`` texels each way."""
    try:
        import pygltflib
    except ImportError as error:
        raise ImportError("GLB files need the package pygltflib: pip install radiosity[files]") from error
    scene = solution.scene
    assert scene is not None
    factor = exposure_of(solution, exposure)
    n, bands = solution.radiosity.shape
    builder = _Builder(pygltflib)
    attributes = pygltflib.Attributes()
    material = pygltflib.Material(
        pbrMetallicRoughness=pygltflib.PbrMetallicRoughness(metallicFactor=0.0, roughnessFactor=1.0),
        extensions={"KHR_materials_unlit": {}},
        doubleSided=False,
    )
    if lightmap is None:
        # Corners of their own for every patch, or colours would be blended from patch to patch.
        faces = np.arange(3 * n).reshape(n, 3)
        origin = scene.faces.reshape(-1)
        colours = np.clip(factor * solution.radiosity / np.pi, 0.0, 1.0)
        builder.add(attributes, "COLOR_0", np.repeat(np.broadcast_to(colours, (n, 3)), 3, axis=0))
        radiosity = np.repeat(solution.radiosity, 3, axis=0)
    else:
        origin, faces, uv = _charts(scene.vertices, scene.faces)
        texels = _texture(shown_radiance(solution), faces, uv, lightmap)
        builder.texture(material, to_srgb(texels, factor))
        builder.add(attributes, "TEXCOORD_0", uv)
        # A vertex of several patches has the mean of what they have.
        sums, counts = np.zeros((len(origin), bands)), np.zeros(len(origin))
        for corner in faces.T:
            np.add.at(sums, corner, solution.radiosity)
            np.add.at(counts, corner, 1.0)
        radiosity = sums / np.maximum(counts, 1.0)[:, None]
    builder.add(attributes, "POSITION", scene.vertices[origin])
    for b in range(bands):
        builder.add(attributes, f"_RADIOSITY_{b}", radiosity[:, b])
    indices = builder.accessor(faces.reshape(-1).astype(np.uint32), _INDICES)
    return builder.file(attributes, indices, material)


class _Builder:
    """Arrays one after the other in one buffer, and the JSON that says where."""

    def __init__(self, pygltflib: Any) -> None:
        self.lib = pygltflib
        self.gltf = pygltflib.GLTF2(
            asset=pygltflib.Asset(version="2.0", generator="radiosity"), extensionsUsed=["KHR_materials_unlit"]
        )
        self.data = bytearray()

    def view(self, data: bytes, target: int | None = None) -> int:
        self.data += bytes(-len(self.data) % 4)
        view = self.lib.BufferView(buffer=0, byteOffset=len(self.data), byteLength=len(data), target=target)
        self.gltf.bufferViews.append(view)
        self.data += data
        return len(self.gltf.bufferViews) - 1

    def accessor(self, values: npt.NDArray[Any], target: int) -> int:
        kind = "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}"
        component = _UINT if values.dtype == np.uint32 else _FLOAT
        accessor = self.lib.Accessor(
            bufferView=self.view(values.tobytes(), target), componentType=component, count=len(values), type=kind
        )
        if kind == "VEC3":
            accessor.min, accessor.max = values.min(axis=0).tolist(), values.max(axis=0).tolist()
        self.gltf.accessors.append(accessor)
        return len(self.gltf.accessors) - 1

    def add(self, attributes: Any, name: str, values: FloatArray) -> None:
        setattr(attributes, name, self.accessor(np.ascontiguousarray(values, np.float32), _ARRAYS))

    def texture(self, material: Any, pixels: npt.NDArray[np.uint8]) -> None:
        from PIL import Image

        png = BytesIO()
        Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels).save(png, format="PNG")
        self.gltf.images.append(self.lib.Image(bufferView=self.view(png.getvalue()), mimeType="image/png"))
        self.gltf.samplers.append(self.lib.Sampler(magFilter=9729, minFilter=9729, wrapS=33071, wrapT=33071))
        self.gltf.textures.append(self.lib.Texture(sampler=0, source=0))
        material.pbrMetallicRoughness.baseColorTexture = self.lib.TextureInfo(index=0)

    def file(self, attributes: Any, indices: int, material: Any) -> bytes:
        lib, gltf = self.lib, self.gltf
        gltf.materials = [material]
        gltf.meshes = [lib.Mesh(primitives=[lib.Primitive(attributes=attributes, indices=indices, material=0)])]
        gltf.nodes = [lib.Node(mesh=0, name="solution")]
        gltf.scenes, gltf.scene = [lib.Scene(nodes=[0])], 0
        gltf.buffers = [lib.Buffer(byteLength=len(self.data))]
        gltf.set_binary_blob(bytes(self.data))
        return b"".join(gltf.save_to_bytes())


def _charts(vertices: FloatArray, faces: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    """The patches laid out in the unit square: the vertex of each new one, the faces, and (V', 2) where they lie."""
    try:
        import xatlas
    except ImportError as error:
        raise ImportError("a lightmap needs the package xatlas: pip install radiosity[files]") from error
    origin, indices, uv = xatlas.parametrize(vertices.astype(np.float32), faces.astype(np.uint32))
    return origin.astype(np.int64), indices.astype(np.int64), uv.astype(np.float64)


def _texture(radiance: FloatArray, faces: IntArray, uv: FloatArray, size: int) -> FloatArray:
    """(size, size, b): the radiance of what lies at every texel, interpolated between the corners of its patch."""
    texture = np.zeros((size, size, radiance.shape[2]))
    known = np.zeros((size, size), bool)
    corners = uv[faces] * size
    for values, triangle in zip(radiance, corners, strict=True):
        low = np.clip(np.floor(triangle.min(axis=0) - 1.0).astype(int), 0, size - 1)
        high = np.clip(np.ceil(triangle.max(axis=0) + 1.0).astype(int), low + 1, size)
        x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        a, b, c = triangle
        twice = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if twice == 0.0:
            continue
        v = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / twice
        w = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / twice
        weights = np.stack([1.0 - v - w, v, w], axis=-1)
        inside = (weights >= 0.0).all(axis=-1)
        block = np.s_[low[1] : high[1], low[0] : high[0]]
        texture[block][inside] = weights[inside] @ values
        known[block][inside] = True
    for _ in range(_PADDING):
        # Texels beside known ones get their mean.
        sums, counts = np.zeros_like(texture), np.zeros((size, size))
        for shift in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            near = np.roll(known, shift, (0, 1))
            sums += np.roll(np.where(known[..., None], texture, 0.0), shift, (0, 1))
            counts += near
        new = ~known & (counts > 0)
        texture[new] = sums[new] / counts[new][:, None]
        known |= new
    return texture
