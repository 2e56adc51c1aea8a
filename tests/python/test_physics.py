"""Physics on random closed scenes: reciprocity, conservation, the furnace, energy, and invariance."""

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import radiosity as rad

# Building and solving a scene takes up to a second on a busy machine.
SLOW = settings(deadline=None, max_examples=12, derandomize=True)
TOLERANCE = 1e-2


@st.composite
def rooms(draw):
    """A closed room with a few boxes in it: a distorted outer box facing inward, boxes facing outward."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    outer = trimesh.creation.box(extents=rng.uniform(4, 8, 3))
    outer.vertices = outer.vertices * (1 + 0.1 * rng.uniform(-1, 1, (8, 1)))
    outer.invert()
    parts = [outer]
    for _ in range(draw(st.integers(0, 2))):
        inner = trimesh.creation.box(extents=rng.uniform(0.2, 0.8, 3))
        inner.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        # Boxes reach 0.7 from their centres: they cut neither into each other nor into the walls.
        inner.apply_translation([(-0.8 if len(parts) == 1 else 0.8), *rng.uniform(-0.2, 0.2, 2)])
        parts.append(inner)
    mesh = trimesh.util.concatenate(parts)
    return rad.Scene(mesh.vertices, mesh.faces).subdivide(1.5)


@given(rooms())
@SLOW
def test_reciprocity_is_exact_and_rows_sum_to_one(scene):
    F = rad.form_factors(scene, tolerance=TOLERANCE)
    matrix = F.toarray()
    assert (matrix >= 0).all()
    exchange = scene.areas[:, None] * matrix
    assert np.allclose(exchange, exchange.T, rtol=4 * np.finfo(float).eps, atol=0)
    # The estimate is a sum of standard errors, in which those of many pairs cancel: a row is hardly ever further off.
    assert np.abs(F.remainder).max() <= max(TOLERANCE, F.error_estimate)


@given(rooms(), st.floats(0.0, 0.95), st.floats(1e-30, 1e30))
@SLOW
def test_furnace(scene, rho, emission):
    F = rad.form_factors(scene, tolerance=TOLERANCE)
    solution = rad.solve_system(F, emission, rho, tolerance=1e-9)
    # An error of TOLERANCE in a row counts once a bounce.
    assert np.allclose(solution.radiosity, emission / (1 - rho), rtol=TOLERANCE / (1 - rho), atol=0)


@given(rooms(), st.integers(0, 2**32 - 1))
@SLOW
def test_energy_is_conserved(scene, seed):
    rng = np.random.default_rng(seed)
    n = scene.n_patches
    F = rad.form_factors(scene, tolerance=TOLERANCE)
    emission = rng.random((n, 2)) * (rng.random((n, 1)) < 0.2)
    solution = rad.solve_system(F, emission, rng.uniform(0, 0.95, (n, 2)), method="gmres", tolerance=1e-10)
    audit = solution.report.audit
    assert audit.imbalance <= 1e-12
    # Closed: what leaves is the error of the rows.
    assert (np.abs(audit.left) <= TOLERANCE * (scene.areas @ solution.radiosity) + 1e-300).all()


@given(rooms(), st.floats(-6, 6), st.integers(0, 2**32 - 1))
@SLOW
def test_moving_scaling_and_renumbering_change_nothing(scene, exponent, seed):
    rng = np.random.default_rng(seed)
    rotation = _rotation(rng)
    order = rng.permutation(scene.n_patches)
    moved = rad.Scene(10.0**exponent * (scene.vertices @ rotation.T + rng.uniform(-10, 10, 3)), scene.faces[order])
    F, G = (rad.form_factors(s, tolerance=TOLERANCE).toarray() for s in (scene, moved))
    # The segments of a pair depend on its numbers, so partly hidden pairs differ by the sampling: both rows are within
    # the tolerance of the same truth.
    assert np.abs(F[np.ix_(order, order)] - G).sum(axis=1).max() <= 2 * TOLERANCE


@given(rooms(), st.integers(0, 2**32 - 1))
@SLOW
def test_light_adds_up_and_more_reflectance_is_never_less_light(scene, seed):
    rng = np.random.default_rng(seed)
    n = scene.n_patches
    F = rad.form_factors(scene, tolerance=TOLERANCE)
    first, second = (rng.random((n, 2)) * (rng.random((n, 1)) < 0.3) for _ in range(2))
    rho = rng.uniform(0.0, 0.8, (n, 2))
    one, other, both = (
        rad.solve_system(F, emission, rho, "direct").radiosity for emission in (first, second, first + second)
    )
    # Three LU solves of condition at most (1 + rho) / (1 - rho) = 9: a few hundred roundings.
    assert np.allclose(both, one + other, rtol=1e-12, atol=1e-12 * both.max())
    brighter = rad.solve_system(F, first, rho + rng.uniform(0.0, 0.15, (n, 2)), "direct").radiosity
    assert (brighter >= one * (1.0 - 1e-12)).all()


@given(rooms(), st.integers(0, 2**32 - 1))
@SLOW
def test_a_thing_more_in_the_room_never_raises_a_form_factor(scene, seed):
    rng = np.random.default_rng(seed)
    # A small tetrahedron between the boxes, which stand at x = -0.8 and 0.8 and reach 0.7 from there.
    corners = 0.09 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) @ _rotation(rng).T
    faces = len(scene.vertices) + np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    fuller = rad.Scene(np.concatenate([scene.vertices, corners]), np.concatenate([scene.faces, faces]))
    n = scene.n_patches
    before, after = (rad.form_factors(s, tolerance=TOLERANCE).toarray()[:n, :n] for s in (scene, fuller))
    # Exact shadows in most pairs; where segments decide, both rows are within the tolerance.
    assert np.maximum(after - before, 0.0).sum(axis=1).max() <= 2 * TOLERANCE
    assert after.sum() < before.sum()


@given(rooms())
@SLOW
def test_splitting_patches_keeps_the_sums(scene):
    finer = scene.subdivide(0.6 * scene.report().longest_edge)
    coarse, fine = (rad.form_factors(s, tolerance=TOLERANCE).toarray() for s in (scene, finer))
    parts = np.zeros((finer.n_patches, scene.n_patches))
    parts[np.arange(finer.n_patches), finer.parent] = 1.0
    # A_i F_ij = sum over the parts k of i and l of j of A_k F_kl: rows of both are within the tolerance.
    joined = parts.T @ (finer.areas[:, None] * fine) @ parts / scene.areas[:, None]
    assert np.abs(joined - coarse).sum(axis=1).max() <= 2 * TOLERANCE


def _rotation(rng):
    return trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]


@st.composite
def heaps(draw):
    """Triangles of all sizes that float about without touching: open, and much of it hidden."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    # On a grid of unit cells; a triangle within 0.45 of the middle of its own.
    cells = rng.permutation(27)[: draw(st.integers(2, 20))]
    middles = np.stack(np.unravel_index(cells, (3, 3, 3)), axis=1).astype(float)
    corners = rng.normal(size=(len(cells), 3, 3))
    corners *= 0.45 * rng.uniform(0.2, 1.0, (len(cells), 1, 1)) / np.linalg.norm(corners, axis=2, keepdims=True)
    corners += middles[:, None]
    sides = draw(st.sampled_from(["front", "both"]))
    return rad.Scene(corners.reshape(-1, 3), np.arange(3 * len(cells)).reshape(-1, 3), sides=sides)


