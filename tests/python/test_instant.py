"""Instant radiosity: against path tracing, maps against rays, and what is told when something is wrong."""

import builtins
import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

import radiosity as rad

VIEW = rad.Camera(**rad.scenes.cornell_box_view())
# Inside the unit cube, from corner to corner.
INSIDE = {"origin": (0.05, 0.1, 0.07), "target": (0.9, 0.8, 0.85), "fov": 70.0}


@pytest.fixture(scope="module")
def cornell():
    return rad.scenes.cornell_box()


@pytest.fixture(scope="module")
def lights(cornell):
    return rad.virtual_lights(cornell, 256)


@pytest.fixture(scope="module")
def gpu():
    """Skips where there is no GPU, not even one in software: see tests/install_vulkan.sh."""
    pytest.importorskip("wgpu", reason="the package wgpu is not installed: pip install radiosity[gpu]")
    from radiosity.shadow_maps import _device

    try:
        _device()
    except RuntimeError as error:
        pytest.skip(str(error))


def test_pictures_are_mitsubas_but_for_how_few_lights_there_are(cornell):
    with np.load(Path(__file__).resolve().parents[1] / "data" / "images" / "cornell_128.npz") as data:
        truth, noise = data["image"].astype(float), data["stderr"].astype(float)
    lamp = truth.max(axis=2) > 0.5
    pixels = ~(lamp | np.roll(lamp, 1, 0) | np.roll(lamp, -1, 0) | np.roll(lamp, 1, 1) | np.roll(lamp, -1, 1))
    images = [rad.instant(cornell, VIEW, 128, 128, 1024, seed=seed, progress=False) for seed in range(8)]
    error = np.mean(images, axis=0) - truth
    # No bias: 8 independent scrambles tell how far their mean may be from the truth, pixel by pixel. What is above 1 is
    # the left-out bounces (0.1 %), and the noise of 7 degrees of freedom: their t has a mean square of 7/5.
    spread = np.var(images, axis=0, ddof=1) / 8 + noise**2
    assert np.sqrt((error[pixels] ** 2).sum() / spread[pixels].sum()) < 1.5
    # 1,024 lights make 4 to 5 %, and 16 paths a pixel 4 % that an average over pixels would take away.
    single = images[0] - truth
    relative = np.sqrt((single[pixels] ** 2).sum(axis=0) / (truth[pixels] ** 2).sum(axis=0)).max()
    assert relative < 0.1


def test_lights_serve_many_views_and_read_well(cornell, lights):
    assert len(lights) <= 256
    assert len(lights) == len(lights.flux) == len(lights.patch) == len(lights.bounce) == len(lights.positions)
    assert np.array_equal(lights.normals, cornell.normals[lights.patch])
    assert "256 lights of" in repr(lights)
    assert not lights.flux.flags.writeable
    # Bounce 0 carries the power of the lamp exactly.
    power = cornell.areas @ cornell.emission
    np.testing.assert_allclose(lights.flux[lights.bounce == 0].sum(axis=0), power, rtol=1e-12)
    by_number = rad.instant(cornell, VIEW, 40, 30, 256)
    assert np.array_equal(by_number, rad.instant(cornell, VIEW, 40, 30, lights))
    assert by_number.shape == (30, 40, 3)
    assert not np.array_equal(by_number, rad.instant(cornell, VIEW, 40, 30, 256, seed=1))


def test_what_the_bound_cuts_is_told(cornell, lights):
    # The view is 64 x 64 pixels, those of share_cut: its lamp, seen directly, is not reflected.
    whole, cut = (rad.instant(cornell, VIEW, 64, 64, lights, compensate=compensate) for compensate in (True, False))
    reflected = whole[whole.max(axis=2) < 0.5].sum()
    with pytest.raises(TypeError, match=r"camera must be a radiosity\.Camera, not NoneType"):
        lights.share_cut(None)
    missing = 1.0 - cut[whole.max(axis=2) < 0.5].sum() / reflected
    # Pixels that the lamp covers in part are left out here, and not there: 1 %.
    assert lights.share_cut(VIEW) == pytest.approx(missing, abs=0.01)
    assert 0.03 < missing < 0.3
    assert lights.share_cut(VIEW, bound=1e4 * lights.bound) < 0.01


