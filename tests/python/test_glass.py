"""Glass is examined body by body: what is wrong with one is told, and what is right is not."""

import numpy as np
import pytest
import trimesh

import radiosity as rad

# In a room 10 m wide; the hair by which bodies are moved out is then 1e-7 m.
HAIR = 1e-7


def ball(radius, at=(0.0, 0.0, 0.0), inside_out=False):
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=radius)
    mesh.apply_translation(at)
    if inside_out:
        mesh.invert()
    return mesh


def box(size, at=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    return mesh


def bowl(at=(0.0, 0.0, 0.0)):
    mesh = ball(1.0, at)
    mesh.update_faces(mesh.triangles_center[:, 2] < at[2])
    return mesh


def triangle(height, size):
    corners = size * np.array([[-0.31, -0.27, 0.0], [0.33, -0.26, 0.0], [0.02, 0.35, 0.0]]) + [0.1, 0.2, height]
    return trimesh.Trimesh(corners, [[0, 1, 2]], process=False)


def room_with(parts, scale=1.0, shift=0.0):
    room = box((10.0, 10.0, 10.0))
    room.invert()
    things = {"room": (room, np.nan), **parts}
    counts = [len(mesh.faces) for mesh, _ in things.values()]
    ior = np.concatenate([np.broadcast_to(index, n) for (_, index), n in zip(things.values(), counts, strict=True)])
    first = np.cumsum([0] + [len(mesh.vertices) for mesh, _ in things.values()])
    return rad.Scene(
        scale * (np.concatenate([mesh.vertices for mesh, _ in things.values()]) + shift),
        np.concatenate([mesh.faces + k for (mesh, _), k in zip(things.values(), first[:-1], strict=True)]),
        reflectance=np.where(np.isnan(ior), 0.5, 0.0)[:, None],
        ior=ior,
        names=[name for name, n in zip(things, counts, strict=True) for _ in range(n)],
    )


def hints_about(parts, **place):
    return [hint for hint in room_with(parts, **place).report().hints if "glass" in hint]


RIGHT = {
    "one body": {"ball": (ball(1), 1.5)},
    "two bodies": {"ball": (ball(1), 1.5), "other": (ball(0.5, (3, 0, 0)), 1.33)},
    "a hollow": {"ball": (ball(2), 1.5), "hollow": (ball(1.5, inside_out=True), 1.5)},
    "a lamp in a hollow": {
        "ball": (ball(2), 1.5),
        "hollow": (ball(1.5, inside_out=True), 1.5),
        "lamp": (ball(1), np.nan),
    },
    "a marble in a hollow": {
        "ball": (ball(2), 1.5),
        "hollow": (ball(1.5, inside_out=True), 1.5),
        "marble": (ball(1), 1.5),
    },
    "glass in glass": {"ball": (ball(2), 1.5), "inner": (ball(1), 1.1)},
    "a gap above the floor": {"block": (box((1, 1, 1), (0, 0, -4.5 + 10 * HAIR)), 1.5)},
    "a gap between panes": {"pane": (box((1, 1, 1)), 1.5), "other": (box((1, 1, 1), (0, 0, 1 + 10 * HAIR)), 1.5)},
    "a sheet above": {"block": (box((1, 1, 1)), 1.5), "sheet": (triangle(0.5 + 10 * HAIR, 0.1), np.nan)},
}

OPEN, TURNED, MIXED = "no closed body", "turned inside out", "several indices in one body"
TOUCHING, INSIDE = "touches or passes through something", "diffuse patches inside glass"

# What is wrong, the objects that it names, and those that it does not.
WRONG = {
    "open": (OPEN, {"bowl": (bowl(), 1.5)}, ["bowl"], []),
    "one of two open": (OPEN, {"ball": (ball(1, (3, 0, 0)), 1.5), "bowl": (bowl(), 1.5)}, ["bowl"], ["ball"]),
    "open at a wall": (OPEN, {"bowl": (bowl((0, 0, 5)), 1.5)}, ["bowl"], []),
    "one of two inside out": (
        TURNED,
        {"ball": (ball(2), 1.5), "other": (ball(0.5, (3, 0, 0), True), 1.5)},
        ["other"],
        ["ball"],
    ),
    "two inside out": (
        TURNED,
        {"ball": (ball(1, (-2, 0, 0), True), 1.5), "other": (ball(1, (2, 0, 0), True), 1.5)},
        ["ball", "other"],
        [],
    ),
    "inside out in the air of a hollow": (
        TURNED,
        {
            "ball": (ball(2), 1.5),
            "hollow": (ball(1.5, inside_out=True), 1.5),
            "marble": (ball(1, inside_out=True), 1.5),
        },
        ["marble"],
        ["ball", "hollow"],
    ),
    "two indices": (
        MIXED,
        {"block": (box((1, 1, 1)), np.repeat([1.3, 1.5], 6)), "ball": (ball(1, (3, 0, 0)), 1.4)},
        ["block"],
        ["ball"],
    ),
    "a lamp inside": (INSIDE, {"ball": (ball(2), 1.5), "lamp": (ball(0.5), np.nan)}, ["lamp"], ["ball", "room"]),
    "a lamp inside beside glass": (
        INSIDE,
        {"ball": (ball(2), 1.5), "inner": (ball(0.5, (1, 0, 0)), 1.1), "lamp": (ball(0.3), np.nan)},
        ["lamp"],
        ["ball", "inner"],
    ),
    "on the floor": (TOUCHING, {"block": (box((1, 1, 1), (0, 0, -4.5)), 1.5)}, ["block", "room"], []),
    "too near the floor": (
        TOUCHING,
        {"block": (box((1, 1, 1), (0, 0, -4.5 + HAIR / 100)), 1.5)},
        ["block", "room"],
        [],
    ),
    "a corner on the floor": (TOUCHING, {"ball": (ball(1, (0, 0, -4)), 1.5)}, ["ball", "room"], []),
    "through the floor": (TOUCHING, {"block": (box((1, 1, 1), (0, 0, -5)), 1.5)}, ["block", "room"], []),
    "a wall through it": (
        TOUCHING,
        {"block": (box((1, 1, 1)), 1.5), "wall": (triangle(0.1, 20.0), np.nan)},
        ["block", "wall"],
        ["room"],
    ),
    "a small sheet on it": (
        TOUCHING,
        {"block": (box((1, 1, 1)), 1.5), "sheet": (triangle(0.5, 0.1), np.nan)},
        ["block", "sheet"],
        ["room"],
    ),
    "panes on each other": (
        TOUCHING,
        {"pane": (box((1, 1, 1)), 1.5), "other": (box((1, 1, 1), (0, 0, 1)), 1.5)},
        ["pane", "other"],
        ["room"],
    ),
    "a small pane on another": (
        TOUCHING,
        {"pane": (box((1, 1, 1)), 1.5), "other": (box((0.1, 0.1, 0.1), (0.2, 0.1, 0.55)), 1.3)},
        ["pane", "other"],
        ["room"],
    ),
    "through each other": (
        TOUCHING,
        {"ball": (ball(1), 1.5), "other": (ball(1, (1, 0, 0)), 1.5)},
        ["ball", "other"],
        ["room"],
    ),
}

# Positions far from the origin are known to 1e-14 of the scene's size: a millionth of a hair.
PLACES = [{}, {"scale": 1e-3, "shift": 50.0}]


@pytest.mark.parametrize("place", PLACES, ids=["metres", "millimetres"])
@pytest.mark.parametrize("parts", RIGHT.values(), ids=RIGHT)
def test_glass_that_is_right_is_not_told_of(parts, place):
    assert hints_about(parts, **place) == []


@pytest.mark.parametrize("place", PLACES, ids=["metres", "millimetres"])
@pytest.mark.parametrize(("what", "parts", "named", "not_named"), WRONG.values(), ids=WRONG)
def test_glass_that_is_wrong_is_named_with_its_remedy(what, parts, named, not_named, place):
    hints = hints_about(parts, **place)
    assert len(hints) == 1
    assert what in hints[0]
    assert all(name in hints[0] for name in named)
    assert not any(name in hints[0] for name in not_named)


def test_a_mirror_may_be_inside_but_not_touch():
    block = box((1, 1, 1))
    for height, told in ((0.1, 0), (0.5, 1)):
        sheet = triangle(height, 0.1)
        scene = rad.Scene(
            np.concatenate([block.vertices, sheet.vertices]),
            np.concatenate([block.faces, sheet.faces + len(block.vertices)]),
            reflectance=0.0,
            mirror=np.r_[np.zeros(12), 0.9],
            ior=np.r_[np.full(12, 1.5), np.nan],
        )
        hints = [hint for hint in scene.report().hints if "glass" in hint]
        assert len(hints) == told
        assert all(TOUCHING in hint and "patch 12" in hint for hint in hints)


def test_the_gap_that_is_told_is_enough():
    # Radiosity 2 on every patch of a closed room of emission 1 and reflectance 1/2, clear bodies in it or not.
    def room(gap):
        scene = room_with({"block": (box((4, 4, 4), (0, 0, -3 + gap)), 1.5)}).subdivide(4.0)
        return scene.with_materials(scene.reflectance, np.where(np.isnan(scene.ior), 1.0, 0.0)[:, None])

    solution = rad.solve(room(10 * HAIR), 0.02, progress=False)
    # The solution's own error, of single patches: three times the RMS that was asked for.
    np.testing.assert_allclose(solution.radiosity[np.isnan(room(0).ior)], 2.0, rtol=0.06)
    assert solution.report.audit.left == 0.0


def test_a_solve_of_wrong_glass_warns():
    scene = room_with({"ball": (ball(1, inside_out=True), 1.5)})
    scene = scene.with_materials(None, np.where(scene.ior > 0.0, 0.0, 1.0)[:, None])
    with pytest.warns(UserWarning, match="glass turned inside out"):
        rad.solve(scene, 0.3, progress=False)
