"""From groups of emitters to groups of receivers: the small matrix of all light that runs between them.

T[r, e] is the mean irradiance of receiver r when all of emitter e gives off 1 W/m^2 and all else is dark, after all
bounces. The sources of a room are few, what is asked of it is little, and n patches are in between: T is what remains
of them. It is the daylight coefficient of Tregenza & Waters 1983 where emitters are parts of the sky, and the script-F
of Gebhart 1957 but for the emissivities.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .arrays import FloatArray, real_array
from .form_factors import FormFactors, form_factors
from .keep import check_scene, corners_of
from .progress import Progress
from .relight import importance
from .scene import Scene
from .system import solve_system

# Relative residual of the solves: nothing beside the form factors.
_RESIDUAL = 1e-8


def transfer(
    scene: Scene,
    emitters: Any,
    receivers: Any,
    tolerance: float = 1e-3,
    *,
    F: FormFactors | None = None,
    threads: int | None = None,
    progress: Progress = True,
) -> FloatArray:
    """(r, e, b) mean irradiance of every receiver for an emission of 1 W/m^2 by every emitter, all bounces included.

    For emissions x (e, b) of the groups, W/m^2, ``np.einsum("reb,eb->rb", T, x)`` is the irradiance of the receivers.
    As many systems are solved as there are emitters, or receivers, whichever are fewer: what arrives at a receiver is
    followed backwards.

    Args:
        scene: the patches with their reflectance; its emission does not matter.
        emitters: groups of patches: a sequence in which each is a name of ``scene.names``, or indices or a mask of
            patches; or an (n, e) array of floats, the emission of each patch for one unit of each source.
        receivers: the same; the mean over a group is weighted by area. Of an (n, r) array the columns are the weights,
            used as they are.
        tolerance: of the form factors' rows; see :func:`radiosity.form_factors`.
        F: the form factors of the scene, where they are there already; ``tolerance`` is not looked at then.
        threads: None for all cores.
        progress: see :mod:`radiosity.progress`.

    Raises:
        TypeError, ValueError: no scene, form factors of other patches, mirrors or glass, a group that is empty or names
            nothing, weights that are not finite, negative emissions.

    Sources:
        Tregenza & Waters 1983; Gebhart 1957; Smits, Arvo & Salesin 1992 (backwards).
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}")
    out = _columns("emitters", emitters, scene, np.ones(scene.n_patches))
    back = _columns("receivers", receivers, scene, scene.areas, normalise=True)
    if (out < 0.0).any():
        patch, group = np.argwhere(out < 0.0)[0].tolist()
        raise ValueError(f"patch {patch}: emission {out[patch, group]:g} of emitter {group} is below 0")
    if F is None:
        F = form_factors(scene, tolerance, threads=threads, progress=progress)
    elif not isinstance(F, FormFactors):
        raise TypeError(f"F must be radiosity.FormFactors, not {type(F).__name__}")
    else:
        check_scene("F", corners_of(F.scene), scene)
    rho, bands = scene.reflectance, scene.bands
    if out.shape[1] <= back.shape[1]:
        emission = np.repeat(out[:, None, :], bands, axis=1)
        states = solve_system(F, emission, rho, "gmres", _RESIDUAL, threads=threads, progress=progress)
        return np.asarray(np.einsum("nr,nbe->reb", back, states.irradiance))
    # Receivers side by side, the bands of each together.
    count = back.shape[1]
    weights = np.repeat(back[:, :, None], bands, axis=2).reshape(len(back), -1)
    found = importance(F._core, np.tile(rho, (1, count)), weights, _RESIDUAL, threads, progress)
    return np.asarray(np.einsum("ne,nrb->reb", out, found.reshape(len(back), count, bands)))


def _columns(name: str, groups: Any, scene: Scene, weights: FloatArray, normalise: bool = False) -> FloatArray:
    """(n, groups) numbers: ``weights`` inside each group and 0 outside, or what the user gives."""
    n = scene.n_patches
    if isinstance(groups, np.ndarray) and groups.ndim == 2 and groups.dtype.kind == "f":
        given = real_array(name, groups)
        if given.shape[0] != n or not given.size or not np.isfinite(given).all():
            raise ValueError(f"{name} of shape {given.shape} must be ({n}, m), m at least 1, of finite numbers")
        return given
    if isinstance(groups, str) or not isinstance(groups, Sequence | np.ndarray) or not len(groups):
        raise TypeError(f"{name} must be a sequence of groups of patches, at least one, or an ({n}, m) array of floats")
    columns = np.zeros((n, len(groups)))
    for g, group in enumerate(groups):
        members = _members(f"{name}[{g}]", group, scene)
        total = weights[members].sum() if normalise else 1.0
        columns[members, g] = weights[members] / total
    return columns


def _members(name: str, group: Any, scene: Scene) -> Any:
    """The numbers of the patches of a group."""
    n = scene.n_patches
    if isinstance(group, str):
        members = np.flatnonzero([of == group for of in scene.names or ()])
        if not members.size:
            known = sorted(set(scene.names or ()))
            raise ValueError(f"{name}: no patch is named {group!r}; the names are {known}")
        return members
    array = np.atleast_1d(np.asarray(group))
    if array.dtype == np.bool_:
        if array.shape != (n,):
            raise ValueError(f"{name}: a mask must have shape ({n},), not {array.shape}")
        array = np.flatnonzero(array)
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise TypeError(f"{name} must be a name, a mask or integers, not {array.dtype} of shape {array.shape}")
    if not array.size:
        raise ValueError(f"{name} is empty")
    bad = array[(array < 0) | (array >= n)]
    if bad.size:
        raise ValueError(f"{name}: patch {bad[0]} is outside 0 .. {n}")
    return np.unique(array)