@pytest.mark.parametrize("shadows", ["rays", "maps"])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_a_furnace_is_as_bright_everywhere_at_any_scale(shadows, scale, request):
    if shadows == "maps":
        request.getfixturevalue("gpu")
    unit = rad.scenes.furnace(reflectance=0.5, emission=1.0)
    scene = rad.Scene(scale * unit.vertices, unit.faces, 0.5, 1.0)
    camera = rad.Camera(*(tuple(scale * x for x in INSIDE[name]) for name in ("origin", "target")), fov=70.0)
    image = rad.instant(scene, camera, 48, 32, 1024, shadows, resolution=256, progress=False)
    # E / (1 - rho) / pi but for the bounces after the ninth (0.1 %), 1,024 lights, 16 paths a pixel, and maps of 256
    # texels, which dim a room of this shape by 0.03 % (benches/instant.py).
    assert image.mean() == pytest.approx(2.0 / np.pi, rel=0.01)


def test_maps_are_rays_but_for_a_texel(gpu, cornell, lights):
    def picture(shadows, resolution=1024):
        return rad.instant(cornell, VIEW, 128, 128, lights, shadows, resolution=resolution, progress=False)

    rays = picture("rays")
    pixels = rays.max(axis=2) < 0.5  # all but the lamp

    def error(image):
        return np.sqrt(((image - rays)[pixels] ** 2).sum() / (rays[pixels] ** 2).sum())

    fine, coarse = picture("maps"), picture("maps", 128)
    # The same lights, places and paths: only edges of shadows differ, by a texel, 1/1000 of the scene, for those of the
    # lights whose shadow edge a pixel lies on. Measured 0.3 % and 2 %.
    assert error(fine) < 0.006
    # First order in the size of a texel: 8 times as large.
    assert 2.0 < error(coarse) / error(fine) < 16.0
    # No acne, no leaks worth mentioning: what is too dark and what is too bright is as little.
    assert fine[pixels].sum() == pytest.approx(rays[pixels].sum(), rel=1e-3)
    off = np.abs(fine - rays).max(axis=2) > 0.05 * rays[pixels].mean()
    assert off[pixels].mean() < 0.01


def test_maps_hide_what_is_behind_large_triangles(gpu):
    # A lamp below a plate of two triangles that reaches far beyond the picture; the ceiling above gets nothing.
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    parts = [0.1 * square, 50.0 * square[::-1] + (0, 0, 0.2), 2.0 * square[::-1] + (0, 0, 1.0)]
    faces = [[4 * k + i for i in face] for k in range(3) for face in ([0, 1, 2], [0, 2, 3])]
    emission = np.repeat([1.0, 0.0, 0.0], 2)[:, None]
    scene = rad.Scene(np.concatenate(parts), faces, 0.0, emission)
    scene = scene.with_materials(np.repeat([0.0, 0.0, 1.0], 2)[:, None], emission)
    camera = rad.Camera((0, 0, 0.5), (0, 0, 1), up=(0, 1, 0), fov=90.0)
    dark = rad.instant(scene, camera, 32, 32, 16, "maps", resolution=64, compensate=False, progress=False)
    assert not dark.any()


@pytest.mark.parametrize("bands", [1, 2, 5])
def test_any_number_of_bands_and_sizes_that_are_no_multiples(gpu, bands):
    scene = rad.scenes.furnace(reflectance=np.linspace(0.2, 0.6, bands), emission=np.linspace(1.0, 2.0, bands))
    camera = rad.Camera(**INSIDE)
    rays, maps = (rad.instant(scene, camera, 37, 19, 100, shadows, progress=False) for shadows in ("rays", "maps"))
    assert maps.shape == (19, 37, bands)
    # A convex room has no shadows: what differs is texels on which two walls meet (benches/instant.py: 0.006 %).
    np.testing.assert_allclose(maps.mean(axis=(0, 1)), rays.mean(axis=(0, 1)), rtol=1e-3)


