"""The bridge to Mitsuba, and this package's radiosity against Mitsuba's path tracer.

Statistics: a patch's path-traced mean B has the standard error s, so z = (B - truth) / s is nearly a normal number of
mean 0 and RMS 1. Limits are 4.5 deviations (a chance of 7e-6) of what they limit. Seeds are fixed, so a test passes or
fails for good on one variant.
"""

from __future__ import annotations

import glob
import importlib.util
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import radiosity as rad
import references
from radiosity.mitsuba.patch_tracer import PatchTracer

needs_mitsuba = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="Mitsuba is not installed: pip install radiosity[mitsuba]"
)

Array = npt.NDArray[np.float64]

# float32 rounding of a coordinate or a colour on its way through Mitsuba, relative.
SINGLE = 2.0**-23


def mitsuba() -> Any:
    """Mitsuba with the variant set that radiosity uses."""
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant(rad.mitsuba.variant())
    return mi


def paths(with_llvm: int, scalar: int) -> int:
    """The number of paths that the variant can trace in the time of a test; scalar ones are ten times slower."""
    return scalar if rad.mitsuba.variant() == "scalar_rgb" else with_llvm


def check_agreement(difference: Array, standard_error: Array) -> None:
    """Hold differences (m, b) of m independent patches to their standard errors: in sum, and one by one."""
    # Bands share paths: each is a test of its own. The sum is weighed as a whole: single z are drawn below 0, because a
    # patch that happened upon few of the rare bright paths has a small standard error, too.
    pooled = difference.sum(axis=0) / np.sqrt((standard_error**2).sum(axis=0))
    assert np.abs(pooled).max() < 4.5, pooled
    # The RMS of m normal numbers deviates by 1 / sqrt(2 m); the same rare paths raise it by up to 0.1 at 1,300 paths a
    # patch (measured: 1.06), less at more.
    rms = np.sqrt(((difference / standard_error) ** 2).mean(axis=0))
    assert np.abs(rms - 1.0).max() < 4.5 / np.sqrt(2 * len(difference)) + 0.1, rms


def corners(scene: rad.Scene) -> Array:
    return scene.vertices[scene.faces]


# --- Scenes there and back --------------------------------------------------------------------------------------------


@needs_mitsuba
def test_a_scene_survives_the_way_to_mitsuba_and_back() -> None:
    scene = references.load("cornell_298").scene
    back = rad.mitsuba.from_mitsuba(rad.mitsuba.to_mitsuba(scene))
    np.testing.assert_allclose(corners(back), corners(scene), rtol=SINGLE, atol=0)
    np.testing.assert_allclose(back.reflectance, scene.reflectance, rtol=SINGLE, atol=0)
    # Emission is divided by pi and multiplied again: two more roundings.
    np.testing.assert_allclose(back.emission, scene.emission, rtol=3 * SINGLE, atol=0)


@needs_mitsuba
def test_every_patch_keeps_its_own_emission_and_reflectance() -> None:
    rng = np.random.default_rng(5)
    cube = rad.scenes.furnace()
    scene = rad.Scene(cube.vertices, cube.faces, reflectance=rng.random((12, 3)), emission=rng.random((12, 3)))
    back = rad.mitsuba.from_mitsuba(rad.mitsuba.to_mitsuba(scene))
    np.testing.assert_allclose(corners(back), corners(scene), rtol=SINGLE, atol=0)
    np.testing.assert_allclose(back.reflectance, scene.reflectance, rtol=2 * SINGLE)
    np.testing.assert_allclose(back.emission, scene.emission, rtol=3 * SINGLE)


@needs_mitsuba
def test_one_band_becomes_grey() -> None:
    back = rad.mitsuba.from_mitsuba(rad.mitsuba.to_mitsuba(rad.scenes.furnace(reflectance=0.25, emission=2.0)))
    assert back.bands == 3
    assert np.array_equal(back.reflectance, np.full((12, 3), 0.25))
    np.testing.assert_allclose(back.emission, 2.0, rtol=3 * SINGLE)


