"""What once went wrong, or would without care: sheets seen from both sides, far ends, thin gaps, white rooms."""

import pickle

import numpy as np
import pytest
import trimesh

import extremes
import radiosity as rad


@pytest.fixture(scope="module")
def worker():
    worker = extremes.Worker()
    yield worker
    worker.close()


@pytest.mark.parametrize("row", [row for row in extremes.ROWS if extremes.chosen(row, short=True)])
def test_the_extremes_table_is_right_at(row, worker):
    cells = {column: worker.cell(row, column) for column in extremes.chosen(row, short=True)}
    assert [f"{column}: {found.text}" for column, found in cells.items() if not found.right] == []


def test_a_cell_that_takes_too_long_is_wrong_and_the_next_one_is_asked(worker, monkeypatch):
    monkeypatch.setattr(extremes, "LIMIT", 0.0)
    assert worker.cell("scale 1000", "monte_carlo")[:2] == ("> 0 s", False)
    monkeypatch.undo()
    assert worker.cell("1 patch", "solve").right


def test_a_two_sided_sheet_is_seen_from_the_side_that_faces_the_ray():
    rng = np.random.default_rng(0)
    vertices = rng.random((60, 3))
    faces = np.array([rng.choice(60, 3, replace=False) for _ in range(40)])
    for scene in (sheet := rad.Scene(vertices, faces, sides="both"), sheet.subdivide(0.1)):
        directions = rng.normal(size=(20000, 3))
        hits = scene.intersect(rng.uniform(-1, 2, (20000, 3)), directions)
        hit = hits.patch >= 0
        assert hit.sum() > 500
        assert (np.sum(scene.normals[hits.patch[hit]] * directions[hit], axis=1) < 0).all()


def test_subdivision_keeps_the_back_of_patch_i_at_i_plus_n():
    scene = rad.Scene(np.eye(3), [[0, 1, 2]], sides="both").subdivide(0.3)
    n = scene.n_patches // 2
    assert n > 10
    assert np.array_equal(scene.faces[n:], scene.faces[:n][:, [0, 2, 1]])
    assert np.array_equal(scene.parent[n:], scene.parent[:n] + 1)


def test_a_vertex_that_no_patch_uses_changes_nothing():
    scene = rad.scenes.two_rooms()
    other = rad.Scene(np.vstack([scene.vertices, [[1e10] * 3]]), scene.faces)
    F, G = (rad.form_factors(s, tolerance=3e-2) for s in (scene, other))
    assert np.array_equal(F.toarray(), G.toarray())


@pytest.mark.parametrize("offset", [0.0, 1e6, 1e7])
def test_nothing_is_blocked_in_an_empty_room_wherever_it_stands(offset):
    room = rad.scenes.furnace(max_edge=0.5)
    room = rad.Scene(2 * room.vertices + offset, room.faces)
    i, j = np.triu_indices(room.n_patches, 1)
    p, q = room.centroids[i], room.centroids[j]
    before = np.sum(room.normals[i] * (q - p), axis=1) > 1e-3
    assert before.sum() > 1000
    assert not room.occluded(p[before], q[before]).any()


@pytest.mark.parametrize("distance", [1e3, 1e6, 1e9])
def test_a_plate_blocks_segments_between_ends_far_away(distance):
    plate = rad.Scene([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions[np.abs(directions[:, 2]) > 0.1]
    middle = np.zeros_like(directions)
    # 1 % from the border: ends at 1e9 are rounded by 1e-7.
    middle[:, :2] = rng.uniform(0.01, 0.99, (len(middle), 2))
    assert plate.occluded(middle - distance * directions, middle + distance * directions).all()


@pytest.mark.parametrize("height", [1e-2, 1e-4, 1e-6])
def test_rows_of_a_flat_room_sum_to_one(height):
    cube = rad.scenes.furnace(max_edge=0.6)
    F = rad.form_factors(rad.Scene(cube.vertices * [1, 1, height], cube.faces), tolerance=1e-6)
    assert np.abs(F.remainder).max() <= 1e-6


@pytest.mark.parametrize("width", [0.03, 0.01])
def test_a_thin_bar_is_not_overlooked(width):
    # Two plates and a bar across the middle: of two pilot rounds in three, no segment meets it.
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]]
    low, high = 0.5 - width / 2, 0.5 + width / 2
    bar = [[0, low, 0.5], [1, low, 0.5], [1, high, 0.5], [0, high, 0.5]]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [8, 9, 10], [8, 10, 11], [8, 10, 9], [8, 11, 10]]
    scene = rad.Scene(corners + bar, faces)
    exact = rad.form_factors(scene, tolerance=2e-4, seed=12345).toarray()
    for seed in range(10):
        F = rad.form_factors(scene, tolerance=2e-3, seed=seed)
        assert F.error_estimate <= 2e-3
        # A row has two pairs that are partly hidden, too few to average out: three standard errors.
        assert np.abs(F.toarray() - exact).sum(axis=1).max() <= 3 * F.error_estimate