def test_bad_arguments_are_named(cornell, lights):
    for wrong, kind, message in [
        ({"lights": 0}, ValueError, "lights 0 is outside"),
        ({"lights": -3}, ValueError, "lights -3 is outside"),
        ({"lights": 2.5}, TypeError, "lights must be an integer"),
        ({"lights": True}, TypeError, "lights must be an integer"),
        ({"shadows": "soft"}, ValueError, "'rays', 'maps'"),
        ({"bound": 0.0}, ValueError, "bound 0.0 is not positive"),
        ({"bound": float("nan")}, ValueError, "bound nan is not positive"),
        ({"bound": "1"}, TypeError, "bound must be a number"),
        ({"width": 0}, ValueError, "width 0 is outside"),
        ({"height": 1.0}, TypeError, "height must be an integer"),
        ({"resolution": 8}, ValueError, "resolution 8 is outside"),
        ({"compensate": 1}, TypeError, "compensate must be True or False"),
        ({"seed": -1}, ValueError, "seed -1 is outside"),
        ({"camera": rad.Camera((0.3, 0.3, -0.8), (0.3, 0.3, -2), up=(0, 1, 0))}, ValueError, "looks at nothing"),
        ({"camera": rad.Camera((0.3, 2, 0.3), (0.3, 0, 0.31))}, ValueError, "only the backs"),
        ({"camera": None}, TypeError, r"radiosity\.Camera"),
        ({"scene": rad.scenes.cornell_box(), "lights": lights}, ValueError, "of another scene"),
        ({"scene": cornell.with_materials(0.5, 0.0)}, ValueError, "emits nothing"),
        ({"scene": rad.solve(cornell, 0.1, progress=False)}, TypeError, r"radiosity\.Scene, not Solution"),
    ]:
        with pytest.raises(kind, match=message):
            rad.instant(**{"scene": cornell, "camera": VIEW, "width": 8, "height": 8} | wrong)
    with pytest.raises(TypeError, match=r"radiosity\.Scene"):
        rad.virtual_lights(None)
    broken = dataclasses.replace(lights, patch=lights.patch + 38)
    with pytest.raises(ValueError, match="not of this scene"):
        rad.instant(cornell, VIEW, 8, 8, broken)


def test_a_stopped_picture_stops(cornell, lights):
    def stop(done, total):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        rad.instant(cornell, VIEW, 512, 512, lights, progress=stop)


def test_maps_say_what_is_missing(cornell, monkeypatch):
    from radiosity import shadow_maps

    def no_wgpu(name, *rest):
        if name == "wgpu":
            raise ImportError("none")
        return real(name, *rest)

    real = builtins.__import__
    shadow_maps._device.cache_clear()
    try:
        monkeypatch.delitem(sys.modules, "wgpu", raising=False)
        monkeypatch.setattr(builtins, "__import__", no_wgpu)
        with pytest.raises(ImportError, match=r"pip install radiosity\[gpu\]"):
            rad.instant(cornell, VIEW, 8, 8, 16, "maps", progress=False)
    finally:
        monkeypatch.undo()
        shadow_maps._device.cache_clear()


def test_no_adapter_names_the_remedy(cornell, monkeypatch):
    wgpu = pytest.importorskip("wgpu", reason="the package wgpu is not installed: pip install radiosity[gpu]")
    from radiosity import shadow_maps

    def none(**_):
        raise RuntimeError("Request adapter failed\nand more")

    shadow_maps._device.cache_clear()
    monkeypatch.setattr(wgpu.gpu, "request_adapter_sync", none)
    with pytest.raises(RuntimeError, match="mesa-vulkan-drivers"):
        rad.instant(cornell, VIEW, 8, 8, 16, "maps", progress=False)


def test_more_than_the_gpu_takes_is_refused(gpu, cornell):
    with pytest.raises(ValueError, match="choose a resolution of"):
        rad.instant(cornell, VIEW, 8, 8, 16, "maps", resolution=1 << 20, progress=False)


def test_a_white_room_whose_light_outlives_its_lights_is_told():
    with pytest.warns(UserWarning, match="of all light, which is left out"):
        lights = rad.virtual_lights(rad.scenes.furnace(0.9999, 1.0), 256)
    # B = E / (1 - rho); every bounce brings the power of the one before, but for 1e-4 of it.
    assert lights.left_out == pytest.approx(0.9999 ** (lights.bounce.max() + 1), rel=1e-12)


def test_light_that_leaves_the_scene_is_not_missed():
    assert rad.virtual_lights(rad.Scene(np.eye(3), [[0, 1, 2]], 0.9, 1.0), 64).left_out == 0.0
    # A white box without some of its patches, whose bounces the matrix of form factors follows.
    cube = rad.scenes.furnace(0.9, 1.0, max_edge=0.8)
    scene = rad.Scene(cube.vertices, cube.faces[4:], 0.9, 1.0)
    F = rad.form_factors(scene, tolerance=1e-4, progress=False)
    for count in (300, 1000):
        lights = [rad.virtual_lights(scene, count, seed=seed) for seed in range(8)]
        bounces = [scene.areas @ scene.emission[:, 0]]
        left = scene.emission[:, 0]
        for _ in range(60):
            left = 0.9 * (F @ left)
            bounces.append(scene.areas @ left)
        truth = np.mean([bounces[some.bounce.max() + 1] / bounces[0] for some in lights])
        # Some ten particles tell it, eight times: 1 / sqrt(80), three times over.
        assert np.mean([some.left_out for some in lights]) == pytest.approx(truth, rel=0.35)
