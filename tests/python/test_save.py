"""Files of solutions: each format read back by another program, and what a failed save leaves."""

import dataclasses
from pathlib import Path

import meshio
import numpy as np
import pygltflib
import pytest
import trimesh

import radiosity as rad
from radiosity.files import replacing
from radiosity.render import exposure_of, to_srgb


@pytest.fixture(scope="module")
def solution():
    return rad.solve(rad.scenes.cornell_box(max_edge=0.2), 0.05, progress=False)


@pytest.fixture(scope="module")
def hierarchical():
    return rad.solve(rad.scenes.cornell_box(), 0.1, "hierarchical", progress=False)


def assert_same(a, b):
    """Field by field, to the last bit."""
    for field in dataclasses.fields(a):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if field.name == "system":
            # F is not in the file.
            assert x is None
        elif isinstance(x, rad.Scene):
            for name in ("vertices", "faces", "reflectance", "emission"):
                np.testing.assert_array_equal(getattr(x, name), getattr(y, name))
            assert x.names == y.names
            assert (x.parent is None) == (y.parent is None)
            np.testing.assert_array_equal(x.parent, y.parent)
        elif isinstance(x, tuple):
            assert len(x) == len(y)
            for step, other in zip(x, y, strict=True):
                assert_same(step, other)
        elif dataclasses.is_dataclass(x):
            assert_same(x, y)
        elif isinstance(x, np.ndarray):
            assert x.dtype == y.dtype
            np.testing.assert_array_equal(x, y)
        else:
            assert x == y


def test_npz_loads_back_bit_for_bit(solution, hierarchical, tmp_path):
    matrix = np.array([[0.0, 0.5], [0.25, 0.0]])
    plain = rad.solve_system(matrix, [[1.0], [0.0]], 0.5, progress=False)
    F = rad.form_factors(solution.scene, 0.1, progress=False)
    gathered = rad.solve_system(F, solution.scene.emission, solution.scene.reflectance, "gmres", progress=False)
    for number, one in enumerate((solution, hierarchical, plain, gathered)):
        path = tmp_path / f"{number}.npz"
        rad.save(one, path)
        assert_same(rad.load_solution(path), one)


def test_glb_has_one_exact_colour_a_patch(solution, tmp_path):
    rad.save(solution, tmp_path / "box.glb")
    (mesh,) = trimesh.load(tmp_path / "box.glb", process=False).geometry.values()
    scene = solution.scene
    # Positions are 32 bits.
    np.testing.assert_allclose(mesh.triangles, scene.vertices[scene.faces], atol=1e-7)
    shown = np.clip(exposure_of(solution, None) * solution.radiosity / np.pi, 0.0, 1.0)
    # All corners of a face have the same colour, in 32 bits.
    colours = np.asarray(mesh.visual.vertex_attributes["color"]).reshape(-1, 3, 3)
    assert (colours == colours[:, :1]).all()
    np.testing.assert_array_equal(colours[:, 0], shown.astype(np.float32))
    # As trimesh shows them: in 8 bits, without the material.
    (plain,) = trimesh.load(tmp_path / "box.glb", process=False, skip_materials=True).geometry.values()
    np.testing.assert_allclose(plain.visual.face_colors[:, :3] / 255.0, shown, atol=0.51 / 255.0)
    exact = _attribute(tmp_path / "box.glb", "_RADIOSITY_1").reshape(-1, 3)
    np.testing.assert_array_equal(exact, np.repeat(solution.radiosity[:, 1:2], 3, axis=1).astype(np.float32))


def _attribute(path, name):
    gltf = pygltflib.GLTF2().load(str(path))
    primitive = gltf.meshes[0].primitives[0]
    assert "KHR_materials_unlit" in gltf.materials[primitive.material].extensions
    accessor = gltf.accessors[getattr(primitive.attributes, name)]
    view = gltf.bufferViews[accessor.bufferView]
    return np.frombuffer(gltf.binary_blob(), np.float32, accessor.count, view.byteOffset)


