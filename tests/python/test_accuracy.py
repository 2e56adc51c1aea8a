"""Scenes solved by rays: what is asked for and what is refused, closed forms, and what the solution says of itself.

The contract, true error against asked tolerance, stands in `test_references.py`.
"""

import subprocess
import sys
import textwrap
from itertools import pairwise
from time import perf_counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import radiosity as rad
import references


def rectangle(corner, u, v, cells=1):
    """Vertices and faces of a parallelogram of cells x cells cells; its front is where u x v points."""
    corner, u, v = (np.array(x, float) for x in (corner, u, v))
    steps = np.arange(cells + 1) / cells
    vertices = [corner + s * u + t * v for t in steps for s in steps]
    faces = []
    for row in range(cells):
        for column in range(cells):
            a = row * (cells + 1) + column
            b, c, d = a + 1, a + cells + 2, a + cells + 1
            faces += [(a, b, c), (a, c, d)]
    return np.array(vertices), np.array(faces)


def scene_of(*parts):
    """A scene of (rectangle, reflectance, emission), one band."""
    vertices, faces, reflectance, emission, base = [], [], [], [], 0
    for (v, f), rho, e in parts:
        vertices.append(v)
        faces.append(f + base)
        base += len(v)
        reflectance += [[rho]] * len(f)
        emission += [[e]] * len(f)
    return rad.Scene(np.concatenate(vertices), np.concatenate(faces), np.array(reflectance), np.array(emission))


# --- Closed forms -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["rays", "dense"])
def test_plates_with_next_to_nothing_between_them(method):
    scene = rad.scenes.parallel_plates(gap=1e-6, reflectance=0.5, emission=((1.0,), (0.0,)), max_edge=0.5)
    solution = rad.solve(scene, 0.01, method=method)
    # B1 = 1 + B2 / 2, B2 = B1 / 2. What leaves by the gap is some 1e-6 of it; the rest is what was asked for.
    lower = np.arange(scene.n_patches) < scene.n_patches // 2
    expected = np.where(lower, 4 / 3, 2 / 3)
    weights = scene.areas / scene.areas.sum()
    error = np.sqrt(weights @ (solution.radiosity[:, 0] - expected) ** 2)
    assert error <= 0.01 * np.sqrt(weights @ (expected - scene.emission[:, 0]) ** 2)


def test_a_lamp_that_lies_on_the_floor_lights_what_it_covers():
    floor = rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0), 4)
    lamp = rectangle((0.25, 0.25, 1e-6), (0, 0.5, 0), (0.5, 0, 0))
    scene = scene_of((floor, 0.0, 0.0), (lamp, 0.0, 3.0))
    solution = rad.solve(scene, 0.01)
    # The lamp's edges follow the mesh: 8 triangles are covered all over. Light spreads by a few gaps beyond an edge, of
    # cells that are 250,000 gaps wide: far below the kernels' 0.05 tolerances.
    centres = scene.centroids[:32]
    covered = ((centres > 0.25) & (centres < 0.75))[:, :2].all(axis=1)
    assert covered.sum() == 8
    assert np.allclose(solution.irradiance[:32, 0], np.where(covered, 3.0, 0.0), rtol=0, atol=3.0 * 0.05 * 0.01)


def test_a_lamp_that_touches_a_wall():
    lamp = rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0))
    wall = rectangle((0, 0, 0), (0, 0, 1), (1, 0, 0), 8)
    scene = scene_of((lamp, 0.0, 2.0), (wall, 0.0, 0.0))
    solution = rad.solve(scene, 0.01)
    # Unit squares with a common edge (Howell C-14, H = W = 1).
    root = np.sqrt(2)
    form_factor = 2 * np.arctan(1) - root * np.arctan(1 / root) + 0.25 * np.log(4 / 3 * (3 / 4) * 3 / 4)
    form_factor /= np.pi
    assert form_factor == pytest.approx(0.2000437761)
    mean = scene.areas[2:] @ solution.irradiance[2:, 0]
    # Nothing stands between: the kernels alone err, by 0.05 tolerances of each form factor.
    assert mean == pytest.approx(2.0 * form_factor, rel=0.05 * 0.01)
    assert solution.report.segments == 0
    assert solution.report.rays == 0


