"""Estimators of form factors against each other: analytic, Monte Carlo, hemicube; and rows made to sum to 1."""

import sys

import numpy as np
import pytest

import radiosity as rad

SAMPLED = ("monte_carlo", "hemicube")


def box(low, high, outside):
    """The 12 triangles of a box, fronts outside or inside."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([[[a, b, c], [a, c, d]] for a, b, c, d in quads]).reshape(-1, 3)
    return np.asarray(low) + corners * np.subtract(high, low), faces if outside else faces[:, ::-1]


def room_with_a_box():
    """A unit cube with a box inside that hides a good part of it: closed, 60 patches."""
    (outer, walls), (inner, sides) = box((0, 0, 0), (1, 1, 1), False), box((0.3, 0.25, 0.2), (0.7, 0.65, 0.6), True)
    scene = rad.Scene(np.concatenate([outer, inner]), np.concatenate([walls, 8 + sides]), 0.5, 1.0)
    return scene.subdivide(max_edge=0.8)


SCENES = {
    "furnace": lambda: rad.scenes.furnace(max_edge=0.8),
    "room": room_with_a_box,
    "plates": lambda: rad.scenes.parallel_plates(max_edge=0.6),
}


@pytest.fixture(scope="module", params=SCENES)
def scene_and_oracle(request):
    scene = SCENES[request.param]()
    return scene, rad.form_factors(scene, tolerance=5e-4, seed=99)


# Monte Carlo and hemicube at what they reach in a second or two; analytic with another seed than the oracle's.
@pytest.mark.parametrize(
    ("method", "tolerance"), [("auto", 1e-2), ("analytic", 1e-2), ("monte_carlo", 2e-2), ("hemicube", 6e-2)]
)
def test_all_methods_agree_within_their_stated_errors(scene_and_oracle, method, tolerance):
    scene, oracle = scene_and_oracle
    F = rad.form_factors(scene, tolerance=tolerance, method=method)
    assert F.error_estimate <= tolerance
    off = np.abs(F.toarray() - oracle.toarray()).sum(axis=1)
    # The estimates are expectations of sums over a row of some tens of terms of which each varies by 75 % of its mean:
    # the worst of 60 rows is within 1.5 times that, four deviations for 30 terms.
    assert off.max() <= 1.5 * F.error_estimate + oracle.error_estimate
    assert F.method == ("analytic" if method == "auto" else method)


@pytest.mark.parametrize("method", SAMPLED)
def test_sampled_rows_are_operators_like_any_other(method):
    scene = rad.scenes.cornell_box(max_edge=None)
    F = rad.form_factors(scene, tolerance=0.1, method=method)
    n = F.shape[0]
    matrix = F.toarray()
    x = np.random.default_rng(0).random((n, 3))
    # Sums of n positive terms in another order: n ulp.
    close = {"rtol": n * np.finfo(float).eps, "atol": 0}
    assert np.allclose(F @ x, matrix @ x, **close)
    assert np.allclose(F.row_sums, matrix.sum(axis=1), **close)
    assert np.array_equal(F.row(5), matrix[5])
    assert np.array_equal(F.tocsr().toarray(), matrix)
    assert np.array_equal(F.areas, scene.areas)
    operator = F.aslinearoperator()
    assert np.allclose(operator @ x, matrix @ x, **close)
    # The true transpose: reciprocity holds within the errors only.
    assert np.allclose(operator.rmatvec(x[:, 0]), matrix.T @ x[:, 0], **close)
    exchange = F.areas[:, None] * matrix
    assert F.reciprocity_error() == pytest.approx(np.abs(exchange - exchange.T).max() / exchange.max(), rel=1e-12)
    assert 1e-6 < F.reciprocity_error() < 1
    # The fewest rays: 1,024 of Monte Carlo, and three hemicubes of 4 x 16^2, 4 x 32^2 and 32^2 x 3 cells.
    assert F.segments >= n * (1024 if method == "monte_carlo" else 3 * (4 * 16**2 + 5 * 32**2))
    assert repr(F).startswith(f"FormFactors({n} patches")


@pytest.mark.parametrize("method", SAMPLED)
def test_the_same_bits_for_any_number_of_threads(method):
    scene = room_with_a_box()
    one, two = (
        rad.form_factors(scene, tolerance=0.1, method=method, seed=3, threads=threads, progress=False)
        for threads in (1, 2)
    )
    assert np.array_equal(one.toarray(), two.toarray())
    assert one.error_estimate == two.error_estimate
    assert one.segments == two.segments
    other = rad.form_factors(scene, tolerance=0.1, method=method, seed=4)
    assert not np.array_equal(one.toarray(), other.toarray())


def test_the_standard_errors_of_monte_carlo_are_calibrated():
    scene = rad.scenes.furnace(max_edge=0.8)
    exact = rad.form_factors(scene, tolerance=1e-6).toarray()
    z = []
    for seed in range(4):
        F = rad.form_factors(scene, tolerance=0.1, method="monte_carlo", seed=seed)
        m = F.segments / F.shape[0]
        estimate = F.toarray()
        error = np.sqrt(exact * (1 - exact) / m)
        # Entries that 30 rays and more are expected to meet: closer to normal than the bound below needs. Rays differ
        # a little from row to row, all rows of a cube being nearly alike.
        often = exact * m > 30
        z.append(((estimate - exact)[often] / error[often]).ravel())
    scores = np.concatenate(z)
    # N independent z-scores have an RMS of 1 +- 1 / sqrt(2 N): here N is some thousands, 1.5 %. Each row has one sum,
    # which takes one degree of freedom of about 40 (1 %), and rays differ by a tenth from row to row (5 %).
    assert scores.size > 2000
    assert np.sqrt(np.mean(scores**2)) == pytest.approx(1, abs=0.08)
    # And no bias: a mean of 0 within four of its deviations.
    assert abs(scores.mean()) <= 4 / np.sqrt(scores.size)


@pytest.mark.parametrize("method", SAMPLED)
def test_sampled_rows_are_solved_with_and_the_error_is_told(method):
    scene = room_with_a_box()
    F = rad.form_factors(scene, tolerance=0.1, method=method)
    oracle = rad.form_factors(scene, tolerance=1e-3)
    emission, reflectance = np.random.default_rng(5).random((scene.n_patches, 1)), 0.6
    solution = rad.solve_system(F, emission, reflectance, method="gmres", tolerance=1e-9)
    truth = rad.solve_system(oracle, emission, reflectance, method="gmres", tolerance=1e-9)
    areas, off = scene.areas[:, None], solution.radiosity - truth.radiosity
    size = np.sqrt((areas * (truth.radiosity - emission) ** 2).sum())
    error = np.sqrt((areas * off**2).sum()) / size
    # Four draws know the estimate to 35 %; a factor of 3 is beyond three deviations of it. The hemicube's errors are
    # those of comparisons with something coarser: larger than the truth.
    assert error <= 3 * solution.error_estimate
    assert solution.error_estimate <= 0.1
    assert solution.standard_error is not None
    assert np.isfinite(solution.standard_error).all()


@pytest.mark.parametrize(("method", "advice"), [("monte_carlo", "1,048,576 rays"), ("hemicube", "4,194,304 cells")])
def test_a_tolerance_that_is_not_met_is_told_with_the_methods_own_advice(method, advice):
    # The two triangles of a square face nobody but one triangle: few rays do.
    scene = rad.Scene([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1]], [[0, 1, 2], [3, 4, 5]])
    with pytest.warns(UserWarning, match=f"above the tolerance 1e-06: .*{advice}"):
        F = rad.form_factors(scene, tolerance=1e-6, method=method)
    exact = rad.form_factors(scene, tolerance=1e-8).toarray()
    # Expectations of one term each: the error is within four deviations, 4 / 0.8 of the mean.
    assert 1e-6 < np.abs(F.toarray() - exact).sum(axis=1).max() <= 5 * F.error_estimate < 0.01


def test_bad_arguments_are_named(monkeypatch):
    scene = rad.scenes.furnace()
    with pytest.raises(ValueError, match="'monte_carlo', 'hemicube'"):
        rad.form_factors(scene, method="guess")
    for method in SAMPLED:
        for tolerance in (0.0, 1.0, np.nan):
            with pytest.raises(ValueError, match="tolerance"):
                rad.form_factors(scene, tolerance=tolerance, method=method)
    monkeypatch.setattr(sys.modules["radiosity.form_factors"], "available_bytes", lambda: 1000)
    for method in SAMPLED:
        with pytest.raises(MemoryError, match=r"sampled form factors of \d+ patches needs .* can be used; use fewer"):
            rad.form_factors(scene, method=method)


@pytest.mark.parametrize("method", SAMPLED)
def test_an_exception_in_the_progress_stops_the_work(method):
    def stop(done, total):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        rad.form_factors(rad.scenes.furnace(max_edge=0.4), tolerance=1e-3, method=method, progress=stop)


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2])
def test_balanced_rows_sum_to_one_with_reciprocity_kept(tolerance):
    F = rad.form_factors(room_with_a_box(), tolerance=tolerance)
    assert F.balanced_by is None
    lacking = np.abs(F.remainder).max()
    balanced = F.balance()
    matrix, before = balanced.toarray(), F.toarray()
    # Sums of 60 entries of which each is rounded a few times.
    assert np.abs(balanced.row_sums - 1).max() <= 1e-12
    assert np.abs(matrix.sum(axis=1) - 1).max() <= 1e-12
    # One number divided by two areas: one rounding each.
    assert balanced.reciprocity_error() <= 4 * np.finfo(float).eps
    assert (matrix >= 0).all()
    assert (matrix[before == 0] == 0).all()
    assert balanced.balanced_by == pytest.approx(np.abs(matrix - before).sum(axis=1).max(), rel=1e-9)
    # No row can be mended by less than it lacks, and the least change is of that order.
    assert lacking <= balanced.balanced_by * (1 + 1e-9)
    assert balanced.balanced_by <= 10 * lacking
    # What it was and what was moved bound what it is.
    assert balanced.error_estimate == F.error_estimate + balanced.balanced_by
    assert np.abs(F.remainder).max() == lacking, "the operator itself is left as it was"


def test_balancing_brings_nothing_further_from_the_truth_than_it_says():
    scene = room_with_a_box()
    oracle = rad.form_factors(scene, tolerance=5e-4, seed=99).toarray()
    F = rad.form_factors(scene, tolerance=5e-2)
    balanced = F.balance()
    before, after = (np.abs(G.toarray() - oracle).sum(axis=1).max() for G in (F, balanced))
    assert after <= before + balanced.balanced_by
    # A furnace: E / (1 - rho) everywhere, exactly, as soon as all rows sum to 1. 1e-12 over 1 - rho, and the residual.
    solution = rad.solve_system(balanced, 1.0, 0.5, method="direct")
    assert np.allclose(solution.radiosity, 2.0, rtol=1e-11, atol=0)


def test_balancing_refuses_open_scenes_and_rows_without_reciprocity():
    with pytest.raises(ValueError, match=r"patch \d+: row sum 0\.\d+ .* not closed"):
        rad.form_factors(rad.scenes.parallel_plates(max_edge=0.6), tolerance=1e-2).balance()
    with pytest.raises(ValueError, match=r"patch \d+: row sum .* not closed"):
        rad.form_factors(rad.scenes.cornell_box(max_edge=None), tolerance=1e-2).balance()
    for method in SAMPLED:
        with pytest.raises(ValueError, match=r"reciprocity.*analytic"):
            rad.form_factors(rad.scenes.furnace(), tolerance=0.2, method=method).balance()
