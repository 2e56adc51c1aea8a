"""Pictures: known radiance, orientation, shading, files."""

import sys

import numpy as np
import pytest

import radiosity as rad
from images import path_traced, relative_rmse
from radiosity.render import auto_exposure, exposure_of, to_srgb


@pytest.fixture(scope="module")
def lit_square():
    """A unit square at z = 0 that faces up, its left half bright (radiosity 2 pi), its right half dim (pi)."""
    vertices = [[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, 1, 0], [1, 1, 0]]
    faces = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]]
    scene = rad.Scene(vertices, faces, reflectance=0.0, emission=np.pi * np.array([[2.0], [2.0], [1.0], [1.0]]))
    return rad.solve(scene)


DOWN = rad.Camera((0.5, 0.5, 2.0), (0.5, 0.5, 0.0), up=(0, 1, 0), fov=30.0)


@pytest.mark.parametrize("shading", ["flat", "smooth"])
def test_radiance_is_radiosity_over_pi_and_x_runs_to_the_right(lit_square, shading):
    image = rad.render(lit_square, DOWN, 40, 30, shading=shading)
    assert image.shape == (30, 40, 1)
    # The middle of each half, away from its borders: exact up to a division by pi.
    assert np.allclose(image[10:20, 12:19], 2.0, rtol=1e-12)
    assert np.allclose(image[10:20, 21:28], 1.0, rtol=1e-12)


def test_row_0_is_on_top(lit_square):
    # Seen from above with +x up: the dim half is on top.
    image = rad.render(lit_square, rad.Camera((0.5, 0.5, 2.0), (0.5, 0.5, 0.0), up=(1, 0, 0), fov=30.0), 32, 32)
    assert image[10, 16, 0] == pytest.approx(1.0)
    assert image[22, 16, 0] == pytest.approx(2.0)


def test_mean_over_the_image_is_the_solid_angle(lit_square):
    # The square fills (0.5 / 2 / tan 15 deg)^2 of the picture; jittered pixels at its border average to that.
    image = rad.render(lit_square, DOWN, 200, 200)
    covered = (0.25 / np.tan(np.radians(15))) ** 2
    # 800 border pixels of 16 samples: a standard error of 0.5 * sqrt(800) / sqrt(16) / 40000 = 1e-4.
    assert image.mean() == pytest.approx(1.5 * covered, rel=1e-3)


def test_backs_and_empty_space_are_black(lit_square):
    with pytest.raises(ValueError, match="sees only the backs of patches"):
        rad.render(lit_square, rad.Camera((0.5, 0.5, -2.0), (0.5, 0.5, 0.0), up=(0, 1, 0)), 8, 8)
    with pytest.raises(ValueError, match="looks at nothing"):
        rad.render(lit_square, rad.Camera((0.5, 0.5, 2.0), (0.5, 0.5, 4.0), up=(0, 1, 0)), 8, 8)
    image = rad.render(lit_square, rad.Camera((0.5, 0.5, 2.0), (0.5, 0.5, 0.0), up=(0, 1, 0), fov=90.0), 32, 32)
    assert (image[0] == 0).all()


def test_smooth_shading_is_continuous_where_flat_is_not():
    solution = rad.solve(rad.scenes.cornell_box(max_edge=0.2), tolerance=0.05)
    camera = rad.Camera((0.278, 0.273, -0.8), (0.278, 0.273, 0.0), up=(0, 1, 0), fov=39.3)
    flat, smooth = (rad.render(solution, camera, 96, 96, shading=shading) for shading in ("flat", "smooth"))
    wall = np.s_[25:40, 30:65]  # the back wall above the blocks

    def steps(image):
        return np.abs(np.diff(image[wall], axis=1)).max()

    # A patch of the wall is some ten pixels wide, and interpolation spreads the step at its border over these. A third
    # leaves room for the steepest of them.
    assert steps(smooth) < 0.3 * steps(flat)
    # Interpolation moves light about but keeps how much there is, save what crosses the border of the cut-out, which is
    # a tenth of it at most: one patch in ten.
    assert smooth[wall].mean() == pytest.approx(flat[wall].mean(), rel=0.1)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_the_same_bits_for_any_number_of_threads(lit_square, threads):
    expected = rad.render(lit_square, DOWN, 33, 17)
    assert np.array_equal(rad.render(lit_square, DOWN, 33, 17, threads=threads), expected)