def test_behind_a_wall_it_is_dark_and_before_it_nothing_is_missing():
    # The wall x = 0 stands between the lamp, at x > 0, and the left half of the floor.
    left, right = (rectangle((x, 0, 0), (1, 0, 0), (0, 1, 0), 3) for x in (-1, 0))
    lamp = rectangle((0, 0, 1), (0, 1, 0), (1, 0, 0))
    wall = rectangle((0, -9, 0), (0, 19, 0), (0, 0, 1))
    back = (wall[0], wall[1][:, ::-1])
    scene = scene_of((left, 0.0, 0.0), (right, 0.0, 0.0), (lamp, 0.0, 1.0), (wall, 0.0, 0.0), (back, 0.0, 0.0))
    solution = rad.solve(scene, 0.01)
    assert (solution.irradiance[:18] == 0).all()
    # Unit squares face to face at distance 1 (Howell C-11): 0.1998; all in view, so the kernels' error alone.
    mean = scene.areas[18:36] @ solution.irradiance[18:36, 0]
    assert mean == pytest.approx(0.199824895698, rel=0.05 * 0.01)


# --- Energy on random boxes -------------------------------------------------------------------------------------------


@st.composite
def boxes(draw):
    """A closed box of random shape and colours with one to three lamps among its 48 patches."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    box = rad.scenes.furnace(max_edge=1.0)
    n = box.n_patches
    emission = np.zeros((n, 2))
    lit = rng.choice(n, draw(st.integers(1, 3)), replace=False)
    emission[lit] = rng.uniform(0.5, 20.0, (len(lit), 2))
    return rad.Scene(box.vertices * rng.uniform(0.3, 3.0, 3), box.faces, rng.uniform(0.2, 0.8, (n, 2)), emission)


@given(boxes(), st.integers(0, 2**64 - 1))
@settings(deadline=None, max_examples=15, derandomize=True)
def test_what_is_emitted_is_absorbed(scene, seed):
    solution = rad.solve(scene, 0.03, seed=seed, progress=False)
    area, rho, audit = scene.areas[:, None], scene.reflectance, solution.report.audit
    assert (audit.left == 0).all()
    assert np.allclose(audit.emitted, scene.areas @ scene.emission, rtol=1e-12, atol=0)
    # sum of A (1 - rho) dH, by Cauchy and Schwarz in terms of the norm of rho dH, of which the estimate tells the RMS:
    # three of them, as of standard deviations.
    reflected = np.sqrt((area * (rho * solution.irradiance) ** 2).sum(axis=0))
    lever = np.sqrt((area * ((1 - rho) / rho) ** 2).sum(axis=0))
    gap = np.abs(audit.emitted - audit.absorbed)
    assert (gap <= 3 * solution.error_estimate * reflected * lever).all()


# --- What the solution says of itself ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cornell_298", "two_rooms_276"])
def test_the_estimate_of_dense_factors_includes_discretisation(name):
    reference = references.load(name)
    with pytest.warns(UserWarning, match="from discretisation"):
        solution = rad.solve(reference.scene, 0.01, method="dense")
    # The square of the error is estimated with a standard error of 15 % (or as much of the tolerance's square, which is
    # smaller here): 7.5 % of the error, times four.
    assert solution.error_estimate == pytest.approx(references.error_of_the_worst_band(reference, solution)[0], rel=0.3)


def test_without_refinement_a_tolerance_out_of_reach_is_a_warning():
    # Patches this coarse leave an error of 0.4 % to 0.7 % (the contract's measure): far above what is asked for.
    with pytest.warns(UserWarning, match=r"above the tolerance 0.002: .* from sampling, .* from discretisation"):
        solution = rad.solve(references.load("cornell_298").scene, 0.002, refine=False)
    assert solution.error_estimate > 0.002


@pytest.mark.filterwarnings("ignore:the error is about")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("name", "tolerance"), [("cornell_298", 0.003), ("two_rooms_276", 0.01)])
def test_without_refinement_the_estimate_can_be_believed(name, tolerance, seed):
    reference = references.load(name)
    solution = rad.solve(reference.scene, tolerance, refine=False, seed=seed)
    assert solution.report.elements == reference.scene.n_patches
    assert not solution.report.corrected
    # A factor of two, for the reasons of the contract in test_references.py.
    assert 0.5 <= solution.error_estimate / references.error_of_the_worst_band(reference, solution)[0] <= 2


def test_the_standard_error_is_the_spread_over_seeds():
    scene = references.load("cornell_298").scene
    solutions = [rad.solve(scene, 0.1, seed=seed) for seed in range(16)]
    spread = np.std([s.radiosity for s in solutions], axis=0, ddof=1)
    told = np.sqrt(np.mean([s.standard_error**2 for s in solutions], axis=0))
    # Pooled over patches: the spread of 16 seeds is known to 1 / sqrt(2 * 15) = 18 % even if all patches went together.
    ratio = np.sqrt((scene.areas @ told**2) / (scene.areas @ spread**2))
    assert ((ratio > 1 - 3 * 0.18) & (ratio < 1 + 3 * 0.18)).all()


def test_equal_bands_are_solved_once():
    box = rad.scenes.cornell_box(max_edge=0.3)
    one = box.with_materials(box.reflectance[:, [0]], box.emission[:, [0]])
    three = box.with_materials(box.reflectance[:, [0, 0, 0]], box.emission[:, [0, 0, 0]])
    alone, together = (rad.solve(scene, 0.05) for scene in (one, three))
    for name in ("radiosity", "irradiance", "standard_error"):
        values = getattr(together, name)
        assert values.shape == (box.n_patches, 3)
        for b in range(3):
            assert np.array_equal(values[:, b], getattr(alone, name)[:, 0])
    assert together.report.bands == 3
    assert np.array_equal(together.report.audit.emitted, np.repeat(alone.report.audit.emitted, 3))
    assert together.report.rays == alone.report.rays
    assert together.scene is three


def test_bands_in_any_order_keep_their_places():
    # Bands 0 and 2 are equal, band 1 lies between them in no sorted order.
    solution = rad.solve(rad.scenes.furnace(reflectance=(0.8, 0.3, 0.8), emission=(2.0, 7.0, 2.0)), 0.1)
    # Walls may count as lamps: the kernels of their form factors err by 0.05 tolerances at most.
    assert np.allclose(solution.radiosity, 10.0, rtol=0.05 * 0.1, atol=0)
    assert np.allclose(solution.irradiance, 10.0, rtol=0.05 * 0.1, atol=0)
    other = rad.solve(rad.scenes.furnace(reflectance=(0.5, 0.3, 0.5), emission=(2.0, 7.0, 2.0)), 0.1)
    assert np.allclose(other.radiosity, [4.0, 10.0, 4.0], rtol=0.05 * 0.1, atol=0)


def test_no_emission_is_darkness_and_a_warning():
    for method in ("rays", "dense"):
        with pytest.warns(UserWarning, match="no emission"):
            solution = rad.solve(rad.scenes.cornell_box().with_materials(0.5, 0.0), method=method)
        assert (solution.radiosity == 0).all()
        assert solution.error_estimate == 0


# Dense form factors have an error, which comes back 1 / (1 - rho) times.
@pytest.mark.parametrize(
    ("method", "rho"),
    [("rays", rho) for rho in (0.0, 1e-9, 0.999, 1 - 1e-6, 1 - 1e-9)] + [("dense", rho) for rho in (0.0, 1e-9)],
)
def test_furnaces_of_any_reflectance(method, rho):
    solution = rad.solve(rad.scenes.furnace(reflectance=rho), 0.1, method=method)
    # Rounding, which comes back 1 / (1 - rho) times.
    assert np.allclose(solution.radiosity, 1.0 / (1.0 - rho), rtol=1e-6)


# --- Memory -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("function", [rad.solve, rad.forecast])
def test_too_little_memory_is_refused(function, monkeypatch):
    monkeypatch.setattr(sys.modules["radiosity.solve"], "available_bytes", lambda: 1000)
    with pytest.raises(MemoryError, match=r"298 patches .* 0\.01 needs .*MiB but only 1000 B .* max_edge"):
        function(references.load("cornell_298").scene, 0.01)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the peak of memory from /proc")
def test_memory_is_what_was_forecast():
    program = """
        import re, radiosity as rad
        peak = lambda: 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1])
        rad.solve(rad.scenes.furnace(), 0.1)  # Threads and their stacks.
        scene = rad.scenes.cornell_box(max_edge=0.021)
        before = peak()
        rad.solve(scene, 0.1)
        used = peak() - before
        print(scene.n_patches, rad.forecast(scene, 0.1).nbytes, used)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True, timeout=300
    )
    patches, told, used = map(int, done.stdout.split())
    assert 25_000 < patches < 30_000
    assert used <= told
    # Enough is not to be twice as much: nobody shall be refused who has room.
    assert told <= 2 * used


