"""Form factors: closed forms, exact values to 300 bits, and the laws that every operator obeys."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import radiosity as rad
import references
from radiosity.scenes.builder import Builder

DATA = Path(__file__).resolve().parents[1] / "data"
CASES = json.loads((DATA / "view_factors.json").read_text(encoding="utf-8"))
SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


@pytest.fixture(scope="module")
def pairs():
    with np.load(DATA / "form_factor_pairs.npz") as data:
        return {name: data[name] for name in data}


@pytest.mark.parametrize("case", CASES["cases"], ids=lambda case: case["name"])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-8])
def test_exact_form_factors_are_met(case, tolerance):
    value = rad.form_factor(case["polygon_a"], case["polygon_b"], tolerance=tolerance)
    # The tolerance asked, plus what is known of the reference itself. Zeros must be exact.
    assert abs(value - case["F_ab"]) <= tolerance * case["F_ab"] + case["abs_tolerance_of_value"]


# What is promised: 99.9 % of the pairs are inside the tolerance, the worst within ten times of it. At 1e-10, the best
# that can be had, slivers of aspect 1e4 and more and triangles of 1e-6 close to one of 1 lose digits to rounding: 99 %.
@pytest.mark.parametrize(
    ("tolerance", "inside", "worst"),
    [(1e-2, 0.999, 10), (1e-3, 0.999, 10), (1e-4, 0.999, 10), (1e-6, 0.999, 10), (1e-8, 0.999, 10), (1e-10, 0.99, 1e3)],
)
def test_pairs_known_to_300_bits_are_met(pairs, tolerance, inside, worst):
    value = rad.pair_form_factors(pairs["a"], pairs["b"], tolerance=tolerance)
    assert np.isfinite(value).all()
    assert (value >= 0).all()
    assert (value[pairs["case"] == "backface"] == 0).all()
    error = np.abs(value - pairs["f_ab"])
    # "Coplanar" triangles of rotated coordinates have exact factors of 1e-34: 0 is right in double precision.
    relative = np.where(pairs["f_ab"] > 1e-30, error / np.maximum(pairs["f_ab"], 1e-30), error)
    assert np.mean(relative <= tolerance) >= inside
    assert relative.max() <= worst * tolerance


@pytest.mark.parametrize(("tolerance", "closed"), [(1e-2, 1e-3), (1e-4, 1e-6), (1e-8, 1e-10)])
def test_rows_of_a_cube_are_better_than_the_tolerance_of_its_pairs(tolerance, closed):
    room = rad.scenes.furnace(max_edge=0.2)
    corners = room.vertices[room.faces]
    i, j = np.triu_indices(room.n_patches, 1)
    exchange = np.zeros((room.n_patches, room.n_patches))
    exchange[i, j] = room.areas[i] * rad.pair_form_factors(corners[i], corners[j], tolerance=tolerance)
    sums = (exchange + exchange.T).sum(axis=1) / room.areas
    # Errors of either sign, most of them far below the tolerance: a tenth or less is left in a row.
    assert np.abs(sums - 1).max() <= closed


def test_reciprocity_of_pairs_is_exact_up_to_one_division(pairs):
    forward = rad.pair_form_factors(pairs["a"], pairs["b"], tolerance=1e-4) * pairs["area_a"]
    backward = rad.pair_form_factors(pairs["b"], pairs["a"], tolerance=1e-4) * pairs["area_b"]
    # One exchange divided by an area computed here and multiplied by the same area computed elsewhere: the areas of
    # slivers far from the origin differ by the rounding of their coordinates.
    well_shaped = ~np.isin(pairs["case"], ["offset1e6", "sliver_1e4", "sliver_1e6"])
    assert np.allclose(forward[well_shaped], backward[well_shaped], rtol=1e-12, atol=0)


@pytest.mark.parametrize("exponent", [-60, -10, 20, 60])
def test_form_factors_do_not_depend_on_the_unit_of_length(pairs, exponent):
    # A power of two scales without rounding, so not a bit may change.
    scaled = rad.pair_form_factors(2.0**exponent * pairs["a"], 2.0**exponent * pairs["b"], tolerance=1e-4)
    assert np.array_equal(scaled, rad.pair_form_factors(pairs["a"], pairs["b"], tolerance=1e-4))


@pytest.fixture(scope="module")
def obstructed():
    """The obstructed case's squares and obstacle, each cut into two triangles, the obstacle with both its sides."""
    corners = np.array([*SQUARE, [0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]], float)
    obstacle = np.array([[0.1, 0.1, 0.5], [0.6, 0.1, 0.5], [0.6, 0.6, 0.5], [0.1, 0.6, 0.5]])
    quads = np.arange(12).reshape(3, 4)
    faces = np.concatenate([[[a, b, c], [a, c, d]] for a, b, c, d in quads])
    return rad.Scene(np.concatenate([corners, obstacle]), np.concatenate([faces, faces[4:, ::-1]]))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4, 1e-5])
