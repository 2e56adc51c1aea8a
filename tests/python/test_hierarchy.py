"""Hierarchical radiosity: the tolerance that is met, the mesh, where refinement ends, and the pictures."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

import radiosity as rad
import references

VIEW = rad.Camera(**rad.scenes.cornell_box_view())


def true_error(reference, solution):
    """The error with the noise of the reference taken off in quadrature, and that noise."""
    return references.error_of_the_worst_band(reference, solution)


@pytest.mark.parametrize("name", references.NAMES)
def test_the_tolerance_is_met_and_the_error_falls_with_it(name):
    reference = references.load(name)
    reached = []
    for tolerance in (0.1, 0.03, 0.01):
        solution = rad.solve(reference.scene, tolerance, "hierarchical", progress=False)
        error, noise = true_error(reference, solution)
        assert solution.error_estimate <= tolerance
        # What the noise hides is known to a tenth of it.
        assert error <= tolerance + 0.1 * noise, f"{error} at {tolerance}"
        reached.append(np.hypot(error, noise))
    # Monotone, as far as the reference's noise tells.
    for coarse, fine in pairwise(reached):
        assert fine <= coarse + 0.1 * noise


@pytest.mark.parametrize("rho", [0.9, 0.97])
def test_white_rooms_keep_the_tolerance(rho):
    # Rays take half a minute to follow the light of the whitest open box.
    open_rooms = [rad.scenes.cornell_box(max_edge=0.15)] if rho < 0.95 else []
    for scene in [rad.scenes.two_rooms(max_edge=1.0), *open_rooms]:
        white = scene.with_materials(rho, scene.emission)
        by_rays = rad.solve(white, 0.01, progress=False)
        solution = rad.solve(white, 0.03, "hierarchical", progress=False)
        difference = white.areas @ (rho * (solution.irradiance - by_rays.irradiance)) ** 2
        norm = white.areas @ (rho * by_rays.irradiance) ** 2
        # Two solutions, each within its own tolerance.
        assert np.sqrt((difference / norm).max()) <= 0.03 + 0.01


def test_form_factors_on_which_all_solvers_run():
    scene = rad.scenes.cornell_box(max_edge=0.12)
    F = rad.form_factors(scene, 0.1, "hierarchical", progress=False)
    assert F.method == "hierarchical"
    assert F.error_estimate <= 0.1
    assert F.links.counts.sum() == 2 * len(F.links.levels)
    assert sorted(F.links.order) == list(range(scene.n_patches))
    # One number a pair of nodes, read from both sides.
    assert F.reciprocity_error() <= 1e-14
    x = np.linspace(1.0, 2.0, scene.n_patches)
    np.testing.assert_allclose(F.toarray() @ x, F @ x, rtol=1e-12)
    np.testing.assert_allclose(F.row(7), F.toarray()[7], rtol=1e-12)
    solutions = [
        rad.solve_system(F, scene.emission, scene.reflectance, method, 1e-8, progress=False).radiosity
        for method in ("direct", "jacobi", "gauss_seidel", "southwell", "gmres")
    ]
    for other in solutions[1:]:
        # The residual of 1e-8 grows at most by 1 / (1 - 0.8).
        np.testing.assert_allclose(other, solutions[0], rtol=1e-6, atol=1e-7 * solutions[0].max())


def test_links_tell_their_error_to_a_solver():
    scene = rad.scenes.cornell_box(max_edge=0.12)
    exact = rad.form_factors(scene, 1e-3, progress=False)
    loose = rad.form_factors(scene, 0.3, "hierarchical", progress=False)
    truth, solution = (
        rad.solve_system(F, scene.emission, scene.reflectance, "gmres", progress=False) for F in (exact, loose)
    )
    reflected = truth.radiosity - scene.emission
    error = np.sqrt((scene.areas @ (solution.radiosity - truth.radiosity) ** 2 / (scene.areas @ reflected**2)).max())
    # An estimate from random signs of single links: of the right size.
    assert error / 4 <= solution.error_estimate <= 4 * error


def test_methods_without_links_have_none():
    F = rad.form_factors(rad.scenes.furnace(), 0.1, progress=False)
    assert F.links is None
    with pytest.raises(ValueError, match="has no links"):
        rad.plot.links(F)
    with pytest.raises(ValueError, match="hierarchical"):
        rad.form_factors(rad.scenes.furnace(), 0.1, "hierarchical", progress=False).balance()


def test_elements_follow_the_shadows():
    box = rad.scenes.cornell_box()
    solution = rad.solve(box, 0.03, "hierarchical", progress=False)
    elements = solution.elements
    fine = elements.scene
    assert fine.n_patches > 20 * box.n_patches
    assert elements.elements is None
    # The faces of a patch are all of it, and have its light.
    np.testing.assert_allclose(np.bincount(fine.parent, fine.areas), box.areas, rtol=1e-9)
    for b in range(3):
        power = np.bincount(fine.parent, fine.areas * elements.irradiance[:, b])
        np.testing.assert_allclose(power, box.areas * solution.irradiance[:, b], rtol=1e-9, atol=1e-12)
    # No T-junctions: what was closed or open stays so, edge by edge.
    assert fine.report().inconsistent_edges == 0
    # Every edge that one face alone has lies in the open front, z = 0, or at the foot of a block, y = 0.
    edges = np.sort(fine.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    alone, counts = np.unique(edges, axis=0, return_counts=True)
    ends = fine.vertices[alone[counts == 1]]
    assert len(ends) > 12
    assert np.isclose(ends[..., 1:], 0.0, atol=1e-12).all(axis=1).any(axis=1).all()
    image = rad.render(elements, VIEW, 64, 64, progress=False)
    assert np.isfinite(image).all()


def test_the_audit_closes():
    solution = rad.solve(rad.scenes.two_rooms(max_edge=1.0), 0.03, "hierarchical", progress=False)
    assert solution.report.audit.imbalance <= 1e-12
    # A closed scene loses nothing but what the iteration leaves.
    assert (solution.report.audit.left == 0.0).all()
    assert "links" in str(solution.report)


def test_equal_bands_are_solved_once_and_all_returned():
    scene = rad.scenes.cornell_box()
    grey = scene.with_materials(0.5, np.repeat(scene.emission[:, :1], 3, axis=1))
    solution = rad.solve(grey, 0.1, "hierarchical", progress=False)
    assert solution.radiosity.shape == (scene.n_patches, 3)
    assert solution.elements.radiosity.shape == (solution.elements.scene.n_patches, 3)
    np.testing.assert_array_equal(solution.elements.radiosity[:, 0], solution.elements.radiosity[:, 2])


def test_the_same_bits_for_any_number_of_threads():
    scene = rad.scenes.cornell_box()
    one, many = (rad.solve(scene, 0.05, "hierarchical", threads=k, progress=False) for k in (1, 3))
    np.testing.assert_array_equal(one.elements.radiosity, many.elements.radiosity)


# --- Extremes ---------------------------------------------------------------------------------------------------------


def plate(corner, u, v):
    corner, u, v = (np.array(x, float) for x in (corner, u, v))
    return [corner, corner + u, corner + u + v, corner + v]


def scene_of_plates(plates, reflectance, emission):
    vertices = np.concatenate(plates)
    faces = [[4 * k + i for i in face] for k in range(len(plates)) for face in ((0, 1, 2), (0, 2, 3))]
    materials = (np.repeat(np.array(x, float), 2)[:, None] for x in (reflectance, emission))
    return rad.Scene(vertices, faces, *materials)


def test_a_sliver_is_not_refined_for_ever():
    floor = plate((0, 0, 0), (1, 0, 0), (0, 1, 0))
    sliver = plate((0, 0.5, 0.01), (0, 1e-6, 0), (1, 0, 0))
    scene = scene_of_plates([floor, sliver], [0.5, 0.5], [0.0, 1e6])
    solution = rad.solve(scene, 0.03, "hierarchical", progress=False)
    assert np.isfinite(solution.radiosity).all()
    # All that leaves the sliver falls on the floor but for what passes its ends and sides.
    assert 0.5 < solution.irradiance[:2].mean() < 1.0


def test_a_narrow_fold_is_no_light_that_grows():
    # Infinite plates with a common edge exchange 1 - sin(angle / 2) (Hottel's crossed strings); of square ones a little
    # leaves at the ends, half a degree high.
    angle = np.radians(1.0)
    vertices = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [np.cos(angle), 0, np.sin(angle)]]
    vertices.append([np.cos(angle), 1, np.sin(angle)])
    faces = [[0, 1, 2], [0, 2, 3], [0, 5, 4], [0, 3, 5]]
    scene = rad.Scene(vertices, faces, [[0.0], [0.0], [0.5], [0.5]], [[1.0], [1.0], [0.0], [0.0]])
    solution = rad.solve(scene, 0.2, "hierarchical", progress=False)
    straight = 1.0 - np.sin(0.5 * angle)
    assert solution.irradiance[2:].mean() == pytest.approx(straight, rel=0.2)
    assert solution.error_estimate <= 0.2


def test_a_small_lamp_in_a_large_hall():
    size, lamp = 100.0, 0.01
    walls = [
        plate((0, 0, 0), (size, 0, 0), (0, size, 0)),
        plate((0, 0, size), (0, size, 0), (size, 0, 0)),
        plate((0, 0, 0), (0, size, 0), (0, 0, size)),
        plate((size, 0, 0), (0, 0, size), (0, size, 0)),
        plate((0, 0, 0), (0, 0, size), (size, 0, 0)),
        plate((0, size, 0), (size, 0, 0), (0, 0, size)),
    ]
    walls.append(plate((50, 50, 99.0), (0, lamp, 0), (lamp, 0, 0)))
    scene = scene_of_plates(walls, [0.5] * 6 + [0.0], [0.0] * 6 + [1e8])
    solution = rad.solve(scene, 0.03, "hierarchical", progress=False)
    power = 1e8 * lamp**2
    # The lamp faces down, 99 m above the floor. By reciprocity the floor receives the fraction F of its power, known in
    # closed form (Howell B-4: four rectangles that meet under the point).
    a = 50.0 / 99.0
    part = a / np.sqrt(1 + a * a) * np.arctan(a / np.sqrt(1 + a * a)) * 2 / (2 * np.pi)
    floor = scene.areas[:2] @ solution.irradiance[:2, 0]
    others = 0.5 * power  # what comes by way of the walls is less than is reflected at first
    assert 4 * part * power * 0.97 <= floor <= 4 * part * power + others


def test_intersecting_plates_and_a_lamp_of_a_millionth_of_the_scene():
    floor = plate((0, 0, 0), (1, 0, 0), (0, 1, 0))
    # A sheet that stands in the floor and goes through it, seen from both sides.
    front = plate((0.5, 0.2, -0.3), (0, 0.6, 0), (0, 0, 0.6))
    back = front[::-1]
    lamp = plate((0.2, 0.2, 0.9), (0, 1.7e-3, 0), (1.7e-3, 0, 0))
    scene = scene_of_plates([floor, front, back, lamp], [0.5, 0.5, 0.5, 0.0], [0.0, 0.0, 0.0, 1e6])
    assert scene.areas[-2:].sum() < 2e-6 * scene.areas.sum()
    by_rays = rad.solve(scene, 0.01, progress=False)
    solution = rad.solve(scene, 0.03, "hierarchical", progress=False)
    rho = scene.reflectance
    difference = scene.areas @ (rho * (solution.irradiance - by_rays.irradiance)) ** 2
    error = np.sqrt((difference / (scene.areas @ (rho * by_rays.irradiance) ** 2))[0])
    # Two solutions, each within its own tolerance.
    assert error <= 0.03 + 0.01


def test_ten_thousand_disconnected_triangles():
    n, lamps = 10_000, 100
    random = np.random.default_rng(1)
    centres = random.uniform(0, 1, (n, 1, 3))
    corners = centres + random.uniform(-0.01, 0.01, (n, 3, 3))
    scene = rad.Scene(
        corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3), 0.0, np.where(np.arange(n) < lamps, 10.0, 0.0)[:, None]
    )
    solution = rad.solve(scene, 0.1, "hierarchical", progress=False)
    # The light of all lamps at some patches, by exact unoccluded form factors and 32 random segments a pair.
    some, segments = random.choice(np.arange(lamps, n), 200, replace=False), 32
    pairs = np.array([(i, j) for i in some for j in range(lamps)])
    F = rad.pair_form_factors(corners[pairs[:, 0]], corners[pairs[:, 1]], 1e-3, progress=False)

    def points(patches):
        u, v = random.uniform(size=(2, len(patches), segments, 1))
        u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
        a, b, c = (corners[patches][:, k, None] for k in range(3))
        return (a + u * (b - a) + v * (c - a)).reshape(-1, 3)

    hidden = scene.occluded(points(pairs[:, 0]), points(pairs[:, 1])).reshape(-1, segments)
    seen = 10.0 * (F * (1.0 - hidden.mean(axis=1))).reshape(len(some), lamps).sum(axis=1)
    error = np.sqrt(scene.areas[some] @ (solution.irradiance[some, 0] - seen) ** 2 / (scene.areas[some] @ seen**2))
    # 200 of 10,000 patches tell the error to about a factor of two: a few next to a lamp have most of it.
    assert error <= 2 * 0.1


# --- Pictures ---------------------------------------------------------------------------------------------------------


def test_pictures_of_links_and_mesh(tmp_path):
    pytest.importorskip("matplotlib")
    scene = rad.scenes.cornell_box(max_edge=0.2)
    F = rad.form_factors(scene, 0.3, "hierarchical", progress=False)
    solution = rad.solve(scene, 0.1, "hierarchical", progress=False)
    figures = {
        "links": rad.plot.links(F),
        "from": rad.plot.links_from(F, 3),
        "mesh": rad.plot.mesh(solution, VIEW, size=100),
        "patches": rad.plot.mesh(dataclasses.replace(solution, elements=None), VIEW, size=100),
    }
    for name, figure in figures.items():
        figure.savefig(tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").stat().st_size > 5000, name
    with pytest.raises(ValueError, match="patch"):
        rad.plot.links_from(F, scene.n_patches)
