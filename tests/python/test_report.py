"""The report finds what was put wrong on purpose, and nothing else."""

from types import SimpleNamespace

import numpy as np
import pytest

import radiosity as rad
from radiosity.report import report


@pytest.fixture
def room() -> rad.Scene:
    return rad.scenes.two_rooms()


def changed(scene: rad.Scene, faces: np.ndarray) -> rad.Scene:
    """The scene with other faces, all of one material."""
    return rad.Scene(scene.vertices, faces, emission=1.0)


def test_a_sound_scene_has_no_findings(room: rad.Scene) -> None:
    found = room.report()
    assert (found.n_patches, found.bands, found.objects) == (172, 3, 10)
    assert found.size == pytest.approx((8.2, 4.0, 3.0), rel=1e-15)
    assert found.total_area == pytest.approx(157.92, rel=1e-13)
    assert found.emitted_power == pytest.approx((100.0, 100.0, 100.0), rel=1e-13)
    assert found.reflectance_range == (0.2, 0.75)
    assert found.longest_edge == pytest.approx(5.0)  # the diagonal of 4 x 3 cells
    assert found.closed
    assert not found.both_sides
    assert found.boundary_edges == found.nonmanifold_edges == found.inconsistent_edges == 0
    for patches in (found.flipped_patches, found.degenerate_patches, found.duplicate_patches, found.coincident_pairs):
        assert len(patches) == 0
    assert found.hints == ()


def test_memory_forecast(room: rad.Scene) -> None:
    found = room.report()
    assert found.dense_bytes == 8 * 172 * 171 // 2 + 8 * 172
    assert "119 kB" in str(found)


def test_a_flipped_floor_is_named(room: rad.Scene) -> None:
    names = np.array(room.names)
    floor = np.flatnonzero(names == "first room floor")
    faces = room.faces.copy()
    faces[floor] = faces[floor][:, ::-1]
    found = rad.Scene(room.vertices, faces, emission=1.0, names=room.names).report()
    np.testing.assert_array_equal(found.flipped_patches, floor)
    assert found.boundary_edges == 0
    assert not found.closed
    # The rim of a 4 x 4 m floor cut at 3 and 5 places, 2 of them the doorway's sides.
    assert found.inconsistent_edges == 2 * 3 + 2 * 5
    (hint,) = found.hints
    assert hint.startswith("facing the other way than their neighbours: patches 0, 1, 2")
    assert "(30 in all; first room floor)" in hint


def test_the_larger_area_wins_not_the_larger_number() -> None:
    # A strip of one square, cut in two, beside a narrow strip cut in ten, which faces the other way.
    y = np.linspace(0.0, 1.0, 6)
    left, right = np.stack([0 * y + 1, y, 0 * y], axis=1), np.stack([0 * y + 1.1, y, 0 * y], axis=1)
    vertices = np.concatenate([[(0, 0, 0), (0, 1, 0)], left, right])
    square = [(0, 2 + k, 3 + k) for k in range(5)] + [(0, 7, 1)]
    strip = [face for k in range(5) for face in ((2 + k, 3 + k, 8 + k), (3 + k, 9 + k, 8 + k))]
    found = rad.Scene(vertices, square + strip, emission=1.0).report()
    assert found.inconsistent_edges == 5
    np.testing.assert_array_equal(found.flipped_patches, np.arange(6, 16))


def test_every_piece_is_judged_by_itself() -> None:
    cube = rad.scenes.furnace()
    far = cube.vertices + 10
    one, two = cube.faces.copy(), cube.faces + len(cube.vertices)
    one[3], two[4:6] = one[3, ::-1], two[4:6, ::-1]
    scene = rad.Scene(np.concatenate([cube.vertices, far]), np.concatenate([one, two]), emission=1.0)
    np.testing.assert_array_equal(scene.report().flipped_patches, [3, 12 + 4, 12 + 5])


