"""A study plans its runs, tells orders and what they leave, repeats nothing that has ended, and says what came out."""

import csv
import math
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import pmpm
from pmpm.cli import main
from pmpm.output.files import OutputError
from pmpm.parallel.comm import Alone
from pmpm.scene.seeding import places_of
from pmpm.studies import folder, orders, samples, study
from pmpm.studies.plan import Options, changed, plan, table_of

RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
SPEED = 3.0  # m/s, about that of the waves


def swing(X):
    return np.stack((0.02 * SPEED * np.sin(10.0 * np.pi * X[:, 1]), 0.0 * X[:, 0]), axis=1)


def scene(**more):
    """A block of rubber, 8 x 8 cells, that begins to shear in a box with two periodic axes."""
    tables = {
        "domain": {"size": [0.2, 0.2], "cell_size": 0.025, "periodic": ["x", "y"]},
        "time": {"end": 0.02},
        "materials": {"rubber": RUBBER},
        "bodies": [
            {"material": "rubber", "shape": {"type": "box", "min": [0.0, 0.0], "max": [0.2, 0.2]}, "velocity": swing}
        ],
    }
    return pmpm.Scene(**(tables | more))


def fall(X, t):
    return np.broadcast_to([0.0, -5.0 * t * t], X.shape)


def falling(**more):
    """A block in free fall, with its exact solution: symplectic steps fall by g t dt / 2 too far, whatever the scheme."""
    shape = {"type": "box", "min": [0.05, 0.1], "max": [0.15, 0.15]}
    tables = {
        "domain": {"size": [0.2, 0.2], "cell_size": 0.025, "gravity": [0.0, -10.0]},
        "bodies": [{"material": "rubber", "shape": shape}],
        "exact": {"displacement": fall},
        "time": {"end": 0.02, "step": 5e-4},
    }
    return scene(**(tables | more))


# ---- orders ----------------------------------------------------------------------------------------------------------------


def test_differences_of_a_second_order_scheme_tell_order_and_error_exactly():
    errors = [0.16, 0.04, 0.01, 0.0025]
    found = orders.of_differences([a - b for a, b in zip(errors, errors[1:], strict=False)])
    assert found.order == pytest.approx(2.0, rel=1e-12)
    assert found.errors == pytest.approx(errors, rel=1e-12)
    assert found.orders[:2] == (None, None)
    assert found.verdict == "order 2.00"


def test_an_order_above_two_does_not_make_the_error_smaller_than_two_would():
    found = orders.of_differences([0.8, 0.1])
    assert found.order == pytest.approx(3.0)
    assert found.errors[-1] == pytest.approx(0.1 / 3.0)


@pytest.mark.parametrize("values", [[0.1, 0.1], [0.1, 0.2], [0.4, 0.1, 0.09]])
def test_differences_that_do_not_shrink_have_no_order_and_no_error(values):
    found = orders.of_differences(values)
    assert found.verdict == "no order: does not converge"
    assert found.order is None
    assert set(found.errors) == {None}
    assert found.differences == (*values, None)


def test_two_levels_tell_a_difference_and_no_order():
    assert orders.of_differences([0.1]) == orders.Estimate(
        (None, None), (0.1, None), (None, None), None, "too few levels for an order"
    )


def test_a_failed_level_breaks_the_chain():
    """Of five levels the first failed: the differences 1-2, 2-3, 3-4 remain."""
    found = orders.of_differences([None, 0.12, 0.03, 0.0075])
    assert found.order == pytest.approx(2.0)
    assert found.errors == (None, *map(pytest.approx, (0.16, 0.04, 0.01, 0.0025)))


def test_a_failed_finest_level_leaves_the_order_of_the_others():
    found = orders.of_differences([0.12, 0.03, None])
    assert found.errors == (*map(pytest.approx, (0.16, 0.04, 0.01)), None)


def test_errors_against_an_exact_solution_are_known_even_where_they_grow():
    found = orders.of_errors([0.1, 0.2])
    assert found.verdict == "no order: does not converge"
    assert found.errors == (0.1, 0.2)


