"""Draws docs/bounces.png and docs/bounces.gif: light bounce by bounce, and shot by shot without and with ambient."""

from pathlib import Path

import radiosity as rad

FOLDER = Path(__file__).parent
BOUNCES = (1, 2, 3, 4, 5)
SHOTS = (1, 4, 16, 64, 256)


def chosen(F, steps, **arguments):
    """The solutions after these steps, and the last."""
    kept = []
    for solution in rad.bounces(F, tolerance=1e-4, **arguments):
        last = solution
        if solution.report.steps in steps:
            kept.append(solution)
        if solution.report.steps > max(steps) and arguments.get("method") == "southwell":
            break
    return [*kept, last]


def main() -> None:
    """Draw both."""
    scene = rad.scenes.cornell_box(max_edge=0.1)
    F = rad.form_factors(scene, tolerance=1e-2)
    camera = rad.Camera(**rad.scenes.cornell_box_view())
    converged = rad.solve_system(F, scene.emission, scene.reflectance, method="gmres", tolerance=1e-6)
    bounced = chosen(F, BOUNCES)
    rows = [[*bounced[:5], converged]]
    labels = ["direct light", *(f"+ {k} bounce{'s' * (k > 1)}" for k in range(1, 5)), "converged"]
    for ambient in (False, True):
        shots = chosen(F, SHOTS, method="southwell", ambient=ambient)[:5]
        rows.append([*shots, converged])
        labels += [f"{k} shot{'s' * (k > 1)}{', ambient' * ambient}" for k in SHOTS] + ["converged"]
    figure = rad.plot.bounces([solution for row in rows for solution in row], camera, labels, columns=6)
    figure.savefig(FOLDER / "bounces.png", dpi=100)
    rad.plot.animation(bounced, camera, FOLDER / "bounces.gif", size=200)


if __name__ == "__main__":
    main()
