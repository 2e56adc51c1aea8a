"""Prints rays a second against Embree 4: kernel against kernel in one process, and batches from Python against embreex.

The kernels' table is made by ``visibility.rs`` on the scenes that this file makes. Embree's single-ray calls
``rtcIntersect1`` and ``rtcOccluded1`` (default flags and build quality) are the peer; the library is the one that the
embreex package brings. From Python, the peer is ``EmbreeScene.run``.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh

import radiosity as rad

ROOT = Path(__file__).resolve().parents[1]
RAYS = 1_000_000
RUNS = 5


def pillars() -> tuple[np.ndarray, np.ndarray]:
    room = trimesh.creation.box((4, 4, 1))
    room.invert()
    columns = []
    for k in range(100):
        column = trimesh.creation.cylinder(0.08, 1, sections=96)
        column.update_faces(np.abs(column.face_normals[:, 2]) < 0.5)
        column.apply_translation((0.4 * (k % 10) - 1.8, 0.4 * (k // 10) - 1.8, 0))
        columns.append(column)
    mesh = trimesh.util.concatenate([room, *columns])
    return mesh.vertices, mesh.faces


def spheres() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    balls = []
    for centre, radius in zip(rng.random((160, 3)), rng.uniform(0.02, 0.06, 160), strict=True):
        ball = trimesh.creation.icosphere(3, radius)
        ball.apply_translation(centre)
        balls.append(ball)
    mesh = trimesh.util.concatenate(balls)
    return mesh.vertices, mesh.faces


def terrain(side: int = 708) -> tuple[np.ndarray, np.ndarray]:
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    z = np.zeros_like(u)
    for octave in range(8):
        f = 3.1 * 2**octave
        z += 0.35 / f * (np.sin(f * u + 1.3 * octave) * np.cos(1.1 * f * v + 0.7) + 0.5 * np.sin(1.7 * f * (u + v)))
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    a, b, c, d = corner, corner + 1, corner + side + 1, corner + side
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([u.ravel(), v.ravel(), z.ravel()], 1), faces


def cornell(max_edge: float | None) -> tuple[np.ndarray, np.ndarray]:
    scene = rad.scenes.cornell_box(max_edge=max_edge)
    return scene.vertices, scene.faces


def kernels(scenes: dict[str, tuple[np.ndarray, np.ndarray]], library: Path | None) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for k, (name, (vertices, faces)) in enumerate(scenes.items()):
            stem = Path(folder, f"{k} {name}")
            np.ascontiguousarray(vertices, np.float64).tofile(f"{stem}.vertices")
            np.ascontiguousarray(faces, np.uint32).tofile(f"{stem}.faces")
        environment = {**os.environ, "RADIOSITY_SCENES": folder, "RADIOSITY_EMBREE": str(library or "")}
        sys.stdout.flush()
        subprocess.run(
            ["cargo", "bench", "--quiet", "--bench", "visibility"], cwd=ROOT, env=environment, check=True, timeout=1800
        )


def batches(scenes: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError:
        print("\nembreex is not installed: no comparison from Python")
        return
    print(f"\nBatches of {RAYS:,} rays from Python, million rays/s, median of {RUNS} runs. embreex: one thread,")
    print("float32 in, patch number out, and with output=True all that it has; radiosity: float64 in, patch, distance")
    print("and barycentric coordinates out, one thread and two.\n")
    print("| scene | embreex | embreex, all | radiosity, 1 thread | ratio | ratio to all | 2 threads | 2 to 1 |")
    print("|---|---|---|---|---|---|---|---|")
    rng = np.random.default_rng(2)
    for name, (vertices, faces) in scenes.items():
        scene = rad.Scene(vertices, faces)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        origins = rng.uniform(low, high, (RAYS, 3))
        directions = rng.normal(size=(RAYS, 3))
        theirs = EmbreeScene()
        TriangleMesh(theirs, vertices[faces].astype(np.float32))
        o, d = origins.astype(np.float32), directions.astype(np.float32)
        calls = {
            "first": lambda theirs=theirs, o=o, d=d: theirs.run(o, d),
            "all": lambda theirs=theirs, o=o, d=d: theirs.run(o, d, output=True),
            "one": lambda scene=scene, a=origins, b=directions: scene.intersect(a, b, threads=1),
            "two": lambda scene=scene, a=origins, b=directions: scene.intersect(a, b, threads=2),
        }
        rates: dict[str, list[float]] = {key: [] for key in calls}
        for run in range(RUNS + 1):
            for key, call in calls.items():
                start = time.perf_counter()
                call()
                if run > 0:  # the first run builds trees
                    rates[key].append(RAYS / (time.perf_counter() - start) / 1e6)
        first, everything, one, two = (float(np.median(rates[key])) for key in calls)
        print(f"| {name} | {first:.2f} | {everything:.2f} | {one:.2f} | {one / first:.2f} |", end="")
        print(f" {one / everything:.2f} | {two:.2f} | {two / one:.2f} |")


def main() -> None:
    scenes = {
        "Cornell 36": cornell(None),
        "Cornell 6k": cornell(0.043),
        "pillars 20k": pillars(),
        "spheres 200k": spheres(),
        "terrain 1M": terrain(),
    }
    library = None
    try:
        import embreex

        library = next(Path(embreex.__file__).resolve().parents[1].glob("embreex.libs/libembree4*"), None)
    except ImportError:
        pass
    kernels(scenes, library)
    batches(scenes)


if __name__ == "__main__":
    main()
