"""Solvers: agreement with LU, furnaces, bounces, energy, and what is said when a system cannot be solved."""

import sys

import numpy as np
import pytest
import scipy.sparse

import radiosity as rad

ITERATIVE = ["jacobi", "gauss_seidel", "southwell", "overshooting", "gmres"]
METHODS = ["direct", *ITERATIVE]


@pytest.fixture(scope="module")
def room():
    """A closed room in three bands, one of them bright, and its form factors."""
    scene = rad.scenes.two_rooms(max_edge=1.5)
    rng = np.random.default_rng(7)
    n = scene.n_patches
    reflectance = np.stack([rng.uniform(0, 0.5, n), rng.uniform(0.3, 0.9, n), np.full(n, 0.9)], axis=1)
    return rad.form_factors(scene, tolerance=1e-2), scene.emission, reflectance


def exact(F, emission, reflectance):
    """The solution by another library: LAPACK's LU through numpy."""
    matrix = F.toarray()
    return np.stack(
        [
            np.linalg.solve(np.eye(len(matrix)) - rho[:, None] * matrix, e)
            for e, rho in zip(emission.T, reflectance.T, strict=True)
        ],
        axis=1,
    )


def relative(difference, reference):
    return np.linalg.norm(difference) / np.linalg.norm(reference)


@pytest.mark.parametrize("method", METHODS)
def test_every_solver_agrees_with_lu(room, method):
    F, emission, reflectance = room
    solution = rad.solve_system(F, emission, reflectance, method=method, tolerance=1e-12)
    # A residual of 1e-12 times 1/(1 - 0.9) for the bounces still to come.
    assert relative(solution.radiosity - exact(F, emission, reflectance), solution.radiosity) <= 1e-10
    assert solution.report.residual <= 1e-12
    assert solution.history[-1].residual == solution.report.residual


@pytest.mark.parametrize("method", METHODS)
def test_plain_arrays_and_sparse_matrices_give_the_same(room, method):
    F, emission, reflectance = room
    matrix = F.toarray()
    expected = exact(F, emission, reflectance)
    for given in (matrix, scipy.sparse.csr_array(matrix), scipy.sparse.coo_matrix(matrix)):
        solution = rad.solve_system(given, emission, reflectance, method=method, tolerance=1e-12)
        assert relative(solution.radiosity - expected, expected) <= 1e-10
        assert solution.report.audit is None
        assert solution.scene is None


def test_step_k_of_jacobi_is_the_light_after_k_bounces(room):
    F, emission, reflectance = room
    bounces = [emission]

    def check(step, radiosity, unshot):
        bounces.append(reflectance * (F @ bounces[-1]))
        # The same products in another order: rounding only.
        assert np.allclose(radiosity, sum(bounces), rtol=1e-12, atol=0)
        assert np.allclose(unshot, reflectance * (F @ bounces[-1]), rtol=1e-9, atol=1e-12)
        assert step == len(bounces) - 1

    solution = rad.solve_system(F, emission, reflectance, method="jacobi", tolerance=1e-3, on_iteration=check)
    assert len(solution.history) == len(bounces) - 1 > 5


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rho", [0.0, 0.5, 0.99])
def test_furnace(method, rho):
    scene = rad.scenes.furnace(reflectance=rho, emission=2.0, max_edge=0.6)
    F = rad.form_factors(scene, tolerance=1e-7)
    solution = rad.solve_system(F, scene.emission, scene.reflectance, method=method, tolerance=1e-10)
    # Rows are within 1e-7 of 1, and an error in them counts once a bounce: 1/(1 - rho) times.
    assert np.allclose(solution.radiosity, 2.0 / (1.0 - rho), rtol=2e-7 / (1.0 - rho), atol=0)


@pytest.mark.parametrize("method", ITERATIVE)
def test_energy_audit_closes_even_for_an_unfinished_solution(room, method):
    F, emission, reflectance = room
    with pytest.raises(rad.ConvergenceError, match=f"{method} stopped after 3 steps") as caught:
        rad.solve_system(F, emission, reflectance, method=method, tolerance=1e-12, max_iterations=3)
    solution = caught.value.solution
    assert len(caught.value.history) == 3
    assert solution.report.audit.unshot.max() > 1e-3
    finished = rad.solve_system(F, emission, reflectance, method=method)
    for audit in (solution.report.audit, finished.report.audit):
        # Sums of some hundred terms of either sign: 1e-13 is a few hundred ulp.
        assert audit.imbalance <= 1e-13


def test_b_is_e_plus_rho_h(room):
    F, emission, reflectance = room
    solution = rad.solve_system(F, emission, reflectance, tolerance=1e-12)
    assert np.allclose(solution.irradiance, F @ solution.radiosity, rtol=1e-12, atol=0)
    assert relative(solution.radiosity - emission - reflectance * solution.irradiance, solution.radiosity) <= 1e-11