@needs_mitsuba
def test_other_numbers_of_bands_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"the scene has 4: .*three"):
        rad.mitsuba.to_mitsuba(rad.scenes.furnace(reflectance=[0.1, 0.2, 0.3, 0.4]))


@needs_mitsuba
@pytest.mark.parametrize(("height", "radiance"), [(1.0, 3.0), (-1.0, 0.0)], ids=["front", "back"])
def test_mitsuba_sees_light_from_the_front_only(height: float, radiance: float) -> None:
    mi = mitsuba()
    plate = rad.Scene([[-1, -1, 0], [3, -1, 0], [-1, 3, 0]], [[0, 1, 2]], reflectance=0.0, emission=3.0 * np.pi)
    camera = {
        "type": "perspective",
        "fov": 10.0,
        "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, height], target=[0, 0, 0], up=[0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
    }
    image = np.array(mi.render(rad.mitsuba.to_mitsuba(plate), sensor=mi.load_dict(camera), spp=4))[:, :, :3]
    np.testing.assert_allclose(image, radiance, rtol=4 * SINGLE)


@needs_mitsuba
def test_a_twosided_shape_becomes_two_patches_a_triangle() -> None:
    mi = mitsuba()
    colours = [{"type": "diffuse", "reflectance": {"type": "rgb", "value": rho}} for rho in ([0.5, 0, 0], [0, 0.25, 0])]
    shape = {
        "type": "rectangle",
        "bsdf": {"type": "twosided", "front": colours[0], "back": colours[1]},
        "lamp": {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 2.0, 3.0]}},
    }
    scene = rad.mitsuba.from_mitsuba(mi.load_dict({"type": "scene", "sheet": shape}))
    np.testing.assert_array_equal(scene.normals, [[0, 0, 1]] * 2 + [[0, 0, -1]] * 2)
    np.testing.assert_array_equal(scene.reflectance, [[0.5, 0, 0]] * 2 + [[0, 0.25, 0]] * 2)
    # A multiplication by pi in 64 bits.
    np.testing.assert_allclose(scene.emission, np.pi * np.array([[1, 2, 3]] * 2 + [[0, 0, 0]] * 2), rtol=1e-15)
    assert scene.names is not None
    assert list(scene.names) == ["sheet"] * 4


@needs_mitsuba
@pytest.mark.parametrize(("flip", "mirror", "up"), [(False, 1.0, 1.0), (True, 1.0, -1.0), (False, -1.0, 1.0)])
def test_the_front_is_the_side_that_mitsuba_shades(flip: bool, mirror: float, up: float) -> None:
    mi = mitsuba()
    # A rectangle looks along +z; mirrored in its own plane it still does, though its corners then run clockwise.
    to_world = mi.ScalarTransform4f().scale([mirror, 1.0, 1.0])
    sheet = {"type": "rectangle", "flip_normals": flip, "to_world": to_world}
    scene = rad.mitsuba.from_mitsuba(mi.load_dict({"type": "scene", "sheet": sheet}))
    np.testing.assert_array_equal(scene.normals, [[0, 0, up]] * 2)


@needs_mitsuba
def test_a_texture_becomes_its_mean_over_each_triangle() -> None:
    mi = mitsuba()
    # Reflectance x along u; its mean over a triangle is its value at the centroid. Between two texels Mitsuba
    # interpolates from centre to centre: with texels 1/4 and 3/4, to_uv stretched so that they lie at the edges.
    image = mi.Bitmap(np.repeat(np.array([0.25, 0.75], dtype=np.float32), 3).reshape(1, 2, 3))
    texture = {
        "type": "bitmap",
        "bitmap": image,
        "raw": True,
        "wrap_mode": "clamp",
        "to_uv": mi.ScalarTransform3f().translate([0.25, 0.0]).scale([0.5, 1.0]),
    }
    shape = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": texture}}
    scene = rad.mitsuba.from_mitsuba(mi.load_dict({"type": "scene", "floor": shape}))
    # The rectangle reaches from -1 to 1: u = (x + 1) / 2. Texture coordinates lose a few more bits.
    u = (scene.centroids[:, 0] + 1.0) / 2.0
    np.testing.assert_allclose(scene.reflectance, np.repeat(0.25 + 0.5 * u[:, None], 3, axis=1), rtol=16 * SINGLE)


