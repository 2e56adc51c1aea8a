"""Suns, skies, points and spots: closed forms, a solve under them, pictures, files, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import radiosity as rad

PLATE = ([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])


def plate(bands=1):
    return rad.Scene(*PLATE, reflectance=np.full(bands, 0.5))


def rms(scene, values):
    return np.sqrt(scene.areas @ values**2)


@pytest.mark.parametrize("method", ["rays", "dense"])
def test_crater_scatters_evenly(method):
    depth, rho, elevation, strength = 0.2, 0.3, np.radians(20.0), 1000.0
    scene = rad.scenes.crater(depth, rings=14, reflectance=rho)
    sun = rad.Sun((np.cos(elevation), 0.0, np.sin(elevation)), strength)
    straight, _ = rad.direct_irradiance(scene, sun, 0.003, progress=False)
    # All that enters the mouth, of area pi / 4, arrives: sin e times it, to the tolerance and the polygon of the rim
    # (84 sides: 1 - sin(2 pi / 84) / (2 pi / 84) = 0.1 %).
    assert scene.areas @ straight[:, 0] == pytest.approx(strength * np.sin(elevation) * np.pi / 4, rel=5e-3)
    solution = rad.solve(scene, 0.005, method, lights=sun, progress=False)
    radius = (0.25 + depth**2) / (2 * depth)
    f = depth / (2 * radius)
    exact = strength * np.sin(elevation) * rho * f * (1 - f) / (1 - rho * f)
    dark = straight[:, 0] == 0.0
    assert dark.sum() > 100
    scattered = solution.irradiance[dark, 0]
    # Facets of 1/28 of the diameter bend the sphere by 1e-3 of it; shadow samples may miss slivers: 2 % in the mean.
    assert scattered @ scene.areas[dark] / scene.areas[dark].sum() == pytest.approx(exact, rel=0.02)
    if method == "dense":
        # Without noise of rays every patch has it, but for what facets at the rim see less than a sphere would.
        assert np.abs(scattered / exact - 1.0).max() < 0.1
    # Rays tell what leaves to the error of the solution.
    assert solution.report.audit.imbalance < 0.01


def test_constant_sky_fills_what_patches_leave_open():
    # A box without a lid: pi L (1 - sum of F), and no backs are seen.
    cube = rad.scenes.furnace(max_edge=0.8)
    keep = ~np.isclose(cube.vertices[cube.faces][..., 2], cube.vertices[:, 2].max()).all(axis=1)
    scene = rad.Scene(cube.vertices, cube.faces[keep], reflectance=0.5)
    straight, error = rad.direct_irradiance(scene, rad.Sky(2.0), 0.002, progress=False)
    F = rad.form_factors(scene, 1e-6, progress=False)
    exact = 2.0 * np.pi * (1.0 - F.row_sums)
    # 4.5 deviations of what was asked for.
    assert rms(scene, straight[:, 0] - exact) < 4.5 * 0.002 * rms(scene, exact)
    # Four scrambles tell each patch's error roughly: of 4 degrees of freedom, six deviations are rare.
    assert np.mean(np.abs(straight[:, 0] - exact) <= 6.0 * error[:, 0] + 1e-12) > 0.97


def test_lights_add_up_and_bands_are_apart():
    scene = rad.scenes.city(20.0)
    lights = [rad.Sun((0.3, -0.5, 0.8), (3.0, 2.0, 0.0)), rad.Sky(1.0, "overcast"), rad.PointLight((0, -8, 6), 5.0)]
    both, _ = rad.direct_irradiance(scene, lights, 0.003, progress=False)
    parts = [rad.direct_irradiance(scene, light, 0.003, progress=False)[0] for light in lights]
    # Each to the tolerance.
    for band in range(3):
        assert rms(scene, both[:, band] - sum(parts)[:, band]) < 3 * 0.003 * rms(scene, both[:, band])
    assert not parts[0][:, 2].any()


def test_methods_agree_and_the_tolerance_is_met():
    scene = rad.scenes.city(10.0)
    lights = (rad.Sun((0.5, -0.4, 0.6), 3.0), rad.Sky.table(np.linspace(1.0, 2.0, 32).reshape(4, 8)))
    best = rad.solve(scene, 0.003, "rays", lights=lights, progress=False)
    for tolerance, seed in ((0.1, 1), (0.03, 2)):
        solution = rad.solve(scene, tolerance, lights=lights, seed=seed, progress=False)
        for band in range(3):
            off = rms(scene, (solution.radiosity - best.radiosity)[:, band]) / rms(scene, best.radiosity[:, band])
            assert off < tolerance
    dense = rad.solve(scene, 0.1, "dense", lights=lights, progress=False)
    off = rms(scene, (dense.radiosity - best.radiosity)[:, 0]) / rms(scene, best.radiosity[:, 0])
    # The estimate of the dense solution is that of its true error, to about a half; the best one has its own.
    assert off < 1.5 * dense.error_estimate + 0.003
    assert dense.report.audit.imbalance < 1e-9
    assert np.allclose(dense.radiosity, scene.reflectance * dense.irradiance, rtol=1e-9)


def test_sky_coefficients_serve_every_sky():
    scene = rad.scenes.city(20.0)
    matrix = rad.sky_coefficients(scene, 4, 8, rays=4096, north=(1, 1, 0), progress=False)
    assert matrix.shape == (scene.n_patches, 32)
    radiance = np.random.default_rng(1).random((4, 8))
    straight, _ = rad.direct_irradiance(scene, rad.Sky.table(radiance, north=(1, 1, 0)), 0.003, progress=False)
    # 4096 quasi-random rays: better than 1 / 64 of pi.
    assert rms(scene, matrix @ radiance.ravel() - straight[:, 0]) < rms(scene, straight[:, 0]) / 64


def test_a_table_lies_as_it_says():
    scene = plate()
    radiance = np.zeros((6, 8))
    radiance[1, 2] = 1.0  # polar angles 30 to 60 degrees, azimuths 90 to 135: from east to south-east
    wall = rad.Scene([[0, 0, 0], [0, 0, 1], [0, 1, 0]], [[0, 2, 1]], reflectance=0.5)  # looks to +x, east
    assert wall.normals[0] == pytest.approx((1, 0, 0))
    sky = rad.Sky.table(radiance)
    level, _ = rad.direct_irradiance(scene, sky, 1e-3, progress=False)
    east, _ = rad.direct_irradiance(wall, sky, 1e-3, progress=False)
    a, b, turn = np.radians(30), np.radians(60), np.radians(45)
    # Integrals of cos theta sin theta and of sin^2 theta cos(azimuth - 90 degrees); 4.5 deviations.
    assert level[0, 0] == pytest.approx(turn * (np.sin(b) ** 2 - np.sin(a) ** 2) / 2, rel=5e-3)
    part = (b - a) / 2 - (np.sin(2 * b) - np.sin(2 * a)) / 4
    assert east[0, 0] == pytest.approx(part * np.sin(turn), rel=5e-3)


def test_gathered_picture_has_the_sun_and_its_shadow():
    # A plate under a smaller one: the pixel in full light and the one in full shadow.
    low = np.array(PLATE[0], float)
    high = 0.25 + 0.5 * low
    scene = rad.Scene(
        np.vstack([low, high * [1, 1, 0] + [0, 0, 0.4]]), [*PLATE[1], [4, 5, 6], [4, 6, 7]], reflectance=0.5
    )
    solution = rad.solve(scene, 0.02, lights=rad.Sun((0.0, 0.0, 2.0), np.pi), progress=False)
    camera = rad.Camera((0.5, -2.0, 1.0), (0.5, 0.5, 0.0), fov=40)
    image = rad.render(solution, camera, 64, 64, "gather", tolerance=0.02, progress=False)
    # rho E / pi; the upper plate's back brings nothing to the floor.
    assert image.max() == pytest.approx(0.5, rel=1e-6)
    column = image[:, 32, 0]
    assert ((column > 0.0) & (column < 0.01)).any() or (column == 0.0).any()
    smooth = rad.render(solution, camera, 64, 64, "smooth", progress=False)
    assert smooth.max() <= 0.5 * (1 + 1e-9)


def test_lights_are_saved(tmp_path):
    lights = (
        rad.Sun((1, 2, 3), 4.0),
        rad.Sky(1.0, "overcast"),
        rad.Sky.table(np.ones((2, 3))),
        rad.PointLight((0, 0, 1), 1.0),
        rad.SpotLight((0, 0, 2), (0, 0, 0), 1.0, 30.0),
    )
    solution = rad.solve(plate(2), 0.1, lights=lights, progress=False)
    rad.save(solution, tmp_path / "lit.npz")
    again = rad.load_solution(tmp_path / "lit.npz")
    assert [type(light) for light in again.lights] == [type(light) for light in solution.lights]
    for a, b in zip(solution.lights, again.lights, strict=True):
        for name in vars(a):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    np.testing.assert_array_equal(again.irradiance, solution.irradiance)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rad.Sun((0, 0, 0), 1.0), "no direction"),
        (lambda: rad.Sun((0, 0, 1), -1.0), "sun irradiance -1 is outside"),
        (lambda: rad.Sun((0, np.nan, 1), 1.0), "sun towards"),
        (lambda: rad.Sky(1.0, "cloudy"), "unknown distribution"),
        (lambda: rad.Sky.table(np.ones(3)), "rows, columns"),
        (lambda: rad.Sky.table(np.ones((2, 2)), north=(0, 0, 1)), "along up"),
        (lambda: rad.PointLight((0, 0, 1e200), 1.0), "point light position"),
        (lambda: rad.SpotLight((0, 0, 1), (0, 0, 1), 1.0), "same point"),
        (lambda: rad.SpotLight((0, 0, 1), (0, 0, 0), 1.0, 190.0), "cutoff 190"),
        (lambda: rad.SpotLight((0, 0, 1), (0, 0, 0), 1.0, 20.0, 30.0), "beam 30"),
        (lambda: rad.direct_irradiance(plate(), rad.Sun((0, 0, 1), (1.0, 2.0))), "light 0: its irradiance has 2 bands"),
        (lambda: rad.direct_irradiance(plate(), rad.Sky(1.0), tolerance=2.0), "tolerance 2"),
        (lambda: rad.solve(plate(), 0.1, "hierarchical", lights=rad.Sky(1.0)), "takes no lights"),
        (lambda: rad.solve(rad.Scene(*PLATE, mirror=0.5), 0.1, lights=rad.Sky(1.0)), "patch 0 is a mirror"),
        (lambda: rad.sky_coefficients(plate(), 0, 4), "rows 0"),
        (lambda: rad.scenes.crater(0.7), "depth 0.7"),
    ],
)
def test_bad_lights_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_what_is_no_light_is_named():
    with pytest.raises(TypeError, match="light 1 must be a Sun"):
        rad.solve(plate(), 0.1, lights=[rad.Sky(1.0), 3.0])
    with pytest.raises(TypeError, match="lights must be lights"):
        rad.solve(plate(), 0.1, lights=3.0)


def test_dense_solutions_know_the_noise_of_a_sky():
    scene = rad.scenes.city(max_edge=16.0)
    solutions = [
        rad.solve(scene, 0.05, "dense", lights=rad.Sky(100.0, "overcast"), seed=seed, progress=False)
        for seed in range(6)
    ]
    spread = np.std([solution.radiosity for solution in solutions], axis=0, ddof=1)
    told = np.mean([solution.standard_error for solution in solutions], axis=0)

    def size(values):
        return np.sqrt(scene.areas @ values**2).max()

    # The spread of six is known to a few per cent of some hundred patches together; what is told is from few scrambles.
    assert 0.5 * size(spread) <= size(told) <= 2.0 * size(spread)