@pytest.mark.parametrize("method", ITERATIVE)
def test_error_estimate_bounds_the_distance_to_the_solution(room, method):
    matrix = room[0].toarray()
    _, emission, reflectance = room
    expected = exact(room[0], emission, reflectance)
    solution = rad.solve_system(matrix, emission, reflectance, method=method, tolerance=1e-3)
    distance = np.linalg.norm(solution.radiosity - expected, axis=0) / np.linalg.norm(expected - emission, axis=0)
    # A plain matrix is bounded in the plain norm only where its columns sum to less than 1 too; this one's areas vary
    # by less than a factor of two, so its norms do as well.
    assert distance.max() <= 2 * solution.error_estimate


def test_southwell_shoots_the_brightest_first_and_needs_one_shot_a_patch_without_reflection(room):
    F, emission, _ = room
    lit = int((emission.sum(axis=1) > 0).sum())
    solution = rad.solve_system(F, emission, 0.0, method="southwell")
    assert len(solution.history) == lit
    powers = np.diff([step.unshot.sum() for step in solution.history], prepend=(F.areas @ emission).sum())
    assert (np.diff(np.abs(powers)) <= 1e-12).all()


def test_ambient_term_completes_an_unfinished_picture():
    scene = rad.scenes.furnace(reflectance=0.8, emission=1.0, max_edge=0.6)
    F = rad.form_factors(scene, tolerance=1e-6)
    seen = []
    rad.solve_system(
        F, scene.emission, scene.reflectance, "southwell", 1e-3, on_iteration=lambda _, b, r: seen.append((b, r))
    )
    radiosity, unshot = seen[len(seen) // 4]
    guess = radiosity + 0.8 * rad.ambient(scene.areas, unshot, 0.8)
    # In a furnace every patch ends at 5; the ambient light must come closer than what has been shot, by half at
    # the least: it is exact at the start, and only the unevenness of what is unshot makes it wrong.
    assert np.abs(guess - 5).mean() < 0.5 * np.abs(radiosity - 5).mean()


def test_superposition_and_more_reflectance_never_less_light(room):
    F, emission, reflectance = room
    other = np.roll(emission, 11, axis=0)

    def radiosity(e, rho):
        return rad.solve_system(F, e, rho, tolerance=1e-13).radiosity

    both = radiosity(emission + other, reflectance)
    # The tolerance of the solver times 1/(1 - 0.9), with a margin of ten.
    assert relative(radiosity(emission, reflectance) + radiosity(other, reflectance) - both, both) <= 1e-11
    assert (radiosity(emission, 0.9 * reflectance) <= radiosity(emission, reflectance) * (1 + 1e-11)).all()


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("method", METHODS)
def test_the_same_bits_for_any_number_of_threads(room, method, threads):
    F, emission, reflectance = room
    expected = rad.solve_system(F, emission, reflectance, method=method)
    solution = rad.solve_system(F, emission, reflectance, method=method, threads=threads)
    assert np.array_equal(solution.radiosity, expected.radiosity)


def test_no_emission_is_darkness(room):
    F, _, reflectance = room
    for method in METHODS:
        solution = rad.solve_system(F, 0.0, reflectance, method=method)
        assert (solution.radiosity == 0).all()
        assert solution.error_estimate == 0


def test_solve_decides_and_says_what_it_decided():
    scene = rad.scenes.cornell_box(max_edge=0.3)
    solution = rad.solve(scene, tolerance=0.02)
    report = solution.report
    assert solution.error_estimate <= 0.02
    assert solution.error_estimate == pytest.approx(np.hypot(report.sampling_error, report.discretisation_error))
    assert report.method == "rays"
    assert report.row_error is None
    assert report.rays > 0
    assert report.segments > 0
    assert report.elements >= scene.n_patches == report.patches
    assert solution.standard_error.shape == solution.radiosity.shape
    assert (solution.standard_error > 0).any()
    assert solution.scene is scene
    text = str(report)
    for word in ("method rays", f"{report.rays} cast", "from sampling", "from discretisation"):
        assert word in text
    # Against a much better one: three times the estimate is three standard deviations.
    better = rad.solve(scene, tolerance=0.004, seed=1)
    area = scene.areas[:, None]
    difference = np.sqrt((area * (solution.radiosity - better.radiosity) ** 2).sum(axis=0))
    difference /= np.sqrt((area * (better.radiosity - scene.emission) ** 2).sum(axis=0))
    assert 0 < difference.max() <= 3 * solution.error_estimate


def test_dense_says_how_good_its_form_factors_are():
    with pytest.warns(UserWarning, match="above the tolerance 0.01: .* from discretisation"):
        solution = rad.solve(rad.scenes.cornell_box(max_edge=0.3), tolerance=0.01, method="dense")
    report = solution.report
    assert report.row_error > 0
    assert report.sampling_error <= 0.01 < report.discretisation_error
    for word in ("gmres", "segments", "row error"):
        assert word in str(report)


def test_a_scene_without_emission_is_dark_and_says_so():
    with pytest.warns(UserWarning, match="no emission"):
        solution = rad.solve(rad.scenes.furnace(emission=0.0))
    assert (solution.radiosity == 0).all()


def test_bad_arguments_are_named(room):
    F, emission, reflectance = room
    with pytest.raises(ValueError, match='"direct", "jacobi", "gauss_seidel", "southwell", "overshooting", "gmres"'):
        rad.solve_system(F, emission, reflectance, method="magic")
    with pytest.raises(ValueError, match=r"patch 0: reflectance 1.5 is outside \[0, 1\]"):
        rad.solve_system(F, emission, 1.5)
    with pytest.raises(ValueError, match=r"patch 0: emission -1 is outside \[0, inf\)"):
        rad.solve_system(F, -1.0, reflectance)
    with pytest.raises(ValueError, match="emission must be a scalar"):
        rad.solve_system(F, np.ones((3, 3)), reflectance)
    with pytest.raises(ValueError, match="disagree on the number of bands"):
        rad.solve_system(F, np.ones(2), np.full(3, 0.5))
    for tolerance in (0.0, 1.0, np.nan):
        with pytest.raises(ValueError, match="tolerance"):
            rad.solve_system(F, emission, reflectance, tolerance=tolerance)
    with pytest.raises(ValueError, match="max_iterations"):
        rad.solve_system(F, emission, reflectance, max_iterations=0)
    with pytest.raises(ValueError, match="F must be square"):
        rad.solve_system(np.ones((2, 3)), 1.0, 0.5)
    with pytest.raises(ValueError, match=r"F\[0, 1\] = -0.5 is outside"):
        rad.solve_system(np.array([[0, -0.5], [0.5, 0]]), 1.0, 0.5)
    with pytest.raises(ValueError, match="'dense'"):
        rad.solve(rad.scenes.furnace(), method="magic")
    with pytest.raises(ValueError, match="threads"):
        rad.solve_system(F, emission, reflectance, threads=0)


def test_light_that_never_leaves_has_no_finite_solution():
    with pytest.raises(ValueError, match="reflectance 1 in band 0 and no light leaves"):
        rad.solve_system(np.array([[0.0, 1.0], [1.0, 0.0]]), 1.0, 1.0)


def test_an_exception_in_on_iteration_stops_the_solver_and_is_passed_on(room):
    F, emission, reflectance = room
    steps = []

    def stop(step, radiosity, unshot):
        steps.append(step)
        if step == 2:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        rad.solve_system(F, emission, reflectance, tolerance=1e-12, on_iteration=stop)
    assert steps == [1, 2]


def test_too_large_a_factorisation_is_refused(monkeypatch, room):
    monkeypatch.setattr(sys.modules["radiosity.system"], "available_bytes", lambda: 1000)
    F, emission, reflectance = room
    with pytest.raises(MemoryError, match=r"LU factorisation .* use an iterative method"):
        rad.solve_system(F, emission, reflectance, method="direct")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("tolerance", [1e-1, 1e-4, 1e-12])
def test_no_patch_is_further_from_lu_than_the_bound(room, method, tolerance):
    F, emission, reflectance = room
    solution = rad.solve_system(F, emission, reflectance, method=method, tolerance=tolerance)
    off = np.abs(solution.radiosity - exact(F, emission, reflectance)).max(axis=0)
    # LAPACK's own rounding: the condition of I - rho F, 20 at the most, times n numbers rounded at 1.1e-16 each.
    rounding = 20 * len(emission) * 1.2e-16 * solution.radiosity.max(axis=0)
    assert (off <= solution.report.bound + rounding).all()
    # A bound that could never fail would prove nothing: it is of the size of the residual over 1 - rho.
    assert (solution.report.bound < 1e3 * tolerance * solution.radiosity.max(axis=0) + 1e-9).all()
    assert "no patch is off by more than" in str(solution.report)


def test_the_bound_is_infinite_where_all_is_reflected():
    F = np.array([[0.0, 1.0], [0.5, 0.0]])
    solution = rad.solve_system(F, 1.0, [[1.0, 0.5], [0.5, 0.5]])
    # Row 0 reflects all that it gathers in band 0, although the system has a solution.
    assert np.isinf(solution.report.bound).tolist() == [True, False]


def test_overshooting_saves_most_of_the_shots_of_a_white_room(room):
    F, emission, _ = room
    shots = {
        method: rad.solve_system(F, emission, 0.95, method=method, tolerance=1e-3).report.steps
        for method in ("southwell", "overshooting")
    }
    assert shots["overshooting"] < 0.5 * shots["southwell"]