def test_a_lightmap_shows_what_smooth_pictures_show(solution, tmp_path):
    rad.save(solution, tmp_path / "map.glb", lightmap=1024, exposure=2.0)
    mesh = trimesh.load(tmp_path / "map.glb", force="mesh", process=False)
    texture = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"))
    assert texture.shape == (1024, 1024, 3)
    # Smooth radiance at the middle of every patch, and the texel that lies there (trimesh turns v over).
    middle = mesh.visual.uv[mesh.faces].mean(axis=1) * [1.0, -1.0] + [0.0, 1.0]
    x, y = np.minimum((middle * 1024).astype(int), 1023).T
    scene = solution.scene
    from radiosity.render import shown_radiance

    expected = to_srgb(shown_radiance(solution).mean(axis=1), 2.0)
    np.testing.assert_allclose(mesh.triangles_center, scene.centroids, atol=1e-6)
    difference = np.abs(texture[y, x].astype(int) - expected.astype(int))
    # A texel is not its patch's centroid: up to half a texel of a patch of some fifty.
    assert np.percentile(difference, 99) <= 6
    assert difference.max() <= 40


def test_ply_has_colours_and_numbers(solution, tmp_path):
    rad.save(solution, tmp_path / "box.ply", exposure=1.5)
    mesh = trimesh.load(tmp_path / "box.ply", process=False)
    np.testing.assert_array_equal(mesh.visual.face_colors[:, :3], to_srgb(solution.radiosity / np.pi, 1.5))
    np.testing.assert_array_equal(mesh.faces, solution.scene.faces)
    data = mesh.metadata["_ply_raw"]["face"]["data"]
    np.testing.assert_allclose(data["radiosity_2"].ravel(), solution.radiosity[:, 2], rtol=1e-6)


@pytest.mark.parametrize("ending", ["vtu", "vtk"])
def test_vtk_has_every_band(solution, hierarchical, tmp_path, ending):
    for one in (solution, hierarchical):
        path = tmp_path / f"box.{ending}"
        rad.save(one, path)
        mesh, shown = meshio.read(path), one.as_shown
        np.testing.assert_array_equal(mesh.points, shown.scene.vertices)
        np.testing.assert_array_equal(mesh.cells_dict["triangle"], shown.scene.faces)
        for name in ("radiosity", "irradiance"):
            for b in range(3):
                np.testing.assert_array_equal(mesh.cell_data[f"{name}_{b}"][0], getattr(shown, name)[:, b])
    five = solution.scene.with_materials(0.5, np.repeat(solution.scene.emission[:, :1], 5, axis=1) * np.arange(1, 6))
    spectrum = rad.solve(five, 0.1, progress=False)
    rad.save(spectrum, tmp_path / "five.vtu")
    for name in ("five.glb", "five.ply"):
        with pytest.raises(ValueError, match=r"1 band \(grey\) or 3 \(RGB\), not 5"):
            rad.save(spectrum, tmp_path / name)
    assert not (tmp_path / "five.glb").exists()