@given(heaps())
@SLOW
def test_what_is_hidden_is_less_and_no_row_sums_to_more_than_one(scene):
    triangles = scene.vertices[scene.faces]
    i, j = np.triu_indices(scene.n_patches, 1)
    unoccluded = np.zeros((scene.n_patches, scene.n_patches))
    unoccluded[i, j] = rad.pair_form_factors(triangles[i], triangles[j], progress=False)
    unoccluded[j, i] = rad.pair_form_factors(triangles[j], triangles[i], progress=False)
    F = rad.form_factors(scene, tolerance=TOLERANCE)
    matrix = F.toarray()
    assert (matrix >= 0).all()
    # The kernels of the scene are chosen for a part of its tolerance.
    assert (matrix <= unoccluded * (1 + TOLERANCE)).all()
    assert F.row_sums.max() <= 1 + F.error_estimate
    exchange = scene.areas[:, None] * matrix
    assert np.allclose(exchange, exchange.T, rtol=4 * np.finfo(float).eps, atol=0)


@given(st.one_of(rooms(), heaps()), st.integers(0, 2**32 - 1))
@SLOW
def test_no_power_is_lost_or_made_whichever_the_scene_and_solver(scene, seed):
    rng = np.random.default_rng(seed)
    n = scene.n_patches
    F = rad.form_factors(scene, tolerance=TOLERANCE)
    method = ("direct", "jacobi", "gauss_seidel", "southwell", "overshooting", "gmres")[seed % 6]
    solution = rad.solve_system(F, rng.random((n, 2)), rng.uniform(0, 0.9, (n, 2)), method)
    assert solution.report.audit.imbalance <= 1e-12
    # Light only adds: nothing falls below what it emits by itself, but for the residual that a solver may leave.
    slack = 0.0 if method != "overshooting" else 1e-5 * solution.radiosity.max()
    assert (solution.radiosity >= solution.scene.emission * (1 - 1e-12) - slack).all()
