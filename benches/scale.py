"""Prints time, memory and error on one machine where n is large: a city, a crater, a theatre of a million triangles.

Every measurement runs in a process of its own, whose peak of memory is that of the work and nothing else. "CPU" is user
plus system time of all threads, divided by two: what two cores that do nothing else would need at least.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import resource
import time
from collections.abc import Callable
from itertools import pairwise
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

import radiosity as rad

Found = dict[str, Any]
QUIET = {"progress": False}


# -------------------------------------------------------------------------------------------------------------- scenes


def city(blocks: int = 9, cell: float = 2.0) -> rad.Scene:
    """Houses of 8 x 8 m on a grid of streets 6 m wide, 4 to 14 m high; every face cut into cells of two triangles.

    Houses are closed boxes; the ground lies around and not beneath them, and everything is open to the sky. With 9 x 9
    houses and cells of 2 m: 22,410 facets. Southern walls emit, as the sun heats them.
    """
    house, street = 8.0, 6.0
    pitch, rng = house + street, np.random.default_rng(22176)
    corners: list[np.ndarray[Any, Any]] = []
    emission: list[np.ndarray[Any, Any]] = []

    def wall(origin: tuple[float, float, float], u: tuple[int, int, int], v: tuple[int, int, int], size: Any) -> None:
        """Two triangles a cell; u x v is the normal."""
        counts = [round(length / cell) for length in size]
        grid = np.stack(np.meshgrid(*[np.arange(count) for count in counts], indexing="ij"), -1).reshape(-1, 2)
        squares = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
        places = cell * (grid[:, None, :] + squares)
        points = np.asarray(origin, float) + places[..., :1] * np.asarray(u) + places[..., 1:] * np.asarray(v)
        triangles = points[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
        corners.append(triangles)
        emission.append(np.full(len(triangles), 100.0 if np.cross(u, v)[1] < 0 else 0.0))

    x, y, z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    back, left = (0, -1, 0), (-1, 0, 0)
    for p in range(blocks):
        for q in range(blocks):
            x0, y0 = p * pitch, q * pitch
            h = cell * int(rng.integers(round(4 / cell), round(14 / cell) + 1))
            x1, y1 = x0 + house, y0 + house
            wall((x0, y0, h), x, y, (house, house))
            wall((x0, y1, 0), x, back, (house, house))
            wall((x0, y0, 0), x, z, (house, h))
            wall((x1, y1, 0), left, z, (house, h))
            wall((x1, y0, 0), y, z, (house, h))
            wall((x0, y1, 0), back, z, (house, h))
            # The street in front of it, and the one beside both.
            wall((x0, y1, 0), x, y, (house, street))
            wall((x1, y0, 0), x, y, (street, pitch))
    triangles = np.concatenate(corners)
    vertices, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    light = np.concatenate(emission)[:, None]
    return rad.Scene(vertices, faces.reshape(-1, 3), reflectance=0.3, emission=light)


def crater(rings: int = 32, bowl: int = 25, width: float = 6.24, outermost: int | None = 198) -> rad.Scene:
    """A crater in a plain: a part of a sphere five times as wide as it is deep (Ingersoll et al. 1992); 6,386 facets.

    Ring r holds about `width` r points; `outermost` of them on the last one make the number of facets. The first `bowl`
    rings lie in the crater, where every facet sees every other; the plain sees nothing but the sky.
    """
    counts = [1] + [round(width * r) for r in range(1, rings + 1)]
    if outermost is not None:
        counts[-1] = outermost
    depth, rim = 0.4, 1.0
    radius = 0.5 * (depth + rim**2 / depth)
    rows, vertices = [], []
    for r, count in enumerate(counts):
        angle = 2.0 * math.pi * np.arange(count) / count
        polar = math.asin(rim / radius) * min(r / bowl, 1.0)
        far = radius * math.sin(polar) * max(r / bowl, 1.0)
        rows.append(np.arange(count) + sum(counts[:r]))
        vertices.append(np.stack([far * np.cos(angle), far * np.sin(angle), np.full(count, -math.cos(polar))], axis=1))
        vertices[-1][:, 2] *= radius
    points, faces = np.concatenate(vertices), []

    def above(triangle: tuple[int, int, int], point: int) -> float:
        """How far a point lies before the plane of a triangle, up to a factor."""
        a, b, c = points[list(triangle)]
        return float(np.cross(b - a, c - a) @ (points[point] - a))

    for inner, outer in pairwise(rows):
        i, o = 0, 0
        steps = len(inner) if len(inner) > 1 else 0
        while i < steps or o < len(outer):
            a, b = inner[i % len(inner)], outer[o % len(outer)]
            after, beyond = inner[(i + 1) % len(inner)], outer[(o + 1) % len(outer)]
            outwards = (o + 1) * len(inner) <= (i + 1) * len(outer)
            if outer[0] <= rows[bowl][0] and i < steps and o < len(outer):
                # In the bowl, the diagonal that leaves it convex.
                outwards = above((a, b, beyond), after) > 0.0
            if o < len(outer) and (i == steps or outwards):
                faces.append((a, b, beyond))
                o += 1
            else:
                faces.append((a, b, after))
                i += 1
    # The sun stands over one half of the bowl.
    scene = rad.Scene(points, np.asarray(faces), reflectance=0.1)
    return scene.with_materials(scene.reflectance, np.where(scene.centroids[:, :1] > 0.0, 1.0, 0.0))


def crater_of(facets: int) -> rad.Scene:
    """A crater with about so many facets."""
    rings = round(math.sqrt(facets / 6.24))
    return crater(rings, round(rings * 25 / 32), outermost=None)


def theatre(triangles: int) -> rad.Scene:
    """The built-in theatre with about so many triangles: the longest edge is found by halving."""
    scene = rad.scenes.theatre()
    if triangles <= scene.n_patches:
        return scene
    short, long = 0.02, 1.0
    for _ in range(7):
        middle = math.sqrt(short * long)
        if scene.subdivide(middle).n_patches > triangles:
            short = middle
        else:
            long = middle
    return scene.subdivide(short)


def cornell(triangles: int) -> rad.Scene:
    """The Cornell box with about so many triangles of one size."""
    area = float(rad.scenes.cornell_box().areas.sum())
    # Halved until no edge is longer, right-angled triangles end at about this edge.
    return rad.scenes.cornell_box(max_edge=2.4 * math.sqrt(area / triangles))


# -------------------------------------------------------------------------------------------------------- measurements


def _timed(work: Callable[[], Any]) -> tuple[Any, Found]:
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, {"seconds": time.perf_counter() - wall, "cpu": 0.5 * (time.process_time() - cpu)}


def _product(F: rad.FormFactors) -> float:
    """Milliseconds of F @ x, the least of ten."""
    x = np.random.default_rng(0).random(F.shape[0])
    return 1e3 * min(_timed(lambda: F @ x)[1]["seconds"] for _ in range(10))


def build(scene: rad.Scene, tolerance: float, method: str = "auto") -> Found:
    """Form factors: what it takes to make, to hold and to apply them."""
    F, found = _timed(lambda: rad.form_factors(scene, tolerance, method, **QUIET))
    rows = np.linspace(0, scene.n_patches - 1, 200).astype(int)
    filled = float(np.mean([np.count_nonzero(F.row(int(i))) for i in rows]))
    x = np.random.default_rng(0).random((scene.n_patches, 4))
    return found | {
        "n": scene.n_patches,
        "row_error": F.error_estimate,
        "bytes": F.nbytes,
        "product_ms": _product(F),
        "entries": filled * scene.n_patches,
        "image": F @ x,
    }


def solved(scene: rad.Scene, tolerance: float) -> Found:
    """A solve by rays: its cost beside what was forecast, which is not timed."""
    told = rad.forecast(scene, tolerance, **QUIET)
    before = _peak()
    solution, found = _timed(lambda: rad.solve(scene, tolerance, **QUIET))
    return found | {
        "n": scene.n_patches,
        "error": solution.error_estimate,
        "told_seconds": told.seconds,
        "told_bytes": told.nbytes,
        "before": before,
    }


def _peak() -> int:
    """Largest resident memory of this process so far, bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _alone(to: Connection, work: Callable[[], Found]) -> None:
    start = _peak()
    found = work()
    to.send(found | {"peak": _peak(), "start": start})


