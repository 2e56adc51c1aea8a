"""Pictures of how a solution came about and what it stands on, by matplotlib (the extra ``plot``)."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, whole_number
from .files import replacing
from .render import Camera, auto_exposure, colour_bands, render, to_srgb
from .scene import Scene
from .solution import Solution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .form_factors import FormFactors, Links

__all__ = ["animation", "bounces", "convergence", "irradiance", "links", "links_from", "mesh", "row_sums"]


def bounces(
    solutions: Solution | Iterable[Solution],
    camera: Camera,
    labels: Sequence[str] | None = None,
    *,
    size: int = 240,
    shading: str = "smooth",
    columns: int = 6,
) -> Figure:
    """A strip of pictures, one a solution, in the exposure of the last.

    Args:
        solutions: of a scene, as :func:`radiosity.bounces` yields them; or one.
        camera: the viewpoint.
        labels: titles, one a solution; None for the number of steps.
        size: width and height of each picture, pixels.
        shading: as in :func:`radiosity.render`.
        columns: pictures a row.

    Returns:
        A matplotlib figure; ``figure.savefig("strip.png")`` writes it.

    Raises:
        ValueError: no solutions, a solution without a scene, or labels of another number.
        ImportError: without matplotlib.
    """
    from matplotlib.figure import Figure

    columns = whole_number("columns", columns, 1, 1000)
    titles, frames = _frames(solutions, camera, size, shading)
    if labels is not None:
        if len(labels) != len(frames):
            raise ValueError(f"{len(labels)} labels for {len(frames)} solutions")
        titles = list(labels)
    rows = -(-len(frames) // columns)
    width = min(columns, len(frames))
    figure = Figure(figsize=(2.0 * width, 2.25 * rows), layout="constrained")
    panels = np.asarray(figure.subplots(rows, width, squeeze=False)).ravel()
    for panel in panels:
        panel.set_axis_off()
    for panel, frame, title in zip(panels, frames, titles, strict=False):
        panel.imshow(frame, cmap="gray", vmin=0, vmax=255)
        panel.set_title(title, fontsize=9)
    return figure


def animation(
    solutions: Solution | Iterable[Solution],
    camera: Camera,
    path: str | os.PathLike[str],
    *,
    size: int = 240,
    shading: str = "smooth",
    seconds: float = 0.5,
) -> None:
    """The same as an animated GIF; the last picture stays four times as long.

    Args:
        solutions: of a scene, as :func:`radiosity.bounces` yields them; or one.
        camera: the viewpoint.
        path: the file to write, ``.gif``.
        size: width and height, pixels.
        shading: as in :func:`radiosity.render`.
        seconds: each picture is shown, at least 0.02.

    Raises:
        ValueError: as :func:`bounces`; another ending, or a time out of range.
    """
    from PIL import Image

    if not str(path).lower().endswith(".gif"):
        raise ValueError(f"{os.fspath(path)}: an animation is a .gif file")
    if not 0.02 <= seconds <= 600.0:
        raise ValueError(f"seconds {seconds} is outside [0.02, 600]")
    _, frames = _frames(solutions, camera, size, shading)
    images = [Image.fromarray(frame[..., 0] if frame.shape[2] == 1 else frame) for frame in frames]
    milliseconds = [round(1000 * seconds)] * (len(images) - 1) + [round(4000 * seconds)]
    with replacing(Path(path)) as temporary:
        images[0].save(temporary, save_all=True, append_images=images[1:], duration=milliseconds, loop=0)


def links(F: FormFactors, *, size: int = 800) -> Figure:
    """The form-factor matrix of ``method="hierarchical"`` as the blocks that one link each stands for.

    Rows and columns are the patches in the order of the tree. A block's colour is the number of pairs of patches that
    it stands for; grey blocks are hidden, white ones face away (Hanrahan, Salzman & Aupperle 1991, figure 7).

    Args:
        F: of ``method="hierarchical"``.
        size: most pixels of the matrix, each way.

    Returns:
        A matplotlib figure.

    Raises:
        ValueError: form factors of another method.
        ImportError: without matplotlib.
    """
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    found = _links_of(F)
    n = len(found.order)
    pixels = min(n, whole_number("size", size, 1, 10_000))
    blocks = np.full((pixels, pixels), np.nan)
    edges = found.ranges * pixels // n
    pairs = np.prod(found.ranges[:, :, 1] - found.ranges[:, :, 0], axis=1).astype(float)
    shown = np.where(found.visibility == 1, 0.0, pairs)
    # The large ones first: none of them may cover smaller ones that share a pixel with it.
    for k in np.argsort(-pairs, kind="stable"):
        (a, b), (c, d) = edges[k]
        blocks[a : max(b, a + 1), c : max(d, c + 1)] = shown[k]
        blocks[c : max(d, c + 1), a : max(b, a + 1)] = shown[k]
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(np.where(blocks == 0.0, 1.0, np.nan), cmap="gray", vmin=0.0, vmax=1.25, extent=(0, n, n, 0))
    seen = np.where(blocks > 0.0, blocks, np.nan)
    image = axes.imshow(seen, norm=LogNorm(1, max(2.0, pairs.max(initial=1.0))), extent=(0, n, n, 0))
    figure.colorbar(image, label="pairs of patches a link")
    axes.set_title(f"{len(found.levels):,} links for {n:,} x {n:,} form factors (grey: hidden)")
    axes.set_xlabel("patch, in the order of the tree")
    axes.set_ylabel("patch")
    return figure


def links_from(F: FormFactors, patch: int) -> Figure:
    """The links of one patch and of all clusters that it is in, in space: a line to the centre of each other end.

    Colours tell how many patches the other end stands for; links that carry nothing are left out.

    Args:
        F: of ``method="hierarchical"``.
        patch: number of the patch.

    Returns:
        A matplotlib figure.

    Raises:
        ValueError: form factors of another method, or no such patch.
        ImportError: without matplotlib.
    """
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    found = _links_of(F)
    scene = F.scene
    place = int(np.flatnonzero(found.order == whole_number("patch", patch, 0, len(found.order) - 1))[0])
    weights = scene.areas[found.order]
    moments = np.vstack([np.zeros(3), np.cumsum(weights[:, None] * scene.centroids[found.order], axis=0)])
    areas = np.concatenate([[0.0], np.cumsum(weights)])
    holds = (found.ranges[:, :, 0] <= place) & (place < found.ranges[:, :, 1])
    ends = np.vstack([found.ranges[holds[:, k] & (found.visibility != 1), 1 - k] for k in (0, 1)])
    first, last = ends.T
    centres = (moments[last] - moments[first]) / (areas[last] - areas[first])[:, None]
    corners = scene.vertices[scene.faces]
    outline = np.concatenate([corners[:, [k, (k + 1) % 3]] for k in range(3)])
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    axes.add_collection3d(Line3DCollection(outline, colors="0.85", linewidths=0.3))
    start = np.broadcast_to(scene.centroids[patch], centres.shape)
    lines = Line3DCollection(
        np.stack([start, centres], axis=1), norm=LogNorm(1, max(2, (last - first).max(initial=1))), linewidths=0.8
    )
    lines.set_array((last - first).astype(float))
    axes.add_collection3d(lines)
    figure.colorbar(lines, label="patches at the other end", shrink=0.7)
    low, high = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    for set_limits, a, b in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), low, high, strict=True):
        set_limits(a, b)
    axes.set_box_aspect(np.maximum(high - low, 1e-3 * (high - low).max()))
    for name, axis in zip("xyz", (axes.xaxis, axes.yaxis, axes.zaxis), strict=True):
        axis.set_label_text(f"{name}, m")
    axes.set_title(f"patch {patch}: {len(ends)} links for {len(found.order):,} form factors")
    return figure


def mesh(solution: Solution, camera: Camera, *, size: int = 600, shading: str = "smooth") -> Figure:
    """A picture and over it the mesh that was solved on: the elements of ``method="hierarchical"``, else the patches.

    Args:
        solution: of a scene.
        camera: the viewpoint.
        size: width and height, pixels.
        shading: as in :func:`radiosity.render`.

    Returns:
        A matplotlib figure.

    Raises:
        ValueError: a solution without a scene; as :func:`radiosity.render`.
        ImportError: without matplotlib.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    shown, scene = _drawn(solution)
    colour_bands(scene.bands, "a picture")
    picture: Any = render(shown, camera, width=size, height=size, shading=shading, progress=False)
    corners = scene.vertices[scene.faces]
    facing = np.einsum("ij,ij->i", scene.normals, np.asarray(camera.origin) - scene.centroids) > 0.0
    edges = np.concatenate([corners[facing][:, [k, (k + 1) % 3]] for k in range(3)])
    places, depth = _projected(camera, edges.reshape(-1, 3), size)
    middle = edges.mean(axis=1)
    ahead = (depth.reshape(-1, 2) > 0.0).all(axis=1)
    origin = np.broadcast_to(np.asarray(camera.origin, np.float64), middle.shape)
    nearer = middle + 1e-4 * (origin - middle)
    seen = ahead & ~scene.occluded(origin, nearer)
    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    frame = to_srgb(picture, auto_exposure(picture))
    axes.imshow(frame, cmap="gray", vmin=0, vmax=255, extent=(0, size, size, 0))
    axes.add_collection(LineCollection(list(places.reshape(-1, 2, 2)[seen]), colors="#20a0ff", linewidths=0.25))
    axes.set_xlim(0, size)
    axes.set_ylim(size, 0)
    axes.set_axis_off()
    axes.set_title(f"{len(scene.faces):,} faces")
    return figure


