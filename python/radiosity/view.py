"""An interactive viewer of a solution: one HTML page that needs no network."""

from __future__ import annotations

import base64
import html
import json
import os
import tempfile
import webbrowser
import zlib
from collections.abc import Iterable, Sequence
from importlib.resources import files as package_files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _core
from .arrays import FloatArray, real_number, shaped, whole_number
from .files import replacing
from .render import Camera, exposure_of
from .scene import Scene
from .solution import Solution

UNITS = ("W/m^2", "lux")
# Of the three primaries of Rec. 709 in luminance; and the lumens of a watt that the program Radiance takes for white
# light (Ward Larson & Shakespeare 1998).
_LUMINANCE = (0.2126, 0.7152, 0.0722)
_EFFICACY = 179.0


class View:
    """The page that :func:`show` made. A notebook shows it by itself."""

    page: str
    """The HTML document."""

    def __init__(self, page: str, height: int) -> None:
        self.page = page
        self._height = height

    def _repr_html_(self) -> str:
        document = html.escape(self.page)
        return f'<iframe srcdoc="{document}" style="width: 100%; height: {self._height}px; border: 0"></iframe>'

    def __repr__(self) -> str:
        return f"View({len(self.page) / 1e6:.1f} MB of HTML; .save(path) or .open())"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the page to an ``.html`` file.

        Raises:
            ValueError: another ending.
            OSError: the file cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() not in (".html", ".htm"):
            raise ValueError(f"{path}: a viewer is an .html file")
        with replacing(path) as temporary:
            Path(temporary).write_text(self.page, encoding="utf-8")

    def open(self) -> Path:
        """Opens the page in the browser, from a temporary file, whose path is returned.

        Raises:
            OSError: there is no browser.
        """
        handle, name = tempfile.mkstemp(prefix="radiosity-", suffix=".html")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(self.page)
        if not webbrowser.open(Path(name).as_uri()):
            os.unlink(name)
            raise OSError("there is no browser here: write the page with .save(path) and open that")
        return Path(name)


def show(
    solution: Solution | Iterable[Solution],
    camera: Camera | None = None,
    *,
    labels: Sequence[str] | None = None,
    unit: str = "W/m^2",
    exposure: float | None = None,
    title: str = "radiosity",
    height: int = 600,
    up: Sequence[float] = (0.0, 0.0, 1.0),
) -> View:
    """A viewer: orbit, pan, walk; exposure; irradiance in false colours; mesh lines; the numbers of a patch by a click.

    Args:
        solution: a solution of a scene; or several of one scene, such as :func:`radiosity.bounces` yields, for a
            slider. Of ``method="hierarchical"`` the elements are shown.
        camera: the first view; None looks at the scene from outside, through the backs of walls, with ``up`` upwards.
        labels: of several solutions, one each; None for the number of steps.
        unit: of the false colours: ``"W/m^2"``, the sum of the bands; or ``"lux"``, 179 lm/W times the luminance of
            three bands taken as R, G, B of Rec. 709, or of one taken as white.
        exposure: the factor from radiance to display, where 1 is white; None chooses one from the last solution.
        title: of the page.
        height: of the viewer in a notebook, pixels.
        up: without a camera, (3,) the direction that is up: z by default; (0, 1, 0) for most glTF files.

    Returns:
        A :class:`View`: a notebook shows it, ``.save("room.html")`` writes a page that works without a network, and
        ``.open()`` opens it in the browser.

    Raises:
        TypeError: no solution.
        ValueError: no solutions, or of different scenes, or without one; neither one band nor three; a wrong unit or
            exposure.
    """
    several = np.iterable(solution) and not isinstance(solution, Solution)
    solutions: list[Solution] = list(solution) if several else [solution]  # type: ignore[arg-type, list-item]
    if not solutions:
        raise ValueError("there is no solution to show")
    for one in solutions:
        if not isinstance(one, Solution):
            raise TypeError(f"solution must be a radiosity.Solution, not {type(one).__name__}")
    if camera is not None and not isinstance(camera, Camera):
        raise TypeError(f"camera must be a radiosity.Camera, not {type(camera).__name__}")
    if unit not in UNITS:
        raise ValueError(f"unknown unit {unit!r}; the units are {UNITS}")
    if exposure is not None and not 0.0 < real_number("exposure", exposure) < np.inf:
        raise ValueError(f"exposure {exposure} is not a positive number")
    shown = [one.as_shown for one in solutions]
    last = shown[-1]
    scene = last.scene
    if scene is None:
        raise ValueError("this solution was made from a plain matrix and knows no geometry; solve form_factors(scene)")
    n, bands = last.radiosity.shape
    if bands not in (1, 3):
        raise ValueError(
            f"a viewer shows 1 band (grey) or 3 (RGB), not {bands}; choose bands with scene.with_materials"
        )
    if not all(_is_same(one.scene, scene) for one in shown):
        raise ValueError("the solutions are not of one scene with one set of materials")
    height = whole_number("height", height, 1, 100_000)
    _check_range(last)
    if labels is not None and len(labels) != len(shown):
        raise ValueError(f"{len(labels)} labels for {len(shown)} solutions")
    weights = _weights(unit, bands)
    arrays: dict[str, npt.NDArray[Any]] = {
        "vertices": scene.vertices.astype(np.float32),
        "faces": scene.faces.astype(np.uint32),
        "reflectance": scene.reflectance.astype(np.float32),
        "emission": scene.emission.astype(np.float32),
    }
    names: list[str] = []
    if scene.names is not None:
        distinct, of_patch = np.unique(np.array(scene.names), return_inverse=True)
        names = distinct.tolist()
        arrays["name"] = of_patch.astype(np.uint32)
    frames = []
    for k, one in enumerate(shown):
        # Half floats of parts of the largest: steps of a thousandth.
        corners = _core.corner_irradiance(scene._core, one.irradiance, None)
        scale = float(np.abs(corners).max()) or 1.0
        arrays[f"flat{k}"] = one.irradiance.astype(np.float32)
        arrays[f"smooth{k}"] = (corners / scale).astype(np.float16).view(np.uint16)
        frames.append({"scale": scale, "label": str(one.report.steps) if labels is None else labels[k]})
    data, places = _packed(arrays)
    gradient, colours = _colours()
    brightness = last.irradiance @ np.asarray(weights[:bands] if bands == 3 else [sum(weights)])
    header = {
        "faces": n,
        "bands": bands,
        "frames": frames,
        "arrays": places,
        "names": names,
        "what": "element" if last is not solutions[-1] else "patch",
        "weights": weights,
        "unit": "lux" if unit == "lux" else "W/m²",
        "most": float(np.percentile(brightness, 99.0)) or 1.0,
        "exposure": exposure_of(last, exposure),
        "colours": colours,
        "gradient": gradient,
        "camera": vars(_first_view(scene, _unit("up", up)) if camera is None else camera),
    }
    page = Template(_asset("page.html")).substitute(
        title=html.escape(title),
        header=json.dumps(header, allow_nan=False).replace("<", "\\u003c"),
        data=base64.b64encode(zlib.compress(data, 9)).decode("ascii"),
        bundle=_asset("bundle.js").replace("</script", "<\\/script"),
    )
    return View(page, height)