def test_partial_occlusion_meets_the_row_tolerance(obstructed, tolerance):
    F = rad.form_factors(obstructed, tolerance=tolerance)
    # All four patches are halves: the mean of the two rows is the factor from square to square.
    value = F.toarray()[:2, 2:4].sum(axis=1).mean()
    assert abs(value - CASES["obstructed"][0]["F_ab"]) <= tolerance
    assert F.error_estimate <= tolerance


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
def test_rows_of_a_closed_convex_scene_sum_to_one_without_casting_a_ray(tolerance):
    F = rad.form_factors(rad.scenes.furnace(max_edge=0.4), tolerance=tolerance)
    assert F.segments == 0
    assert np.abs(F.remainder).max() <= tolerance


def test_rows_of_a_closed_room_with_obstacles_sum_to_one_within_the_tolerance():
    # Two rooms and a door: closed, not convex.
    F = rad.form_factors(rad.scenes.two_rooms(max_edge=1.5), tolerance=1e-3)
    assert np.abs(F.remainder).max() <= 1e-3


def test_the_operator_is_consistent_with_its_matrix():
    F = rad.form_factors(rad.scenes.cornell_box(max_edge=0.3), tolerance=1e-2)
    n = F.shape[0]
    matrix = F.toarray()
    x = np.random.default_rng(0).random((n, 3))
    # Sums of n positive terms in another order: n ulp.
    close = {"rtol": n * np.finfo(float).eps, "atol": 0}
    assert np.allclose(F @ x, matrix @ x, **close)
    assert np.allclose(F @ x[:, 0], matrix @ x[:, 0], **close)
    assert np.allclose(F.row_sums, matrix.sum(axis=1), **close)
    assert np.array_equal(F.row(5), matrix[5])
    assert np.array_equal(F.tocsr().toarray(), matrix)
    operator = F.aslinearoperator()
    assert np.allclose(operator @ x, matrix @ x, **close)
    assert np.allclose(operator.rmatvec(x[:, 0]), matrix.T @ x[:, 0], rtol=1e-12, atol=0)
    exchange = F.areas[:, None] * matrix
    # Each G is stored once; dividing by an area and multiplying again rounds twice.
    assert np.allclose(exchange, exchange.T, rtol=4 * np.finfo(float).eps, atol=0)
    assert F.reciprocity_error() <= 4 * np.finfo(float).eps
    assert F.nbytes >= 8 * n * (n - 1) // 2
    assert (matrix >= 0).all()
    assert (np.diag(matrix) == 0).all()


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_the_same_bits_for_any_number_of_threads(threads):
    scene = rad.scenes.cornell_box(max_edge=0.3)
    expected = rad.form_factors(scene, tolerance=5e-2, seed=3)
    F = rad.form_factors(scene, tolerance=5e-2, seed=3, threads=threads)
    assert np.array_equal(F.toarray(), expected.toarray())
    assert F.error_estimate == expected.error_estimate