@needs_mitsuba
def test_everything_that_cannot_become_a_patch_is_named() -> None:
    mi = mitsuba()
    tint = {"type": "rgb", "value": [0.9, 1.0, 0.9]}
    image = {"type": "bitmap", "data": mi.TensorXf(np.full((2, 2, 3), 0.5, dtype=np.float32))}
    scene = mi.load_dict(
        {
            "type": "scene",
            "ball": {"type": "sphere"},
            "pan": {"type": "rectangle", "bsdf": {"type": "conductor", "material": "Au"}},
            "bulb": {"type": "point", "position": [0.0, 0.0, 1.0]},
            "floor": {"type": "rectangle", "bsdf": {"type": "diffuse"}},
            "green": {"type": "cube", "bsdf": {"type": "dielectric", "specular_transmittance": tint}},
            "matt": {"type": "cube", "bsdf": {"type": "dielectric", "specular_reflectance": image}},
            "clear": {"type": "cube", "bsdf": {"type": "dielectric", "specular_transmittance": 1.0}},
        }
    )
    with pytest.raises(ValueError, match="cannot become a Scene") as caught:
        rad.mitsuba.from_mitsuba(scene)
    message = str(caught.value)
    assert "shape 'ball' is a Sphere, not a mesh" in message
    assert "shape 'pan' has the BSDF SmoothConductor" in message
    assert "is a PointLight" in message
    for name in ("green", "matt"):
        assert f"shape '{name}' is a dielectric of colour" in message
    assert "clear" not in message
    assert "floor" not in message


@needs_mitsuba
def test_a_mitsuba_scene_without_shapes_is_refused() -> None:
    with pytest.raises(ValueError, match="it has no shapes"):
        rad.mitsuba.from_mitsuba(mitsuba().load_dict({"type": "scene"}))


# --- The reference ----------------------------------------------------------------------------------------------------


@needs_mitsuba
def test_a_furnace_glows_evenly() -> None:
    furnace = references.load("furnace_cube_300")
    radiosity, standard_error = rad.mitsuba.reference_radiosity(furnace.scene, 400_000, seed=1)
    check_agreement(radiosity - furnace.radiosity, standard_error)


@needs_mitsuba
@pytest.mark.parametrize(("scale", "offset"), [(1e-3, 0.0), (1.0, 1e3), (1e-3, 1.0)])
def test_a_small_or_distant_furnace_glows_as_brightly(scale: float, offset: float) -> None:
    # Left where it is, Mitsuba would find each of these 1 to 2 % dark.
    cube = rad.scenes.furnace(reflectance=0.5, emission=1.0)
    moved = rad.Scene(cube.vertices * scale + offset, cube.faces, reflectance=0.5, emission=1.0)
    radiosity, standard_error = rad.mitsuba.reference_radiosity(moved, paths(600_000, 120_000), seed=2)
    assert np.abs((radiosity - 2.0) / standard_error).max() < 4.5
    # The mean over all patches is known to 0.2 %: less than what is to be seen.
    mean_error = np.sqrt((standard_error**2).mean() / 12)
    assert abs(radiosity.mean() - 2.0) < 4.5 * mean_error
    assert mean_error < 0.004