def _is_same(scene: Scene | None, other: Scene) -> bool:
    names = ("vertices", "faces", "reflectance", "emission", "mirror", "ior")
    return scene is other or (
        scene is not None
        and all(np.array_equal(getattr(scene, name), getattr(other, name), equal_nan=True) for name in names)
    )


def _check_range(solution: Solution) -> None:
    """Refuses what 32 bits cannot hold."""
    most = float(np.abs(solution.radiosity).max(initial=float(solution.irradiance.max(initial=0.0))))
    if most > 1e37 or 0.0 < most < 1e-30:
        raise ValueError(f"a radiosity of {most:g} W/m^2 is outside 1e-30 .. 1e37, which a browser can show: scale it")


def _asset(name: str) -> str:
    return (package_files("radiosity") / "viewer" / name).read_text(encoding="utf-8")


def _weights(unit: str, bands: int) -> list[float]:
    """What the irradiance of three bands counts in false colours; one band is sent as three times itself."""
    if unit == "lux":
        return [_EFFICACY * part for part in _LUMINANCE]
    return [1.0, 1.0, 1.0] if bands == 3 else [1.0 / 3.0] * 3


def _packed(arrays: dict[str, npt.NDArray[Any]]) -> tuple[bytes, list[tuple[str, str, int, int]]]:
    """The arrays one after the other; name, kind, first byte and length of each."""
    kinds = {"float32": "f32", "uint32": "u32", "uint16": "u16"}
    data, places = bytearray(), []
    for name, values in arrays.items():
        data += bytes(-len(data) % 4)
        places.append((name, kinds[values.dtype.name], len(data), values.size))
        data += np.ascontiguousarray(values).tobytes()
    return bytes(data), places


def _colours() -> tuple[list[str], list[int]]:
    """Five colours of viridis (Smith & van der Walt 2015) and those between: a CSS gradient, and 256 colours, RGBA."""
    stops = np.array([[0.27, 0, 0.33], [0.23, 0.32, 0.55], [0.13, 0.57, 0.55], [0.37, 0.79, 0.38], [0.99, 0.91, 0.14]])
    at = np.linspace(0, len(stops) - 1, 256)
    rgb = np.stack([np.interp(at, np.arange(len(stops)), stops[:, c]) for c in range(3)], axis=1)
    bytes_of = np.round(255 * np.column_stack([rgb, np.ones(256)])).astype(int)
    gradient = [f"rgb({', '.join(str(round(255 * c)) for c in stop)})" for stop in stops.tolist()]
    return gradient, bytes_of.ravel().tolist()


def _first_view(scene: Scene, up: FloatArray) -> Camera:
    """All of the scene, from above one of its corners."""
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    centre, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    # The axis across that is furthest from up comes first.
    across = np.eye(3)[np.argmin(np.abs(up))]
    across = across - (across @ up) * up
    across /= np.linalg.norm(across)
    towards = 0.5 * across - 0.75 * np.cross(up, across) + 0.43 * up
    origin = centre + 1.1 * radius / np.sin(np.radians(20.0)) * towards
    return Camera(tuple(origin.tolist()), tuple(centre.tolist()), tuple(up.tolist()))


def _unit(name: str, value: Sequence[float]) -> FloatArray:
    vector = shaped(name, value, 3)
    length = float(np.linalg.norm(vector))
    if not 0.0 < length < np.inf:
        raise ValueError(f"{name} {tuple(vector.tolist())} is no direction")
    unit: FloatArray = vector / length
    return unit
