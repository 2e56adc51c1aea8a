"""Shadow maps on the GPU: the light that virtual point lights send straight to the pixels (Keller 1997, section 4).

    H(x) = sum over lights k of Phi_k / pi min(G, c) V,    V = whether the map of k holds nothing nearer than x

A map is a hemicube of depths (Cohen & Greenberg 1985), which shows triangles of any size as they are. A texel holds the
depth of its middle: so a point is lifted along its normal by what its plane may rise within half a texel, and no more
(normal offset). Shadows are off by up to a texel: 2 / resolution of the distance from the light.

What is seen at the pixels, and what paths add, comes from the rays of the core, in 64 bits; the GPU sees positions in
units of the scene, in 32.
"""

from __future__ import annotations

import struct
from functools import cache
from importlib.resources import files as package_files
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _core
from .arrays import FloatArray, thread_count
from .instant import VirtualLights
from .memory import available_bytes
from .progress import Progress, reporter
from .render import Viewpoint

# Places in a pixel, as in the core.
SAMPLES = 16
# Texels of the maps that are held at once: 8 maps of 1024, of 3 times that many.
_TEXELS = 8 * 1024**2
_FACES = 5
_Singles: TypeAlias = npt.NDArray[np.float32]


class ShadowMaps:
    """The lights of a scene on the GPU, for pictures of one size.

    Args:
        lights: the lights.
        shape: (h, w, b) of the pictures.
        resolution: texels along an edge of the hemicube.

    Raises:
        ImportError: the package wgpu is missing.
        RuntimeError: there is no GPU driver.
        ValueError: more than the device takes.
    """

    def __init__(self, lights: VirtualLights, shape: tuple[int, int, int], resolution: int) -> None:
        self._device, self._pipelines = _device()
        self._lights = lights
        self._height, self._width, self._bands = shape
        # The halves of a hemicube's faces.
        self._resolution = resolution + resolution % 2
        self._layers = max(1, min(len(lights), _TEXELS // self._resolution**2))
        self._check()
        scene = lights.scene
        low, high = (end(scene.vertices[scene.faces], axis=(0, 1)) for end in (np.min, np.max))
        self._centre, self._scale = 0.5 * (low + high), 2.0 / float((high - low).max())

    def add_light(
        self,
        image: FloatArray,
        bounds: FloatArray,
        view: Viewpoint,
        seed: int,
        threads: int | None,
        progress: Progress,
    ) -> None:
        """Adds to an image, (h, w, b) radiance, what the lights send straight to its pixels.

        Args:
            image: the image.
            bounds: (m,) the bound of each light's geometry term, 1/m^2.
            view: the viewpoint.
            seed: of the places in the pixels.
            threads: of the rays that find them.
            progress: see :mod:`radiosity.progress`.
        """
        self._upload(bounds)
        scene = self._lights.scene
        flat = image.reshape(-1, self._bands)
        with reporter(progress, "shadow maps") as report:
            for sample in range(SAMPLES):
                positions, patch = _core.places(
                    scene._core,
                    view,
                    self._width,
                    self._height,
                    sample,
                    seed,
                    available_bytes(),
                    thread_count(threads),
                )
                seen = patch >= 0
                irradiance = self._irradiance(sample, positions, scene.normals[patch], seen)
                flat += np.where(seen[:, None], scene.reflectance[patch] / np.pi * irradiance, 0.0)
                if report is not None:
                    report(sample + 1, SAMPLES)

    def _upload(self, bounds: FloatArray) -> None:
        """Brings scene and lights to the device."""
        import wgpu

        lights, scene = self._lights, self._lights.scene
        # A light counts for one place of the pixels: those of a place follow each other.
        order = np.argsort(lights._sample, kind="stable")
        self._ends = np.searchsorted(lights._sample[order], np.arange(SAMPLES + 1)).tolist()
        brightest = float(lights.flux.max())
        # Lengths are multiplied by the scale, and geometry terms divided by its square.
        self._unit = brightest * self._scale**2 / np.pi
        normals = lights.normals[order]
        x = np.cross(np.where(np.abs(normals[:, :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), normals)
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        table = np.zeros((len(lights), 4, 4), np.float32)
        table[:, 0, :3] = self._normalised(lights.positions[order])
        table[:, 0, 3] = np.minimum(bounds[order] / self._scale**2, 1e30)
        table[:, 1, :3], table[:, 2, :3], table[:, 3, :3] = x, np.cross(normals, x), normals
        usage = wgpu.BufferUsage
        self._vertices = self._buffer(self._normalised(scene.vertices), usage.VERTEX)
        self._indices = self._buffer(scene.faces.astype(np.uint32), usage.INDEX)
        self._table = self._buffer(table, usage.STORAGE)
        self._flux = self._buffer((lights.flux[order] / brightest).astype(np.float32), usage.STORAGE)
        pixels = self._height * self._width
        self._places = self._device.create_buffer(size=32 * pixels, usage=usage.STORAGE | usage.COPY_DST)
        self._sums = self._device.create_buffer(
            size=4 * pixels * self._bands, usage=usage.STORAGE | usage.COPY_SRC | usage.COPY_DST
        )
        maps = self._device.create_texture(
            size=(2 * self._resolution, 3 * self._resolution // 2, self._layers),
            format="depth32float",
            usage=wgpu.TextureUsage.RENDER_ATTACHMENT | wgpu.TextureUsage.TEXTURE_BINDING,
        )
        self._maps = maps.create_view(dimension="2d-array")
        self._layer = [
            maps.create_view(dimension="2d", base_array_layer=k, array_layer_count=1) for k in range(self._layers)
        ]

    def _normalised(self, points: FloatArray) -> _Singles:
        normalised: _Singles = ((points - self._centre) * self._scale).astype(np.float32)
        return normalised

    def _buffer(self, data: np.ndarray[Any, Any], usage: int) -> Any:
        return self._device.create_buffer_with_data(data=np.ascontiguousarray(data), usage=usage)

    def _check(self) -> None:
        """Refuses what is more than the device takes, before it is asked to."""
        scene, lights = self._lights.scene, len(self._lights)
        limits = self._device.limits
        edge, binding = limits["max-texture-dimension-2d"], limits["max-storage-buffer-binding-size"]
        pixels, corners = self._width * self._height, max(scene.n_patches, len(scene.vertices))
        for what, needed, most, remedy in (
            ("texels along a map", 2 * self._resolution, edge, f"choose a resolution of {edge // 2} or less"),
            ("bytes of the pixels", max(32, 4 * self._bands) * pixels, binding, "choose fewer pixels"),
            ("bytes of the lights", max(64, 4 * self._bands) * lights, binding, "choose fewer lights"),
            ("bytes of the patches", 12 * corners, limits["max-buffer-size"], 'choose shadows="rays"'),
        ):
            if needed > most:
                raise ValueError(f"{what}: {needed} are needed, and this GPU takes no more than {most}; {remedy}")

    def _irradiance(self, sample: int, positions: FloatArray, normals: FloatArray, seen: Any) -> FloatArray:
        """(m, b) what the lights of one place of the pixels send there, W/m^2."""
        table = np.zeros((len(positions), 2, 4), np.float32)
        table[:, 0, :3], table[:, 0, 3], table[:, 1, :3] = self._normalised(positions), seen, normals
        queue = self._device.queue
        queue.write_buffer(self._places, 0, table)
        encoder = self._device.create_command_encoder()
        encoder.clear_buffer(self._sums)
        queue.submit([encoder.finish()])
        first, end = self._ends[sample : sample + 2]
        for batch in range(first, end, self._layers):
            self._add(batch, min(self._layers, end - batch))
        sums = np.frombuffer(queue.read_buffer(self._sums), np.float32).reshape(-1, self._bands)
        return self._unit * sums.astype(np.float64)

    def _add(self, first: int, count: int) -> None:
        """Draws the maps of some lights, and adds what they let through."""
        import wgpu

        draw, gather = self._pipelines
        header = struct.pack("8I", self._width, self._height, self._bands, self._resolution, first, count, 0, 0)
        batch = self._device.create_buffer_with_data(data=header, usage=wgpu.BufferUsage.UNIFORM)
        buffers = (batch, self._places, self._flux, self._sums)
        entries: list[Any] = [{"binding": k, "resource": {"buffer": buffer}} for k, buffer in enumerate(buffers)]
        entries.append({"binding": len(buffers), "resource": self._maps})
        lights = [{"binding": 0, "resource": {"buffer": self._table}}]
        group = self._device.create_bind_group
        encoder = self._device.create_command_encoder()
        edge, half = self._resolution, self._resolution // 2
        places = ((0, 0, edge), (0, edge, half), (edge, 0, half), (edge, half, half), (edge, edge, half))
        for k in range(count):
            target = {
                "view": self._layer[k],
                "depth_clear_value": 0.0,
                "depth_load_op": "clear",
                "depth_store_op": "store",
            }
            drawing = encoder.begin_render_pass(color_attachments=[], depth_stencil_attachment=target)
            drawing.set_pipeline(draw)
            drawing.set_bind_group(0, group(layout=draw.get_bind_group_layout(0), entries=lights))
            drawing.set_vertex_buffer(0, self._vertices)
            drawing.set_index_buffer(self._indices, "uint32")
            for face, (x, y, height) in enumerate(places):
                drawing.set_viewport(x, y, edge, height, 0.0, 1.0)
                drawing.draw_indexed(self._indices.size // 4, 1, 0, 0, _FACES * (first + k) + face)
            drawing.end()
        work = encoder.begin_compute_pass()
        work.set_pipeline(gather)
        work.set_bind_group(0, group(layout=gather.get_bind_group_layout(0), entries=lights))
        work.set_bind_group(1, group(layout=gather.get_bind_group_layout(1), entries=entries))
        work.dispatch_workgroups(-(-self._width // 8), -(-self._height // 8))
        work.end()
        self._device.queue.submit([encoder.finish()])


@cache
def _device() -> tuple[Any, tuple[Any, Any]]:
    """The device, and its pipelines: drawing maps, and gathering light. One for the process."""
    try:
        import wgpu
    except ImportError as error:
        needed = "pip install radiosity[gpu], with Python 3.11 or later"
        raise ImportError(f'shadows="maps" needs the package wgpu: {needed}') from error
    try:
        adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance")
        if adapter.info["backend_type"] == "OpenGL":
            raise RuntimeError("only OpenGL, which cannot read depths")
        names = ("max-texture-dimension-2d", "max-buffer-size", "max-storage-buffer-binding-size")
        device = adapter.request_device_sync(required_limits={name: adapter.limits[name] for name in names})
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise RuntimeError(
            f'shadows="maps" finds no GPU ({reason}): install the driver of yours, or Vulkan in software (package '
            'mesa-vulkan-drivers on Debian and Ubuntu); shadows="rays" needs neither'
        ) from error
    code = (package_files("radiosity") / "shadow_maps.wgsl").read_text(encoding="utf-8")
    module = device.create_shader_module(code=code)
    position = {"format": "float32x3", "offset": 0, "shader_location": 0}
    corners = {"array_stride": 12, "attributes": [position]}
    draw = device.create_render_pipeline(
        layout="auto",
        vertex={"module": module, "entry_point": "project", "buffers": [corners]},
        primitive={"topology": "triangle-list"},
        depth_stencil={"format": "depth32float", "depth_write_enabled": True, "depth_compare": "greater"},
    )
    gather = device.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "gather"})
    return device, (draw, gather)
