"""`pmpm plot`: what is drawn of a run, and what is said where nothing can be."""

import json
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from law_examples import EXAMPLES

import pmpm
from pmpm.cli import main
from pmpm.output import plot


@pytest.fixture(scope="module")
def falling(tmp_path_factory):
    """The folder of a run of a block that flies and falls freely."""
    folder = tmp_path_factory.mktemp("plot")
    scene = pmpm.Scene(
        domain={"size": [0.4, 0.4], "cell_size": 0.05, "gravity": [0.0, -10.0]},
        time={"end": 0.05},
        materials={"m": EXAMPLES["neo_hookean"] | {"density": 1000.0, "youngs_modulus": 1e5}},
        bodies=[
            {"material": "m", "shape": {"type": "box", "min": [0.1, 0.2], "max": [0.2, 0.3]}, "velocity": [0.5, 0.0]}
        ],
        output={"snapshot_interval": 0.01, "diagnostics_interval": 0.002},
    )
    (folder / "falling.toml").write_text(scene.to_toml(), encoding="utf-8")
    assert main(["run", str(folder / "falling.toml"), "--out", str(folder / "falling"), "--quiet"]) == 0
    return folder / "falling"


def lines_of(panels, title):
    (panel,) = (panel for panel in panels if panel.title == title)
    return {label: (x, y) for label, x, y in panel.lines}


def test_lines_are_those_of_a_free_fall(falling):
    panels = plot.panels_of(pmpm.load(falling))
    energies = lines_of(panels, "energies")
    t, kinetic = energies["kinetic"]
    mass = 10.0  # kg: 0.01 m2 of 1000 kg/m3, a metre thick
    assert kinetic == pytest.approx(0.5 * mass * (0.5**2 + (10.0 * t) ** 2), rel=0.02)
    dt = pmpm.load(falling).diagnostics["dt"][0]  # by which symplectic steps fall farther
    assert energies["potential"][1] == pytest.approx(-mass * 10.0 * 5.0 * t * (t + dt), abs=0.005)
    reach = lines_of(panels, "extent of material")
    t, right = reach["highest x"]
    assert list(reach) == ["lowest x", "highest x", "lowest y", "highest y"]
    assert right == pytest.approx(right[0] + 0.5 * t, abs=1e-3)
    assert lines_of(panels, "momentum")["x"][1] == pytest.approx(5.0)
    (phases,) = (panel.bars for panel in panels if panel.title == "run time by phase")
    assert {"p2g", "g2p"} <= {name for name, *_ in phases}
    assert all(least <= mean <= most for _, least, mean, most in phases)


def test_energies_that_stay_zero_have_no_line(falling):
    diagnostics = pmpm.load(falling).diagnostics
    silent = dict.fromkeys(("strain", "dissipated"), np.zeros_like(diagnostics["time"]))
    assert [label for label, *_ in plot.energies(diagnostics | silent)] == ["kinetic", "potential"]


@pytest.mark.parametrize("kind", ["png", "pdf", "svg"])
def test_a_picture_is_written_where_it_is_asked_for(kind, falling, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    file = tmp_path / f"run.{kind}"
    assert main(["plot", str(falling), "--out", str(file)]) == 0
    assert f"{file}: energies, momentum, largest speed, time step, extent of material" in capsys.readouterr().out
    assert file.stat().st_size > 5000
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_without_a_name_it_lies_in_the_folder_of_the_run(falling):
    pytest.importorskip("matplotlib")
    assert main(["plot", str(falling)]) == 0
    assert (falling / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_a_large_snapshot_is_read_piece_by_piece(falling, monkeypatch):
    whole = plot.extents(pmpm.load(falling).snapshots)
    monkeypatch.setattr(plot, "ROWS", 3)
    pieces = plot.extents(pmpm.load(falling).snapshots)
    assert all(np.array_equal(one[2], other[2]) for one, other in zip(whole, pieces, strict=True))


def test_many_snapshots_are_looked_at_from_the_first_to_the_last(falling, monkeypatch):
    monkeypatch.setattr(plot, "MOST_SNAPSHOTS", 3)
    (_, times, _), *_ = plot.extents(pmpm.load(falling).snapshots)
    assert len(times) == 3
    assert (times[0], times[-1]) == (0.0, 0.05)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["nowhere"], "nowhere does not exist"),
        (["."], "does not hold a run"),
        (["{run}", "--out", "x.bmp"], "must end with one of .png, .pdf, .svg"),
        (["{run}", "--out", "/proc/none/x.png"], "--out /proc/none/x.png"),
    ],
)
def test_what_cannot_be_drawn_is_told_with_status_2(arguments, complaint, falling, tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    assert main(["plot", *(argument.format(run=falling) for argument in arguments)]) == 2
    assert complaint in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def test_a_run_that_has_just_begun_has_nothing_to_draw(falling, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    record = json.loads((falling / "run.json").read_text(encoding="utf-8"))
    (tmp_path / "run.json").write_text(json.dumps(record | {"report": {}}), encoding="utf-8")
    (tmp_path / "scene.toml").write_bytes((falling / "scene.toml").read_bytes())
    assert main(["plot", str(tmp_path)]) == 2
    assert "nothing to draw yet" in capsys.readouterr().err


def test_a_damaged_snapshot_is_named(falling, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    for name in ("run.json", "scene.toml"):
        (tmp_path / name).write_bytes((falling / name).read_bytes())
    (tmp_path / "snapshots").mkdir()
    for path in (falling / "snapshots").glob("*.hdf"):
        (tmp_path / "snapshots" / path.name).write_bytes(path.read_bytes())
    broken = sorted((tmp_path / "snapshots").glob("*.hdf"))[1]
    with h5py.File(broken, "r+") as file:
        del file["VTKHDF/Points"]
    assert main(["plot", str(tmp_path)]) == 2
    assert str(broken) in capsys.readouterr().err


def test_without_matplotlib_it_says_what_to_install(falling, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert main(["plot", str(falling)]) == 2
    assert "pip install 'pmpm[viz]'" in capsys.readouterr().err
