"""The tests in tests/mpi, for several ranks, as tests of a plain `python -m pytest`."""

import re

import launch
import pytest
from conftest import FOR_SEVERAL_RANKS

LIMIT = 900


@pytest.mark.timeout(LIMIT + 20)
@pytest.mark.parametrize("ranks", [2, 3])
def test_tests_for_several_ranks_pass(ranks, tmp_path):
    options = ["--with-mpi", "--color=no", "-v", "-rs", f"--rootdir={FOR_SEVERAL_RANKS.parent}"]
    done = launch.python(["-m", "pytest", *options, FOR_SEVERAL_RANKS], ranks, LIMIT, tmp_path)
    closing = re.findall(r"^=+ (.*) in [0-9.]+s.*=+$", done.text, re.MULTILINE)
    assert done.status == 0, done.text
    assert f"world of {ranks} ranks" in done.text, done.text
    assert len(closing) == 1, done.text
    assert re.fullmatch(r"[1-9][0-9]* passed", closing[0]), done.text  # none skipped, deselected, or expected to fail
