"""Mirrors and glass: against rooms unfolded at their mirrors, closed forms, and Mitsuba's path tracer."""

import pickle

import numpy as np
import pytest
import trimesh

import radiosity as rad
from images import path_traced, relative_rmse
from radiosity.scenes.builder import Builder
from test_mitsuba import check_agreement, needs_mitsuba

VIEW = rad.Camera(**rad.scenes.mirror_and_glass_view())
QUIET = {"progress": False}


def mirrored_room(mirror, *names):
    """A cube with a lamp and a block; the wall at x = 1, or what is named, is a mirror. And which patches are."""
    builder = Builder()
    lines = [np.linspace(0.0, 1.0, 7).tolist()] * 3
    for axis in range(3):
        for facing, at in ((1, 0.0), (-1, 1.0)):
            colour = (0.6, 0.2, 0.2) if axis == 1 else (0.5, 0.5, 0.5)
            builder.wall(f"{'xyz'[axis]} = {at:g}", axis, facing, at, lines, colour)
    builder.box("block", (0.5, 0.3, 0.1), (0.7, 0.6, 0.5), (0.7, 0.7, 0.7))
    builder.wall("lamp", 2, -1, 0.99, ([0.3, 0.5], [0.4, 0.6], [0.0, 1.0]), (0.0, 0.0, 0.0), (30.0, 20.0, 10.0))
    scene = builder.scene(None)
    is_mirror = np.isin(scene.names, names or ["x = 1"])
    reflectance = np.where(is_mirror[:, None], 0.0, scene.reflectance)
    mirrored = rad.Scene(
        scene.vertices,
        scene.faces,
        reflectance,
        scene.emission,
        names=scene.names,
        mirror=np.where(is_mirror, mirror, 0.0),
    )
    return mirrored, is_mirror


def unfolded(scene, is_mirror):
    """The room and its image in place of the mirror: the same light, for a mirror that loses nothing."""
    real = ~is_mirror
    image = scene.vertices * [-1.0, 1.0, 1.0] + [2.0, 0.0, 0.0]
    return rad.Scene(
        np.concatenate([scene.vertices, image]),
        np.concatenate([scene.faces[real], scene.faces[real][:, ::-1] + len(image)]),
        np.tile(scene.reflectance[real], (2, 1)),
        np.tile(scene.emission[real], (2, 1)),
    )


@pytest.fixture(scope="module")
def perfect():
    scene, is_mirror = mirrored_room(1.0)
    return scene, is_mirror, rad.solve(unfolded(scene, is_mirror), 0.003, **QUIET)


@pytest.mark.parametrize("tolerance", [0.1, 0.03, 0.01])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_room_with_a_mirror_is_half_of_a_room_twice_as_large(perfect, tolerance, seed):
    scene, is_mirror, reference = perfect
    solution = rad.solve(scene, tolerance, seed=seed, **QUIET)
    real = ~is_mirror
    assert (solution.radiosity[is_mirror] == 0.0).all()
    area = scene.areas[real][:, None]
    truth = reference.radiosity[: real.sum()] - scene.emission[real]
    wrong = solution.radiosity[real] - scene.emission[real] - truth
    error = np.sqrt((area * wrong**2).sum(axis=0) / (area * truth**2).sum(axis=0)).max()
    # The reference itself is right to 0.3 %.
    assert error <= np.hypot(tolerance, 0.003)
    assert solution.error_estimate <= tolerance


def test_a_mirror_shows_the_room_behind_it(perfect):
    scene, _, reference = perfect
    solution = rad.solve(scene, 0.01, **QUIET)
    camera = rad.Camera((0.1, 0.15, 0.6), (1.0, 0.7, 0.45), fov=70.0)
    seen = rad.two_pass(solution, camera, 60, 40, tolerance=0.01, **QUIET)
    wanted = rad.render(reference, camera, 60, 40, "gather", tolerance=0.01, **QUIET)
    # Beside the lamp and its edges, in which one sample more or less of it counts much.
    dark = wanted.max(axis=2) < 2.0
    assert dark.mean() > 0.9
    # Both have noise of 1 %, the edges of the block a few samples of 4 to 16 more, and the solutions 1 and 0.3 %.
    assert relative_rmse(seen, wanted, dark) < 0.03


def with_faces(scene, faces, reflectance):
    """The scene and more patches between its vertices."""
    count = len(faces)
    return rad.Scene(
        scene.vertices,
        np.concatenate([scene.faces, faces]),
        np.concatenate([scene.reflectance, np.full((count, scene.bands), reflectance)]),
        np.concatenate([scene.emission, np.zeros((count, scene.bands))]),
        mirror=np.append(scene.mirror, np.zeros(count)),
        ior=np.append(scene.ior, np.full(count, np.nan)),
    )


