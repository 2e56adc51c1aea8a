"""Pictures of how a solution came about, by matplotlib (the extra ``plot``)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .arrays import whole_number
from .render import Camera, auto_exposure, render, to_srgb
from .solution import Solution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["animation", "bounces"]


def bounces(
    solutions: Iterable[Solution],
    camera: Camera,
    labels: Sequence[str] | None = None,
    *,
    size: int = 240,
    shading: str = "smooth",
    columns: int = 6,
) -> Figure:
    """A strip of pictures, one a solution, in the exposure of the last.

    Args:
        solutions: of a scene, as :func:`radiosity.bounces` yields them.
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
    solutions: Iterable[Solution],
    camera: Camera,
    path: str | os.PathLike[str],
    *,
    size: int = 240,
    shading: str = "smooth",
    seconds: float = 0.5,
) -> None:
    """The same as an animated GIF; the last picture stays four times as long.

    Args:
        solutions: of a scene, as :func:`radiosity.bounces` yields them.
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
    images[0].save(path, save_all=True, append_images=images[1:], duration=milliseconds, loop=0)


def _frames(
    solutions: Iterable[Solution], camera: Camera, size: int, shading: str
) -> tuple[list[str], list[npt.NDArray[np.uint8]]]:
    """Titles and pictures, all in the exposure of the last."""
    titles, images = [], []
    for solution in solutions:
        image: Any = render(solution, camera, width=size, height=size, shading=shading, progress=False)
        titles.append(str(solution.report.steps))
        images.append(image)
    if not images:
        raise ValueError("there is no solution to draw")
    exposure = auto_exposure(images[-1])
    return titles, [to_srgb(image, exposure) for image in images]
