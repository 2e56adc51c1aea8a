"""Draws the pictures of docs/hierarchical.md, and prints its table of tolerances, links and errors."""

from pathlib import Path
from time import perf_counter

import numpy as np

import radiosity as rad

FOLDER = Path(__file__).parent


def table() -> None:
    """Error, links and seconds against the tolerance, on a fine mesh; rays beside them."""
    for name, scene in (
        ("Cornell box", rad.scenes.cornell_box(max_edge=0.05)),
        ("Cornell box", rad.scenes.cornell_box(max_edge=0.03)),
        ("two rooms", rad.scenes.two_rooms(max_edge=0.3)),
        ("colonnade", rad.scenes.colonnade()),
    ):
        truth = rad.solve(scene, 0.003, seed=1, progress=False).irradiance
        rho, areas = scene.reflectance, scene.areas
        norm = areas @ (rho * truth) ** 2
        for tolerance in (0.1, 0.03, 0.01):
            line = f"{name:12s} {scene.n_patches:6d} {tolerance:5.0%}"
            for method in ("hierarchical", "rays"):
                start = perf_counter()
                solution = rad.solve(scene, tolerance, method, progress=False)
                seconds = perf_counter() - start
                error = np.sqrt((areas @ (rho * (solution.irradiance - truth)) ** 2 / norm).max())
                line += f" | {method} {seconds:6.2f} s {error:7.2%}"
                if method == "hierarchical":
                    leaves, links = solution.report.elements, solution.report.links
                    line += f" {leaves:6d} elements {links:7d} links {2 * links / leaves:4.0f} a leaf"
            print(line, flush=True)


def main() -> None:
    """Draw all."""
    camera = rad.Camera(**rad.scenes.cornell_box_view())
    solution = rad.solve(rad.scenes.cornell_box(), 0.03, "hierarchical", progress=False)
    rad.plot.mesh(solution, camera, size=700).savefig(FOLDER / "hierarchical_mesh.png", dpi=110)
    scene = rad.scenes.cornell_box(max_edge=0.1)
    F = rad.form_factors(scene, 0.3, "hierarchical", progress=False)
    rad.plot.links(F).savefig(FOLDER / "hierarchical_links.png", dpi=100)
    floor = next(i for i, name in enumerate(scene.names or ()) if name == "floor")
    rad.plot.links_from(F, floor + 50).savefig(FOLDER / "hierarchical_links_from.png", dpi=100)
    table()


if __name__ == "__main__":
    main()
