"""The command line."""

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
