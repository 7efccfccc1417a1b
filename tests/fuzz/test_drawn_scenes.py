"""Whatever a scene says, pmpm takes it and runs, or says in a few lines what is wrong: no crash, no hang, no memory gone.

Good scenes are run, those with something broken in them are checked: as file, as `--set`, and with damaged bytes. The draw is
the same every time that the same tests are collected.
"""

import contextlib
import math
from collections import namedtuple

import drawn_scenes as drawn
import pytest
import verdict
from hypothesis import HealthCheck, Phase, find, given, settings
from hypothesis import strategies as st
from hypothesis.errors import NoSuchExample

from pmpm import estimate
from pmpm.scene.needs import scene_needs
from pmpm.scene.schema import Scene

CASES = [(row, telling) for row in drawn.ROWS for telling in drawn.tellings(row)]
FEWEST_GOOD, BROKEN, SETTINGS, DAMAGED, EXTREME = 400, 700, 400, 400, 300
MOST_DRAWN = 3000  # for a key that chance missed: the rarest comes once in some hundreds
SMALL = 100_000  # cells and particles that are run without a thought
STEPS = ("--quiet", "--steps", "3", "--overwrite")

Example = namedtuple("Example", "text outcome complaints")


def times(count):
    """Draw so many examples, the same ones every time; a failing one is shown as it is."""
    return settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )


def tried(text, arguments, allowed, seconds=verdict.SECONDS):
    outcome = verdict.run(arguments, seconds)
    return Example(text, outcome, verdict.complaints(outcome, allowed))


def wrong(examples):
    """What is wrong with examples, with the beginning of what they were, for the first few."""
    found = [(example.complaints, example.text[:3000]) for example in examples if example.complaints]
    return "\n\n".join(f"{complaints}\n{text}" for complaints, text in found[:3])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("scenes") / "scene.toml"


@pytest.fixture(scope="module")
def out(file):
    return file.with_name("out")


@pytest.fixture(scope="module")
def good(file, out):
    """([Example] of good scenes that were run, the keys in them)."""
    examples, keys = [], set()

    def run(table):
        text = drawn.toml_text(table)
        file.write_text(text, encoding="utf-8")
        keys.update(drawn.keys_of(table))
        examples.append(tried(text, ["run", file, "--out", out, *STEPS], (0, 1), verdict.COMPILING))

    for row, telling in CASES:
        times(math.ceil(FEWEST_GOOD / len(CASES)))(given(drawn.scenes(row, telling))(run))()
    any_scene = st.sampled_from(CASES).flatmap(lambda case: drawn.scenes(*case))
    # What is drawn depends on which modules are loaded, hypothesis takes constants from them: keys that were missed are sought.
    for key in sorted(drawn.all_keys()):
        if key not in keys:
            with contextlib.suppress(NoSuchExample):
                run(find(any_scene, lambda table, key=key: key in drawn.keys_of(table), settings=times(MOST_DRAWN)))
    return examples, keys


def test_good_scenes_run(good):
    assert not wrong(good[0])


def test_few_good_scenes_fail(good):
    failed = [example for example in good[0] if example.outcome.status == 1]
    assert len(failed) <= len(good[0]) // 20, failed[0].outcome.err


def test_enough_good_scenes_are_run(good):
    assert len(good[0]) >= FEWEST_GOOD


def test_good_scenes_hold_every_key_of_the_schema(good):
    assert drawn.all_keys() - good[1] == set()


def test_broken_files_are_taken_or_refused(file, out):
    examples = []

    @times(BROKEN)
    @given(drawn.broken())
    def look(table):
        text = drawn.toml_text(table)
        file.write_bytes(text.encode("utf-8", "surrogatepass"))
        examples.append(tried(text, ["check", file], (0, 2)))
        if examples[-1].outcome.status == 2:  # what a check refuses, a run refuses
            examples.append(tried(text, ["run", file, "--out", out.with_name("broken"), *STEPS], (2,)))

    look()
    assert not wrong(examples)
    assert not out.with_name("broken").exists()


def test_broken_settings_are_taken_or_refused(file):
    examples = []

    @times(SETTINGS)
    @given(drawn.scenes(), st.data())
    def look(table, data):
        file.write_text(drawn.toml_text(table), encoding="utf-8")
        texts = data.draw(st.lists(drawn.settings(table), min_size=1, max_size=3))
        arguments = [argument for text in texts for argument in ("--set", text)]
        examples.append(tried(str(arguments), ["check", file, *arguments], (0, 2)))

    look()
    assert not wrong(examples)


def test_damaged_files_are_taken_or_refused(file):
    examples = []

    @times(DAMAGED)
    @given(drawn.damaged())
    def look(content):
        file.write_bytes(content)
        examples.append(tried(repr(content), ["check", file], (0, 2)))

    look()
    assert not wrong(examples)


def test_extreme_numbers_run_or_fail_or_are_refused(file, out):
    """Small ones that ask for no other kernels are run; they may fail, for a reason that is told."""
    examples = []

    @times(EXTREME)
    @given(drawn.extreme())
    def look(pair):
        good, text = map(drawn.toml_text, pair)
        file.write_text(text, encoding="utf-8")
        examples.append(tried(text, ["check", file], (0, 2)))
        if examples[-1].outcome.status == 0 and is_small(Scene.from_text(text), Scene.from_text(good)):
            run = tried(text, ["run", file, "--out", out, *STEPS], (0, 1, 2), verdict.COMPILING)
            # How fast waves run through what starts under stress, only the run finds out.
            told = run.outcome.status != 2 or "time.step" in run.outcome.err or "too far" in run.outcome.err
            examples.append(run if told else run._replace(complaints=[f"check took it: {run.outcome.err}"]))

    look()
    assert not wrong(examples)


def is_small(scene, good):
    most = max(estimate.places_to_try(scene), math.prod(map(float, scene.cells)))
    return most <= SMALL and scene_needs(scene) == scene_needs(good)
