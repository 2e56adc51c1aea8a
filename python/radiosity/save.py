"""Solutions as files: to go on with (npz), to look at (glb), and to work on elsewhere (ply, vtu, vtk)."""

from __future__ import annotations

import dataclasses
import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .arrays import FloatArray, read_only, real_number, whole_number
from .files import replacing
from .gltf import glb
from .lights import Light, PointLight, Sky, SpotLight, Sun, lights_of
from .render import exposure_of, to_srgb
from .scene import Scene
from .solution import EnergyAudit, Report, Solution, Step

FORMATS = (".npz", ".glb", ".ply", ".vtu", ".vtk")
# Of the layout of .npz files.
VERSION = 1
# With lights, which earlier versions would leave out in silence.
_VERSION_WITH_LIGHTS = 2
_MOST_TEXELS = 16384
_LIGHTS: dict[str, Any] = {kind.__name__: kind for kind in (Sun, Sky, PointLight, SpotLight)}
# What JSON makes of the types of a report's fields.
_KINDS: dict[str, Any] = {
    "str": str,
    "int": int,
    "float": (int, float),
    "bool": bool,
    "float | None": (int, float, type(None)),
    "dict[str, float]": dict,
}


def save(
    solution: Solution, path: str | os.PathLike[str], *, exposure: float | None = None, lightmap: int | None = None
) -> None:
    """Writes a solution to a file; the ending decides the format. An existing file is replaced only by a whole one.

    ========  =========================================================================================================
    .npz      everything, bit for bit; :func:`load_solution` reads it
    .glb      glTF 2.0 for viewers: unlit colours, one a patch, or a texture (``lightmap``); the attributes
              ``_RADIOSITY_0``, ... keep B of each band as it is, W/m^2, in 32 bits. ``trimesh`` shows the colours when
              it loads the file with ``skip_materials=True``
    .ply      a mesh with face colours (sRGB) and the face properties ``radiosity_0``, ..., ``irradiance_0``, ...
    .vtu,     for ParaView and other VTK programs, with radiosity, irradiance, reflectance, emission and, where it is
    .vtk      known, the standard error, as cell data; needs the extra ``files``
    ========  =========================================================================================================

    Args:
        solution: of a scene. Of ``method="hierarchical"``, ``.npz`` keeps patches and elements, all others the
            elements.
        path: where to.
        exposure: colours of ``.glb`` and ``.ply``: the factor from radiance B / pi to display, where 1 is white and
            what is above is cut off; None chooses one from the solution.
        lightmap: ``.glb`` only: texels each way of a texture that holds the smooth radiance, in place of one colour a
            patch; the patches are laid out in it by xatlas. ``.glb`` needs the extra ``files``.

    Raises:
        TypeError: no solution.
        ValueError: an unknown ending, a solution of many states or without a scene, colours of a solution that has
            neither one band nor three, an exposure that is not positive, a lightmap where there is none.
        ImportError: a package of the extra ``files`` is missing.
        OSError: the file cannot be written.
    """
    if not isinstance(solution, Solution):
        raise TypeError(f"solution must be a radiosity.Solution, not {type(solution).__name__}")
    shown = solution.as_shown
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in FORMATS:
        others = {".png": "save_image writes pictures", ".exr": "save_image writes pictures", ".html": "show(...).save"}
        hint = f" ({others[kind]})" if kind in others else ""
        raise ValueError(f"{path}: unknown format {path.suffix!r}{hint}; the formats are {FORMATS}")
    if solution.scene is None and kind != ".npz":
        raise ValueError(f"{path}: this solution was made from a plain matrix and has no mesh; .npz keeps its numbers")
    if exposure is not None and not 0.0 < real_number("exposure", exposure) < np.inf:
        raise ValueError(f"exposure {exposure} is not a positive number")
    if lightmap is not None:
        if kind != ".glb":
            raise ValueError(f"{path}: only .glb files have a lightmap")
        lightmap = whole_number("lightmap", lightmap, 8, _MOST_TEXELS)
    bands = solution.radiosity.shape[1]
    if kind in (".glb", ".ply") and bands not in (1, 3):
        raise ValueError(
            f"{path}: colours have 1 band (grey) or 3 (RGB), not {bands}; .npz, .vtu and .vtk take any number"
        )
    # Whatever can fail fails before the file is touched.
    data = glb(shown, exposure, lightmap) if kind == ".glb" else b""
    with replacing(path) as temporary:
        if kind == ".npz":
            contents = _contents(solution)
            # The directory of a zip file has no checksum: what it has lost would not be missed.
            np.savez_compressed(temporary, arrays=np.int64(len(contents)), **contents)
        elif kind == ".glb":
            Path(temporary).write_bytes(data)
        elif kind == ".ply":
            _write_ply(temporary, shown, exposure)
        else:
            _write_vtk(temporary, shown)


