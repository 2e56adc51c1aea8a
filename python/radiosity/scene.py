"""The scene: triangular patches with reflectance and emission, frozen once built."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from . import _core
from .arrays import (
    FloatArray,
    IntArray,
    aligned,
    one_per_patch,
    per_patch,
    read_only,
    shaped,
    thread_count,
    triangle_indices,
)
from .memory import available_bytes
from .report import Report, counted, report

if TYPE_CHECKING:
    import trimesh

SIDES = ("front", "both")


class Hits(NamedTuple):
    """What m rays hit first."""

    patch: IntArray
    """(m,) patch number, -1 where nothing is hit."""
    distance: FloatArray
    """(m,) distance along the ray in lengths of its direction, inf where nothing is hit."""
    barycentric: FloatArray
    """(m, 2) weights of the patch's corners 1 and 2, nan where nothing is hit."""


class Scene:
    """Triangular patches, one radiosity each, with their reflectance and emission per band.

    Surfaces are one-sided: the front is the side from which the corners run counter-clockwise (right-hand rule). The
    back blocks light but neither emits nor reflects. Lengths are metres; form factors do not depend on the unit.

    Args:
        vertices: (V, 3) coordinates, m.
        faces: (n, 3) indices of the corners of each patch.
        reflectance: rho in [0, 1]: a scalar, (b,) one value a band, or (n, b). A 1-D array always means bands. What is
            not told patch by patch holds for the diffuse patches.
        emission: self-emitted radiosity E >= 0, W/m^2, in the same shapes. It is what the surface gives off by itself
            (a diffuse radiance of E / pi), never the light that falls on it.
        sides: ``"front"``, or ``"both"`` to make thin sheets: every patch then gets a reversed twin, and patch i + n is
            the back of patch i.
        names: optional, the name of the object that each patch belongs to.
        mirror: what of the light a perfect mirror sends back, in [0, 1], all bands alike; a scalar or (n,). 0 is no
            mirror.
        ior: index of refraction (> 0) of the body behind a smooth clear surface, its front outside; a scalar or (n,).
            nan is no glass. Glass is a closed body with nothing diffuse in it, and a gap around it: :meth:`report`
            looks at that. A patch is diffuse, a mirror or glass: mirrors and glass have reflectance 0 and emission 0,
            and no radiosity. :func:`radiosity.solve` by rays
            carries light over them, :func:`radiosity.two_pass` draws them; what cannot carry them refuses such scenes.

    Raises:
        TypeError: an argument holds no numbers, or faces no integers.
        ValueError: shapes that do not fit, or values out of range; the message lists every problem by patch number.
    """

    parent: IntArray | None
    """(n,) for a scene made by :meth:`subdivide`: the patch of the coarse scene that each patch is a part of."""
    names: tuple[str, ...] | None
    """The name of the object that each patch belongs to."""

    def __init__(
        self,
        vertices: Any,
        faces: Any,
        reflectance: Any = 0.5,
        emission: Any = 0.0,
        sides: str = "front",
        names: Sequence[str] | None = None,
        mirror: Any = 0.0,
        ior: Any = np.nan,
    ) -> None:
        if sides not in SIDES:
            raise ValueError(f"sides must be one of {SIDES}, not {sides!r}")
        indices = triangle_indices("faces", faces)
        n = len(indices)
        materials = _materials(n, reflectance, emission, mirror, ior)
        if names is not None and len(names) != n:
            raise ValueError(f"names must hold {n} names, one a patch, not {len(names)}")
        self._core = _core.Scene(shaped("vertices", vertices, "V", 3), indices, *materials, sides == "both")
        self.parent = None
        self.names = None if names is None else tuple(names) * (2 if sides == "both" else 1)

    @classmethod
    def _from_core(cls, core: _core.Scene, names: tuple[str, ...] | None) -> Scene:
        scene = cls.__new__(cls)
        scene._core = core
        scene.parent = None
        scene.names = names
        return scene

    @classmethod
    def from_trimesh(
        cls,
        mesh: trimesh.Trimesh | trimesh.Scene,
        reflectance: Any = None,
        emission: Any = None,
        mirror: Any = None,
        ior: Any = None,
    ) -> Scene:
        """A scene from a ``trimesh`` mesh or scene, its transforms applied and its materials used where present.

        Args:
            mesh: a ``trimesh.Trimesh`` or ``trimesh.Scene``.
            reflectance: overrides the materials, mirrors among them; scalar, (b,) or (n, b).
            emission: overrides the materials, W/m^2; scalar, (b,) or (n, b).
            mirror: overrides the materials; scalar or (n,), 0 for what is none.
            ior: overrides the materials; scalar or (n,), nan for what is no glass.

        See :func:`radiosity.load` for how materials are understood.
        """
        from .load import from_trimesh

        return from_trimesh(mesh, reflectance, emission, mirror, ior)

    @cached_property
    def vertices(self) -> FloatArray:
        """(V, 3) coordinates, m."""
        return read_only(self._core.vertices)

    @cached_property
    def faces(self) -> IntArray:
        """(n, 3) corner indices."""
        return read_only(self._core.faces)

    @cached_property
    def reflectance(self) -> FloatArray:
        """(n, b) reflectance rho."""
        return read_only(self._core.reflectance)

    @cached_property
    def emission(self) -> FloatArray:
        """(n, b) emission E, W/m^2."""
        return read_only(self._core.emission)

    @cached_property
    def mirror(self) -> FloatArray:
        """(n,) what of the light each patch mirrors; 0 where it is no mirror."""
        return read_only(self._core.materials[0])

    @cached_property
    def ior(self) -> FloatArray:
        """(n,) index of refraction of glass; nan where a patch is none."""
        return read_only(self._core.materials[1])

    @property
    def is_diffuse(self) -> bool:
        """Whether there is neither mirror nor glass."""
        return not (self.mirror.any() or (self.ior > 0.0).any())

    @cached_property
    def areas(self) -> FloatArray:
        """(n,) areas A, m^2."""
        return read_only(self._core.areas)

    @cached_property
    def normals(self) -> FloatArray:
        """(n, 3) unit normals, front side."""
        return read_only(self._core.normals)

    @cached_property
    def centroids(self) -> FloatArray:
        """(n, 3) centroids, m."""
        return read_only(self.vertices[self.faces].mean(axis=1))

    @property
    def n_patches(self) -> int:
        """Number of patches n."""
        return len(self.faces)

    @property
    def bands(self) -> int:
        """Number of bands b: RGB is three, heat is one."""
        return int(self.reflectance.shape[1])

    def __repr__(self) -> str:
        patches, bands = counted(self.n_patches, "patch", "patches"), counted(self.bands, "band", "bands")
        return f"Scene({patches}, {bands}, {self.areas.sum():.6g} m^2)"

    def __getstate__(self) -> dict[str, Any]:
        arrays = (self.vertices, self.faces, self.reflectance, self.emission, self.mirror, self.ior)
        return {"arrays": arrays, "parent": self.parent, "names": self.names}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vertices, faces, reflectance, emission, mirror, ior = (aligned(array) for array in state["arrays"])
        self._core = _core.Scene(vertices, faces, reflectance, emission, mirror, ior, False)
        self.parent = state["parent"]
        self.names = state["names"]

    def with_materials(
        self, reflectance: Any = None, emission: Any = None, mirror: Any = None, ior: Any = None
    ) -> Scene:
        """The same patches with other materials, in the shapes that :class:`Scene` takes; None keeps what is there.

        What becomes a mirror or glass loses its reflectance and emission unless these are given; what ceases to be one
        has none until they are.

        Raises:
            ValueError: as :class:`Scene`.
        """
        m, n = (self.mirror if mirror is None else mirror), (self.ior if ior is None else ior)
        materials = _materials(self.n_patches, reflectance, emission, m, n, (self.reflectance, self.emission))
        core = _core.Scene(self.vertices, self.faces, *materials, False)
        scene = Scene._from_core(core, self.names)
        scene.parent = self.parent
        return scene

    def subdivide(self, max_edge: float) -> Scene:
        """A finer scene in which no edge is longer than ``max_edge`` (m), without T-junctions.

        Materials are inherited; ``.parent`` of the result gives each patch's origin in this scene.

        Raises:
            ValueError: ``max_edge`` is not positive.
            MemoryError: the result would be too large.
        """
        core, parent = self._core.subdivide(float(max_edge), available_bytes())
        names = None if self.names is None else tuple(self.names[p] for p in parent.tolist())
        scene = Scene._from_core(core, names)
        scene.parent = read_only(parent)
        return scene

    def report(self) -> Report:
        """What to know before solving: orientation, holes, degenerate and duplicate patches, memory. Print it."""
        return report(self)

    def intersect(self, origins: Any, directions: Any, threads: int | None = None) -> Hits:
        """The first patch that each ray hits, from either side.

        Watertight, and the same at any scale and place: what is hit is decided in double precision (Woop, Benthin &
        Wald 2013). A ray does not hit the surface that it starts on: no patch whose plane its origin lies in as far as
        rounding tells, and nothing within 1e-9 of the scene's size.

        Args:
            origins: (m, 3) starting points, m.
            directions: (m, 3) directions, of any length but 0.
            threads: None for all cores.

        Returns:
            Hits: ``.patch`` (m,), ``.distance`` (m,), ``.barycentric`` (m, 2).

        Raises:
            ValueError: shapes that differ, a coordinate that is not finite, a direction of length 0.
        """
        o, d = _pair("origins", origins, "directions", directions)
        return Hits(*self._core.intersect(o, d, thread_count(threads)))

    def occluded(self, p: Any, q: Any, threads: int | None = None) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(m,) whether a patch meets the open segment from ``p`` to ``q``, (m, 3) each.

        Watertight like :meth:`intersect`. Patches block from both sides. The ends themselves do not count: a point on a
        patch sees what is before it.

        Raises:
            ValueError: shapes that differ, or a coordinate that is not finite.
        """
        return self._core.occluded(*_pair("p", p, "q", q), thread_count(threads))


def _materials(
    n: int, reflectance: Any, emission: Any, mirror: Any, ior: Any, kept: tuple[Any, Any] = (None, None)
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The materials of n patches; ``kept`` are reflectance and emission where None is given.

    Only what is told patch by patch can be told of a mirror or glass: the core refuses that, by patch.
    """
    mirrored, index = one_per_patch("mirror", n, mirror), one_per_patch("ior", n, ior)
    both = np.flatnonzero((mirrored != 0.0) & ~np.isnan(index))
    if both.size:
        raise ValueError(f"patch {both[0]}: it is a mirror and glass at once ({both.size} patches are)")
    given = (reflectance, emission)
    rho, e = (old if new is None else new for new, old in zip(given, kept, strict=True))
    values = per_patch(n, reflectance=rho, emission=e)
    is_specular = ((mirrored != 0.0) | ~np.isnan(index))[:, None]
    rho, e = (
        told if np.ndim(new) == 2 else np.where(is_specular, 0.0, told) for new, told in zip(given, values, strict=True)
    )
    return rho, e, mirrored, index


def _pair(name_a: str, a: Any, name_b: str, b: Any) -> tuple[FloatArray, FloatArray]:
    first, second = shaped(name_a, a, "m", 3), shaped(name_b, b, "m", 3)
    if len(first) != len(second):
        raise ValueError(f"{name_a} has {len(first)} rows and {name_b} {len(second)}; they must be as many")
    return first, second