def stack():
    """A furnace with ten plates inside: more bodies in most shafts than shadows are drawn of, so segments are cast."""
    room = rad.scenes.furnace(max_edge=0.5)
    square = np.array([[0.3, 0.25, 0.0], [0.7, 0.25, 0.0], [0.7, 0.65, 0.0], [0.3, 0.65, 0.0]])
    vertices, faces = [room.vertices], [room.faces]
    for storey in range(10):
        first = len(room.vertices) + 4 * storey
        vertices.append(square + np.array([0, 0, 0.3 + 0.03 * storey]))
        faces.append(first + np.array([[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 3, 2]]))
    return rad.Scene(np.concatenate(vertices), np.concatenate(faces))


def test_another_seed_gives_another_estimate_within_the_error():
    scene = stack()
    first, second = (rad.form_factors(scene, tolerance=2e-2, seed=seed) for seed in (1, 2))
    difference = np.abs(first.toarray() - second.toarray()).sum(axis=1)
    assert difference.max() > 0
    # Each row is within the tolerance of the truth, so two are within twice that of each other.
    assert difference.max() <= 2 * 2e-2


def test_occluded_factors_never_exceed_unoccluded_ones():
    scene = references.load("cornell_298").scene
    F = rad.form_factors(scene, tolerance=3e-2).toarray()
    corners = scene.vertices[scene.faces]
    i, j = np.nonzero(F)
    free = rad.pair_form_factors(corners[i], corners[j], tolerance=1e-8)
    # The unoccluded kernel was asked for two hundredths of the row tolerance.
    assert (F[i, j] <= free * (1 + 0.02 * 3e-2)).all()


def test_both_sides_make_two_patches_that_do_not_see_each_other():
    plates = rad.scenes.parallel_plates(max_edge=None)
    both = rad.Scene(plates.vertices, plates.faces, 0.5, 1.0, sides="both")
    n = plates.n_patches
    assert both.n_patches == 2 * n
    F = rad.form_factors(both, tolerance=1e-6).toarray()
    # The plates are convex and face each other: fronts see fronts, backs see nothing.
    assert np.array_equal(F[:n, :n], rad.form_factors(plates, tolerance=1e-6).toarray())
    assert F[n:].sum() == 0
    assert F[:, n:].sum() == 0


@pytest.mark.parametrize(
    ("polygon", "message"),
    [
        ([[0, 0, 0], [1, 0, 0]], "polygon_b has 2 vertices"),
        ([[0, 0, 1], [1, 0, 1], [1, 1, 2], [0, 1, 1]], "polygon_b is not planar"),
        ([[0, 0, 1], [1, 0, 1], [0.1, 0.1, 1], [0, 1, 1]], "polygon_b is not convex"),
        ([[0, 0, 1], [1, 0, 1], [2, 0, 1]], "polygon_b has zero area"),
        ([[0, 0, 1], [1, 0, np.nan], [1, 1, 1]], "polygon_b vertex 1 is"),
    ],
)
def test_bad_polygons_are_named(polygon, message):
    with pytest.raises(ValueError, match=message):
        rad.form_factor(SQUARE, polygon)


def test_bad_arguments_are_named():
    scene = rad.scenes.furnace()
    triangles = np.zeros((2, 3, 3))
    with pytest.raises(ValueError, match="pair 0: triangle a has zero area"):
        rad.pair_form_factors(triangles, triangles)
    with pytest.raises(ValueError, match="a has 2 triangles and b 1"):
        rad.pair_form_factors(triangles, triangles[:1])
    with pytest.raises(ValueError, match="polygon_a must have shape"):
        rad.form_factor([1, 2, 3], SQUARE)
    with pytest.raises(TypeError, match="polygon_a must hold real numbers"):
        rad.form_factor("square", SQUARE)
    for tolerance in (0.0, -1.0, 1.0, 1e-11, np.nan):
        with pytest.raises(ValueError, match="tolerance"):
            rad.form_factor(SQUARE, SQUARE, tolerance=tolerance)
        with pytest.raises(ValueError, match="tolerance"):
            rad.form_factors(scene, tolerance=tolerance)
    with pytest.raises(ValueError, match="'analytic'"):
        rad.form_factors(scene, method="guess")
    with pytest.raises(TypeError, match=r"radiosity\.Scene"):
        rad.form_factors(triangles)
    F = rad.form_factors(scene)
    with pytest.raises(ValueError, match="x must have shape"):
        F @ np.ones(3)
    with pytest.raises(IndexError, match="row 99"):
        F.row(99)


