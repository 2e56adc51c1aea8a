"""The command line."""

from pathlib import Path

import numpy as np
import pytest

import radiosity as rad
from radiosity.cli import main


def test_demo_prints_the_table_and_writes_the_picture(tmp_path, capsys):
    Image = pytest.importorskip("PIL.Image")
    assert main(["demo", "--output", str(tmp_path), "--tolerance", "0.1", "--no-mitsuba"]) == 0
    table = capsys.readouterr().out
    for row in ("patches", "1004", "rays", "error, estimated", "energy imbalance", "error against Mitsuba"):
        assert row in table
    with Image.open(tmp_path / "cornell_box.png") as picture:
        assert picture.size == (512, 512)
        red, green = picture.getpixel((60, 250)), picture.getpixel((450, 250))
    # The left wall is red and the right one green.
    assert red[0] > 2 * red[1]
    assert green[1] > green[0] > 0


def test_errors_are_one_line_and_status_1(tmp_path, capsys):
    assert main(["demo", "--output", str(tmp_path), "--tolerance", "7"]) == 1
    assert capsys.readouterr().err == "radiosity: tolerance 7.0 is outside (0, 1)\n"
    assert list(tmp_path.iterdir()) == []
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert main(["demo", "--output", str(blocked)]) == 1
    assert "file" in capsys.readouterr().err


def test_help_and_version(capsys):
    for flag in ("--help", "--version"):
        with pytest.raises(SystemExit) as exit_:
            main([flag])
        assert exit_.value.code == 0
    assert rad.__version__ in capsys.readouterr().out
    with pytest.raises(SystemExit) as exit_:
        main(["dance"])
    assert exit_.value.code == 2


def test_a_scene_is_solved_rendered_and_shown(tmp_path, capsys):
    solved, picture, page = (str(tmp_path / name) for name in ("box.npz", "box.png", "box.html"))
    assert main(["solve", "cornell_box", "-o", solved, "--max-edge", "0.3", "--tolerance", "0.1"]) == 0
    told = capsys.readouterr()
    assert "rays" in told.out
    assert f"written    {solved}" in told.out
    solution = rad.load_solution(solved)
    assert solution.error_estimate <= 0.1
    view = rad.scenes.cornell_box_view()
    camera = []
    for name in ("origin", "target", "up"):
        camera += [f"--{name}", *map(str, view[name])]
    camera += ["--fov", str(view["fov"]), "--quiet"]
    assert main(["render", solved, "-o", picture, "--size", "64", "48", "--shading", "gather", *camera]) == 0
    Image = pytest.importorskip("PIL.Image")
    with Image.open(picture) as image:
        assert image.size == (64, 48)
    assert main(["show", solved, "-o", page, "--unit", "lux", *camera]) == 0
    assert "lux" in (tmp_path / "box.html").read_text(encoding="utf-8")
    # The view of the Cornell box is known; a solution is made on the way.
    assert main(["render", "cornell_box", "-o", picture, "--size", "32", "32", "--tolerance", "0.2", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_form_factors_are_written(tmp_path, capsys):
    path = tmp_path / "F.npz"
    assert main(["form-factors", "furnace", "-o", str(path), "--tolerance", "0.01"]) == 0
    assert "row sums" in capsys.readouterr().out
    with np.load(path) as data:
        np.testing.assert_allclose(data["form_factors"].sum(axis=1), 1.0, atol=0.01)
        assert data["areas"].shape == (len(data["form_factors"]),)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["solve", "none.glb", "-o", "x.npz"], "none.glb: no such file"),
        (["solve", "cornell_box", "-o", "x.doc"], "unknown format '.doc'"),
        (["solve", "cornell_box", "-o", "nowhere/x.npz"], "nowhere: no such folder"),
        (
            ["render", "cornel_box", "-o", "x.png"],
            "; did you mean cornell_box?",
        ),
        (["solve", "q", "-o", "x.npz"], "q: no such file, and no built-in scene, which are "),
        (["show", "none.obj", "-o", "x.html"], "none.obj: no such file"),
        (["render", "two_rooms", "-o", "x.png"], "say where the camera stands"),
        (["render", "two_rooms", "-o", "x.png", "--origin", "1", "1", "1"], "both --origin"),
        (["render", "cornell_box", "-o", "x.png", "--size", "0", "4", "--tolerance", "0.5"], "width 0 is outside"),
        (["show", "cornell_box", "-o", "x.pdf"], "unknown format '.pdf'"),
        (["form-factors", "cornell_box", "-o", "x.csv"], "unknown format '.csv'"),
        (["show", "x.npz", "-o", "x.html", "--max-edge", "1", "--tolerance", "0.1"], "--tolerance, --max-edge cannot"),
        (["solve", "x.npz", "-o", "y.npz"], "x.npz: no such file"),
    ],
)
def test_wrong_requests_are_refused_in_one_line(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main([*arguments, "--quiet"]) == 1
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_gltf_files_have_y_up(tmp_path):
    pytest.importorskip("PIL.Image")
    picture, told = str(tmp_path / "box.png"), str(tmp_path / "told.png")
    glb = str(Path(rad.__file__).parent / "data" / "cornell_box.glb")
    view = ["--origin", "0.278", "0.273", "-0.8", "--target", "0.278", "0.273", "0", "--size", "32", "32"]
    same = [*view, "--tolerance", "0.2", "--quiet"]
    assert main(["render", glb, "-o", picture, *same]) == 0
    assert main(["render", glb, "-o", told, "--up", "0", "1", "0", *same]) == 0
    assert Path(picture).read_bytes() == Path(told).read_bytes()


def test_mirrors_and_glass_are_drawn_in_two_passes(tmp_path, monkeypatch, capsys):
    pytest.importorskip("PIL.Image")
    picture = tmp_path / "room.png"
    command = ["render", "mirror_and_glass", "-o", str(picture), "--size", "16", "12", "--tolerance", "0.2", "--quiet"]
    assert main([*command, "--noise", "0.5"]) == 0
    assert picture.exists()
    monkeypatch.setattr("radiosity.cli.solve", None)  # refused before any work
    assert main([*command, "--shading", "flat"]) == 1
    assert "mirror_and_glass has mirrors or glass, which only --shading gather draws" in capsys.readouterr().err
