"""Prints error and cost of form factors: kernels and pairs (``form_factor.rs``), exact cases, scenes with occlusion.

The peer is pyViewFactor (``pip install pyviewfactor``), on the same scene in the same run; without it there is no
comparison. The true row error is max_i sum_j |F_ij - converged F_ij|.
"""

import json
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
DATA = ROOT / "tests" / "data"
RUNS = 3


def box_room(fineness: int) -> rad.Scene:
    """A cube with two turned boxes on its floor: 1,152 fineness^2 triangles."""

    def grid(low: tuple, high: tuple, turn: float, squares: int) -> trimesh.Trimesh:
        places = np.linspace(0, 1, squares + 1)
        u, v = (a.ravel() for a in np.meshgrid(places, places, indexing="ij"))
        corner = (np.arange(squares)[:, None] * (squares + 1) + np.arange(squares)).ravel()
        a, b, c, d = corner, corner + squares + 1, corner + squares + 2, corner + 1
        faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        sides = []
        for axis in range(3):
            for far in (0.0, 1.0):
                vertices = np.roll(np.stack([np.full_like(u, far), u, v], 1), axis, axis=1)
                sides.append(trimesh.Trimesh(vertices, faces if far else faces[:, ::-1], process=False))
        box = trimesh.util.concatenate(sides)
        box.vertices = np.array(low) + box.vertices * np.subtract(high, low)
        middle = 0.5 * np.add(low, high)
        box.apply_transform(trimesh.transformations.rotation_matrix(turn, (0, 0, 1), middle))
        return box

    room = grid((0, 0, 0), (1, 1, 1), 0.0, 8 * fineness)
    room.invert()
    first = grid((0.15, 0.2, 0.0), (0.45, 0.5, 0.6), 0.35, 4 * fineness)
    second = grid((0.55, 0.5, 0.0), (0.85, 0.8, 0.3), -0.3, 4 * fineness)
    mesh = trimesh.util.concatenate([room, first, second])
    return rad.Scene(mesh.vertices, mesh.faces, 0.5)


def pairs(*arguments: str) -> None:
    """Runs the Rust bench on the sets of exact pairs."""
    with np.load(DATA / "form_factor_pairs.npz") as data:
        a, b, exact, case = data["a"], data["b"], data["f_ab"], data["case"]
    # Exact values below 1e-30 belong to coplanar triangles with rounded corners: 0 in double precision.
    exact = np.where(exact < 1e-30, 0.0, exact)
    rows = np.concatenate([a.reshape(-1, 9), b.reshape(-1, 9), exact[:, None]], axis=1)
    with tempfile.TemporaryDirectory() as folder:
        for name in dict.fromkeys(case):
            rows[case == name].astype("<f8").tofile(Path(folder) / f"{name}.bin")
        sys.stdout.flush()
        subprocess.run(
            ["cargo", "bench", "--quiet", "--bench", "form_factor", "--", *arguments],
            cwd=ROOT,
            env={**os.environ, "RADIOSITY_PAIRS": folder},
            check=True,
            timeout=1800,
        )


def exact_cases() -> None:
    cases = json.loads((DATA / "view_factors.json").read_text(encoding="utf-8"))["cases"]
    tolerances = (1e-3, 1e-8)
    print("\nrelative error of form_factor (absolute where the exact value is 0)\n")
    print(f"{'case':40s} {'exact':>14s}" + "".join(f"{f'at {tolerance:g}':>11s}" for tolerance in tolerances))
    for case in cases:
        exact = case["F_ab"]
        errors = [
            abs(rad.form_factor(case["polygon_a"], case["polygon_b"], tolerance) - exact) / (exact or 1.0)
            for tolerance in tolerances
        ]
        print(f"{case['name']:40s} {exact:14.8g}" + "".join(f"{error:11.1e}" for error in errors))


def timed(scene: rad.Scene, tolerance: float, runs: int = RUNS, method: str = "auto") -> tuple[float, rad.FormFactors]:
    """Median seconds, and the form factors."""
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        F = rad.form_factors(scene, tolerance=tolerance, method=method, progress=False)
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds)), F


def row_error(F: np.ndarray, converged: np.ndarray) -> float:
    return float(np.abs(F - converged).sum(axis=1).max())


def rooms() -> None:
    print("\nroom with two turned boxes, all cores\n")
    print(f"{'triangles':>9s} {'tolerance':>10s} {'seconds':>8s} {'estimate':>9s} {'true row error':>15s}")
    for fineness, tolerances, reference in ((1, (1e-2, 1e-3, 1e-4), 3e-5), (2, (1e-2, 1e-3), 1e-4)):
        scene = box_room(fineness)
        converged = timed(scene, reference, runs=1)[1].toarray()
        for tolerance in tolerances:
            seconds, F = timed(scene, tolerance)
            error = row_error(F.toarray(), converged)
            print(f"{scene.n_patches:9d} {tolerance:10.0e} {seconds:8.2f} {F.error_estimate:9.1e} {error:15.1e}")
        if fineness == 1:
            peer(scene, converged)


def peer(scene: rad.Scene, converged: np.ndarray) -> None:
    try:
        import pyvista
        from pyviewfactor import compute_viewfactor_matrix
    except ImportError:
        print("pyViewFactor is not installed: no comparison")
        return
    faces = np.insert(scene.faces, 0, 3, axis=1).ravel()
    mesh = pyvista.PolyData(np.array(scene.vertices), faces)
    # Patches under a box see nothing of the room.
    clear = converged.sum(axis=1) > 1 - 1e-3
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        # Without obstacles it takes none, not even the mesh. Its F[i, j] leaves j and reaches i.
        F = compute_viewfactor_matrix(mesh, obstacles=[mesh]).T
        seconds.append(time.perf_counter() - start)
    # The first call compiles.
    print(
        f"{scene.n_patches:9d} pyViewFactor: {seconds[1]:.2f} s ({seconds[0]:.2f} s with compilation), row error",
        end="",
    )
    errors = np.abs(F - converged).sum(axis=1)
    print(
        f" {errors.max():.2g}, of rows not under a box {errors[clear].max():.2g}, median row {np.median(errors):.2g};"
    )
    print(f"          row sums not under a box off by {np.abs(F[clear].sum(axis=1) - 1).max():.2g}")


def obstructed() -> None:
    case = json.loads((DATA / "view_factors.json").read_text(encoding="utf-8"))["obstructed"][0]
    corners = [
        *([0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]),
        *([0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]),
        *([0.1, 0.1, 0.5], [0.6, 0.1, 0.5], [0.6, 0.6, 0.5], [0.1, 0.6, 0.5]),
    ]
    faces = np.concatenate([[[k, k + 1, k + 2], [k, k + 2, k + 3]] for k in (0, 4, 8)])
    # The obstacle has both its sides.
    scene = rad.Scene(np.array(corners, float), np.concatenate([faces, faces[4:, ::-1]]))
    print("\ntwo squares and an obstacle with both its sides, eight triangles\n")
    print(f"{'tolerance':>10s} {'seconds':>8s} {'error':>9s}")
    for tolerance in (1e-3, 1e-4, 1e-5):
        seconds, F = timed(scene, tolerance)
        # The patches of a square are halves: the mean of two rows is the factor from square to square.
        error = abs(F.toarray()[:2, 2:4].sum(axis=1).mean() - case["F_ab"])
        print(f"{tolerance:10.0e} {seconds:8.4f} {error:9.1e}")


def main() -> None:
    pairs(*sys.argv[1:])
    if sys.argv[1:]:
        return
    exact_cases()
    rooms()
    obstructed()


if __name__ == "__main__":
    main()