def test_a_tolerance_that_is_not_met_is_told(obstructed):
    with pytest.warns(UserWarning, match="above the tolerance 1e-08"):
        F = rad.form_factors(obstructed, tolerance=1e-8)
    assert F.error_estimate > 1e-8


def test_too_large_an_operator_is_refused_before_any_work(monkeypatch):
    monkeypatch.setattr(sys.modules["radiosity.form_factors"], "available_bytes", lambda: 1000)
    with pytest.raises(MemoryError, match=r"dense exchange of \d+ patches needs .* can be used; use fewer patches"):
        rad.form_factors(rad.scenes.furnace(max_edge=0.2))


@pytest.fixture(scope="module")
def streets() -> rad.Scene:
    """Four by four houses on a ground: most pairs of walls are hidden from each other."""
    builder = Builder()
    lines = np.arange(0.0, 27.0, 2.0)
    builder.wall("ground", 2, +1, 0.0, (lines, lines, [0.0]), (0.5,), (0.0,))
    for k in range(16):
        x, y = 2.0 + 6.0 * (k % 4), 2.0 + 6.0 * (k // 4)
        builder.box(f"house {k}", (x, y, 0.0), (x + 4.0, y + 4.0, 3.0 + k % 3), (0.5,), (1.0,))
    return builder.scene(max_edge=3.0)


def test_what_is_hidden_is_neither_stored_nor_lost(streets):
    F = rad.form_factors(streets, tolerance=1e-2)
    full = F.toarray()
    # Less than half of what all pairs take: few see each other.
    assert F.nbytes < 0.5 * streets.report().dense_bytes
    # A product adds up the same terms in another order than numpy: some 1,000 of them round off by a few ulp.
    x = np.random.default_rng(1).random((streets.n_patches, 3))
    np.testing.assert_allclose(F @ x, full @ x, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(F.row_sums, full.sum(axis=1), rtol=1e-12, atol=1e-15)
    # Gauss-Seidel gathers by rows, Southwell shoots by columns: both solve the matrix to 1e-10 of the emission.
    exact = rad.solve_system(full, streets.emission, streets.reflectance, "direct").radiosity
    for method in ("gauss_seidel", "southwell"):
        found = rad.solve_system(F, streets.emission, streets.reflectance, method, 1e-10, progress=False).radiosity
        np.testing.assert_allclose(found, exact, rtol=1e-8)


def test_pairs_without_exchange_do_not_see_each_other(streets):
    F = rad.form_factors(streets, tolerance=1e-2).toarray()
    rng = np.random.default_rng(2)
    # Random points of random pairs that face each other: no segment may be free where F is 0.
    i, j = rng.integers(0, streets.n_patches, (2, 200_000))
    corners = streets.vertices[streets.faces]
    p, q = (np.einsum("mk,mkc->mc", rng.dirichlet([1.0] * 3, len(k)), corners[k]) for k in (i, j))
    facing = [np.einsum("mc,mc->m", streets.normals[k], way) > 0.0 for k, way in ((i, q - p), (j, p - q))]
    none = (F[i, j] == 0.0) & facing[0] & facing[1]
    assert none.sum() > 10_000
    assert streets.occluded(p[none], q[none]).all()


def test_row_errors_of_a_town_are_within_the_tolerance(streets):
    rough, fine = (rad.form_factors(streets, tolerance=t).toarray() for t in (3e-2, 1e-3))
    # The error of the fine one is a thirtieth of the tolerance asked of the other: it does not count.
    assert np.abs(rough - fine).sum(axis=1).max() < 3e-2
