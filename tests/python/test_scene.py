"""Scene: what goes in comes out, frozen; what is wrong is named; rays."""

import pickle

import numpy as np
import pytest

import radiosity as rad

VERTICES = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
FACES = [[0, 1, 2], [0, 2, 3]]


def test_arrays_and_shapes():
    scene = rad.Scene(VERTICES, FACES, reflectance=[0.1, 0.2, 0.3], emission=[[1.0], [2.0]], names=["a", "b"])
    assert (scene.n_patches, scene.bands) == (2, 3)
    assert scene.areas.tolist() == [0.5, 0.5]
    assert scene.normals.tolist() == [[0, 0, 1], [0, 0, 1]]
    assert np.allclose(scene.centroids[0], [2 / 3, 1 / 3, 0])
    assert scene.reflectance.tolist() == [[0.1, 0.2, 0.3]] * 2
    assert scene.emission.tolist() == [[1.0] * 3, [2.0] * 3]
    assert scene.names == ("a", "b")
    assert scene.faces.dtype == np.int64
    with pytest.raises(ValueError, match="read-only"):
        scene.vertices[0, 0] = 5


def test_it_does_not_keep_the_callers_arrays():
    vertices = np.array(VERTICES, float)
    scene = rad.Scene(vertices, FACES)
    vertices[:] = 7
    assert scene.vertices.tolist() == VERTICES


def test_it_survives_pickling():
    scene = rad.Scene(VERTICES, FACES, 0.3, 1.5, sides="both").subdivide(0.6)
    copy = pickle.loads(pickle.dumps(scene))
    for name in ("vertices", "faces", "reflectance", "emission", "parent"):
        assert np.array_equal(getattr(copy, name), getattr(scene, name))


def test_subdivide_keeps_materials_area_and_names():
    scene = rad.Scene(VERTICES, FACES, reflectance=[[0.1], [0.2]], emission=[[0.0], [3.0]], names=["a", "b"])
    fine = scene.subdivide(0.3)
    corners = fine.vertices[fine.faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 0.3
    assert fine.n_patches > 20
    for i in (0, 1):
        assert fine.areas[fine.parent == i].sum() == pytest.approx(0.5, rel=1e-14)
    assert np.array_equal(fine.reflectance, scene.reflectance[fine.parent])
    assert [fine.names[k] for k in (0, -1)] == ["a", "b"]
    assert scene.parent is None
    for bad in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="max_edge"):
            scene.subdivide(bad)


def test_arrays_at_odd_addresses_are_as_good_as_others():
    def moved(array):
        # What a message holds may begin anywhere; the core reads whole words.
        bytes_ = np.empty(array.nbytes + 1, np.uint8)[1:]
        bytes_[:] = array.reshape(-1).view(np.uint8)
        return bytes_.view(array.dtype).reshape(array.shape)

    vertices, faces = np.array(VERTICES, float), np.array(FACES, np.int64)
    assert not moved(vertices).flags.aligned
    scene = rad.Scene(moved(vertices), moved(faces), 0.3)
    assert np.array_equal(scene.vertices, vertices)
    assert np.array_equal(scene.faces, faces)
    state = scene.__getstate__()
    state["arrays"] = tuple(moved(array) for array in state["arrays"])
    again = rad.Scene.__new__(rad.Scene)
    again.__setstate__(state)
    assert np.array_equal(again.areas, scene.areas)
    box = rad.form_factors(rad.scenes.furnace(), tolerance=0.1, progress=False)
    x = np.arange(12.0)
    assert np.array_equal(box @ moved(x), box @ x)


def test_every_problem_is_reported_at_once():
    vertices = [*VERTICES, [2, 0, 0], [np.nan, 0, 0]]
    with pytest.raises(ValueError, match="vertex 5 is") as caught:
        rad.Scene(vertices, [[0, 1, 2], [0, 1, 9], [-1, 0, 2]])
    text = str(caught.value)
    assert "patch 1: vertex index 9 is outside 0 .. 6" in text
    assert "patch 2: vertex index -1" in text
    with pytest.raises(ValueError, match=r"patch 1: area 0e0 m\^2 is zero") as caught:
        rad.Scene(
            [*VERTICES, [2, 0, 0]], [[0, 1, 2], [0, 1, 4]], reflectance=[[1.2], [-0.1]], emission=[[-1], [np.inf]]
        )
    text = str(caught.value)
    for line in (
        "patch 0: reflectance 1.2 is outside [0, 1] (band 0)",
        "patch 1: reflectance -0.1",
        "patch 0: emission -1 is outside [0, inf) (band 0)",
        "patch 1: emission inf",
    ):
        assert line in text


def test_many_problems_of_a_kind_are_counted():
    with pytest.raises(ValueError, match="and 92 more of this kind"):
        rad.Scene(VERTICES, [[0, 1, 2]] * 100, reflectance=2.0)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"faces": []}, ValueError, "no patches"),
        ({"faces": [[0.0, 1.0, 2.0]]}, TypeError, "faces must hold integers"),
        ({"faces": [[0, 1, 2, 3]]}, ValueError, "faces must have shape"),
        ({"vertices": [[0, 0]]}, ValueError, "vertices must have shape"),
        ({"vertices": "cube"}, TypeError, "vertices must hold real numbers"),
        ({"reflectance": np.full((3, 1), 0.5)}, ValueError, "reflectance must be a scalar"),
        ({"reflectance": [0.5, 0.5], "emission": [1, 1, 1]}, ValueError, "disagree on the number of bands"),
        ({"sides": "back"}, ValueError, "'front', 'both'"),
        ({"names": ["one"]}, ValueError, "names must hold 2"),
    ],
)
def test_bad_arguments_are_named(arguments, error, message):
    with pytest.raises(error, match=message):
        rad.Scene(**{"vertices": VERTICES, "faces": FACES} | arguments)


