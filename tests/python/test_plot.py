"""Plots of numbers: what is drawn is what the numbers are. Strips, links and meshes are tested with what they show."""

import numpy as np
import pytest

import radiosity as rad

VIEW = rad.Camera(**rad.scenes.cornell_box_view())


@pytest.fixture(scope="module")
def factors():
    return rad.form_factors(rad.scenes.cornell_box(max_edge=0.3), 0.05, progress=False)


def test_false_colours_show_the_irradiance(factors):
    scene = factors.scene
    solution = rad.solve_system(factors, scene.emission, scene.reflectance, progress=False)
    figure = rad.plot.irradiance(solution, VIEW, size=60, shading="flat")
    shown = figure.axes[0].images[0].get_array()
    # The middle of the back wall, on one patch.
    hits = scene.intersect(np.array([VIEW.origin]), np.array([[0.01, 0.08, 1.0]]))
    at = solution.irradiance[hits.patch[0]].sum()
    assert np.isclose(shown, at, rtol=1e-9).any()
    assert figure.axes[1].get_ylabel() == "irradiance, W/m^2"
    figure = rad.plot.irradiance(solution, VIEW, size=20, most=5.0)
    assert figure.axes[0].images[0].get_clim() == (0.0, 5.0)
    with pytest.raises(ValueError, match="knows no geometry"):
        rad.plot.irradiance(rad.solve_system(np.zeros((2, 2)), 1.0, 0.5, progress=False), VIEW)


def test_false_colours_show_what_falls_on_mirrors_and_glass():
    scene = rad.scenes.mirror_and_glass(0.3, facets=1)
    solution = rad.solve(scene, 0.1, progress=False)
    view = rad.Camera(**rad.scenes.mirror_and_glass_view())
    shown = rad.plot.irradiance(solution, view, size=60, shading="flat").axes[0].images[0].get_array()
    # Where the camera sees the mirror, and the top of the glass, which the lamp shines on.
    targets = np.array([[0.278, 0.4, 0.5592], [0.19, 0.18, 0.15]])
    patches = scene.intersect(np.tile(view.origin, (2, 1)), targets - view.origin).patch
    assert scene.mirror[patches[0]] > 0.0
    assert scene.ior[patches[1]] > 0.0
    for patch in patches:
        # Rounding of sums over the bands.
        assert np.isclose(shown, solution.irradiance[patch].sum(), rtol=1e-9).any()


def test_false_colours_of_a_closed_room():
    scene = rad.scenes.furnace(reflectance=0.5, emission=1.0)
    solution = rad.solve(scene, 0.1, progress=False)
    middle = scene.centroids.mean(axis=0)
    figure = rad.plot.irradiance(solution, rad.Camera(middle, scene.centroids[0]), size=20)
    # B = E / (1 - rho) = H = 2, to the tolerance of the solution, of single patches three times as much.
    np.testing.assert_allclose(figure.axes[0].images[0].get_array(), 2.0, rtol=0.3)


def test_the_histogram_counts_every_row(factors):
    axes = rad.plot.row_sums(factors).axes[0]
    assert sum(patch.get_height() for patch in axes.patches) == factors.shape[0]


def test_convergence_draws_every_residual(factors):
    scene = factors.scene
    solutions = [
        rad.solve_system(factors, scene.emission, scene.reflectance, method, progress=False)
        for method in ("jacobi", "gauss_seidel", "gmres")
    ]
    axes = rad.plot.convergence(solutions).axes[0]
    for line, solution in zip(axes.lines, solutions, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), [step.residual for step in solution.history])
        assert line.get_label() == solution.report.method
    with pytest.raises(ValueError, match="no solution"):
        rad.plot.convergence([])
    with pytest.raises(ValueError, match="labels"):
        rad.plot.convergence(solutions, ["one"])


def test_what_cannot_be_drawn_is_refused_before_any_work(factors):
    scene = factors.scene
    solution = rad.solve_system(factors, scene.emission, scene.reflectance, progress=False)
    five = rad.solve_system(factors, np.ones((scene.n_patches, 5)), 0.5, progress=False)
    for draw in (rad.plot.mesh, rad.plot.irradiance, rad.plot.bounces):
        with pytest.raises(TypeError, match="not a Scene"):
            draw(scene, VIEW)
    for draw in (rad.plot.mesh, rad.plot.bounces):
        with pytest.raises(ValueError, match=r"1 band \(grey\) or 3 \(RGB\), not 5"):
            draw(five, VIEW)
    for draw in (rad.plot.row_sums, rad.plot.links):
        with pytest.raises(TypeError, match="not a Solution"):
            draw(solution)
    with pytest.raises(ValueError, match="most -1 is not"):
        rad.plot.irradiance(solution, VIEW, most=-1)
    # One solution is enough.
    assert len(rad.plot.convergence(solution).axes[0].lines) == len(rad.plot.bounces(solution, VIEW).axes) == 1
