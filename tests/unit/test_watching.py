"""When those who watch a run are called."""

from types import SimpleNamespace

import pytest

from pmpm.watching import Observer, next_count


@pytest.mark.parametrize(("time", "seconds", "count"), [(0.0, 0.1, 1), (0.25, 0.1, 3), (0.2, 0.1, 3), (7.0, 2.0, 4)])
def test_the_next_multiple_of_an_interval_lies_after_now(time, seconds, count):
    assert next_count(time, seconds) == count


@pytest.mark.parametrize("seconds", [5e-324, 1e-310, 1e-30])
def test_an_interval_of_next_to_nothing_is_due_in_every_step(seconds):
    """Though the number of intervals in a time may be infinite."""
    observer = Observer(print, None, seconds)
    assert [observer.due(SimpleNamespace(time=time)) for time in (1e-5, 2e-5, 1.0, 1e6)] == [True] * 4
