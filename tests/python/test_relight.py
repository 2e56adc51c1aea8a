"""Light anew: many states, other lamps and paints, transfer matrices, and derivatives, each against solving anew."""

import copy
import importlib.util
import pickle
import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse

import radiosity as rad

QUIET = {"progress": False}
# Residual of the solves below: what is compared agrees to a few of them.
TIGHT = 1e-12


@pytest.fixture(scope="module")
def room():
    """Two rooms with a door, in three bands, one of them bright."""
    scene = rad.scenes.two_rooms(max_edge=2.0)
    rng = np.random.default_rng(7)
    n = scene.n_patches
    reflectance = np.stack([rng.uniform(0, 0.5, n), rng.uniform(0.3, 0.9, n), np.full(n, 0.9)], axis=1)
    return scene.with_materials(reflectance=reflectance)


@pytest.fixture(scope="module", name="F")
def factors(room):
    return rad.form_factors(room, tolerance=1e-2, **QUIET)


@pytest.fixture(scope="module")
def emissions(room):
    """(n, b, 40) states: every patch may glow; the last is dark."""
    e = np.random.default_rng(3).uniform(0.0, 2.0, (room.n_patches, 3, 40))
    e[:, :, -1] = 0.0
    return e


def relative(difference, reference):
    return np.linalg.norm(difference) / np.linalg.norm(reference)


