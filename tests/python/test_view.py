"""The viewer: what the page holds, and what a real browser makes of it."""

import json
import re
import shutil

import numpy as np
import pytest

import radiosity as rad
from radiosity.render import to_srgb

VIEW = rad.Camera(**rad.scenes.cornell_box_view())
SIZE = 400


@pytest.fixture(scope="module")
def solution():
    return rad.solve(rad.scenes.cornell_box(max_edge=0.1), 0.05, progress=False)


@pytest.fixture(scope="module")
def browser():
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next((found for found in map(shutil.which, names) if found), None)
    if path is None:
        pytest.skip("no Chromium on this machine: see tests/install_chromium.sh")
    api = pytest.importorskip("playwright.sync_api")
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=flags)
        yield browser
        browser.close()


@pytest.fixture
def opened(browser, tmp_path):
    """Opens a view from a file without a network; what goes wrong in the page fails the test."""
    pages, errors = [], []

    def open_page(view):
        view.save(tmp_path / "view.html")
        page = browser.new_page(viewport={"width": SIZE, "height": SIZE})
        pages.append(page)
        page.context.set_offline(True)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto((tmp_path / "view.html").as_uri())
        page.wait_for_function("window.viewer && window.viewer.ready", timeout=60_000)
        page.evaluate("document.getElementById('panel').open = true")
        page.add_style_tag(content="#panel, #patch { opacity: 0 }")
        return page

    yield open_page
    for page in pages:
        page.close()
    assert errors == []


def picture(page):
    from io import BytesIO

    from PIL import Image

    return np.asarray(Image.open(BytesIO(page.screenshot())).convert("RGB")).astype(int)


@pytest.mark.parametrize("shading", ["smooth", "flat"])
def test_the_browser_shows_what_render_shows(opened, solution, shading):
    page = opened(rad.show(solution, VIEW, exposure=4.0))
    page.select_option("#shading", shading)
    expected = to_srgb(rad.render(solution, VIEW, SIZE, SIZE, shading, progress=False), 4.0).astype(int)
    difference = np.abs(picture(page) - expected)
    # Half floats and roundings: a level of 255. At edges a browser has other samples than we.
    assert np.percentile(difference, 95) <= 2
    assert difference.mean() <= 1.0


def test_exposure_false_colours_and_lines_change_the_picture(opened, solution):
    page = opened(rad.show(solution, VIEW, exposure=2.0))
    first = picture(page)
    page.locator("#exposure").fill("1")
    expected = to_srgb(rad.render(solution, VIEW, SIZE, SIZE, progress=False), 4.0).astype(int)
    assert np.percentile(np.abs(picture(page) - expected), 95) <= 2
    page.locator("#exposure").fill("0")
    page.check("#lines", force=True)
    assert (picture(page) != first).mean() > 0.02
    page.uncheck("#lines", force=True)
    assert (picture(page) == first).mean() > 0.999
    assert not page.locator("#bar").is_visible()
    page.select_option("#mode", "irradiance")
    assert page.locator("#bar").is_visible()
    assert "W/m²" in page.locator("#most").inner_text()
    shown = picture(page)[: SIZE - 60]
    # From dark blue to green and yellow.
    assert shown[..., 2].max() > 100
    assert shown[..., 1].max() > 150


def test_a_click_tells_the_numbers_of_a_patch(opened, solution):
    page = opened(rad.show(solution, VIEW))
    x, y = 0.5 * SIZE, 0.8 * SIZE
    page.mouse.click(x, y)
    picked = page.evaluate("viewer.state.picked")
    up, right = 1.0 - 2.0 * y / SIZE, 2.0 * x / SIZE - 1.0
    half = np.tan(np.radians(0.5 * VIEW.fov))
    # The camera looks along +z with y up: right is -x.
    direction = np.array([[-right * half, up * half, 1.0]])
    assert picked == solution.scene.intersect(np.array([VIEW.origin]), direction).patch[0]
    text = page.locator("#patch").text_content()
    assert f"patch {picked}" in text
    assert solution.scene.names[picked] in text
    for value in solution.irradiance[picked]:
        assert f"{value:.4g}"[:5] in text


