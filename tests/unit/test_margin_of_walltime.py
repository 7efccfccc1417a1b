"""How much of its wall time a run leaves for its last checkpoint."""

import time
from types import SimpleNamespace

from pmpm import requests
from pmpm.parallel.comm import Alone


def test_reading_and_compiling_before_the_first_step_are_no_step(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(requests, "clock", SimpleNamespace(monotonic=lambda: now[0], time=time.time))
    asked = requests.Requests(Alone(), deadline=time.time() + 3600.0)
    simulation = SimpleNamespace(comm=Alone(), nbytes=0, ask=None)
    for now[0] in (600.0, 600.5, 601.0):  # s: ten minutes until the first step is done, then half a second each
        asked(simulation)
    assert asked.longest_step == 0.5