def test_bad_arguments_are_named(lit_square):
    with pytest.raises(ValueError, match="'flat', 'smooth'"):
        rad.render(lit_square, DOWN, shading="glossy")
    with pytest.raises(ValueError, match="width 0 is outside"):
        rad.render(lit_square, DOWN, width=0)
    with pytest.raises(TypeError, match="height must be an integer"):
        rad.render(lit_square, DOWN, height=1.5)
    with pytest.raises(ValueError, match="knows no geometry"):
        rad.render(rad.solve_system(np.zeros((1, 1)), 1.0, 0.5), DOWN)
    with pytest.raises(TypeError, match=r"radiosity\.Solution"):
        rad.render(lit_square.scene, DOWN)
    for bad, message in [
        ({"target": (0, 0, 0)}, "same point"),
        ({"up": (0, 0, 2)}, "parallel to the view"),
        ({"fov": 180.0}, r"outside \(0, 180\)"),
        ({"origin": (0, 0, np.nan)}, "not finite"),
    ]:
        with pytest.raises(ValueError, match=message):
            rad.Camera(**{"origin": (0, 0, 0), "target": (0, 0, 1), "up": (0, 1, 0)} | bad)


def test_png_holds_srgb(tmp_path):
    image = np.zeros((2, 3, 3))
    image[0, 0] = (1.0, 0.5, 0.0)
    image[1, 2] = 2.0
    path = tmp_path / "picture.png"
    rad.save_image(path, image, exposure=1.0)
    Image = pytest.importorskip("PIL.Image")
    with Image.open(path) as opened:
        pixels = np.asarray(opened)
    # IEC 61966-2-1: 0.5 is 188 of 255; what is brighter than white is white.
    assert pixels.tolist()[0][0] == [255, 188, 0]
    assert pixels.tolist()[1][2] == [255, 255, 255]
    assert to_srgb(np.zeros((1, 1, 1))).tolist() == [[[0]]]


def test_exr_holds_the_numbers(tmp_path):
    OpenEXR = pytest.importorskip("OpenEXR")
    image = np.random.default_rng(0).random((5, 7, 3)) * 100
    path = tmp_path / "picture.exr"
    rad.save_image(path, image)
    with OpenEXR.File(str(path)) as file:
        pixels = file.channels()["RGB"].pixels
    # Stored as float32.
    assert np.allclose(pixels, image, rtol=1e-7)
    rad.save_image(tmp_path / "grey.exr", image[..., :1])


def test_a_failed_save_leaves_the_old_file_whole(tmp_path, monkeypatch):
    path = tmp_path / "picture.png"
    path.write_bytes(b"old")
    for image, message in [
        (np.zeros((2, 2, 5)), "1 band .* or 3"),
        (np.zeros((2, 2)), "must have shape"),
        (np.full((2, 2, 3), np.nan), "not finite"),
        (np.zeros((0, 2, 3)), "must have shape"),
    ]:
        with pytest.raises(ValueError, match=message):
            rad.save_image(path, image)
    with pytest.raises(ValueError, match=r"formats are \('.png', '.exr'\)"):
        rad.save_image(tmp_path / "picture.jpg", np.zeros((2, 2, 3)))
    with pytest.raises(ValueError, match="exposure"):
        rad.save_image(path, np.zeros((2, 2, 3)), exposure=0.0)
    with pytest.raises(FileNotFoundError, match="no such folder"):
        rad.save_image(tmp_path / "missing" / "picture.png", np.zeros((2, 2, 3)))

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(sys.modules["radiosity.render"], "_write_png", fail)
    with pytest.raises(OSError, match="disk full"):
        rad.save_image(path, np.zeros((2, 2, 3)))
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["picture.png"]


CORNELL_VIEW = rad.Camera(**rad.scenes.cornell_box_view())


@pytest.fixture(scope="module")
def traced():
    """Mitsuba's picture of the Cornell box, its standard error, and the pixels beside the lamp."""
    return path_traced("cornell")


@pytest.fixture(scope="module")
def solved_cornell():
    return rad.solve(rad.scenes.cornell_box(max_edge=0.05), 0.01, progress=False)


