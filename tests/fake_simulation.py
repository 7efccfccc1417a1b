"""A simulation that computes nothing: it holds particles and answers what observers ask."""

from types import SimpleNamespace

import numpy as np

from pmpm.output.datasets import Later
from pmpm.parallel.comm import Alone

STATE_COLUMNS = {"hencky_strain": 6, "v_c": None}
SAND = 1


def fake_scene(dim=3, precision="float64", fields=("velocity", "pressure", "stress", "material"), title="A column"):
    return SimpleNamespace(
        title=title,
        dim=dim,
        method=SimpleNamespace(precision=precision),
        output=SimpleNamespace(fields=fields),
        materials={"water": "fluid", "sand": "drucker_prager"},
        time=SimpleNamespace(end=1.0),
    )


def later(rows):
    return Later(rows.shape, rows.dtype, lambda: [rows])


class FakeSimulation:
    """`count` particles over all ranks; `shares` are the ranks' parts of them (default: more on later ones)."""

    def __init__(self, scene, comm=None, count=40, shares=None, seed=0):
        self.scene, self.comm = scene, comm or Alone()
        self.time, self.step_count, self.dt = 0.1 + 0.2, 7, 1e-5 / 3.0
        self.count = count
        shares = np.array(shares or np.arange(1, self.comm.size + 1), float)
        cuts = np.round(np.cumsum(np.append(0.0, shares)) / shares.sum() * count).astype(int)
        self.here = slice(cuts[self.comm.rank], cuts[self.comm.rank + 1])
        self.all = self.particles(np.random.default_rng(seed))

    def particles(self, random):
        n, dim = self.count, self.scene.dim
        real = np.dtype(self.scene.method.precision)
        columns = {"velocity": dim, "stress": 6, "deformation_gradient": 9, "hencky_strain": 6}
        scalars = ("pressure", "J", "density", "speed", "v_c")
        held = {name: random.standard_normal((n, width)).astype(real) for name, width in columns.items()}
        held |= {name: random.standard_normal(n).astype(real) for name in scalars}
        held["x"] = random.random((n, dim))
        held["id"] = random.permutation(n).astype(np.int64) * 3
        held["material"] = (np.arange(n) >= n // 2).astype(np.int32)
        for name in STATE_COLUMNS:
            held[name][held["material"] != SAND] = np.nan
        return held

    def rows(self):
        return self.here.stop - self.here.start

    def fields_later(self, names):
        return {name: later(self.all[name][self.here].copy()) for name in names}

    def law_fields_later(self, names):
        is_sand = self.all["material"][self.here] == SAND
        state = {name: later(self.all[name][self.here][is_sand]) for name in names if name in STATE_COLUMNS}
        # A rank without sand does not know of the law.
        return {"drucker_prager": state} if is_sand.any() else {}

    def mean_forces(self):
        return {}

    def collider_places(self):
        return {}

    def measure(self):
        return {"particles": float(self.count), "mass": 2.0 / 3.0, "momentum_x": 1e-300, "max_speed": float("nan")}

    def advance(self, seconds=0.1):
        self.time += seconds
        self.step_count += 1
