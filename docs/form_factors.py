"""Draws docs/form_factors.png: error against cost of every kernel, and row error against time of a room with occlusion.

Run it as ``python docs/form_factors.py``; it needs Rust (for the kernels' bench) and the extra ``plot``.
"""

import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benches"))

import form_factor as bench  # noqa: E402

SETS = {"near_1_2": "1 to 2 diameters", "mid_2_10": "2 to 10 diameters", "far_10_100": "10 to 100 diameters"}
KERNELS = ("area P3", "area P6", "point P7", "area P12", "point P12", "point P16", "contour")


def kernels(axes: plt.Axes) -> None:
    """From the last table of the bench: three numbers a kernel, ns, median and worst relative error."""
    output = subprocess.run(
        [sys.executable, str(ROOT / "benches" / "form_factor.py"), "kernels"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    rows = {row[0]: row[1:] for row in map(str.split, output.splitlines()) if len(row) == 1 + 3 * len(KERNELS)}
    for colour, (name, label) in zip(("C0", "C1", "C2"), SETS.items(), strict=True):
        ns, median, worst = np.array(rows[name], float).reshape(-1, 3).T
        axes.vlines(ns, np.maximum(median, 1e-16), worst, colour, alpha=0.4)
        axes.plot(ns, worst, "v", color=colour, label=f"{label}, worst")
        axes.plot(ns, np.maximum(median, 1e-16), "o", color=colour, mfc="white", label=f"{label}, median")
        if name == "near_1_2":
            for kernel, x, y in zip(KERNELS, ns, worst, strict=True):
                # Two kernels of one cost and error share a label.
                label = {"area P12": "", "point P12": "area, point P12"}.get(kernel, kernel)
                axes.annotate(label, (x, y), (0, 6), textcoords="offset points", fontsize=7, rotation=35)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="ns a pair, one thread",
        ylabel="relative error",
        xlim=(20, 1100),
        ylim=(3e-17, 10),
    )
    axes.set_xticks([30, 50, 100, 200, 500, 1000], ["30", "50", "100", "200", "500", "1000"], minor=False)
    axes.minorticks_off()
    axes.set_title("kernels, triangles without occlusion")
    axes.legend(fontsize=7, loc="upper right")


def rooms(axes: plt.Axes) -> None:
    """Row error against seconds, a point a tolerance."""
    scene = bench.box_room(1)
    converged = bench.timed(scene, 3e-5, runs=1)[1].toarray()
    for method, tolerances in (("analytic", (1e-1, 1e-2, 1e-3, 1e-4)), ("monte_carlo", (0.3, 0.1, 0.05))):
        points = []
        for tolerance in tolerances:
            seconds, F = bench.timed(scene, tolerance, 3 if method == "analytic" else 1, method)
            error = bench.row_error(F.toarray(), converged)
            print(f"{method:11s} {tolerance:6g} {seconds:6.2f} s, estimate {F.error_estimate:.1e}, true {error:.1e}")
            # The two loosest cost nearly the same: one label to the left, one to the right.
            offset, side = ((-6, 3), "right") if not points else ((6, 3), "left")
            axes.annotate(f"{tolerance:g}", (seconds, error), offset, textcoords="offset points", fontsize=8, ha=side)
            points.append((seconds, error))
        axes.plot(*zip(*points, strict=True), "o-", label=method)
    axes.set(xscale="log", yscale="log", xlabel="seconds, all cores", ylabel="true row error", xlim=(0.1, 30))
    axes.set_xticks([0.1, 0.3, 1, 3, 10, 30], ["0.1", "0.3", "1", "3", "10", "30"])
    axes.minorticks_off()
    axes.set_title("room with two boxes, 1,152 triangles, by tolerance")
    axes.legend(fontsize=8)


def main() -> None:
    """Writes the picture."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    kernels(left)
    rooms(right)
    figure.savefig(ROOT / "docs" / "form_factors.png", dpi=130)


if __name__ == "__main__":
    main()