def with_body(scene, mesh, mirror=0.0, ior=np.nan):
    """The scene and a closed trimesh body in it, a mirror or glass."""
    n, m = scene.n_patches, len(mesh.faces)
    return rad.Scene(
        np.concatenate([scene.vertices, mesh.vertices]),
        np.concatenate([scene.faces, mesh.faces + len(scene.vertices)]),
        np.concatenate([scene.reflectance, np.zeros((m, scene.bands))]),
        np.concatenate([scene.emission, np.zeros((m, scene.bands))]),
        mirror=np.concatenate([scene.mirror, np.full(m, mirror)]),
        ior=np.concatenate([np.full(n, np.nan), np.full(m, ior)]),
    )


def ball(centre, radius):
    mesh = trimesh.creation.icosphere(2, radius)
    return mesh.apply_translation(centre)


@needs_mitsuba
@pytest.mark.parametrize("names", [["x = 1"], ["x = 1", "y = 0", "block"]])
def test_patches_lit_by_way_of_mirrors_are_mitsubas(names):
    scene, is_mirror = mirrored_room(0.8, *names)
    solution = rad.solve(scene, 0.003, **QUIET)
    truth, error = rad.mitsuba.reference_radiosity(scene, 3_000_000, seed=3)
    assert (truth[is_mirror] == 0.0).all()
    # What rays leave is 0.3 % in the mean, ten times less than the path tracer's standard errors.
    lit = ~is_mirror & (scene.emission.max(axis=1) == 0.0)
    lit &= (error > 0.0).all(axis=1)
    check_agreement(solution.radiosity[lit] - truth[lit], np.hypot(error[lit], solution.standard_error[lit]))


def glass_room():
    scene = rad.scenes.mirror_and_glass(0.1, facets=2)
    return scene, scene.names


def room_with_a_mirror_ball():
    scene, _ = mirrored_room(0.0, "none")
    return with_body(scene, ball((0.3, 0.7, 0.3), 0.2), mirror=0.8), scene.names


@needs_mitsuba
@pytest.mark.parametrize(
    ("room", "wanted"),
    [
        (glass_room, ("floor", "ceiling", "left wall", "right wall", "white sphere")),
        (room_with_a_mirror_ball, ("x = 0", "x = 1", "y = 0", "y = 1", "z = 0", "z = 1", "block")),
    ],
)
def test_objects_lit_by_way_of_curved_surfaces_are_mitsubas(room, wanted):
    scene, names = room()
    solution = rad.solve(scene, 0.01, **QUIET)
    truth, error = rad.mitsuba.reference_radiosity(scene, 1_500_000, seed=1)
    for name in wanted:
        own = np.flatnonzero(np.array(names) == name)
        area = scene.areas[own][:, None]
        ours, theirs = (area * solution.radiosity[own]).sum(axis=0), (area * truth[own]).sum(axis=0)
        # 4.5 standard errors of the path tracer, which finds the lamp by way of such surfaces by chance only, and 1 %.
        slack = 4.5 * np.sqrt(((area * error[own]) ** 2).sum(axis=0)) + 0.01 * theirs
        assert (np.abs(ours - theirs) < slack).all(), name


@pytest.mark.parametrize("is_white", [True, False])
def test_glass_that_bends_nothing_changes_nothing(is_white):
    # All light of the lamp passes the body: without it that is a closed form, with it come rays from the lamp, of which
    # the mirror absorbs most.
    scene, is_mirror = mirrored_room(0.2)
    # With a back to the lamp no light is lost.
    scene = with_faces(scene, scene.faces[np.array(scene.names) == "lamp"][:, ::-1], 0.2)
    is_mirror = np.append(is_mirror, [False, False])
    if is_white:
        scene = scene.with_materials(np.where(scene.reflectance > 0.0, 0.9, 0.0), scene.emission)
    around = trimesh.creation.box(bounds=[(0.25, 0.35, 0.9), (0.55, 0.65, 0.999)])
    solution = rad.solve(with_body(scene, around, ior=1.0), 0.03, **QUIET)
    truth = rad.solve(scene, 0.005, **QUIET)
    n = scene.n_patches
    area = scene.areas[:, None]
    ours, theirs = (solution.radiosity[:n] - scene.emission)[~is_mirror], (truth.radiosity - scene.emission)[~is_mirror]
    error = np.sqrt((area[~is_mirror] * (ours - theirs) ** 2).sum(axis=0) / (area[~is_mirror] * theirs**2).sum(axis=0))
    # The reference itself is right to 0.5 %.
    assert error.max() <= np.hypot(0.03, 0.005)
    # What falls on mirrors is known like what falls on the rest: the sum has little of the noise of single ones.
    on_mirror = area[is_mirror].T @ solution.irradiance[:n][is_mirror]
    np.testing.assert_allclose(on_mirror, area[is_mirror].T @ truth.irradiance[is_mirror], rtol=0.01)
    # A white room is scaled to the balance; in a dark one single errors, mostly noise, go out in sums.
    assert solution.report.audit.imbalance < (1e-12 if is_white else 0.005)