@needs_mitsuba
def test_high_reflectance_is_right_and_its_standard_error_too() -> None:
    # Closed form 1 / (1 - 0.99) = 100. With Mitsuba's own roulette: 90, and a standard error that claims 1.5.
    cube = rad.scenes.furnace(reflectance=0.99, emission=1.0)
    radiosity, standard_error = rad.mitsuba.reference_radiosity(cube, paths(24_000, 2_400), seed=3)
    # Paths are cut where less than 1e-4 of the light, 0.01, is left out.
    assert np.abs((radiosity - 100.0) / standard_error).max() < 4.5 + 0.01 / standard_error.min()
    assert standard_error.max() < 0.5


@needs_mitsuba
def test_mitsuba_agrees_with_the_stored_cornell_box() -> None:
    cornell = references.load("cornell_298")
    radiosity, standard_error = rad.mitsuba.reference_radiosity(cornell.scene, paths(1_500_000, 500_000), seed=4)
    dark = (cornell.scene.reflectance == 0.0).all(axis=1) | (cornell.standard_error == 0.0).all(axis=1)
    # What no light reaches (the floor under a block) and what reflects none is known exactly, to both.
    np.testing.assert_allclose(radiosity[dark], cornell.radiosity[dark], rtol=SINGLE)
    together = np.hypot(standard_error, cornell.standard_error)[~dark]
    check_agreement((radiosity - cornell.radiosity)[~dark], together)


@needs_mitsuba
def test_the_fast_tracer_agrees_with_the_stored_cornell_box_and_is_better_for_its_paths() -> None:
    cornell = references.load("cornell_298")
    tracer = PatchTracer(cornell.scene)
    # Runs of stratified paths differ in their seed: their spread is the error bar that a single one lacks.
    count = paths(120_000, 40_000)
    runs, traced = zip(*(tracer(count, seed) for seed in range(16)), strict=True)
    assert all(count <= number <= 1.2 * count for number in traced) or tracer.variant == "scalar_rgb"
    spread = np.std(runs, axis=0, ddof=1) / math.sqrt(16)
    dark = (cornell.standard_error == 0.0).all(axis=1)
    difference = np.mean(runs, axis=0) - cornell.radiosity
    # The RMS of Student's t with 15 degrees of freedom is 1.07: within what `check_agreement` allows.
    check_agreement(difference[~dark], np.hypot(spread, cornell.standard_error)[~dark])
    np.testing.assert_allclose(difference[dark], 0.0, atol=SINGLE * cornell.scene.emission.max())
    _, independent = rad.mitsuba.reference_radiosity(cornell.scene, traced[0], seed=1)
    if tracer.variant != "scalar_rgb":  # which traces independent paths
        noise, usual = (
            references.relative_error(cornell.scene, cornell.radiosity, cornell.radiosity, error)[1]
            for error in (math.sqrt(16) * spread, independent)
        )
        assert noise < 0.9 * usual  # measured: 0.75


@needs_mitsuba
def test_the_fast_tracer_refuses_what_it_cannot_trace() -> None:
    with pytest.raises(ValueError, match="three bands and the scene has 4"):
        PatchTracer(rad.scenes.furnace(emission=[1.0] * 4))
    with pytest.raises(ValueError, match="at least 24 are needed"):
        PatchTracer(rad.scenes.furnace())(23)


@needs_mitsuba
def test_any_number_of_bands() -> None:
    # Seven bands: three runs of up to three bands, the last filled up with black.
    rho, emission = np.arange(1, 8) / 10.0, np.arange(1.0, 8.0)
    cube = rad.scenes.furnace(reflectance=rho, emission=emission)
    radiosity, standard_error = rad.mitsuba.reference_radiosity(cube, 120_000, seed=5)
    assert radiosity.shape == standard_error.shape == (12, 7)
    assert np.abs((radiosity - emission / (1.0 - rho)) / standard_error).max() < 4.5


