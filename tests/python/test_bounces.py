"""Every bounce visible: the steps of the solvers one by one, and their pictures."""

import subprocess
import sys
import threading

import numpy as np
import pytest
from PIL import Image

import radiosity as rad

CAMERA = rad.Camera(**rad.scenes.cornell_box_view())


@pytest.fixture(scope="module")
def box():
    scene = rad.scenes.cornell_box(max_edge=0.3)
    return scene, rad.form_factors(scene, tolerance=1e-2)


def test_a_step_of_jacobi_is_a_bounce(box):
    scene, F = box
    radiosity = scene.emission
    for count, solution in enumerate(rad.bounces(F, tolerance=1e-4), 1):
        irradiance = F @ radiosity
        radiosity = scene.emission + scene.reflectance * irradiance
        # The same sums in another order.
        assert np.allclose(solution.radiosity, radiosity, rtol=1e-12, atol=1e-12)
        assert np.allclose(solution.irradiance, irradiance, rtol=1e-9, atol=1e-9)
        assert solution.report.steps == count
        last = solution
    assert last.history[-1].residual <= 1e-4
    whole = rad.solve_system(F, scene.emission, scene.reflectance, method="jacobi", tolerance=1e-4)
    assert np.array_equal(whole.radiosity, last.radiosity)
    assert whole.history[-1].residual == pytest.approx(last.history[-1].residual, rel=1e-9)


def test_a_scene_is_enough(box):
    scene, _ = box
    first, *_ = rad.bounces(scene)
    # Light straight from the lamp: what it lights is lit, and the lamp alone emits.
    assert first.scene is not None
    assert (first.radiosity >= scene.emission).all()
    assert first.report.steps == 1


def test_a_shot_lights_what_it_reaches(box):
    scene, F = box
    first = next(iter(rad.bounces(F, method="southwell")))
    # The brightest patch has shot all that it emits: its column of F.
    brightest = int(np.argmax((scene.areas[:, None] * scene.emission).sum(axis=1)))
    arriving = F.toarray()[:, [brightest]] * scene.emission[brightest]
    assert np.allclose(first.irradiance, arriving, rtol=1e-12, atol=1e-15)
    assert np.allclose(first.radiosity, scene.emission + scene.reflectance * arriving, rtol=1e-12, atol=1e-15)


def test_every_so_many_and_the_last(box):
    _, F = box
    shots = [solution.report.steps for solution in rad.bounces(F, method="southwell", every=50, tolerance=1e-3)]
    assert shots[:-1] == list(range(50, shots[-1], 50))
    assert shots[-1] > shots[-2]


def test_the_ambient_term_shows_early_what_comes_late(box):
    """Cohen, Chen, Wallace & Greenberg 1988: after few shots the picture with it is closer to the solution."""
    scene, F = box
    exact = rad.solve_system(F, scene.emission, scene.reflectance, method="direct").radiosity

    def off(ambient):
        first = next(iter(rad.bounces(F, method="southwell", every=20, ambient=ambient)))
        return np.sqrt(scene.areas @ (first.radiosity - exact) ** 2).sum(), first.history[0].unshot

    with_it, without = off(True), off(False)
    assert with_it[0] < without[0]
    assert np.array_equal(with_it[1], without[1])


def test_who_stops_asking_stops_the_solver(box):
    _, F = box
    before = threading.active_count()
    steps = rad.bounces(F, 1.0, 0.999, method="jacobi", tolerance=1e-9)
    next(steps)
    next(steps)
    assert threading.active_count() == before + 1
    steps.close()
    assert threading.active_count() == before


def test_a_program_may_end_in_the_middle():
    program = "import numpy as np, radiosity as rad; s = rad.bounces(np.full((50, 50), 0.02), 1.0, 0.9999); next(s)"
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_steps_that_run_out_end_the_iterator(box):
    _, F = box
    assert [solution.report.steps for solution in rad.bounces(F, max_iterations=3, tolerance=1e-9)] == [1, 2, 3]


def test_matrices_without_a_scene(box):
    scene, F = box
    with pytest.raises(ValueError, match="need emission and reflectance"):
        rad.bounces(F.toarray())
    solution = list(rad.bounces(F.toarray(), scene.emission, scene.reflectance))[-1]
    assert solution.scene is None
    with pytest.raises(ValueError, match="every"):
        rad.bounces(F, every=0)
    with pytest.raises(ValueError, match="unknown method"):
        next(rad.bounces(F, method="no such"))


def test_a_strip_of_pictures(box):
    _, F = box
    solutions = list(rad.bounces(F, tolerance=1e-3))
    figure = rad.plot.bounces(solutions, CAMERA, size=32, columns=2)
    images = [axis.images[0].get_array() for axis in figure.axes if axis.images]
    assert len(images) == len(solutions)
    assert [axis.get_title() for axis in figure.axes if axis.images] == [str(k + 1) for k in range(len(solutions))]
    # One exposure for all: light only ever comes in addition.
    means = [float(np.mean(image)) for image in images]
    assert means == sorted(means)
    assert means[0] < means[-1]
    with pytest.raises(ValueError, match="1 labels for"):
        rad.plot.bounces(solutions, CAMERA, ["one"], size=8)
    with pytest.raises(ValueError, match="no solution to draw"):
        rad.plot.bounces([], CAMERA)


def test_an_animation(box, tmp_path):
    _, F = box
    solutions = list(rad.bounces(F, tolerance=1e-3))[:3]
    rad.plot.animation(solutions, CAMERA, tmp_path / "bounces.gif", size=32, seconds=0.1)
    with Image.open(tmp_path / "bounces.gif") as image:
        assert image.n_frames == len(solutions)
        assert image.size == (32, 32)
    with pytest.raises(ValueError, match=r"\.gif"):
        rad.plot.animation(solutions, CAMERA, tmp_path / "bounces.mp4")
    with pytest.raises(ValueError, match="seconds 0"):
        rad.plot.animation(solutions, CAMERA, tmp_path / "bounces.gif", seconds=0)