# --- Bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("function", [rad.solve, rad.forecast])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tolerance": 0.0}, r"tolerance 0\.0 is outside \(0, 1\)"),
        ({"tolerance": 1.0}, r"tolerance 1\.0 is outside \(0, 1\)"),
        ({"tolerance": -0.1}, r"tolerance -0\.1 is outside"),
        ({"tolerance": np.nan}, "tolerance nan is outside"),
        ({"order": 2}, "order 2 is neither 0"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**64}, "seed"),
        ({"threads": 0}, "threads"),
    ],
)
def test_values_out_of_range_are_named(function, arguments, message):
    with pytest.raises(ValueError, match=message):
        function(rad.scenes.furnace(), **arguments)


@pytest.mark.parametrize("function", [rad.solve, rad.forecast])
def test_kinds_that_do_not_fit_are_refused(function):
    with pytest.raises((TypeError, ValueError), match="seed"):
        function(rad.scenes.furnace(), seed=1.5)
    with pytest.raises(TypeError, match=r"radiosity\.Scene, not ndarray"):
        function(np.eye(3))


def test_unknown_methods_are_refused():
    with pytest.raises(ValueError, match="'auto', 'dense', 'rays'"):
        rad.solve(rad.scenes.furnace(), method="gmres")


@pytest.mark.parametrize("method", ["rays", "dense"])
def test_a_closed_scene_that_absorbs_nothing_has_no_solution(method):
    box = rad.scenes.furnace()
    with pytest.raises(ValueError, match="reflectance 1 in band 0"):
        rad.Scene(box.vertices, box.faces, reflectance=1.0, emission=1.0)
    # An edge divided on one of its sides only: no longer closed by its edges, though no light leaves.
    a, b, c = box.faces[0]
    vertices = np.vstack([box.vertices, 0.5 * (box.vertices[a] + box.vertices[b])])
    middle = len(box.vertices)
    faces = np.vstack([[(a, middle, c), (middle, b, c)], box.faces[1:]])
    scene = rad.Scene(vertices, faces, reflectance=1.0, emission=1.0)
    with pytest.raises(ValueError, match="reflectance 1 in band 0"):
        rad.solve(scene, 0.1, method=method)


# --- Progress ---------------------------------------------------------------------------------------------------------


def test_progress_rises():
    seen = []
    rad.solve(rad.scenes.cornell_box(max_edge=0.1), 0.02, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1][0] > 0
    assert all(done <= total for done, total in seen)
    assert all(a[0] <= b[0] and a[1] <= b[1] for a, b in pairwise(seen))


def test_an_exception_in_the_callback_stops_the_solve():
    def refuse(done, total):
        raise RuntimeError("stop it")

    start = perf_counter()
    with pytest.raises(RuntimeError, match="stop it"):
        rad.solve(rad.scenes.cornell_box(max_edge=0.02), 0.002, progress=refuse)
    # The whole would take minutes; the mesh is made first, and the callback is called several times a second.
    assert perf_counter() - start < 20
    assert rad.solve(rad.scenes.furnace(), 0.1).error_estimate < 0.1