def irradiance(
    solution: Solution, camera: Camera, *, size: int = 600, shading: str = "smooth", most: float | None = None
) -> Figure:
    """The irradiance of all bands together in false colours, with a colour bar, W/m^2.

    Mirrors and glass are drawn as what they are to light that arrives: surfaces, with what falls on their fronts.

    Args:
        solution: of a scene.
        camera: the viewpoint.
        size: width and height, pixels.
        shading: ``"flat"`` or ``"smooth"``.
        most: irradiance at the end of the colours; None for the 99th percentile of what is seen.

    Returns:
        A matplotlib figure.

    Raises:
        ValueError: a solution without a scene; as :func:`radiosity.render`.
        ImportError: without matplotlib.
    """
    from matplotlib.figure import Figure

    if shading == "gather":
        raise ValueError("false colours show the irradiance as it was solved: shading is 'flat' or 'smooth'")
    shown, scene = _drawn(solution)
    if most is not None and not most > 0.0:
        raise ValueError(f"most {most} is not a positive irradiance")
    # Grey that emits nothing has the radiance H / (2 pi). White would be refused where a room is closed.
    surfaces = scene.with_materials(np.full(scene.bands, 0.5), 0.0, mirror=0.0, ior=np.nan)
    grey = dataclasses.replace(shown, radiosity=0.5 * shown.irradiance, scene=surfaces)
    seen = 2.0 * math.pi * render(grey, camera, width=size, height=size, shading=shading, progress=False).sum(axis=2)
    figure = Figure(figsize=(6.6, 5.6), layout="constrained")
    axes = figure.add_subplot()
    top = float(np.percentile(seen[seen > 0.0], 99.0)) if most is None and (seen > 0.0).any() else most
    # Where nothing is seen there is no irradiance, not an irradiance of 0.
    image = axes.imshow(np.where(seen > 0.0, seen, np.nan), vmin=0.0, vmax=top)
    figure.colorbar(image, label="irradiance, W/m^2", extend="max")
    axes.set_axis_off()
    return figure