def alone(work: Callable[[], Found], limit: float) -> Found | None:
    """What `work` finds in a process of its own; None after `limit` seconds."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_alone, args=(there, work))
    process.start()
    there.close()
    try:
        return here.recv() if here.poll(limit) else None
    except EOFError:
        return None
    finally:
        process.kill()
        process.join()


# -------------------------------------------------------------------------------------------------------------- tables


def _operators(title: str, works: dict[str, Callable[[], Found]], limit: float) -> None:
    print(f"\n{title}\n")
    print("| operator | n | seconds | CPU s | row error | entries of F | held MB | peak MB | F x ms | error of F x |")
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    image = None
    for name, work in works.items():
        found = alone(work, limit)
        if found is None:
            print(f"| {name} | | over {limit:g} | | | | | | | |", flush=True)
            continue
        # Against the first row, the most careful one.
        y = found["image"]
        image = y if image is None or image.shape != y.shape else image
        off = "" if y is image else f"{np.linalg.norm(y - image) / np.linalg.norm(image):.1e}"
        print(
            f"| {name} | {found['n']:,} | {found['seconds']:.1f} | {found['cpu']:.1f} | {found['row_error']:.1e} "
            f"| {found['entries'] / 1e6:.2f} M | {found['bytes'] / 1e6:.1f} | {found['peak'] / 1e6:.0f} "
            f"| {found['product_ms']:.2f} | {off} |",
            flush=True,
        )


def print_city(limit: float) -> None:
    """The city at 1 % rows."""
    _operators(
        "A city, occluded: form_factors(city(), tolerance=0.01)",
        {f"analytic, {k} x {k} houses": lambda k=k: build(city(k), 0.01) for k in (3, 5, 9)},
        limit,
    )


def print_crater(limit: float) -> None:
    """The crater that python-flux measures."""
    _operators(
        "A crater: form_factors(crater(), ...)",
        {
            "analytic, 1e-4": lambda: build(crater(), 1e-4),
            "analytic, 1e-2": lambda: build(crater(), 1e-2),
            "hierarchical, 3e-2": lambda: build(crater(), 3e-2, "hierarchical"),
            "hierarchical, 1e-1": lambda: build(crater(), 1e-1, "hierarchical"),
        },
        limit,
    )


def print_growth(limit: float) -> None:
    """Links at one tolerance, while n grows."""
    sizes = (10_000, 30_000, 100_000, 300_000, 1_000_000)

    def growing(scene: Callable[[int], rad.Scene]) -> dict[str, Callable[[], Found]]:
        return {f"hierarchical, {n:,}": lambda n=n: build(scene(n), 0.3, "hierarchical") for n in sizes}

    _operators('The Cornell box: form_factors(cornell(n), 0.3, "hierarchical")', growing(cornell), limit)
    _operators('A crater: form_factors(crater(rings), 0.3, "hierarchical")', growing(crater_of), limit)


def rows(scene: rad.Scene, tolerances: tuple[float, ...]) -> Found:
    """What links say of their rows beside how far these are off, sum over j of |dF_ij|: (told, worst, mean)."""
    dense = rad.form_factors(scene, 1e-3, **QUIET).toarray()
    found = {}
    for tolerance in tolerances:
        links = rad.form_factors(scene, tolerance, "hierarchical", **QUIET)
        off = np.abs(links.toarray() - dense).sum(axis=1)
        found[f"{tolerance:.0%}"] = (links.error_estimate, off.max(), off.mean())
    return found


def print_rows(limit: float) -> None:
    """Rows of links against dense rows."""
    print("\nRows of links, sum over j of |dF_ij|\n")
    print("| scene | n | asked | told | worst | mean |\n|---|---|---|---|---|---|")
    tolerances = (0.3, 0.1, 0.03)
    scenes = {
        "Cornell box": cornell(2500),
        "Cornell box, finer": cornell(10_000),
        "two rooms": rad.scenes.two_rooms(),
        "colonnade": rad.scenes.colonnade(),
        "crater": crater(16, 12, outermost=None),
    }
    for name, scene in scenes.items():
        found = alone(lambda scene=scene: rows(scene, tolerances), limit)
        if found is None:
            print(f"| {name} | {scene.n_patches:,} | over {limit:g} s | | | |", flush=True)
            continue
        for tolerance in tolerances:
            asked = f"{tolerance:.0%}"
            told = " | ".join(f"{value:.2%}" for value in found[asked])
            print(f"| {name} | {scene.n_patches:,} | {asked} | {told} |", flush=True)


def print_theatre(limit: float) -> None:
    """A solve of up to a million triangles."""
    print("\nA theatre: solve(theatre(n), tolerance=0.05)\n")
    print("| n | seconds | CPU s | error | peak MB | scene MB | told MB | told s |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for n in (53_548, 100_000, 300_000, 1_000_000):
        found = alone(lambda n=n: solved(theatre(n), 0.05), limit)
        if found is None:
            print(f"| {n:,} | over {limit:g} | | | | | | |", flush=True)
            continue
        print(
            f"| {found['n']:,} | {found['seconds']:.0f} | {found['cpu']:.0f} | {found['error']:.1%} "
            f"| {found['peak'] / 1e6:.0f} | {found['before'] / 1e6:.0f} | {found['told_bytes'] / 1e6:.0f} "
            f"| {found['told_seconds']:.0f} |",
            flush=True,
        )


TABLES: dict[str, Callable[[float], None]] = {
    "city": print_city,
    "crater": print_crater,
    "growth": print_growth,
    "rows": print_rows,
    "theatre": print_theatre,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", choices=TABLES, action="append", help="one of the tables; may be given more than once"
    )
    parser.add_argument("--limit", type=float, default=1800.0, help="seconds that one measurement may take")
    given = parser.parse_args()
    for name in given.only or TABLES:
        TABLES[name](given.limit)


if __name__ == "__main__":
    main()
