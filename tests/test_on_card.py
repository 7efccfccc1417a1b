"""A simulated graphics card computes what the processor does, but for the growth of round-off: the rows of
tests/fast_and_scalar.py, each after some steps, a regroup, and restarts from a checkpoint of either on the other.

The simulator decides at import, so that each run has processes of its own. tests/by_hand/on_card_all.py runs other rows.
"""

import json
import os
from concurrent.futures import ThreadPoolExecutor

import fast_and_scalar as agreement
import launch
import pytest
import several_laws

import pmpm

OTHERS = "driven", "in and out", "two tiles, float32", "driven, no room to sum in", "linear, on nodes", "in contact"
ROWS = [*map(agreement.label, agreement.PAIRS + agreement.SINGLE), *OTHERS]
ON_TWO_RANKS = {
    "several 2 quadratic mls float32 False": "host",
    "neo_hookean 2 quadratic flip float32 False": "card",
    "in contact": "card",
}
HEARD = 1e-5, 1e-12  # of the energies, which float32 sums block by block: eps times the steps of a sum of a hundred
LIMIT, PARTS = 800, 6


def on_card(labels, folder, ranks=None, **environment):
    """What tests/on_card.py has found, by row."""
    program = (
        ["-m", "mpi4py", launch.ROOT / "tests" / "on_card.py"] if ranks else [launch.ROOT / "tests" / "on_card.py"]
    )
    done = launch.python([*program, folder, *labels], ranks, LIMIT, folder, NUMBA_ENABLE_CUDASIM="1", **environment)
    assert done.status == 0, done.text
    found = [json.loads(line) for line in done.text.splitlines() if line.startswith("{")]
    assert [row["row"] for row in found] == list(labels), done.text
    return found


def check(found):
    for after, apart in found["apart"].items():
        assert {name: far for name, far in apart.items() if not far <= agreement.BOUND} == {}, (found["row"], after)
    assert found["alike"], found["row"]
    # It would be cheap to agree where one computes for both.
    assert found["apart"]["steps"]["v"] > 0.0, found["row"]
    assert found["energies"] <= HEARD["float32" not in found["row"]], found["row"]


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Of each part of the rows, what will be found: as many at a time as there are cores, for the simulator uses one."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        waiting = [
            pool.submit(on_card, ROWS[part::PARTS], tmp_path_factory.mktemp(f"part_{part}")) for part in range(PARTS)
        ]
        yield waiting
        pool.shutdown(cancel_futures=True)


@pytest.mark.parametrize("part", range(PARTS))
def test_card_and_processor_agree_to_round_off_after_some_steps(part, parts):
    for row in parts[part].result():
        check(row)


@pytest.mark.parametrize(("row", "halo"), ON_TWO_RANKS.items())
def test_cards_of_two_ranks_agree_with_their_processors_with_halo_migration_and_other_cuts(row, halo, tmp_path):
    """Sums by way of the host, and straight from one card's arrays to the other's, as an MPI that knows cards sends them."""
    (found,) = on_card([row], tmp_path, ranks=2, PMPM_HALO=halo)
    check(found)
    assert found["sent"] > 0
    assert found["direct"] == (halo == "card")


def test_a_failure_on_a_card_is_told_as_on_the_processor(tmp_path):
    (found,) = on_card(["driven, failing"], tmp_path)
    one, other = found["failures"]
    assert "of material b" in one
    assert other.split(" (velocity")[0] == one.split(" (velocity")[0]


def test_a_card_sorts_many_particles_and_holds_what_was_estimated_before_it_was_asked(tmp_path):
    """The estimate leaves room for nodes of material that spreads."""
    (found,) = on_card(["many"], tmp_path)
    assert found["alike"]
    assert found["particles"] == 8000
    assert 0.6 * found["estimated"] < found["held"] < found["estimated"]


def test_a_run_on_cards_leaves_what_a_run_on_processors_leaves(tmp_path):
    """Snapshots, diagnostics and a record that says what computed."""
    (tmp_path / "drop.toml").write_text(several_laws.corner(end=1.0).to_toml(), encoding="utf-8")
    arguments = ["-m", "pmpm", "run", "drop.toml", "--steps", "4", "--set", "output.diagnostics_interval=1e-9"]
    for backend in ("cpu", "cuda"):
        folder = tmp_path / backend
        done = launch.python(
            [*arguments, "--backend", backend, "--out", folder], 2, LIMIT, tmp_path, NUMBA_ENABLE_CUDASIM="1"
        )
        assert done.status == 0, done.text
        assert ("a simulated card" in done.text) == (backend == "cuda"), done.text
    runs = {backend: pmpm.load(tmp_path / backend) for backend in ("cpu", "cuda")}
    assert [runs[backend].record["report"]["backend"] for backend in runs] == ["cpu", "cuda"]
    kinetic = [runs[backend].diagnostics["kinetic"] for backend in runs]
    assert kinetic[0] == pytest.approx(kinetic[1], rel=1e-5)
    assert runs["cuda"].snapshots[-1].velocity == pytest.approx(runs["cpu"].snapshots[-1].velocity, rel=1e-4, abs=1e-6)