def row_sums(F: FormFactors) -> Figure:
    """A histogram of the sums of all rows of F: 1 in a closed scene, less where light leaves.

    Args:
        F: form factors.

    Returns:
        A matplotlib figure.

    Raises:
        ImportError: without matplotlib.
    """
    from matplotlib.figure import Figure

    _require_form_factors(F)
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.add_subplot()
    axes.hist(F.row_sums, bins=60, color="#4060a0")
    axes.axvline(1.0, color="0.5", linewidth=0.8)
    axes.set_yscale("log")
    axes.set_xlabel(f"sum of a row (estimated error {F.error_estimate:.1e})")
    axes.set_ylabel("patches")
    return figure


def convergence(solutions: Solution | Sequence[Solution], labels: Sequence[str] | None = None) -> Figure:
    """The relative residual of solvers against their steps.

    Args:
        solutions: of :func:`radiosity.solve_system`; or one.
        labels: one each; None for the names of the methods.

    Returns:
        A matplotlib figure.

    Raises:
        ValueError: no solutions, or labels of another number.
        ImportError: without matplotlib.
    """
    from matplotlib.figure import Figure

    solutions = list(_all_of(solutions))
    if not solutions:
        raise ValueError("there is no solution to draw")
    names = [solution.report.method for solution in solutions] if labels is None else list(labels)
    if len(names) != len(solutions):
        raise ValueError(f"{len(names)} labels for {len(solutions)} solutions")
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.add_subplot()
    for solution, name in zip(solutions, names, strict=True):
        residuals = [step.residual for step in solution.history]
        axes.loglog(range(1, len(residuals) + 1), residuals, marker=".", label=name)
    axes.set_xlabel("step")
    axes.set_ylabel("relative residual")
    axes.legend()
    return figure