def test_a_pane_takes_a_thirteenth():
    # Before a glowing wall in the dark: every ray passes with (1 - R) / (1 + R), R = 1/25, all turns within the pane
    # counted.
    builder = Builder()
    builder.wall("wall", 0, -1, 2.0, ([0.0, 2.0], [-1.0, 1.0], [-1.0, 1.0]), (0.0,) * 3, (np.pi,) * 3)
    wall = builder.scene(None)
    pane = trimesh.creation.box(bounds=[(1.0, -0.5, -0.5), (1.2, 0.5, 0.5)])
    scene = with_body(wall, pane, ior=1.5)
    solution = rad.solve(scene, 0.05, **QUIET)
    image = rad.two_pass(
        solution, rad.Camera((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), fov=20.0), 20, 20, tolerance=0.02, **QUIET
    )
    # R changes by less than 1e-4 up to 14 degrees. The second way at a pane is followed by chance.
    np.testing.assert_allclose(image.mean(axis=(0, 1)), 12 / 13, rtol=0.005)


@pytest.mark.parametrize("tolerance", [0.05, 0.02])
def test_pictures_with_mirror_and_glass_are_mitsubas(tolerance):
    truth, standard_error, beside = path_traced("mirror_and_glass")
    solution = rad.solve(rad.scenes.mirror_and_glass(0.06), 0.01, **QUIET)
    image = rad.two_pass(solution, VIEW, 128, 128, tolerance=tolerance, **QUIET)
    # Single pixels that a rare bright path has struck tell nothing: 3 % of them.
    beside = beside & (standard_error < 0.05 * truth).all(axis=2)
    assert beside.mean() > 0.6
    noise = np.sqrt((standard_error[beside] ** 2).sum(axis=0) / (truth[beside] ** 2).sum(axis=0)).max()
    # Sampling as asked, the path tracer's noise (1.8 %, mostly on the ceiling), and 1 % of the solution.
    assert relative_rmse(image, truth, beside) <= np.hypot(np.hypot(tolerance, noise), 0.01)
    # No bias: means over 10,000 pixels have next to no noise. Measured 0.1 %.
    np.testing.assert_allclose(image[beside].mean(axis=0), truth[beside].mean(axis=0), rtol=0.005)


def test_where_nothing_is_a_mirror_there_is_no_second_pass():
    solution = rad.solve(rad.scenes.cornell_box(0.2), 0.05, **QUIET)
    once = rad.render(solution, VIEW, 24, 20, "gather", tolerance=0.2, **QUIET)
    assert (rad.two_pass(solution, VIEW, 24, 20, tolerance=0.2, **QUIET) == once).all()


def test_the_same_bits_for_any_number_of_threads():
    scene = rad.scenes.mirror_and_glass(0.2, facets=1)

    def bits(threads):
        solution = rad.solve(scene, 0.1, threads=threads, **QUIET)
        image = rad.two_pass(solution, VIEW, 24, 20, tolerance=0.2, threads=threads, **QUIET)
        return solution.radiosity.tobytes() + image.tobytes()

    one = bits(1)
    assert bits(2) == one
    assert bits(7) == one


def test_who_cannot_carry_mirrors_says_who_can():
    scene, is_mirror = mirrored_room(0.5)
    patch = np.flatnonzero(is_mirror)[0]
    for method in ("auto", "analytic", "monte_carlo", "hemicube", "hierarchical"):
        with pytest.raises(ValueError, match=f"patch {patch} is a mirror, which .* cannot carry: a solve by rays"):
            rad.form_factors(scene, 0.1, method=method, **QUIET)
    for method in ("dense", "hierarchical"):
        with pytest.raises(ValueError, match=f"patch {patch} is a mirror, which .* cannot carry: a solve by rays"):
            rad.solve(scene, 0.1, method, **QUIET)
    with pytest.raises(ValueError, match="cannot carry"):
        next(iter(rad.bounces(scene)))
    with pytest.raises(ValueError, match=f"patch {patch} is a mirror, which instant radiosity cannot carry"):
        rad.instant(scene, VIEW, 8, 8, **QUIET)
    solution = rad.solve(scene, 0.1, **QUIET)
    for shading in ("flat", "smooth", "gather"):
        with pytest.raises(ValueError, match=f"patch {patch} is a mirror, and render draws diffuse patches: two_pass"):
            rad.render(solution, VIEW, 8, 8, shading, **QUIET)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"mirror": 1.5}, "patch 0: a mirror that reflects 1.5 is outside"),
        ({"ior": 0.0}, r"patch 0: index of refraction 0 is outside \(0, inf\)"),
        ({"ior": [1.5, -1.0]}, "patch 1: index of refraction -1 is outside"),
        ({"mirror": 0.5, "ior": 1.5}, "patch 0: it is a mirror and glass at once"),
        ({"mirror": [0.5]}, r"mirror must be a scalar or \(2,\), one a patch"),
        ({"mirror": 0.5, "reflectance": [[0.5], [0.0]]}, "patch 0: a mirror has no reflectance"),
        ({"ior": 1.5, "emission": [[1.0], [0.0]]}, "patch 0: glass has no reflectance and no emission"),
        ({"ior": 1.5, "sides": "both"}, "patch 0: glass has one front"),
    ],
)
def test_wrong_materials_are_named(wrong, message):
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]
    with pytest.raises(ValueError, match=message):
        rad.Scene(*square, **{"reflectance": 0.0, **wrong})