def test_reflectance_1_everywhere_in_a_closed_scene_is_refused():
    cube = rad.scenes.furnace(reflectance=0.5)
    with pytest.raises(ValueError, match="there is no finite solution"):
        rad.Scene(cube.vertices, cube.faces, reflectance=1.0)
    # An open scene loses light, and one absorbing patch is enough.
    rad.Scene(cube.vertices, cube.faces[1:], reflectance=1.0)
    rho = np.ones((cube.n_patches, 1))
    rho[3] = 0.9
    rad.Scene(cube.vertices, cube.faces, reflectance=rho)


def test_intersect():
    scene = rad.Scene(VERTICES, FACES)
    hits = scene.intersect([[0.75, 0.25, 2], [0.25, 0.75, -1], [5, 5, 1]], [[0, 0, -2], [0, 0, 1], [0, 0, -1]])
    assert hits.patch.tolist() == [0, 1, -1]
    assert hits.distance.tolist() == [1.0, 1.0, np.inf]
    weights = np.array([1 - hits.barycentric[0].sum(), *hits.barycentric[0]])
    assert np.allclose(weights @ scene.vertices[scene.faces[0]], [0.75, 0.25, 0])
    assert np.isnan(hits.barycentric[2]).all()
    with pytest.raises(ValueError, match="ray 0: its direction is zero"):
        scene.intersect([[0, 0, 1]], [[0, 0, 0]])
    with pytest.raises(ValueError, match=r"ray 1: its origin .* is not finite"):
        scene.intersect([[0, 0, 1], [0, np.inf, 1]], [[0, 0, 1], [0, 0, 1]])
    with pytest.raises(ValueError, match="as many"):
        scene.intersect([[0, 0, 1]], [[0, 0, 1], [0, 0, 1]])


def test_occluded():
    scene = rad.Scene(VERTICES, FACES)
    above, below, beside = [0.5, 0.4, 1], [0.5, 0.4, -1], [2, 0.4, -1]
    on = [0.5, 0.4, 0]
    blocked = scene.occluded([above, below, above, above, on], [below, above, beside, on, below])
    # Both directions are blocked; the ends of a segment do not block it.
    assert blocked.tolist() == [True, True, False, False, False]


def test_rays_do_not_hit_the_surface_that_they_start_on():
    room = rad.scenes.furnace(max_edge=0.5)
    hits = room.intersect(room.centroids, room.normals)
    # The opposite wall of the unit cube, straight ahead.
    assert np.allclose(hits.distance, 1.0, rtol=0, atol=1e-12)
    assert np.array_equal(room.normals[hits.patch], -room.normals)


def test_large_batches_give_what_single_rays_give_on_any_number_of_threads():
    scene = rad.scenes.two_rooms()
    rng = np.random.default_rng(3)
    # More than one share between two looks for Ctrl-C, and no multiple of a batch.
    origins = rng.uniform(scene.vertices.min(axis=0), scene.vertices.max(axis=0), (300_001, 3))
    directions = rng.normal(size=origins.shape)
    one, two = (scene.intersect(origins, directions, threads=threads) for threads in (1, 2))
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a, b, equal_nan=True)
    for k in (0, 1023, 1024, 262_143, 262_144, 300_000):
        single = scene.intersect(origins[k : k + 1], directions[k : k + 1])
        assert single.patch[0] == one.patch[k]
        assert single.distance[0] == one.distance[k]
    ends = origins + directions
    blocked = scene.occluded(origins, ends)
    assert 0.1 < blocked.mean() < 0.9
    # A hit before the end is what blocks, but for hits at the very end.
    assert np.array_equal(blocked, one.distance < 1.0)


def test_no_rays_give_no_hits():
    scene = rad.scenes.furnace()
    hits = scene.intersect(np.empty((0, 3)), np.empty((0, 3)))
    assert hits.patch.shape == (0,)
    assert hits.barycentric.shape == (0, 2)
    assert scene.occluded(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)


def test_rays_that_are_no_rays_are_refused():
    scene = rad.scenes.furnace()
    for bad in (np.nan, np.inf, -np.inf):
        rays = np.ones((3, 3))
        rays[2, 1] = bad
        with pytest.raises(ValueError, match="ray 2: its origin"):
            scene.intersect(rays, np.ones((3, 3)))
        with pytest.raises(ValueError, match="ray 2: its direction"):
            scene.intersect(np.ones((3, 3)), rays)
        with pytest.raises(ValueError, match="ray 2: its end"):
            scene.occluded(np.ones((3, 3)), rays)


def test_patches_without_area_are_refused_by_name():
    with pytest.raises(ValueError, match="patch 1: area"):
        rad.Scene([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], [[0, 1, 2], [0, 1, 3]])