def test_vertices_are_compared_by_position() -> None:
    cube = rad.scenes.furnace()
    corners = cube.vertices[cube.faces].reshape(-1, 3)
    corners[corners == 0] = np.where(np.arange(np.count_nonzero(corners == 0)) % 2, -0.0, 0.0)  # one position
    scene = rad.Scene(corners, np.arange(36).reshape(12, 3), emission=1.0)
    assert scene.report().closed
    corners[0] += 1e-9
    assert not rad.Scene(corners, np.arange(36).reshape(12, 3), emission=1.0).report().closed


def test_a_hole_is_counted() -> None:
    cube = rad.scenes.furnace()
    one_missing = changed(cube, np.delete(cube.faces, 5, axis=0)).report()
    assert (one_missing.boundary_edges, one_missing.closed) == (3, False)
    face_missing = changed(cube, cube.faces[2:]).report()
    assert face_missing.boundary_edges == 4
    assert "4 edges of one patch only" in str(face_missing)


def test_of_two_sided_patches_one_turned_round_repeats_the_other() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = [[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 3, 2]]
    scene = rad.Scene(square, faces, emission=1.0, sides="both")
    assert any("repeating earlier patches: patches 2, 3;" in hint for hint in scene.report().hints)
    with pytest.raises(ValueError, match="patch 2 repeats patch 0"):
        rad.form_factors(scene, progress=False)
    assert rad.Scene(square, faces, emission=1.0).report().duplicate_patches.size == 0


def test_facing_outwards_is_said() -> None:
    cube = rad.scenes.furnace()
    found = changed(cube, cube.faces[:, ::-1]).report()
    assert found.closed
    assert found.faces_outwards
    assert any("faces outwards" in hint for hint in found.hints)


@pytest.mark.parametrize(("gap", "is_named"), [(1e-8, False), (1e-10, True)])
def test_gaps_that_rays_do_not_see_are_named(gap: float, is_named: bool) -> None:
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, gap], [0, 1, gap], [1, 0, gap]]
    scene = rad.Scene(1e3 * np.array(vertices), [[0, 1, 2], [3, 4, 5]], emission=1.0)
    assert (
        any("nearly, but not quite, are in one place: patches 0, 1" in hint for hint in scene.report().hints)
        == is_named
    )


def test_duplicates_and_coincident_pairs() -> None:
    cube = rad.scenes.furnace()
    turned = cube.faces[3][[1, 2, 0]]  # the same patch, started at another corner
    scene = changed(cube, np.vstack([cube.faces, turned, cube.faces[7], cube.faces[3], cube.faces[5][::-1]]))
    found = scene.report()
    np.testing.assert_array_equal(found.duplicate_patches, [12, 13, 14])
    np.testing.assert_array_equal(found.coincident_pairs, [[5, 15]])
    assert any("repeating earlier patches" in hint and "patches 12, 13, 14" in hint for hint in found.hints)


def test_both_sides_are_recognised() -> None:
    cube = rad.scenes.furnace()
    found = rad.Scene(cube.vertices, cube.faces[2:], emission=1.0, sides="both").report()
    assert found.both_sides
    assert found.n_patches == 20
    # Holes and pairs refer to the sheet, not to its doubled sides.
    assert found.boundary_edges == 4
    assert len(found.coincident_pairs) == 0
    assert found.inconsistent_edges == 0
    assert "both sides of each triangle" in str(found)
    closed = rad.Scene(cube.vertices, cube.faces[:, ::-1], emission=1.0, sides="both").report()
    assert closed.closed
    assert closed.hints == ()


def test_needles_and_specks_are_found() -> None:
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.5, 1e-3, 0), (0, 0, 1e-7), (1e-7, 0, 0), (0, 1e-7, 0)]
    scene = rad.Scene(vertices, [(0, 1, 2), (0, 1, 3), (4, 5, 6)], emission=1.0)
    found = scene.report()
    np.testing.assert_array_equal(found.degenerate_patches, [1, 2])
    assert found.worst_aspect_ratio == pytest.approx(1000)
    assert any("patches 1, 2" in hint for hint in found.hints)