def test_round_off_has_no_order():
    assert orders.of_differences([4e-14, 1e-14]).orders == (None, None, None)


POINTS = {"fine": [(1.0, 0.4), (4.0, 0.1), (16.0, 0.025)], "quick": [(0.5, 0.4), (8.0, 0.1)]}


def test_the_time_to_an_error_lies_on_a_straight_line_in_logarithms():
    assert orders.seconds_to(POINTS["fine"], 0.2) == pytest.approx(2.0)
    assert orders.seconds_to(POINTS["fine"], 0.025) == pytest.approx(16.0)
    assert orders.seconds_to(POINTS["fine"], 0.01) is None
    assert orders.seconds_to(POINTS["fine"], 1.0) == 1.0


def test_the_sentence_names_who_is_ahead_at_which_error():
    """At 0.2 both take 2 s (quick: 0.5 s to 8 s from 0.4 to 0.1, halfway), from 0.1 on fine is faster."""
    assert orders.sentence(POINTS) == (
        "Most accuracy per second: fine and quick alike at an error of 0.2; fine at errors of 0.1 to 0.05. "
        "An error of 0.05 is reached after fine 8 s; quick does not."
    )


def test_schemes_without_errors_are_not_ranked():
    assert orders.sentence({"apic": [], "flip": []}).startswith("No error is known for any scheme")


# ---- the plan --------------------------------------------------------------------------------------------------------------


def test_levels_halve_cells_and_keep_particles_per_cell():
    made = plan(scene(), Options(levels=3, transfer=("apic", "flip")), Alone())
    assert [(entry.scheme, entry.level) for entry in made.entries] == [
        (label, level) for level in range(3) for label in ("apic", "flip")
    ]
    assert [entry.scene.domain.cell_size for entry in made.entries[::2]] == [0.025, 0.0125, 0.00625]
    assert {entry.scene.bodies[0].particles_per_cell for entry in made.entries} == {4}
    assert {entry.scene.bodies[0].velocity for entry in made.entries} == {swing}  # functions stay
    assert made.entries[1].scene.method.flip_blend == 0.99


def test_a_fixed_step_is_halved_with_the_cells():
    made = plan(falling(), Options(levels=2), Alone())
    assert [entry.scene.time.step for entry in made.entries] == [5e-4, 2.5e-4]


def test_steps_alone_are_halved_on_request():
    made = plan(scene(), Options(levels=3, refine="time", cfl=(0.8, 0.4)), Alone())
    assert [(entry.scheme, entry.scene.time.cfl) for entry in made.entries[:4]] == [
        ("apic cfl 0.8", 0.8),
        ("apic cfl 0.4", 0.4),
        ("apic cfl 0.8", 0.4),
        ("apic cfl 0.4", 0.2),
    ]
    assert {entry.scene.domain.cell_size for entry in made.entries} == {0.025}


def test_a_blend_goes_with_the_transfer_that_has_one():
    flip = scene(method={"transfer": "flip", "flip_blend": 0.5})
    assert changed(flip, {"method.transfer": "apic"}).method.flip_blend is None
    assert changed(flip, {"method.transfer": "aflip"}).method.flip_blend == 0.5


def test_a_scene_is_made_again_with_all_its_functions():
    made = falling(bodies=[scene().bodies[0]])
    assert pmpm.Scene.from_table(table_of(made), "scene").to_toml() == made.to_toml()


def test_a_combination_that_cannot_be_is_left_out_and_the_others_are_run():
    made = plan(scene(), Options(levels=1, transfer=("apic", "mls"), shape_function=("linear", "cubic")), Alone())
    assert made.schemes == ("apic linear", "apic cubic", "mls cubic")
    assert "needs quadratic or cubic splines" in made.left_out["mls linear"]