def _projected(camera: Camera, points: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """(m, 2) pixels of (m, 3) points in a square picture, x to the right and y down, and (m,) their depths."""
    forward = np.subtract(camera.target, camera.origin)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    relative = points - np.asarray(camera.origin)
    depth = relative @ forward
    scale = 0.5 * size / (math.tan(math.radians(0.5 * camera.fov)) * np.where(depth > 0.0, depth, 1.0))
    up = np.cross(right, forward)
    places = np.stack([0.5 * size + scale * (relative @ right), 0.5 * size - scale * (relative @ up)], axis=1)
    return places, depth


def _all_of(solutions: Solution | Iterable[Solution]) -> Iterator[Solution]:
    for solution in [solutions] if isinstance(solutions, Solution) or not np.iterable(solutions) else solutions:
        if not isinstance(solution, Solution):
            raise TypeError(f"this draws solutions, as solve makes them, not a {type(solution).__name__}")
        yield solution


def _drawn(solution: Solution) -> tuple[Solution, Scene]:
    """What is drawn of a solution, and its scene."""
    (solution,) = _all_of(solution)
    shown = solution.as_shown
    if shown.scene is None:
        raise ValueError("this solution was made from a plain matrix and knows no geometry; solve form_factors(scene)")
    return shown, shown.scene


def _require_form_factors(F: FormFactors) -> None:
    from .form_factors import FormFactors

    if not isinstance(F, FormFactors):
        raise TypeError(f"this draws form factors, as form_factors makes them, not a {type(F).__name__}")


def _links_of(F: FormFactors) -> Links:
    _require_form_factors(F)
    found = F.links
    if found is None:
        raise ValueError(f'method {F.method!r} has no links; use form_factors(..., method="hierarchical")')
    return found


def _frames(
    solutions: Solution | Iterable[Solution], camera: Camera, size: int, shading: str
) -> tuple[list[str], list[npt.NDArray[np.uint8]]]:
    """Titles and pictures, all in the exposure of the last."""
    titles, images = [], []
    for solution in _all_of(solutions):
        colour_bands(solution.radiosity.shape[1], "a picture")
        image: Any = render(solution, camera, width=size, height=size, shading=shading, progress=False)
        titles.append(str(solution.report.steps))
        images.append(image)
    if not images:
        raise ValueError("there is no solution to draw")
    exposure = auto_exposure(images[-1])
    return titles, [to_srgb(image, exposure) for image in images]
