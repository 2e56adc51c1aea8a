"""The bench of accuracy against time: its numbers, its files, its command."""

import csv
import dataclasses

import numpy as np
import pytest

from radiosity import bench
from radiosity.cli import main


def row(method, seconds, error, **values):
    defaults = {field.name: None for field in dataclasses.fields(bench.Row)}
    return bench.Row(
        **{**defaults, "scene": "furnace", "patches": 192, "noise": 0.0, "method": method, "seconds": seconds}
        | {"error": error}
        | values
    )


def test_the_furnace_meets_every_tolerance_and_the_files_say_so(tmp_path, capsys):
    tolerances = (0.1, 0.01)
    rows = bench.run(tmp_path / "new", ["furnace"], with_mitsuba=False, tolerances=tolerances, runs=1)
    with (tmp_path / "new" / "bench.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert list(lines[0]) == [field.name for field in dataclasses.fields(bench.Row)]
    assert len(lines) == len(rows)
    methods = [f"dense, {solver}" for solver in bench.SOLVERS] + list(bench.SOLVE)
    assert [(line["method"], float(line["tolerance"])) for line in lines] == [
        (method, tolerance) for method in methods for tolerance in tolerances
    ]
    for line in lines:
        assert (line["scene"], line["patches"], line["noise"]) == ("furnace", "192", "0.0")
        assert float(line["seconds"]) > 0.0
        # A furnace has a constant radiosity and no shadows: nothing but the tolerance is left to err.
        assert float(line["error"] or 0.0) <= float(line["tolerance"])
        assert line["times_mitsuba"] == line["paths"] == ""
        if line["method"].startswith("dense"):
            assert 0.0 < float(line["solver_seconds"]) < float(line["seconds"])
    table = capsys.readouterr().out
    assert "furnace: 192 patches, noise of the reference 0 %" in table
    assert all(method in table for method in methods)
    pytest.importorskip("matplotlib")
    assert (tmp_path / "new" / "bench.png").read_bytes().startswith(b"\x89PNG")


def test_the_referee_is_fitted_by_its_median_and_methods_are_measured_against_it():
    # Errors 1 % / sqrt(seconds), one of them with a bad draw; and one that cannot be told from the noise.
    referee = [row(bench.REFEREE, seconds, 0.01 / seconds**0.5) for seconds in (0.25, 1.0)]
    referee += [row(bench.REFEREE, 4.0, 0.009), row(bench.REFEREE, 9.0, None)]
    c = bench.referee_constant(referee)
    assert c == pytest.approx(0.01)
    # 0.5 % take the referee 4 s.
    assert bench.against(row("dense, gmres", 0.5, 0.005), c).times_mitsuba == pytest.approx(8.0)
    assert bench.against(row("dense, gmres", 0.5, None), c).times_mitsuba is None
    assert bench.against(row("dense, gmres", 0.5, 0.005), bench.referee_constant([])).times_mitsuba is None


def test_a_tolerance_that_the_reference_cannot_check_is_left_out(tmp_path):
    # Half of it would be less than the noise of the stored Cornell box.
    assert bench.run(tmp_path, ["cornell"], with_mitsuba=False, tolerances=(1e-3,), runs=1) == []
    assert (tmp_path / "bench.csv").read_text().count("\n") == 1


def test_the_command(tmp_path, capsys, monkeypatch):
    asked = []
    monkeypatch.setattr("radiosity.cli.run_bench", lambda *arguments: asked.append(arguments))
    assert main(["bench", "--output", str(tmp_path), "--scenes", "furnace", "two_rooms", "--no-mitsuba"]) == 0
    assert asked == [(str(tmp_path), ["furnace", "two_rooms"], False)]
    with pytest.raises(SystemExit) as exit_:
        main(["bench", "--scenes", "teapot"])
    assert exit_.value.code == 2
    assert "teapot" in capsys.readouterr().err


def test_the_picture_holds_errors_of_any_size(tmp_path):
    pytest.importorskip("matplotlib")
    rows = [row("dense, gmres", 0.1, error, tolerance=0.1) for error in (None, 1e-9, 0.5)]
    rows += [row(bench.REFEREE, seconds, 0.01 / np.sqrt(seconds), paths=1) for seconds in (0.1, 1.0)]
    bench.draw(tmp_path / "bench.png", rows)
    assert (tmp_path / "bench.png").stat().st_size > 0