@needs_mitsuba
def test_patches_of_different_emission() -> None:
    # In a closed scene all that is emitted is absorbed: sum A E = sum A (1 - rho) H, with H = (B - E) / rho.
    rng = np.random.default_rng(6)
    cube = rad.scenes.furnace()
    rho, emission = rng.uniform(0.2, 0.8, (12, 3)), rng.uniform(0.0, 1.0, (12, 3))
    scene = rad.Scene(cube.vertices, cube.faces, reflectance=rho, emission=emission)
    radiosity, standard_error = rad.mitsuba.reference_radiosity(scene, paths(600_000, 200_000), seed=6)
    absorbing = scene.areas[:, None] * (1.0 - rho) / rho
    absorbed = (absorbing * (radiosity - emission)).sum(axis=0)
    error = np.sqrt(((absorbing * standard_error) ** 2).sum(axis=0))
    emitted = (scene.areas[:, None] * emission).sum(axis=0)
    assert np.abs((absorbed - emitted) / error).max() < 4.5
    # And the test could see a percent.
    assert (error / emitted).max() < 0.01


@needs_mitsuba
def test_a_thin_sheet_in_a_furnace_glows_on_both_sides() -> None:
    cube = rad.scenes.furnace()
    sheet = np.array([[0.2, 0.3, 0.5], [0.8, 0.3, 0.5], [0.5, 0.8, 0.6]])
    vertices = np.concatenate([cube.vertices, sheet])
    faces = np.concatenate([cube.faces, [[8, 9, 10], [8, 10, 9]]])
    scene = rad.Scene(vertices, faces, reflectance=0.5, emission=1.0)
    radiosity, standard_error = rad.mitsuba.reference_radiosity(scene, paths(280_000, 140_000), seed=7)
    # The two sides are moved 5e-6 of the scene's size apart for tracing: too little to be seen here.
    assert np.abs((radiosity - 2.0) / standard_error).max() < 4.5


@needs_mitsuba
def test_units_of_emission_do_not_matter() -> None:
    cube = rad.scenes.furnace(reflectance=0.5, emission=1.0)
    tiny = rad.scenes.furnace(reflectance=0.5, emission=1e-42)
    one = rad.mitsuba.reference_radiosity(cube, 2400, seed=8)
    other = rad.mitsuba.reference_radiosity(tiny, 2400, seed=8)
    # 1e-42 is less than a 32-bit number can hold. The same paths, and one division and multiplication more.
    np.testing.assert_allclose(np.array(other) * 1e42, np.array(one), rtol=1e-14)


@needs_mitsuba
def test_a_scene_without_light_is_black() -> None:
    radiosity, standard_error = rad.mitsuba.reference_radiosity(rad.scenes.furnace(emission=0.0), 100)
    assert not radiosity.any()
    assert not standard_error.any()