def test_a_surface_with_one_side_is_said() -> None:
    angle = np.linspace(0, 2 * np.pi, 13)[:-1]
    centre = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    half = angle / 2
    across = 0.3 * np.stack([np.cos(half) * np.cos(angle), np.cos(half) * np.sin(angle), np.sin(half)], axis=1)
    vertices = np.concatenate([centre + across, centre - across])
    faces = []
    for k in range(12):
        a, b = k, k + 12
        c, d = (k + 1, k + 13) if k < 11 else (12, 0)  # half a turn: the ends join crosswise
        faces += [(a, c, b), (b, c, d)]
    found = rad.Scene(vertices, faces, emission=1.0).report()
    assert found.inconsistent_edges == 1
    assert len(found.flipped_patches) == 0
    assert any("Moebius" in hint for hint in found.hints)


def test_no_light_and_perfect_mirrors_of_light_are_hinted_at() -> None:
    cube = rad.scenes.furnace()
    reflectance = np.full((12, 1), 0.5)
    reflectance[4] = 1.0
    found = rad.Scene(cube.vertices, cube.faces, reflectance).report()
    assert any("reflecting all light" in hint and "patch 4" in hint for hint in found.hints)
    assert any("no patch emits" in hint for hint in found.hints)


def test_it_reads_well() -> None:
    text = str(rad.scenes.cornell_box().report())
    assert text.splitlines()[0] == "Scene of 38 patches in 3 bands, 8 objects"
    assert "0.556 x 0.5488 x 0.5592 m" in text
    assert "0.729, 0.5146, 0.1715 W" in text  # 0.01365 m^2 times (17, 12, 4) pi
    columns = {line.index(line.split("  ")[-1].strip()) for line in text.splitlines()[1:]}
    assert len(columns) == 1
    assert all(len(line) <= 100 for line in text.splitlines())


def test_a_large_shuffled_sheet() -> None:
    # A flat sheet of 2 * 250^2 patches with unshared corners in random order, three in ten of them flipped.
    side = 250
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    corner = (y * (side + 1) + x).ravel()
    right, up = corner + 1, corner + side + 1
    faces = np.concatenate([np.stack([corner, right, up], axis=1), np.stack([right, up + 1, up], axis=1)])
    rng = np.random.default_rng(0)
    faces = faces[rng.permutation(len(faces))]
    wrong = rng.random(len(faces)) < 0.3
    faces[wrong] = faces[wrong][:, ::-1]
    grid = np.stack(np.meshgrid(np.arange(side + 1), np.arange(side + 1), [0]), axis=-1).reshape(-1, 3).astype(float)
    # Only arrays are looked at: a stand-in spares building the scene.
    n = len(faces)
    scene = SimpleNamespace(
        vertices=grid[faces].reshape(-1, 3),
        faces=np.arange(3 * n).reshape(-1, 3),
        areas=np.full(n, 0.5),
        reflectance=np.full((n, 1), 0.5),
        emission=np.ones((n, 1)),
        mirror=np.zeros(n),
        ior=np.full(n, np.nan),
        n_patches=n,
        bands=1,
        names=None,
    )
    found = report(scene)  # type: ignore[arg-type]
    np.testing.assert_array_equal(found.flipped_patches, np.flatnonzero(wrong))
    assert found.boundary_edges == 4 * side


def test_mirrors_and_glass_are_counted_and_glass_is_looked_at():
    scene = rad.scenes.mirror_and_glass(facets=1)
    report = scene.report()
    assert (report.mirrors, report.glass) == (2, 80)
    assert "mirrors, glass      2 and 80 patches" in str(report)
    assert not any("glass" in hint for hint in report.hints)
    parts = {"mirror": scene.mirror, "ior": scene.ior, "reflectance": scene.reflectance, "emission": scene.emission}
    last = np.flatnonzero(scene.ior > 0.0)[-1]
    holed = rad.Scene(
        scene.vertices,
        np.delete(scene.faces, last, axis=0),
        **{name: np.delete(values, last, axis=0) for name, values in parts.items()},
    )
    assert any("glass that is no closed body" in hint for hint in holed.report().hints)