@pytest.mark.parametrize("tolerance", [0.03, 0.01])
def test_gathered_pictures_are_mitsubas_within_the_tolerance(traced, solved_cornell, tolerance):
    truth, standard_error, pixels = traced
    image = rad.render(solved_cornell, CORNELL_VIEW, 128, 128, "gather", tolerance=tolerance, progress=False)
    noise = np.sqrt((standard_error[pixels] ** 2).sum(axis=0) / (truth[pixels] ** 2).sum(axis=0)).max()
    # Sampling as asked; patches that straddle the foot of a block, whose mean is wrong on either side, show beside it:
    # 0.8 % of the picture, measured at a tolerance of 0.005 with the noise taken off.
    assert relative_rmse(image, truth, pixels) <= np.hypot(np.hypot(tolerance, noise), 0.01)
    # No bias: the mean over 15,000 pixels has next to no noise, and that of the solution is within 1 %.
    np.testing.assert_allclose(image[pixels].mean(axis=0), truth[pixels].mean(axis=0), rtol=0.01)


def test_smooth_pictures_of_patches_are_mitsubas_but_for_what_patches_cannot_show(traced, solved_cornell):
    truth, _, pixels = traced
    smooth = rad.render(solved_cornell, CORNELL_VIEW, 128, 128, progress=False)
    # Patches of 5 cm spread the edge of a shadow over 6 of 128 pixels: measured 5.3 %.
    assert relative_rmse(smooth, truth, pixels) <= 0.07


def test_a_gathered_picture_is_refined_pass_by_pass(solved_cornell):
    seen = []
    image = rad.render(
        solved_cornell,
        CORNELL_VIEW,
        32,
        24,
        "gather",
        tolerance=0.01,
        on_image=lambda picture, error: seen.append((picture, error)),
        progress=False,
    )
    assert len(seen) > 1
    assert all(picture.shape == (24, 32, 3) for picture, _ in seen)
    np.testing.assert_array_equal(seen[-1][0], image)
    assert seen[-1][1] <= 0.01 < seen[-2][1]

    def stop(picture, error):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        rad.render(solved_cornell, CORNELL_VIEW, 32, 24, "gather", on_image=stop, progress=False)
    for wrong, error in ((0.0, ValueError), (1.0, ValueError), (float("nan"), ValueError), ("1 %", TypeError)):
        with pytest.raises(error, match="tolerance"):
            rad.render(solved_cornell, CORNELL_VIEW, 32, 24, "gather", tolerance=wrong, progress=False)


def test_gathered_pictures_hardly_depend_on_the_patches(traced):
    truth, _, pixels = traced
    coarse = rad.solve(rad.scenes.cornell_box(), 0.01, progress=False)
    image = rad.render(coarse, CORNELL_VIEW, 128, 128, "gather", tolerance=0.01, progress=False)
    # A wall is two patches, so what it reflects a second time is off by more than half in places. Measured 7.7 %.
    assert relative_rmse(image, truth, pixels) <= 0.1


def test_exposure_depends_neither_on_lamps_nor_on_size_nor_on_the_mesh():
    scene = rad.scenes.gallery()
    solution = rad.solve(scene, 0.1, progress=False)
    camera = rad.Camera(**rad.scenes.gallery_view())
    # The windows are more than 5 % of a square picture and less of a wide one: a percentile over all pixels differs by
    # a factor of 4. What else is seen differs, too: measured 1.38.
    of_picture = [
        auto_exposure(rad.render(solution, camera, *size, progress=False)) for size in ((200, 200), (320, 180))
    ]
    assert of_picture[0] == pytest.approx(of_picture[1], rel=0.5)
    of_mesh = [
        exposure_of(rad.solve(rad.scenes.cornell_box(max_edge), 0.05, progress=False), None) for max_edge in (None, 0.1)
    ]
    # Large patches hide what is bright on a part of them: measured 1.40 (a percentile over patches: 12).
    assert of_mesh[0] == pytest.approx(of_mesh[1], rel=0.5)


def test_what_a_shading_does_not_take_is_refused(lit_square):
    with pytest.raises(ValueError, match="on_image tells of the passes"):
        rad.render(lit_square, DOWN, 8, 8, on_image=print)
    with pytest.raises(ValueError, match="tolerance -1 is outside"):
        rad.render(lit_square, DOWN, 8, 8, tolerance=-1)
    with pytest.raises(ValueError, match=r"scene reaches from \[0, 0, 0\] to \[1, 1, 0\]"):
        rad.render(lit_square, rad.Camera((0.5, 0.5, 2.0), (0.5, 0.5, 4.0), up=(0, 1, 0)), 8, 8)