@pytest.mark.parametrize(
    ("options", "fragment"),
    [
        ({"levels": 0}, "--levels 0: must be a whole number from 1"),
        ({"refine": "particles"}, "--refine particles: is not known"),
        ({"repeat": 0}, "--repeat 0"),
        ({"until": -1.0}, "--until -1.0: must be a number > 0"),
        ({"until": math.nan}, "--until nan"),
        ({"until": 1.0}, "--until 1.0: must be at most time.end = 0.02 s"),
        ({"transfer": ("apic", "apic")}, "--transfer: apic is named twice"),
        ({"transfer": ("apic", "flipp")}, 'method.transfer = "flipp" is not known; did you mean flip'),
        ({"cfl": (0.4, 2.0)}, "time.cfl = 2.0 must be a number > 0 and <= 1"),
        ({"levels": 12}, "study: level "),  # too fine for what can be allocated
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_run(options, fragment, tmp_path):
    with pytest.raises(pmpm.SceneError) as raised:
        pmpm.study(scene(), tmp_path / "study", **options)
    assert fragment in str(raised.value)
    assert not (tmp_path / "study").exists()


# ---- what is compared ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [4, 3])
def test_ids_tell_where_particles_started(count):
    """On a lattice, and at random places."""
    bodies = [{"material": "rubber", "shape": {"type": "sphere", "center": [0.1, 0.1], "radius": 0.06}}]
    bodies += [{"material": "rubber", "shape": {"type": "box", "min": [0.0, 0.15], "max": [0.2, 0.2]}}]
    made = scene(bodies=[body | {"particles_per_cell": count} for body in bodies])
    found = pmpm.Simulation(made).fields(["id", "x"])
    body, cell, place = places_of(made, found["id"])
    np.testing.assert_allclose((cell + place) * 0.025, found["x"] % 0.2, rtol=0.0, atol=1e-15)
    assert np.array_equal(body, found["x"][:, 1] % 0.2 > 0.15)


def sampled(made, coarse):
    simulation = pmpm.Simulation(made)
    sampler = samples.Sampler(simulation, coarse)
    simulation.every(sampler, steps=1, at_start=True)
    simulation.run()
    return sampler.result()


@pytest.fixture(scope="module")
def two_levels():
    """Samples of a block that moves as a whole by 1.3 times the periodic box, at two levels, and the size of the box."""
    push = {"velocity": [13.0, 0.0]}
    coarse = scene(bodies=[scene().bodies[0].model_dump() | push])
    return sampled(coarse, coarse), sampled(changed(coarse, {"domain.cell_size": 0.0125}), coarse), np.array([0.2, 0.2])


def test_levels_of_a_rigid_motion_through_a_periodic_end_do_not_differ(two_levels):
    """At all times, those between two steps among them: positions are linear in time."""
    coarse, fine, size = two_levels
    assert len(coarse["times"]) == samples.TIMES + 1
    found = samples.differences(coarse, fine, size)
    assert max(found["displacement"].max(), found["mass"].max(), found["kinetic"].max()) < 1e-9


def test_a_shifted_block_differs_by_its_shift(two_levels):
    coarse, _, size = two_levels
    shifted = coarse | {"displacement": coarse["displacement"] + [0.0, 0.01]}
    moved = np.sqrt((shifted["displacement"] ** 2).sum(axis=2).mean(axis=1)).max()
    found = samples.differences(coarse, shifted, size)
    np.testing.assert_allclose(found["displacement"], 0.01 / moved, rtol=1e-12)


def test_the_extent_is_that_of_the_mass():
    """Of 99 % of the mass of a box from 0.05 to 0.15 m, evenly spread over its width."""
    made = falling(exact=None)
    extent = sampled(made, made)["extent"]
    np.testing.assert_allclose(extent[0, 0], [0.05 + 0.005 * 0.1, 0.15 - 0.005 * 0.1], rtol=0.0, atol=0.025 / 4)
    assert extent[-1, 1, 0] < extent[0, 1, 0] - 1e-3  # it has fallen by 2 mm


# ---- whole studies ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def smooth(tmp_path_factory):
    """The study of a smooth motion in two schemes."""
    return pmpm.study(scene(), tmp_path_factory.mktemp("smooth") / "study", transfer=["apic", "mls"], quiet=True)


def test_a_smooth_motion_converges_with_order_two(smooth):
    """Quadratic splines, lumped mass: second order; at 8, 16 and 32 cells not all of it shows."""
    for scheme in smooth.schemes:
        assert 1.6 < scheme.estimate.order < 2.4
        assert scheme.estimate.errors[0] > 3.0 * scheme.estimate.errors[1] > 9.0 * scheme.estimate.errors[2] > 0.0
    assert all(apart < 0.005 for _, apart in smooth.apart.values())  # both converge to the same


def test_a_study_leaves_table_page_and_picture(smooth):
    with open(smooth.path / "study.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["scheme"], row["level"]) for row in rows] == [(s, str(n)) for s in ("apic", "mls") for n in range(3)]
    assert all(float(row["seconds"]) > 0.0 and float(row["bytes_per_particle"]) >= 104.0 for row in rows)
    page = (smooth.path / "study.md").read_text(encoding="utf-8")
    assert smooth.sentence in page
    assert "| apic | 0.00625 | cfl 0.4 | 4096 |" in page
    assert smooth.text.count("\n") > 10
    pytest.importorskip("matplotlib")
    assert (smooth.path / "study.png").read_bytes().startswith(b"\x89PNG")


def test_the_error_against_an_exact_solution_is_that_of_the_step(tmp_path):
    """Free fall of symplectic steps: g t dt / 2 of g t^2 / 2, dt / t = 1/40 at the end, of first order."""
    found = pmpm.study(falling(), tmp_path / "study", levels=3, quiet=True)
    (scheme,) = found.schemes
    assert found.exact
    assert scheme.estimate.errors == pytest.approx([1 / 40, 1 / 80, 1 / 160], rel=1e-9)
    assert scheme.estimate.order == pytest.approx(1.0, rel=1e-9)
    assert "error of 0.0062 at level 2" in found.text


def test_a_scene_may_be_a_function_of_the_refinement(tmp_path):
    def of(factor):
        return falling(time={"end": 0.02, "step": 5e-4 / factor**2})

    (scheme,) = pmpm.study(of, tmp_path / "study", levels=2, quiet=True).schemes
    assert scheme.estimate.errors == pytest.approx([1 / 40, 1 / 160], rel=1e-9)


def counted(monkeypatch):
    """A list that grows with each run that is begun."""
    begun, run = [], study.run_entry

    def run_and_count(entry, *others):
        begun.append(entry.number)
        return run(entry, *others)

    monkeypatch.setattr(study, "run_entry", run_and_count)
    return begun


def test_a_study_that_was_interrupted_goes_on_and_repeats_nothing(tmp_path, monkeypatch):
    begun, keep = counted(monkeypatch), study.StudyFolder.keep

    def keep_two(self, row, found):
        if row["number"] == 2:
            raise KeyboardInterrupt  # as if it were killed: nothing of the run is written
        keep(self, row, found)

    with monkeypatch.context() as patch:
        patch.setattr(study.StudyFolder, "keep", keep_two)
        with pytest.raises(KeyboardInterrupt):
            pmpm.study(falling(exact=None), tmp_path / "study", quiet=True)
    found = pmpm.study(falling(exact=None), tmp_path / "study", quiet=True)
    assert begun == [0, 1, 2, 2]
    again = pmpm.study(falling(exact=None), tmp_path / "study", quiet=True)
    assert begun == [0, 1, 2, 2]
    assert again.rows == found.rows


def test_a_row_of_another_scene_does_not_count(tmp_path, monkeypatch):
    begun = counted(monkeypatch)
    pmpm.study(falling(), tmp_path / "study", levels=2, quiet=True)
    row = tmp_path / "study" / "runs" / "001.json"
    row.write_text(row.read_text().replace('"hash": "', '"hash": "0'))
    pmpm.study(falling(), tmp_path / "study", levels=2, quiet=True)
    assert begun == [0, 1, 1]


def test_another_study_in_the_folder_is_refused_and_replaced_on_request(tmp_path, monkeypatch):
    pmpm.study(falling(), tmp_path / "study", levels=1, quiet=True)
    with pytest.raises(OutputError, match="holds another study .--levels was 1, is 2.*--overwrite"):
        pmpm.study(falling(), tmp_path / "study", levels=2, quiet=True)
    with pytest.raises(OutputError, match="the scene is another"):
        pmpm.study(falling(title="other"), tmp_path / "study", levels=1, quiet=True)
    (tmp_path / "study" / "mine.txt").write_text("stays")
    begun = counted(monkeypatch)
    pmpm.study(falling(title="other"), tmp_path / "study", levels=1, overwrite=True, quiet=True)
    assert begun == [0]
    assert (tmp_path / "study" / "mine.txt").exists()


def test_a_folder_with_other_files_is_refused_even_with_overwrite(tmp_path):
    (tmp_path / "mine.txt").write_text("stays")
    with pytest.raises(OutputError, match="does not hold a study .mine.txt."):
        pmpm.study(falling(), tmp_path, overwrite=True, quiet=True)
    assert os.listdir(tmp_path) == ["mine.txt"]


def test_a_run_that_fails_is_a_row_and_the_study_goes_on(tmp_path):
    """The block falls through a free floor: at every level, but the last of them in another way than the first."""
    floor = {"size": [0.2, 0.2], "cell_size": 0.025, "gravity": [0.0, -10.0], "walls": {"y_min": "free"}}
    sinking = falling(exact=None, domain=floor, time={"end": 0.2})
    found = pmpm.study(sinking, tmp_path / "study", levels=2, quiet=True)
    assert [row["status"] for row in found.rows] == ["failed", "failed"]
    assert "step" in found.rows[0]["cause"]
    assert found.text.count("failed: ") == 2
    assert "No error is known" in found.text


def test_a_disk_that_fills_up_ends_the_study_and_keeps_what_had_ended(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("block.toml").write_text(falling(exact=None).to_toml(), encoding="utf-8")
    written = folder.write_atomically

    def full(path, text):
        if path.name == "001.json":
            raise OSError(28, "No space left on device", str(path))
        written(path, text)

    with monkeypatch.context() as patch:
        patch.setattr(folder, "write_atomically", full)
        assert main(["study", "block.toml", "--levels", "2", "--quiet"]) == 1
    message = capsys.readouterr().err
    assert "001.json: No space left on device; runs that had ended are kept" in message
    begun = counted(monkeypatch)
    assert main(["study", "block.toml", "--levels", "2", "--quiet"]) == 0
    assert begun == [1]


def test_without_matplotlib_the_tables_are_written_and_the_user_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    pmpm.study(falling(), tmp_path / "study", levels=1)
    assert "pip install 'pmpm[viz]'" in capsys.readouterr().err
    assert (tmp_path / "study" / "study.csv").exists()
    assert not (tmp_path / "study" / "study.png").exists()


# ---- the command -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["dam_brake"], "did you mean dam_break"),
        (["dam_break", "--levels", "0"], "--levels 0"),
        (["dam_break", "--transfer", "apci"], "did you mean"),
        (["dam_break", "--precision", "float16"], "method.precision"),
        (["dam_break", "--set", "time.ent=1"], "did you mean end"),
        (["dam_break", "--out", "/proc/study"], "/proc"),
    ],
)
def test_wrong_input_ends_with_status_2_and_one_message(arguments, fragment, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["study", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("pmpm: ")
    assert fragment in captured.err
    assert os.listdir(tmp_path) == []


def test_the_command_prints_the_table_and_leaves_its_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("block.toml").write_text(falling(exact=None).to_toml(), encoding="utf-8")
    assert main(["study", "block.toml", "--levels", "2", "--transfer", "apic,flip", "--quiet"]) == 0
    captured = capsys.readouterr()
    assert "too few levels for an order" in captured.out
    assert captured.err == ""
    assert {"study.json", "study.csv", "study.md", "runs"} <= set(os.listdir("block_study"))
    assert not (tmp_path / "block_study" / "run.lock").exists()