def load_solution(path: str | os.PathLike[str]) -> Solution:
    """A solution that :func:`save` wrote to an ``.npz`` file, bit for bit.

    Raises:
        FileNotFoundError: no such file.
        ValueError: the file is no saved solution, is damaged, or was written by a later version.
    """
    path = Path(path)
    if path.is_file() and not zipfile.is_zipfile(path):
        raise ValueError(f"{path}: no saved solution; only the .npz files of save can be read again, whole")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            if "settings" in file.files:
                raise ValueError("form factors: load_form_factors reads them")
            contents = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no such file") from None
    except (OSError, ValueError, EOFError, KeyError) as error:
        raise ValueError(f"{path}: no saved solution ({error})") from error
    except Exception as error:  # zipfile and zlib raise their own kinds
        raise ValueError(f"{path}: damaged ({error})") from error
    version = contents.get("version")
    if version is None or np.shape(version):
        raise ValueError(f"{path}: no saved solution")
    if int(version) > _VERSION_WITH_LIGHTS:
        raise ValueError(f"{path}: written by a later version of radiosity (layout {int(version)})")
    count = contents.pop("arrays", None)
    if count is not None and (np.shape(count) or int(count) != len(contents)):
        raise ValueError(f"{path}: damaged, {len(contents)} arrays are there of those that were written")
    try:
        solution = _solution_of(contents)
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: damaged, {error!r} is missing or wrong") from error
    except ValueError as error:
        raise ValueError(f"{path}: damaged, {error}") from error
    return solution


def _contents(solution: Solution) -> dict[str, Any]:
    """Arrays by name; those of elements begin with ``elements/``."""
    report, scene = solution.report, solution.scene
    plain = {
        part.name: getattr(report, part.name)
        for part in dataclasses.fields(report)
        if part.name not in ("audit", "bound")
    }
    contents: dict[str, Any] = {
        "version": np.int64(_VERSION_WITH_LIGHTS if solution.lights else VERSION),
        "radiosity": solution.radiosity,
        "irradiance": solution.irradiance,
        "standard_error": solution.standard_error,
        "error_estimate": np.float64(solution.error_estimate),
        "residuals": np.array([step.residual for step in solution.history]),
        "unshot": np.array([step.unshot for step in solution.history]).reshape(
            len(solution.history), solution.radiosity.shape[1]
        ),
        "report": np.array(json.dumps(plain)),
        "bound": report.bound,
    }
    if report.audit is not None:
        contents |= {f"audit/{name}": value for name, value in dataclasses.asdict(report.audit).items()}
    if scene is not None:
        contents |= {name: getattr(scene, name) for name in ("vertices", "faces", "reflectance", "emission", "parent")}
        if not scene.is_diffuse:
            contents |= {"mirror": scene.mirror, "ior": scene.ior}
        contents["names"] = None if scene.names is None else np.array(scene.names)
    for k, light in enumerate(solution.lights):
        fields = {part.name: getattr(light, part.name) for part in dataclasses.fields(light)}
        contents |= {f"lights/{k}/kind": np.array(type(light).__name__)}
        contents |= {f"lights/{k}/{name}": np.array(value) for name, value in fields.items()}
    if solution.elements is not None:
        contents |= {f"elements/{name}": value for name, value in _contents(solution.elements).items()}
    return {name: value for name, value in contents.items() if value is not None}


