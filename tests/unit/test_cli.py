"""The command line: exit status, one message, and nothing written when the input is wrong."""

import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from drop import DROP
from unit.broken_scenes import BROKEN

from pmpm.cli import main
from pmpm.physics.materials import LAWS
from pmpm.scene.files import builtin_scenes


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def scene_file(folder):
    path = folder / "drop.toml"
    path.write_text(DROP, encoding="utf-8")
    return path


def refused(arguments, capsys):
    """The one message of a command that must end with exit status 2."""
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("pmpm: ")
    assert "Traceback" not in captured.err
    return captured.err


@pytest.mark.parametrize(("name", "text", "fragments"), BROKEN, ids=[case[0] for case in BROKEN])
@pytest.mark.parametrize("command", ["run", "check"])
def test_a_broken_scene_ends_with_status_2_and_writes_nothing(command, name, text, fragments, folder, capsys):
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    message = refused([command, "scene.toml"], capsys)
    assert all(fragment in message for fragment in fragments)
    assert os.listdir(folder) == ["scene.toml"]


def test_a_missing_file_is_named_with_the_nearest_scene(folder, capsys):
    assert "dam_break" in refused(["run", "dam_brake"], capsys)


def test_a_body_without_particles_is_named(scene_file, capsys):
    shape = 'bodies.0.shape={ type = "sphere", center = [0.1, 0.1], radius = 0.001 }'
    assert "bodies[0] holds no particle" in refused(["run", "drop.toml", "--set", shape], capsys)
    assert os.listdir() == ["drop.toml"]


def test_a_fixed_step_beyond_the_stable_one_is_refused(scene_file, capsys):
    message = refused(["run", "drop.toml", "--set", "time.step=0.005"], capsys)
    assert "time.step = 0.005 s is longer than the stable step of" in message
    assert os.listdir() == ["drop.toml"]


def test_a_periodic_axis_with_too_few_cells_is_refused(scene_file, capsys):
    settings = ["--set", "domain.size=[0.2, 0.06]", "--set", 'domain.periodic=["y"]', "--set"]
    box = 'bodies.0.shape={ type = "box", min = [0.0, 0.0], max = [0.1, 0.06] }'
    assert "axis y has 3 cells, a periodic axis needs 5" in refused(["run", "drop.toml", *settings, box], capsys)


def test_without_a_card_a_run_on_one_is_refused(scene_file, capsys):
    """No driver here; with one, a message of another kind would be the wrong one."""
    assert "no NVIDIA driver" in refused(["run", "drop.toml", "--backend", "cuda"], capsys)


def test_a_card_is_driven_from_one_thread(scene_file, capsys):
    assert "--threads" in refused(["run", "drop.toml", "--backend", "cuda", "--threads", "2"], capsys)


@pytest.mark.parametrize(
    "option", [["--until", "-1"], ["--steps", "0"], ["--threads", "0"], ["--threads", "5000"], ["--until", "nan"]]
)
def test_a_senseless_number_is_refused(option, scene_file, capsys):
    assert option[0] in refused(["run", "drop.toml", *option], capsys)


def test_an_unknown_option_ends_with_status_2(scene_file):
    with pytest.raises(SystemExit) as stopped:
        main(["run", "drop.toml", "--sett", "x=1"])
    assert stopped.value.code == 2


def test_a_run_leaves_the_promised_folder(scene_file, capsys):
    assert main(["run", "drop.toml", "--quiet"]) == 0
    assert {"scene.toml", "snapshots.xdmf", "snapshots", "diagnostics.csv", "log.txt", "run.json"} == set(
        os.listdir("drop")
    )
    record = json.loads(Path("drop/run.json").read_text(encoding="utf-8"))
    assert record["status"] == "finished"
    assert record["report"]["time"] == 0.01


def test_a_finished_run_is_not_overwritten_unasked(scene_file, capsys):
    assert main(["run", "drop.toml", "--quiet", "--steps", "3"]) == 0
    before = Path("drop/run.json").read_text(encoding="utf-8")
    assert "--overwrite" in refused(["run", "drop.toml", "--quiet"], capsys)
    assert Path("drop/run.json").read_text(encoding="utf-8") == before
    assert main(["run", "drop.toml", "--quiet", "--steps", "3", "--overwrite"]) == 0


def test_a_folder_that_cannot_be_written_is_refused(scene_file, folder, capsys):
    place = "/proc/run"  # not even root can make a folder there
    if os.geteuid() != 0:
        (folder / "closed").mkdir()
        os.chmod(folder / "closed", stat.S_IRUSR | stat.S_IXUSR)
        place = "closed/run"
    assert place in refused(["run", "drop.toml", "--quiet", "--out", place], capsys)


def test_a_path_through_a_file_is_refused(scene_file, capsys):
    assert "drop.toml" in refused(["run", "drop.toml", "--out", "drop.toml/run"], capsys)


def test_check_explains_and_writes_nothing(scene_file, folder, capsys):
    assert main(["check", "drop.toml"]) == 0
    text = capsys.readouterr().out
    for part in ("100 in 1 bodies", "time step", "left out", "deformation gradient", "fluid (keeps J)"):
        assert part in text
    assert os.listdir(folder) == ["drop.toml"]


def test_check_estimates_the_first_time_step(scene_file, capsys):
    """0.4 dx / (c sqrt(2)) = 0.4 x 0.02 / (15 x 1.41421) = 3.77e-4 s."""
    main(["check", "drop.toml"])
    assert "0.000377 s at the start" in capsys.readouterr().out


def test_scenes_lists_every_built_in_scene(capsys):
    assert main(["scenes"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in builtin_scenes())


def test_materials_lists_every_law_with_keys_units_and_source(capsys):
    assert main(["materials"]) == 0
    text = capsys.readouterr().out
    for name, law in LAWS.items():
        assert name in text
        assert law.SOURCE in text
        assert all(key.name in text for key in law.KEYS)
    assert "kg/m3" in text


def test_info_describes_a_run(scene_file, capsys):
    main(["run", "drop.toml", "--quiet", "--steps", "3"])
    capsys.readouterr()
    assert main(["info", "drop"]) == 0
    assert "a drop" in capsys.readouterr().out


def test_info_of_something_else_is_refused(folder, capsys):
    (folder / "notes.txt").write_text("hello", encoding="utf-8")
    assert "notes.txt" in refused(["info", "notes.txt"], capsys)


@pytest.mark.parametrize("number", ["-1e-2", "-0.01", "-1E-2"])
def test_a_negative_number_may_have_an_exponent(number, capsys):
    """argparse by itself takes -1e-2 for an option."""
    assert main(["point", "neo_hookean", "--strain", number, "--rows", "2"]) == 0
    assert "to -0.01 in 200 steps" in capsys.readouterr().out


def test_a_reader_that_has_seen_enough_is_no_error(folder):
    """What `pmpm materials | head -1` does: the pipe is closed before all has been said."""
    reading, writing = os.pipe()
    os.close(reading)
    found = subprocess.run(
        [sys.executable, "-m", "pmpm", "materials"], stdout=writing, stderr=subprocess.PIPE, text=True
    )
    os.close(writing)
    assert (found.returncode, found.stderr) == (0, "")
