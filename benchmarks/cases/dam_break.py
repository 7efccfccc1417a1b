"""The dam break of Martin and Moyce (1952) as a smoke test: gates and measurements are those of benchmarks/dam_break.py."""

import importlib
import math

import numpy as np

import pmpm
from cases import Case, Table, at_most, holds
from cases.gathered import by_id

experiment = importlib.import_module("dam_break")


def front_history(cells, comm=None, **changes):
    """((T*, Z) of the front, largest change of the volume, relative) with `cells` cells per column width. Collective."""
    scene = pmpm.Scene.builtin("dam_break", {"domain.cell_size": experiment.A / cells, **changes})
    simulation, times, fronts, drift = pmpm.Simulation(scene, comm), [], [], [0.0]

    def note(simulation):
        x, J = by_id(simulation, "x", "J")
        times.append(simulation.time * math.sqrt(2.0 * experiment.GRAVITY / experiment.A))
        fronts.append(np.quantile(x[:, 0], 0.995) / experiment.A)
        drift.append(abs(float(J.mean()) - 1.0))

    simulation.every(note, seconds=0.002)
    simulation.run()
    return (np.array(times), np.array(fronts)), max(drift)


CELLS = {"tiny": (10, 20), "standard": (10, 20), "sweep": (20, 40)}


def verify(size, comm):
    found = {cells: front_history(cells, comm) for cells in CELLS[size]}
    wrong = experiment.complaints(*(history for history, _ in found.values()))
    names = " and ".join(f"a/{cells}" for cells in found)
    yield holds(f"{names}: {'; '.join(wrong) or 'front and slope'}", not wrong, "of benchmarks/dam_break.py")
    for cells, (_, drift) in found.items():
        yield at_most(
            f"a/{cells}: largest change of the volume", drift, 0.02, "nearly incompressible: c = 10 sqrt(2 g a)"
        )
    rows = [
        (f"a/{cells}", f"{experiment.slope(*history):.3f}", f"{drift:.2%}") for cells, (history, drift) in found.items()
    ]
    yield Table("Late front and volume", ("cell", "slope dZ/dT*", "change of volume"), rows)


ABOUT = """
The built-in scene `dam_break`: front within -5 % and +20 % of the experiment from T* = 1.9 on, slope dZ/dT* in 1.55 .. 1.85
over T* = 3 .. 5.3, both within 3 % of those of half the cell size. Finer grids and the measurements: [dam
break](dam_break.md).
"""

CASE = Case("V9", "Dam break", ABOUT, verify)