def test_the_slider_runs_over_bounces_and_the_camera_moves(opened):
    scene = rad.scenes.cornell_box(max_edge=0.3)
    F = rad.form_factors(scene, 0.1, progress=False)
    system = rad.bounces(F, scene.emission, scene.reflectance, method="jacobi")
    steps = [one for one, _ in zip(system, range(3), strict=False)]
    page = opened(rad.show(steps, VIEW, labels=["direct", "+1", "+2"]))
    assert page.locator("#label").text_content() == "+2"
    last = picture(page).sum()
    page.locator("#frame").fill("0")
    assert page.locator("#label").text_content() == "direct"
    first = picture(page)
    assert first.sum() < last, "every bounce adds light"
    page.mouse.move(200, 320)
    page.mouse.down()
    page.mouse.move(260, 320)
    page.mouse.up()
    assert (picture(page) != first).mean() > 0.1, "dragging orbits"
    page.locator("#reset").evaluate("button => button.click()")
    assert (picture(page) == first).mean() > 0.999
    before = page.evaluate("viewer.camera.position.z")
    page.keyboard.down("w")
    page.wait_for_function(f"viewer.camera.position.z > {before} + 0.01")
    page.keyboard.up("w")


def test_fifty_thousand_triangles_fit_in_5_mb_and_are_seen_in_a_notebook():
    scene = rad.scenes.cornell_box(max_edge=0.0155)
    assert scene.n_patches > 50_000
    solution = rad.solve(scene, 0.3, progress=False)
    view = rad.show(solution, VIEW)
    assert len(view.page) < 5_000_000
    assert view._repr_html_().startswith('<iframe srcdoc="&lt;!doctype html&gt;')
    assert "http://" not in view.page.split("<script>")[0]


def test_lux_and_elements_and_what_is_refused(solution, tmp_path):
    hierarchical = rad.solve(rad.scenes.cornell_box(), 0.3, "hierarchical", progress=False)
    assert '"what": "element"' in rad.show(hierarchical, unit="lux").page
    with pytest.raises(ValueError, match="unknown unit"):
        rad.show(solution, unit="candela")
    with pytest.raises(ValueError, match="no solution"):
        rad.show([])
    with pytest.raises(TypeError, match=r"radiosity\.Solution"):
        rad.show([solution.scene])
    with pytest.raises(ValueError, match="not of one scene"):
        rad.show([solution, hierarchical])
    other = rad.solve(solution.scene.with_materials(0.3, solution.scene.emission), 0.3, progress=False)
    with pytest.raises(ValueError, match="one set of materials"):
        rad.show([solution, other])
    with pytest.raises(TypeError, match="height"):
        rad.show(solution, height="600px")
    bright = rad.solve(solution.scene.with_materials(0.5, 1e100 * solution.scene.emission), 0.3, progress=False)
    with pytest.raises(ValueError, match="a browser can show"):
        rad.show(bright)
    with pytest.raises(ValueError, match="labels"):
        rad.show(solution, labels=["a", "b"])
    five = solution.scene.with_materials(0.5, np.arange(1.0, 6.0))
    with pytest.raises(ValueError, match="not 5"):
        rad.show(rad.solve(five, 0.3, progress=False))
    with pytest.raises(ValueError, match="no geometry"):
        rad.show(rad.solve_system(np.zeros((2, 2)), 1.0, 0.5, progress=False))
    with pytest.raises(ValueError, match=r"\.html"):
        rad.show(solution).save(tmp_path / "view.pdf")


def test_up_turns_the_first_view(solution):
    def first(**options):
        page = rad.show(solution, **options).page
        return json.loads(re.search(r'"camera": (\{.*?\})', page)[1])

    low, high = solution.scene.vertices.min(axis=0), solution.scene.vertices.max(axis=0)
    for up in ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]):
        camera = first(up=up)
        assert camera["up"] == up
        # From above: higher than all of the scene.
        assert np.dot(camera["origin"], up) > np.dot(high, up)
        np.testing.assert_allclose(camera["target"], 0.5 * (low + high))
    with pytest.raises(ValueError, match="is no direction"):
        rad.show(solution, up=(0, 0, 0))
    for wrong in (solution.scene, None):
        with pytest.raises(TypeError, match=r"must be a radiosity\.Solution"):
            rad.show(wrong)