@pytest.mark.parametrize("method", ["direct", "jacobi", "gauss_seidel", "southwell", "overshooting", "gmres"])
def test_many_states_are_what_each_is_alone(room, F, emissions, method):
    e = emissions[:, :, :3] if method in ("southwell", "overshooting") else emissions
    states = rad.solve_system(F, e, room.reflectance, method, tolerance=1e-8, **QUIET)
    assert isinstance(states, rad.Solutions)
    assert states.radiosity.shape == states.irradiance.shape == e.shape
    assert len(states) == e.shape[2] == len(states.residuals)
    assert states.residuals.max() == states.report.residual <= 1e-8
    for s in (0, len(states) // 2, -1):
        alone = rad.solve_system(F, e[:, :, s], room.reflectance, method, tolerance=1e-8, **QUIET)
        # Both have a residual of 1e-8; a white band multiplies it by up to 1 / (1 - 0.9).
        np.testing.assert_allclose(states[s].radiosity, alone.radiosity, rtol=0, atol=2e-7 * max(e.max(), 1.0))


def test_one_of_many_states_is_a_solution(room, F, emissions):
    states = rad.solve_system(F, emissions, room.reflectance, "direct", **QUIET)
    one = states[5]
    assert one.scene.emission.tolist() == emissions[:, :, 5].tolist()
    assert np.array_equal(one.radiosity, states.radiosity[:, :, 5])
    # The audit of LU factors closes to rounding, of sums of some hundred numbers.
    assert one.report.audit.imbalance <= 1e-12
    assert sum(1 for _ in states) == 40
    picture = rad.render(one, rad.Camera((1, 1, 1), (2, 2, 1)), width=8, height=8)
    assert np.isfinite(picture).all()
    camera = rad.Camera((1, 1, 1), (2, 2, 1))
    for use in (lambda: rad.render(states, camera), states.update, lambda: states.vjp(0)):
        with pytest.raises(ValueError, match=r"take one, solution\[s\]"):
            use()
    with pytest.raises(IndexError):
        states[40]


def test_the_error_estimate_of_many_states_is_that_of_each(room, emissions):
    # Loose factors, so that the estimates are of sampling: of states that are alike in kind, each one's is that of all.
    F = rad.form_factors(room, tolerance=0.1, method="monte_carlo", **QUIET)
    e = emissions[:, :, :8]
    states = rad.solve_system(F, e, room.reflectance, "gmres", **QUIET)
    alone = [rad.solve_system(F, e[:, :, s], room.reflectance, "gmres", **QUIET).error_estimate for s in range(8)]
    # Four random combinations tell a root mean square to 1 / sqrt(2 x 4) = 35 %; so do four draws alone.
    assert 0.4 * np.mean(alone) <= states.error_estimate <= 2.5 * np.mean(alone)


def test_states_are_refused_by_patch_band_and_state(room, F, emissions):
    e = emissions.copy()
    e[4, 1, 7] = -1.0
    with pytest.raises(ValueError, match=r"patch 4: emission -1 is outside \[0, inf\) \(band 1, state 7\)"):
        rad.solve_system(F, e, room.reflectance, **QUIET)
    with pytest.raises(ValueError, match="no states"):
        rad.solve_system(F, emissions[:, :, :0], room.reflectance, **QUIET)
    with pytest.raises(ValueError, match="bands"):
        rad.solve_system(F, emissions[:, :2], room.reflectance, **QUIET)
    assert np.isnan(rad.solve_system(F, emissions, room.reflectance, "direct", **QUIET)[0].error_estimate)
    with pytest.raises(ValueError, match="one state"):
        rad.solve_system(F, emissions, room.reflectance, "gmres", start=emissions[:, :, 0], **QUIET)
    with pytest.raises(rad.ConvergenceError) as caught:
        rad.solve_system(F, emissions, room.reflectance, "jacobi", max_iterations=2, **QUIET)
    assert len(caught.value.solution) == 40


def test_states_are_the_same_for_any_number_of_threads(room, F, emissions):
    one, two = (rad.solve_system(F, emissions, room.reflectance, "gmres", threads=t, **QUIET) for t in (1, 2))
    assert np.array_equal(one.radiosity, two.radiosity)
    assert one.error_estimate == two.error_estimate


def test_other_lamps_and_paints_from_the_solution_before(room, F):
    rho = room.reflectance
    solution = rad.solve_system(F, room.emission, rho, "gmres", TIGHT, **QUIET)
    paint = rho.copy()
    paint[:4] *= 0.9
    for change in ({"reflectance": paint}, {"emission": 0.5 * room.emission}, {"emission": 1.0, "reflectance": 0.3}):
        after = solution.update(**change, tolerance=TIGHT, **QUIET)
        anew = rad.solve_system(
            F, change.get("emission", room.emission), change.get("reflectance", rho), "gmres", TIGHT, **QUIET
        )
        assert relative(after.radiosity - anew.radiosity, anew.radiosity) <= 1e-10
        # A solution of its own: it can be updated again.
        assert after.update(**QUIET).report.steps == 1
    # A tenth off four patches: to 1e-6 nearly all is known.
    after = solution.update(reflectance=paint, **QUIET)
    assert after.report.steps < rad.solve_system(F, room.emission, paint, "gmres", **QUIET).report.steps
    assert np.array_equal(after.scene.reflectance, paint)


def test_what_a_solution_keeps_is_its_own(room, F):
    e, rho = room.emission.copy(), room.reflectance.copy()
    solution = rad.solve_system(F, e, rho, "gmres", **QUIET)
    states = rad.solve_system(F, e[:, :, None] * [1.0, 2.0], rho, "gmres", **QUIET)
    before = solution.vjp(np.ones_like(e), **QUIET), states[1].scene.emission.copy()
    e *= 3.0
    rho *= 0.5
    assert np.array_equal(solution.vjp(np.ones_like(e), **QUIET).reflectance, before[0].reflectance)
    assert np.array_equal(states[1].scene.emission, before[1])


def test_bands_that_go_dark_are_dark(room, F):
    solution = rad.solve_system(F, room.emission, room.reflectance, "gmres", **QUIET)
    dark = solution.update(emission=room.emission * [1.0, 1.0, 0.0], **QUIET)
    assert not dark.radiosity[:, 2].any()
    # As much as that of the same solve from nothing, which kernels and visibility make.
    anew = rad.solve_system(F, room.emission * [1.0, 1.0, 0.0], room.reflectance, "gmres", **QUIET)
    assert dark.error_estimate <= 1.5 * anew.error_estimate
    assert np.array_equal(solution.update(reflectance=0.0, **QUIET).radiosity, room.emission)


def test_one_band_of_emission_is_for_all(room, F):
    e = np.random.default_rng(6).uniform(size=(room.n_patches, 1, 3))
    states = rad.solve_system(F, e, room.reflectance, "direct", **QUIET)
    alone = rad.solve_system(F, e[:, :, 2], room.reflectance, "direct", **QUIET)
    # LU factors of the same matrix; sums of some hundred products in another order.
    np.testing.assert_allclose(states.radiosity[:, :, 2], alone.radiosity, rtol=1e-12)


def test_solve_by_dense_factors_can_be_updated(room):
    solution = rad.solve(room, 0.1, "dense", **QUIET)
    brighter = solution.update(emission=2.0 * room.emission, tolerance=1e-9, **QUIET)
    # Linear; the first solution has a residual of 1e-10, this one of 1e-9.
    assert relative(brighter.radiosity - 2.0 * solution.radiosity, brighter.radiosity) <= 1e-7


def test_solutions_without_factors_say_so(room):
    solution = rad.solve(room, 0.1, **QUIET)
    lit = rad.solve(room, 0.1, "dense", lights=rad.PointLight((2, 2, 1), 1.0), **QUIET)
    assert lit.system is None
    for use in (solution.update, lit.update, lambda: solution.vjp(np.ones_like(solution.radiosity))):
        with pytest.raises(ValueError, match=r"has no form factors at hand: .*solve_system"):
            use()


def test_form_factors_stay_behind_when_a_solution_travels(room, F):
    solution = rad.solve_system(F, room.emission, room.reflectance, **QUIET)
    for other in (copy.deepcopy(solution), pickle.loads(pickle.dumps(solution))):
        assert other.system is None
        assert np.array_equal(other.radiosity, solution.radiosity)


def test_a_start_is_for_gmres_and_of_the_right_shape(room, F):
    e, rho = room.emission, room.reflectance
    with pytest.raises(ValueError, match="jacobi"):
        rad.solve_system(F, e, rho, "jacobi", start=e, **QUIET)
    with pytest.raises(ValueError, match="start must have shape"):
        rad.solve_system(F, e, rho, "gmres", start=e[:-1], **QUIET)
    bad = e.copy()
    bad[2, 1] = np.nan
    with pytest.raises(ValueError, match=r"patch 2: the radiosity to start from is NaN, not finite \(band 1\)"):
        rad.solve_system(F, e, rho, "gmres", start=bad, **QUIET)


def brought(F, kind):
    matrix = F.toarray()
    return {"array": matrix, "sparse": scipy.sparse.csr_array(matrix)}.get(kind, F)


@pytest.mark.parametrize("kind", ["analytic", "hierarchical", "monte_carlo", "hemicube", "array", "sparse"])
def test_derivatives_are_those_of_finite_differences(kind):
    scene = rad.scenes.cornell_box(max_edge=0.4)
    # Seldom symmetric: sampled rows and plain matrices have no reciprocity to go by.
    method = {"array": "monte_carlo", "sparse": "monte_carlo"}.get(kind, kind)
    F = brought(rad.form_factors(scene, 0.3 if method != "hemicube" else 0.5, method, **QUIET), kind)
    rng = np.random.default_rng(1)
    shape = (scene.n_patches, 3)
    values = {"emission": rng.uniform(0.5, 1.0, shape), "reflectance": rng.uniform(0.2, 0.8, shape)}
    g = rng.normal(size=shape)

    def scalar(**changed):
        return (
            g * rad.solve_system(F, **{**values, **changed}, method="gmres", tolerance=TIGHT, **QUIET).radiosity
        ).sum()

    solution = rad.solve_system(F, **values, method="gmres", tolerance=TIGHT, **QUIET)
    gradient = solution.vjp(g, **QUIET)
    for name in values:
        direction = rng.normal(size=shape)
        along = (getattr(gradient, name) * direction).sum()
        step = 1e-4
        ahead, behind = (scalar(**{name: values[name] + sign * step * direction}) for sign in (1, -1))
        # Central differences are off by step^2 = 1e-8 of the third derivative, and by rounding, 1e-12 / step.
        assert abs((ahead - behind) / (2 * step) - along) <= 1e-6 * np.linalg.norm(getattr(gradient, name))


def test_backwards_is_the_transpose(room, F):
    rng = np.random.default_rng(2)
    for method in ("analytic", "hierarchical", "monte_carlo", "hemicube"):
        factors = rad.form_factors(room, 0.5, method, **QUIET)
        x, y = rng.normal(size=(2, room.n_patches, 5))
        linear = factors.aslinearoperator()
        # Sums of some hundred products, to rounding.
        np.testing.assert_allclose(np.sum(y * (factors @ x)), np.sum(x * linear.rmatmat(y)), rtol=1e-10)
        np.testing.assert_allclose(linear.rmatvec(y[:, 0]), factors.toarray().T @ y[:, 0], rtol=1e-10, atol=1e-12)


def test_products_of_many_columns_are_those_of_each(F):
    # 360 patches make four tiles, the last one smaller; 40 columns are many; to the rounding of a hundred products.
    x = np.random.default_rng(5).normal(size=(F.shape[0], 40))
    np.testing.assert_allclose(F @ x, np.stack([F @ column for column in x.T], axis=1), rtol=0, atol=1e-13)
    assert F.shape[0] > 96
    assert F.shape[0] % 96


def test_a_cotangent_is_checked(room, F):
    solution = rad.solve_system(F, room.emission, room.reflectance, **QUIET)
    with pytest.raises(ValueError, match="cotangent must have shape"):
        solution.vjp(np.ones(3), **QUIET)
    g = np.ones_like(solution.radiosity)
    g[3, 2] = np.inf
    with pytest.raises(ValueError, match="patch 3"):
        solution.vjp(g, **QUIET)
    with pytest.raises(ValueError, match="tolerance"):
        solution.vjp(np.ones_like(g), tolerance=2.0, **QUIET)


@pytest.mark.parametrize("many", ["emitters", "receivers"])
def test_transfer_is_superposition_from_either_side(room, F, many):
    rng = np.random.default_rng(4)
    n = room.n_patches
    few, lot = [[0, 1], [5]], [rng.choice(n, 4, replace=False) for _ in range(6)]
    emitters, receivers = (lot, few) if many == "emitters" else (few, lot)
    T = rad.transfer(room, emitters, receivers, F=F, **QUIET)
    assert T.shape == (len(receivers), len(emitters), 3)
    powers = rng.uniform(size=(len(emitters), 3))
    emission = np.zeros((n, 3))
    for group, power in zip(emitters, powers, strict=True):
        emission[group] += power
    h = rad.solve_system(F, emission, room.reflectance, "gmres", TIGHT, **QUIET).irradiance
    expected = [np.average(h[group], axis=0, weights=room.areas[group]) for group in receivers]
    # The solves of transfer have residuals of 1e-8, at 1 / (1 - 0.9) in a white band.
    np.testing.assert_allclose(np.einsum("reb,eb->rb", T, powers), expected, rtol=1e-6)


def test_groups_of_transfer_have_names_masks_or_weights():
    scene = rad.scenes.cornell_box(max_edge=0.5)
    scene.names = tuple("lamp" if e > 0 else "walls" for e in scene.emission[:, 0])
    F = rad.form_factors(scene, 1e-2, **QUIET)
    lamp = scene.emission[:, 0] > 0
    named = rad.transfer(scene, ["lamp"], ["walls"], F=F, **QUIET)
    masked = rad.transfer(scene, [lamp], [np.flatnonzero(~lamp)], F=F, **QUIET)
    walls = np.where(lamp, 0.0, scene.areas)
    weighted = rad.transfer(scene, lamp[:, None].astype(float), (walls / walls.sum())[:, None], F=F, **QUIET)
    assert np.array_equal(named, masked)
    # The same weights, summed in another order.
    np.testing.assert_allclose(weighted, named, rtol=1e-14)
    # Energy: what a closed room absorbs is what the lamp gives off, and F is balanced to its row error of 1 %.
    assert rad.transfer(scene, ["lamp"], ["walls"], tolerance=1e-2, **QUIET).shape == (1, 1, 3)
    for bad, message in [
        (["door"], r"no patch is named 'door'"),
        ([[]], "is empty"),
        ([[scene.n_patches]], "outside 0"),
        ([lamp[:-1]], "mask"),
        (-np.ones((scene.n_patches, 1)), "below 0"),
        (np.full((scene.n_patches, 1), np.nan), "finite"),
    ]:
        with pytest.raises(ValueError, match=message):
            rad.transfer(scene, bad, ["walls"], F=F, **QUIET)
    for bad in ("lamp", [], [[0.5]]):
        with pytest.raises(TypeError):
            rad.transfer(scene, bad, ["walls"], F=F, **QUIET)


def test_transfer_takes_factors_of_its_own_patches_only(room, F):
    stretched = rad.Scene(room.vertices * [1, 1, 2], room.faces, room.reflectance)
    with pytest.raises(ValueError, match=r"F: patch 34 was moved, by up to 3 m \(280 patches have changed\)"):
        rad.transfer(stretched, [[0]], [[1]], F=F, **QUIET)
    with pytest.raises(ValueError, match="F: patch 3 is a mirror now"):
        rad.transfer(room.with_materials(mirror=np.eye(1, room.n_patches, 3)[0]), [[0]], [[1]], F=F, **QUIET)
    with pytest.raises(TypeError, match=r"F must be radiosity\.FormFactors"):
        rad.transfer(room, [[0]], [[1]], F=F.toarray(), **QUIET)


def finite_difference(F, e, rho, weights, step=1e-6):
    """d/ds of sum of weights B for e and rho scaled by 1 + s."""
    solved = (rad.solve_system(F, e * s, rho * s, "gmres", TIGHT, **QUIET) for s in (1 + step, 1 - step))
    ahead, behind = ((weights * solution.radiosity).sum() for solution in solved)
    return (ahead - behind) / (2 * step)


JAX = """
import jax
import numpy as np
import pytest

import radiosity as rad

jax.config.update("jax_enable_x64", True)
scene = rad.scenes.cornell_box(max_edge=0.5)
solver = rad.gradients.jax_solver(rad.form_factors(scene, 0.1, progress=False))
e, rho = np.array(scene.emission), np.array(scene.reflectance)
weights = np.random.default_rng(0).normal(size=e.shape)
print(float(jax.jit(jax.grad(lambda s: (weights * solver(e * s, rho * s)).sum()))(1.0)))
with pytest.raises(Exception, match="must both have shape"):
    solver(e[:-1], rho)
"""


def test_jax_differentiates_through_a_solve():
    if importlib.util.find_spec("jax") is None:
        pytest.skip("jax is not installed")
    scene = rad.scenes.cornell_box(max_edge=0.5)
    F = rad.form_factors(scene, 0.1, **QUIET)
    weights = np.random.default_rng(0).normal(size=scene.emission.shape)
    # In a process of its own: where it is imported, every fork of another test would warn.
    found = subprocess.run([sys.executable, "-c", JAX], capture_output=True, text=True, check=True).stdout
    # Central differences with a step of 1e-6: rounding of 1e-12 over it.
    expected = finite_difference(F, np.array(scene.emission), np.array(scene.reflectance), weights)
    assert float(found) == pytest.approx(expected, rel=1e-5)


def test_torch_differentiates_through_a_solve():
    torch = pytest.importorskip("torch")
    scene = rad.scenes.cornell_box(max_edge=0.5)
    F = rad.form_factors(scene, 0.1, **QUIET)
    e, rho = np.array(scene.emission), np.array(scene.reflectance)
    weights = np.random.default_rng(0).normal(size=e.shape)
    s = torch.ones((), dtype=torch.float64, requires_grad=True)
    radiosity = rad.gradients.torch_solver(F)(torch.tensor(e) * s, torch.tensor(rho) * s)
    (torch.tensor(weights) * radiosity).sum().backward()
    assert float(s.grad) == pytest.approx(finite_difference(F, e, rho, weights), rel=1e-5)