@needs_mitsuba
def test_the_same_seed_gives_the_same_numbers() -> None:
    cube = rad.scenes.furnace()
    first, again, other = (rad.mitsuba.reference_radiosity(cube, 2400, seed=seed)[0] for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@needs_mitsuba
def test_paths_of_few_bounces_leave_out_later_light() -> None:
    # B after k bounces in a furnace: E (1 - rho^(k+1)) / (1 - rho). Here rho = 1: E (k + 1).
    cube = rad.scenes.furnace(reflectance=1.0 - 1e-9, emission=1.0)
    radiosity, standard_error = rad.mitsuba.reference_radiosity(cube, 120_000, seed=9, max_bounces=4)
    assert np.abs((radiosity - 5.0) / standard_error).max() < 4.5


@needs_mitsuba
def test_nearly_perfect_reflectance_is_refused() -> None:
    cube = rad.scenes.furnace(reflectance=0.9999)
    with pytest.raises(ValueError, match=r"reflectance 0\.9999 .*max_bounces"):
        rad.mitsuba.reference_radiosity(cube, 2400)


@needs_mitsuba
def test_a_patch_under_another_is_named() -> None:
    cube = rad.scenes.furnace()
    twice = np.concatenate([cube.faces, cube.faces[4:5]])
    with pytest.raises(ValueError, match=r"patch (4|12): \d+% of the rays"):
        rad.mitsuba.reference_radiosity(rad.Scene(cube.vertices, twice, emission=1.0), 2600)


@needs_mitsuba
@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"paths": 11}, ValueError, "11 paths for 12 patches: at least 24"),
        ({"paths": 1e6}, TypeError, "paths must be an integer, not float"),
        ({"paths": 2400, "seed": -1}, ValueError, "seed"),
        ({"paths": 2400, "seed": 0.5}, TypeError, "seed"),
        ({"paths": 2400, "max_bounces": 0}, ValueError, "max_bounces"),
        ({"paths": 2400, "max_bounces": 2.0}, TypeError, "max_bounces"),
    ],
)
def test_bad_arguments(arguments: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        rad.mitsuba.reference_radiosity(rad.scenes.furnace(), **arguments)


# --- The variant, in processes of their own ---------------------------------------------------------------------------

PROGRAM = """
import json, os, sys
import radiosity as rad
if len(sys.argv) > 1:
    import mitsuba
    mitsuba.set_variant(sys.argv[1])
before = os.environ.get("DRJIT_LIBLLVM_PATH")
radiosity, _ = rad.mitsuba.reference_radiosity(rad.scenes.furnace(), 2400)
import mitsuba
print(json.dumps({"variant": rad.mitsuba.variant(), "set": mitsuba.variant(), "mean": radiosity.mean(),
                  "path_kept": before is None or before == os.environ["DRJIT_LIBLLVM_PATH"]}))
"""


def run(program: str, *arguments: str, **environment: str) -> dict[str, Any]:
    import os

    result = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    answer: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    # 200 paths a patch, 12 patches: a deviation of about 0.5 %.
    assert answer.get("mean", 2.0) == pytest.approx(2.0, rel=0.03)
    return answer


def old_llvm() -> list[str]:
    """LLVM libraries with which Mitsuba's kernels abort the process, where this machine has any."""
    return [path for version in (14, 15) for path in glob.glob(f"/usr/lib/*/libLLVM-{version}.so")]


@needs_mitsuba
@pytest.mark.parametrize("library", ["no library", *old_llvm()])
def test_an_unusable_llvm_leads_to_the_scalar_variant(library: str, tmp_path: Path) -> None:
    if library == "no library":
        broken = tmp_path / "libLLVM-19.so"
        broken.write_text("this is text")
        library = str(broken)
    answer = run(PROGRAM, DRJIT_LIBLLVM_PATH=library)
    assert answer["variant"] == answer["set"] == "scalar_rgb"
    assert answer["path_kept"]


@needs_mitsuba
@pytest.mark.parametrize("library", old_llvm()[-1:])
def test_a_llvm_variant_that_would_abort_is_put_aside_for_a_while(library: str) -> None:
    answer = run(PROGRAM, "llvm_ad_rgb", DRJIT_LIBLLVM_PATH=library)
    assert answer["variant"] == "scalar_rgb"
    assert answer["set"] == "llvm_ad_rgb"


@needs_mitsuba
@pytest.mark.parametrize(
    ("user", "ours"), [("scalar_rgb", ["scalar_rgb"]), ("scalar_spectral", ["llvm_ad_rgb", "scalar_rgb"])]
)
def test_the_variant_of_the_user_stays_set(user: str, ours: list[str]) -> None:
    answer = run(PROGRAM, user)
    assert answer["variant"] in ours
    assert answer["set"] == user


@needs_mitsuba
def test_objects_of_a_variant_without_rgb_are_refused() -> None:
    program = """
import json
import mitsuba
import radiosity as rad
mitsuba.set_variant("scalar_spectral")
try:
    rad.mitsuba.to_mitsuba(rad.scenes.furnace())
except ValueError as error:
    print(json.dumps({"message": str(error)}))
"""
    assert (
        "'scalar_spectral' is set, but radiosity needs an RGB one: call mitsuba.set_variant(" in run(program)["message"]
    )


def test_without_mitsuba_the_message_says_what_to_install() -> None:
    program = """
import json
import sys
sys.modules["mitsuba"] = None
import radiosity as rad
try:
    rad.mitsuba.reference_radiosity(rad.scenes.furnace(), 2400)
except ImportError as error:
    print(json.dumps({"message": str(error)}))
"""
    assert "pip install radiosity[mitsuba]" in run(program)["message"]


# --- Radiosity against the path tracer --------------------------------------------------------------------------------


def merged(fine: rad.Scene, coarse: rad.Scene, values: Array, standard_error: Array) -> tuple[Array, Array]:
    """Return the means (n, b) over the patches of a coarse scene, and their errors, from those of its subdivision."""
    parent = fine.parent
    assert parent is not None
    total = np.zeros((coarse.n_patches, coarse.bands))
    variance = np.zeros_like(total)
    np.add.at(total, parent, fine.areas[:, None] * values)
    np.add.at(variance, parent, (fine.areas[:, None] * standard_error) ** 2)
    return total / coarse.areas[:, None], np.sqrt(variance) / coarse.areas[:, None]


@needs_mitsuba
def test_one_bounce_is_the_path_tracers() -> None:
    # One bounce from evenly bright lamps, E + rho F E, has no discretisation error: patch averages of F are all it
    # takes. So this is a test of form factors and occlusion: a lamp over a plate that throws half-shadows on the floor.
    scene = references.load("penumbra_292").scene
    count = paths(1_000_000, 300_000)
    traced, standard_error = rad.mitsuba.reference_radiosity(scene, count, seed=11, max_bounces=1)
    tolerance = 1e-3
    ours = scene.emission + scene.reflectance * (rad.form_factors(scene, tolerance=tolerance) @ scene.emission)
    lit = (standard_error > 0.0).all(axis=1)
    np.testing.assert_allclose(ours[~lit], traced[~lit], rtol=SINGLE)
    # Rows of F are to be right to the tolerance, which here is a tenth of the noise and less.
    check_agreement((ours - traced)[lit], standard_error[lit])
    # And that for each patch, by the bound that a row's error gives.
    bound = tolerance * scene.reflectance * scene.emission.max(axis=0)
    assert (np.abs(ours - traced) <= 4.5 * standard_error + bound).all()


def coloured_cube() -> rad.Scene:
    """A closed room in which each of three patches is the lamp of its own band: smooth light and no shadows."""
    return rad.scenes.furnace().with_materials(0.5, np.eye(12)[:, :3])


@needs_mitsuba
@pytest.mark.parametrize(
    ("base", "max_edges", "least_gain"),
    [
        # Patch-constant radiosity errs in proportion to the patches' size h where light is smooth: each halving of h
        # divides the error by 2 (measured: 2.0 and 2.2), and a tenth off for patches of uneven shape and noise.
        pytest.param(coloured_cube(), (1.5, 0.75, 0.375), 1.8, id="coloured cube"),
        # Between h and sqrt(h) where patches straddle edges of shadows: by 1.41 or more (measured: 1.6), less a tenth.
        pytest.param(rad.scenes.cornell_box(), (0.3, 0.15), 1.27, id="cornell box"),
    ],
)
def test_our_error_is_discretisation_and_falls_with_refinement(
    base: rad.Scene, max_edges: tuple[float, ...], least_gain: float
) -> None:
    levels = [base.subdivide(max_edges[0])]
    for max_edge in max_edges[1:]:
        levels.append(levels[-1].subdivide(max_edge))
    # One reference, at the finest level: that of a coarser patch is the mean over its parts.
    reference, noise = rad.mitsuba.reference_radiosity(levels[-1], paths(4_000_000, 1_500_000), seed=10)
    errors = []
    for k in reversed(range(len(levels))):
        scene = levels[k]
        # Row errors of 3e-3 move the error by 1e-4 of the light, a hundredth of what is measured here.
        factors = rad.form_factors(scene, tolerance=3e-3)
        solution = rad.solve_system(factors, scene.emission, scene.reflectance, method="gauss_seidel")
        error, own_noise = references.relative_error(scene, solution.radiosity, reference, noise)
        print(f"{scene.n_patches} patches: error {error:.3%}, noise of the reference {own_noise:.3%}")
        errors.insert(0, error)
        if k > 0:
            reference, noise = merged(scene, levels[k - 1], reference, noise)
    gains = np.array(errors[:-1]) / np.array(errors[1:])
    assert errors[-1] > 0.0, "the reference is too noisy to see the error"
    assert gains.min() > least_gain
    # As large as patch-constant radiosity errs with so few patches (Cornell boxes of 190 and 760: 2.0 and 1.2 %).
    assert errors[-1] < 0.02


def _two_buildings() -> rad.Scene:
    """Two houses on a ground of 4 x 4 m, a slit above it: no patch may lie on another one."""
    from radiosity.scenes.builder import Builder

    builder, grey = Builder(), (0.4, 0.5, 0.6)
    builder.wall("ground", 2, 1, 0.0, ([-2.0, -1.0, 0.0, 1.0, 2.0], [-2.0, -1.0, 0.0, 1.0, 2.0], [0.0]), grey)
    builder.box("house", (-1.0, -1.0, 0.05), (0.0, 0.0, 1.5), grey)
    builder.box("house", (0.5, 0.0, 0.05), (1.0, 1.0, 0.8), grey)
    return builder.scene(1.5)


_TABLE = np.random.default_rng(0).random((6, 12, 3))


@needs_mitsuba
@pytest.mark.parametrize(
    "lights",
    [
        (rad.Sky((1.0, 2.0, 3.0)),),
        (rad.Sky(1.0, "overcast"),),
        (rad.Sky.table(_TABLE, north=(1, 1, 0)),),
        (rad.Sun((0.5, 0.3, 0.7), (3.0, 2.0, 1.0)), rad.Sky(1.0, "overcast")),
        (rad.PointLight((0.3, -0.5, 1.2), 2.0),),
        (rad.SpotLight((0.5, -1.5, 2.0), (0.0, 0.5, 0.0), (5.0, 1.0, 2.0), 40.0, 20.0),),
    ],
    ids=["constant", "overcast", "table", "sun and sky", "point", "spot"],
)
def test_lights_agree_with_the_path_tracer(lights):
    scene = _two_buildings()
    solution = rad.solve(scene, 0.003, lights=lights, progress=False)
    traced, error = rad.mitsuba.reference_radiosity(scene, paths(2000, 100) * scene.n_patches, lights=lights)
    # Only in sum: in the shadow of a point light patches that no path has lit yet have no standard error at all.
    both = np.hypot(error, solution.standard_error)
    weights = scene.areas[:, None]
    pooled = (weights * (traced - solution.radiosity)).sum(axis=0)
    assert np.abs(pooled / np.sqrt(((weights * both) ** 2).sum(axis=0))).max() < 4.5
    # And the RMS of the difference is that of the noise, with 4.5 deviations of its own, and of the tolerance.
    off, noise = (np.sqrt((weights * values**2).sum(axis=0)) for values in (traced - solution.radiosity, both))
    size = np.sqrt((weights * traced**2).sum(axis=0))
    assert (off < (1.0 + 4.5 / np.sqrt(2 * scene.n_patches)) * noise + 2 * 0.003 * size).all()


@needs_mitsuba
def test_several_skies_are_refused():
    with pytest.raises(ValueError, match="one sky"):
        rad.mitsuba.to_mitsuba(_two_buildings(), [rad.Sky(1.0), rad.Sky(2.0)])