@pytest.mark.parametrize("rho", [0.5, 0.97, 0.99])
def test_the_error_estimate_holds_in_white_rooms(rho):
    room = trimesh.creation.box((4, 4, 4))
    room.invert()
    blocks = [trimesh.creation.box((1, 1, 1)) for _ in range(2)]
    blocks[0].apply_translation((-0.9, 0, 0))
    blocks[1].apply_translation((0.9, 0.3, 0.2))
    mesh = trimesh.util.concatenate([room, *blocks])
    emission = np.zeros((len(mesh.faces), 1))
    emission[:2] = 1
    scene = rad.Scene(mesh.vertices, mesh.faces, rho, emission).subdivide(1.5)
    area = scene.areas[:, None]

    def distance(a, b):
        return np.sqrt((area * (a.radiosity - b.radiosity) ** 2).sum() / (area * (b.radiosity - emission0) ** 2).sum())

    emission0 = scene.emission
    exact = rad.solve(scene, tolerance=0.002, seed=99)
    for seed in range(3):
        solution = rad.solve(scene, tolerance=0.02, seed=seed)
        assert solution.error_estimate <= 0.02
        # Three standard deviations, and what the better solution is off by itself.
        assert distance(solution, exact) <= 3 * solution.error_estimate + 3 * exact.error_estimate


@pytest.mark.parametrize("emission", [1e-300, 1e-170, 1e160, 1e200])
def test_emissions_of_any_size(emission):
    solution = rad.solve(rad.scenes.furnace(0.5, emission))
    assert np.allclose(solution.radiosity / emission, 2.0, rtol=1e-9)
    assert solution.error_estimate < 0.01


def test_an_iteration_that_diverges_says_so():
    # Rows that sum to 2 at a reflectance of 0.9: no light source is needed.
    matrix = np.full((4, 4), 0.5)
    with pytest.raises(rad.ConvergenceError, match="jacobi diverged at step"):
        rad.solve_system(matrix, 1.0, 0.9, method="jacobi")


def test_an_unfinished_solution_without_reflected_light_is_not_called_exact():
    matrix = np.array([[0, 8.8e-5], [8.8e-5, 0]])
    solution = rad.solve_system(matrix, [[1.0], [0.0]], 0.9, method="southwell", tolerance=1e-3)
    assert solution.radiosity[1] == 0
    assert solution.error_estimate == np.inf


def test_a_convergence_error_survives_pickling():
    with pytest.raises(rad.ConvergenceError) as caught:
        rad.solve_system(np.full((2, 2), 0.5), 1.0, 0.99, max_iterations=1)
    copy = pickle.loads(pickle.dumps(caught.value))
    assert str(copy) == str(caught.value)
    assert np.array_equal(copy.solution.radiosity, caught.value.solution.radiosity)


def test_a_subdivision_that_cannot_be_is_refused_at_once():
    with pytest.raises(MemoryError, match="choose a larger max_edge"):
        rad.scenes.cornell_box().subdivide(1e-5)
    huge = rad.Scene([[1e16, 0, 0], [1e16 + 8, 0, 0], [1e16, 8, 0]], [[0, 1, 2]])
    with pytest.raises(ValueError, match="below the rounding of coordinates"):
        huge.subdivide(1.0)


def test_a_picture_that_cannot_be_is_refused_at_once():
    solution = rad.solve(rad.scenes.parallel_plates(emission=(1.0, 0.0)))
    with pytest.raises(MemoryError, match="choose fewer pixels"):
        rad.render(solution, rad.Camera((0.5, 0.5, 0.5), (0.5, 0.5, 0), up=(0, 1, 0)), 1 << 20, 1 << 20)


def test_a_small_thing_far_away_is_seen():
    solution = rad.solve(rad.Scene([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], 0.5, 1.0))
    image = rad.render(solution, rad.Camera((0.5, 0.5, 100), (0.5, 0.5, 0), up=(0, 1, 0)), 128, 128)
    assert 0 < (image > 0).sum() < 16


def test_rays_from_beyond_all_bounds_hit_nothing_and_harm_nothing():
    # Coordinates that are numbers, but no longer so in units of the scene.
    room = rad.scenes.furnace()
    room = rad.Scene(0.5 * room.vertices, room.faces)
    assert room.occluded([[1e308] * 3], [[0.1] * 3]).tolist() == [False]
    assert room.intersect([[1e308, 0, 0]], [[-1.0, 0, 0]]).patch.tolist() == [-1]


def test_light_beyond_the_numbers_is_refused_by_patch():
    with pytest.raises(ValueError, match=r"patch \d+: its radiosity comes out as (inf|NaN)"):
        rad.solve(rad.scenes.furnace(0.5, 1.7e308), 0.3)


def test_a_bound_of_nearly_nothing_takes_no_longer_than_others():
    room = rad.scenes.furnace(0.5, 1.0)
    camera = rad.Camera((0.5, 0.5, 0.9), (0.5, 0.6, 0.0))
    # Every path goes on at every bounce: it ends at random, not when nothing is left to carry.
    image = rad.instant(room, camera, 8, 8, 256, bound=5e-324)
    assert np.isfinite(image).all()
    # E / (pi (1 - rho)). Pixels differ by some 5 %: the mean of 64 of them is within 5 % at eight standard errors.
    assert abs(image.mean() / (2.0 / np.pi) - 1.0) < 0.05


@pytest.mark.parametrize(("origin", "up"), [((0, 0, 1e160), (0, 1, 0)), ((0, 0, 1e308), (0, 1, 0))])
def test_a_camera_from_beyond_all_bounds_is_refused(origin, up):
    with pytest.raises(ValueError, match="m from its origin, outside"):
        rad.Camera(origin, (0, 0, -1e308), up)


def test_an_up_of_any_length_is_a_direction():
    room = rad.scenes.furnace(0.5, 1.0)
    solution = rad.solve(room, 0.3)
    images = [
        rad.render(solution, rad.Camera((0.5, 0.5, 0.9), (0.5, 0.6, 0), (0, y, 0)), 8, 8) for y in (1.0, 2.0**1000)
    ]
    assert np.array_equal(*images)