def test_what_holds_for_all_patches_holds_for_the_diffuse_ones():
    corners, faces = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3], [0, 3, 1]]
    assert not rad.Scene(corners, faces, mirror=0.9).reflectance.any()
    mirror, ior = [0.9, 0.0, 0.0], [np.nan, np.nan, 1.5]
    scene = rad.Scene(corners, faces, [0.2, 0.4], 3.0, mirror=mirror, ior=ior)
    np.testing.assert_array_equal(scene.reflectance, [[0, 0], [0.2, 0.4], [0, 0]])
    np.testing.assert_array_equal(scene.emission, [[0, 0], [3, 3], [0, 0]])
    grey = scene.with_materials(0.7)
    np.testing.assert_array_equal(grey.reflectance, [[0, 0], [0.7, 0.7], [0, 0]])
    np.testing.assert_array_equal(grey.emission, scene.emission)
    np.testing.assert_array_equal(grey.ior, ior)
    with pytest.raises(ValueError, match="patch 0: a mirror has no reflectance"):
        scene.with_materials(np.full((3, 2), 0.7))

    # What becomes a mirror loses what it was; what ceases to be one is black until told otherwise.
    moved = scene.with_materials(mirror=[0.0, 0.5, 0.0])
    np.testing.assert_array_equal(moved.mirror, [0.0, 0.5, 0.0])
    np.testing.assert_array_equal(moved.ior, ior)
    assert not moved.reflectance.any()
    diffuse = scene.with_materials(0.5, mirror=0.0, ior=np.nan)
    assert diffuse.is_diffuse
    assert (diffuse.reflectance == 0.5).all()
    np.testing.assert_array_equal(diffuse.emission, scene.emission)
    with pytest.raises(ValueError, match="patch 2: it is a mirror and glass at once"):
        scene.with_materials(mirror=0.5)


def test_a_closed_room_of_mirrors_that_lose_nothing_is_refused():
    room = rad.scenes.furnace()
    for material in ({"mirror": 1.0}, {"ior": 1.5}):
        with pytest.raises(ValueError, match="reflectance 1 in band 0, or is a mirror of 1 or glass"):
            rad.Scene(room.vertices, room.faces, 0.0, 0.0, **material)


def test_a_slider_holds_solutions_of_the_same_mirrors_only():
    rooms = [mirrored_room(part)[0] for part in (0.5, 0.5, 0.6)]
    one, same, other = (rad.solve(room, 0.2, **QUIET) for room in rooms)
    rad.show([one, same])
    with pytest.raises(ValueError, match="not of one scene with one set of materials"):
        rad.show([one, other])


def test_materials_are_kept(tmp_path):
    scene = rad.scenes.mirror_and_glass(0.3, facets=0)
    solution = rad.solve(scene, 0.2, **QUIET)
    rad.save(solution, tmp_path / "lit.npz")
    finer = scene.subdivide(0.15)
    for other, wanted in (
        (rad.load_solution(tmp_path / "lit.npz").scene, slice(None)),
        (pickle.loads(pickle.dumps(scene)), slice(None)),
        (scene.with_materials(0.0, 0.0), slice(None)),
        (finer, finer.parent),
    ):
        np.testing.assert_array_equal(other.mirror, scene.mirror[wanted])
        np.testing.assert_array_equal(other.ior, scene.ior[wanted])
        assert not other.is_diffuse


@needs_mitsuba
def test_mitsuba_scenes_keep_their_mirrors_and_their_glass():
    scene = rad.scenes.mirror_and_glass(0.3, facets=0)
    back = rad.mitsuba.from_mitsuba(rad.mitsuba.to_mitsuba(scene))
    # Through 32 bits.
    np.testing.assert_allclose(back.mirror, scene.mirror, rtol=1e-7)
    np.testing.assert_allclose(back.ior, scene.ior, rtol=1e-7)
    np.testing.assert_allclose(back.reflectance, scene.reflectance, rtol=1e-6)