def _solution_of(contents: Mapping[str, Any]) -> Solution:
    get = contents.get
    scene = None
    if "vertices" in contents:
        names = None if get("names") is None else tuple(str(name) for name in contents["names"])
        vertices, faces, reflectance, emission = (
            contents[name] for name in ("vertices", "faces", "reflectance", "emission")
        )
        specular = {name: contents[name] for name in ("mirror", "ior") if name in contents}
        scene = Scene(vertices, faces, reflectance, emission, names=names, **specular)
        parent = get("parent")
        scene.parent = None if parent is None else read_only(parent)
    n, bands = np.shape(contents["radiosity"])
    if scene is not None and (n, bands) != (scene.n_patches, scene.bands):
        raise ValueError(f"radiosity has the shape {(n, bands)} and the scene {(scene.n_patches, scene.bands)}")

    def numbers(name: str, *shape: int) -> FloatArray:
        array: FloatArray = contents[name]
        if array.dtype != np.float64 or array.shape != shape:
            raise ValueError(f"{name} is {array.dtype} of shape {array.shape} and not float64 of {shape}")
        return read_only(array)

    def if_there(name: str, *shape: int) -> FloatArray | None:
        return numbers(name, *shape) if name in contents else None

    audit = None
    if "audit/emitted" in contents:
        powers = {part.name: numbers(f"audit/{part.name}", bands) for part in dataclasses.fields(EnergyAudit)}
        audit = EnergyAudit(**powers)
    plain = json.loads(str(contents["report"]))
    of_elements = {name.removeprefix("elements/"): value for name, value in contents.items() if "elements/" in name}
    steps = len(contents["residuals"])
    unshot = numbers("unshot", steps, bands)
    return Solution(
        radiosity=numbers("radiosity", n, bands),
        irradiance=numbers("irradiance", n, bands),
        standard_error=if_there("standard_error", n, bands),
        error_estimate=float(numbers("error_estimate")),
        history=tuple(map(Step, numbers("residuals", steps).tolist(), unshot)),
        report=Report(**_checked(plain), audit=audit, bound=if_there("bound", bands)),
        scene=scene,
        elements=_solution_of(of_elements) if of_elements else None,
        lights=lights_of(_lights_in(contents), bands),
    )


def _lights_in(contents: Mapping[str, Any]) -> list[Light]:
    """The lights of a solution, in their order."""
    lights: list[Light] = []
    while f"lights/{len(lights)}/kind" in contents:
        of = f"lights/{len(lights)}/"
        kind = _LIGHTS[str(contents[of + "kind"])]
        values = {part.name: contents[of + part.name] for part in dataclasses.fields(kind)}
        # Words and single numbers are kept as arrays without a shape.
        lights.append(kind(**{name: value if value.shape else value.item() for name, value in values.items()}))
    return lights


def _checked(plain: dict[str, Any]) -> dict[str, Any]:
    """What a report was written as, if every value is of the type that it must have."""
    kinds = {part.name: _KINDS.get(str(part.type)) for part in dataclasses.fields(Report)}
    for name, value in plain.items():
        kind = kinds.get(name)
        if kind is None or not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise TypeError(f"{name} {value!r}")
        if isinstance(value, int) and value.bit_length() > 64:
            raise TypeError(f"{name}, a number of {value.bit_length()} bits")
    if not all(isinstance(seconds, float) for seconds in plain.get("seconds", {}).values()):
        raise TypeError("seconds")
    return plain


def _write_ply(path: str, solution: Solution, exposure: float | None) -> None:
    import trimesh

    scene = solution.scene
    assert scene is not None
    mesh = trimesh.Trimesh(scene.vertices, scene.faces, process=False, validate=False)
    colours = to_srgb(solution.radiosity / np.pi, exposure_of(solution, exposure))
    mesh.visual = trimesh.visual.ColorVisuals(mesh, face_colors=np.broadcast_to(colours, (len(colours), 3)))
    for name in ("radiosity", "irradiance"):
        values = getattr(solution, name)
        mesh.face_attributes |= {f"{name}_{b}": np.ascontiguousarray(values[:, b]) for b in range(values.shape[1])}
    Path(path).write_bytes(trimesh.exchange.ply.export_ply(mesh, include_attributes=True))


def _write_vtk(path: str, solution: Solution) -> None:
    try:
        import meshio
    except ImportError as error:
        raise ImportError("VTK files need the package meshio: pip install radiosity[files]") from error
    scene = solution.scene
    assert scene is not None
    data = {"radiosity": solution.radiosity, "irradiance": solution.irradiance}
    data |= {"reflectance": scene.reflectance, "emission": scene.emission}
    if solution.standard_error is not None:
        data["standard_error"] = solution.standard_error
    # One band is a scalar; the old format .vtk has scalars and vectors of three only.
    of_bands = {
        (name if values.shape[1] == 1 else f"{name}_{b}"): [np.ascontiguousarray(values[:, b])]
        for name, values in data.items()
        for b in range(values.shape[1])
    }
    meshio.Mesh(scene.vertices, [("triangle", scene.faces)], cell_data=of_bands).write(path)