def test_what_cannot_be_saved_is_refused_before_any_work(solution, tmp_path):
    with pytest.raises(ValueError, match=r"unknown format '.xyz'"):
        rad.save(solution, tmp_path / "a.xyz")
    with pytest.raises(FileNotFoundError, match="no such folder"):
        rad.save(solution, tmp_path / "nowhere" / "a.npz")
    with pytest.raises(TypeError, match=r"must be a radiosity\.Solution"):
        rad.save(solution.scene, tmp_path / "a.npz")
    with pytest.raises(ValueError, match="exposure"):
        rad.save(solution, tmp_path / "a.glb", exposure=-1.0)
    with pytest.raises(ValueError, match="lightmap"):
        rad.save(solution, tmp_path / "a.ply", lightmap=64)
    plain = rad.solve_system(np.zeros((2, 2)), 1.0, 0.5, progress=False)
    with pytest.raises(ValueError, match="no mesh"):
        rad.save(plain, tmp_path / "a.glb")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_save_leaves_the_old_file_whole(solution, tmp_path, monkeypatch):
    path = tmp_path / "box.vtu"
    path.write_text("old", encoding="ascii")

    def fail(self, name):
        Path(name).write_text("half", encoding="ascii")
        raise OSError("disk full")

    monkeypatch.setattr(meshio.Mesh, "write", fail)
    with pytest.raises(OSError, match="disk full"):
        rad.save(solution, path)
    assert path.read_text(encoding="ascii") == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_files_that_are_no_solutions_are_refused(solution, tmp_path):
    good = tmp_path / "good.npz"
    rad.save(solution, good)
    data = good.read_bytes()
    for name, contents in (("short.npz", data[: len(data) // 2]), ("text.npz", b"hello"), ("empty.npz", b"")):
        (tmp_path / name).write_bytes(contents)
        with pytest.raises(ValueError, match=name):
            rad.load_solution(tmp_path / name)
    np.savez(tmp_path / "other.npz", a=1)
    with pytest.raises(ValueError, match="no saved solution"):
        rad.load_solution(tmp_path / "other.npz")
    np.savez(tmp_path / "later.npz", version=99)
    with pytest.raises(ValueError, match="later version"):
        rad.load_solution(tmp_path / "later.npz")
    with pytest.raises(FileNotFoundError):
        rad.load_solution(tmp_path / "none.npz")


@pytest.mark.parametrize("ending", [".glb", ".ply"])
def test_saved_light_is_not_taken_for_paint(solution, tmp_path, ending):
    rad.save(solution, tmp_path / f"lit{ending}")
    with pytest.raises(ValueError, match="a saved solution: its colours are light"):
        rad.load(tmp_path / f"lit{ending}")


def test_other_endings_are_sent_to_who_writes_them(solution, tmp_path):
    with pytest.raises(ValueError, match="save_image writes pictures"):
        rad.save(solution, tmp_path / "x.png")
    (tmp_path / "x.npz").write_bytes(b"")
    with pytest.raises(ValueError, match="load_solution reads saved solutions"):
        rad.load(tmp_path / "x.npz")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("radiosity", np.zeros(3)),
        ("irradiance", np.zeros((3, 1))),
        ("irradiance", np.array([["x"]])),
        ("unshot", np.zeros((1, 7))),
        ("bound", np.zeros(9)),
        ("audit/left", np.zeros((1, 1))),
        ("error_estimate", np.zeros(2)),
        ("faces", np.zeros((1, 3), np.int64)),
    ],
)
def test_arrays_of_another_kind_are_refused_by_name(solution, tmp_path, name, value):
    rad.save(solution, tmp_path / "sound.npz")
    with np.load(tmp_path / "sound.npz") as file:
        arrays = {each: file[each] for each in file.files}
    np.savez(tmp_path / "edited.npz", **{**arrays, name: value})
    with pytest.raises(ValueError, match=r"edited\.npz: damaged"):
        rad.load_solution(tmp_path / "edited.npz")


def test_a_solution_without_a_step_is_kept_too(tmp_path):
    black = rad.solve(rad.scenes.furnace(0.0, 1.0), 0.3, "rays", progress=False)
    assert black.history == ()
    rad.save(black, tmp_path / "black.npz")
    assert_same(rad.load_solution(tmp_path / "black.npz"), black)


def test_bands_that_are_equal_come_back(tmp_path):
    scene = rad.scenes.cornell_box(max_edge=0.5)
    grey = scene.with_materials(0.5, np.repeat(scene.emission[:, :1], 3, axis=1))
    for cache in (None, tmp_path / "cache"):
        solution = rad.solve(grey, 0.2, "dense", cache=cache, progress=False)
        assert solution.report.bound.shape == (3,)
        rad.save(solution, tmp_path / "grey.npz")
        assert np.array_equal(rad.load_solution(tmp_path / "grey.npz").radiosity, solution.radiosity)


def interrupted_archive():
    """Ctrl-C as zipfile has it: it cannot close what is open, and says so in its place."""
    try:
        raise KeyboardInterrupt
    finally:
        raise ValueError("Can't close the ZIP file")


def test_ctrl_c_that_an_archive_hides_is_ctrl_c(tmp_path):
    with pytest.raises(KeyboardInterrupt), replacing(tmp_path / "a.npz"):
        interrupted_archive()
    with pytest.raises(ValueError, match="of its own"), replacing(tmp_path / "a.npz"):
        raise ValueError("of its own")
    assert not list(tmp_path.iterdir())
