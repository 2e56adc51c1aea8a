"""Residual and true error of every solver against its work, on an easy scene, a white room and nearly a furnace.

The true error is the distance to LAPACK's LU of the same system, relative to B - E, the worst band. Work is counted in
rows of F touched, n of them being a product with F, and in seconds without the measuring. Prints a table of what it
takes to 0.1 %; `python benches/solve.py FILE.png` draws all steps as well.
"""

import sys
import time

import numpy as np

import radiosity as rad

METHODS = ("direct", "jacobi", "gauss_seidel", "southwell", "overshooting", "gmres")
# Products with F before the first step; a step is one, but for shots, which touch one column.
BEFORE = {"jacobi": 1, "gmres": 1}
SHOTS = ("southwell", "overshooting")
WANTED = 1e-3
# Lower edge of the panels.
LOWEST = 1e-6
MOST_STEPS = {"jacobi": 20_000, "gauss_seidel": 20_000, "southwell": 200_000, "overshooting": 200_000}


def scenes():
    """(name, scene): as painted; white and open at the front; closed, with hardly any loss."""
    cornell = rad.scenes.cornell_box(max_edge=0.1)
    closed = rad.scenes.furnace(max_edge=0.15)
    lamp = np.zeros(closed.emission.shape)
    lamp[: closed.n_patches // 12] = 1.0
    yield "as painted", cornell
    yield "white room, rho = 0.95", cornell.with_materials(0.95, cornell.emission)
    yield "nearly a furnace, rho = 0.999", closed.with_materials(0.999, lamp)


def history(F, scene, exact, method):
    """Arrays of rows touched / n, seconds, residual and error, one entry a step."""
    steps, spent = [], 0.0
    start = time.perf_counter()
    areas, e = scene.areas, scene.emission
    light = np.sqrt(areas @ (exact - e) ** 2)
    emitted = np.sqrt(areas @ e**2)

    def observe(step, radiosity, unshot):
        nonlocal spent
        now = time.perf_counter()
        rows = step / scene.n_patches if method in SHOTS else BEFORE.get(method, 0) + step
        error = (np.sqrt(areas @ (radiosity - exact) ** 2) / light).max()
        steps.append((rows, now - start - spent, (np.sqrt(areas @ unshot**2) / emitted).max(), error))
        spent += time.perf_counter() - now

    try:
        rad.solve_system(
            F, e, scene.reflectance, method, 1e-6, MOST_STEPS.get(method), on_iteration=observe, progress=False
        )
    except rad.ConvergenceError as error:
        print(f"  {error}")
    return np.array(steps)


def main() -> None:
    rows = []
    for name, scene in scenes():
        F = rad.form_factors(scene, tolerance=0.1, progress=False)
        matrix, rho, e = F.toarray(), scene.reflectance, scene.emission
        one = np.eye(len(matrix))
        exact = np.stack([np.linalg.solve(one - rho[:, [b]] * matrix, e[:, b]) for b in range(scene.bands)], 1)
        print(f"\n{name}: {scene.n_patches} patches, {scene.bands} bands, to a true error of {WANTED:.1%} of B - E")
        print(f"{'method':14s} {'steps':>7s} {'rows/n':>8s} {'seconds':>8s} {'residual':>9s}")
        paths = {}
        for method in METHODS:
            paths[method] = path = history(F, scene, exact, method)
            there = np.flatnonzero(path[:, 3] <= WANTED)
            if there.size:
                touched, seconds, residual, _ = path[there[0]]
                print(f"{method:14s} {there[0] + 1:7d} {touched:8.2f} {seconds:8.4f} {residual:9.1e}")
            else:
                print(f"{method:14s} {'never':>7s} {path[-1, 0]:8.2f} {path[-1, 1]:8.4f} {path[-1, 2]:9.1e}")
        rows.append((name, paths))
    if len(sys.argv) > 1:
        draw(rows, sys.argv[1])


def draw(rows, path) -> None:
    """One row of panels a scene: true error (lines) and residual (dotted) against rows touched and against seconds."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.2 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), 2, sharey="row")
    for (name, paths), pair in zip(rows, panels, strict=True):
        for panel, column, label in ((pair[0], 0, "rows of F touched / n"), (pair[1], 1, "seconds")):
            for k, (method, steps) in enumerate(paths.items()):
                # One point, far below the axis: it stands on the edge.
                marker = "o" if len(steps) == 1 else None
                errors = np.maximum(steps[:, 3], LOWEST) if marker else steps[:, 3]
                panel.loglog(
                    steps[:, column], errors, clip_on=marker is None, color=f"C{k}", marker=marker, label=method
                )
                panel.loglog(steps[:, column], steps[:, 2], color=f"C{k}", linestyle=":", linewidth=1)
            panel.set(xlabel=label, ylim=(LOWEST, 3))
            panel.grid(alpha=0.3)
        pair[0].set(title=name, ylabel="error of B - E; residual dotted")
    panels[0][0].legend(fontsize=8)
    figure.savefig(path, dpi=110)
    print(f"\nwritten: {path}")


if __name__ == "__main__":
    main()
