"""Cuts follow the work: a column of water runs out along a long tank, on 4 and on 8 ranks, with cuts that move and without.

    python benchmarks/balance.py [--quick] [--docs docs]

Everything is counted, nothing timed, so that any number of cores will do: imbalance is the work of the busiest rank over the
mean of all, as pmpm/parallel/balance.py counts it, by the cuts and the particles that a regroup has left behind. Without
balance cuts stay where they were: either those pmpm starts with, even by seeded volume, or slabs of even width.

Gates: with balance at most 1.10 at every regroup, without it more than 2 at some; where slabs cannot be narrow enough, at most
1.10 times what no cuts could beat, and 1.001 times where cuts have moved; and all runs end with the bits of one rank, those too
that go on from a checkpoint on other numbers of ranks. Prints a line per run and exits non-zero where a gate fails. With --docs
it writes results/balance.md and pictures/balance.png there (needs matplotlib). --quick: a coarse tank, short. Wants mpirun.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import machine
import numpy as np
import pages
from conservation import bits, mpirun
from stages import Progress

import pmpm
from pmpm.parallel.balance import imbalance, slab_works, sums_below
from pmpm.parallel.comm import from_launcher

HIGHEST, WITHOUT, OF_BEST, EXACT = 1.10, 2.0, 1.10, 1.001
FIELDS = ("id", "x", "velocity", "C", "J")
CELL, GRAVITY = 0.01, 9.81
FEW = 200  # layers: of more, all cuts are too many to try
PROFILES = 160  # of the material along the tank, over a run
MOVING, FIXED, EVEN = "moving", "fixed", "even"
WHAT = {MOVING: "cuts that move", FIXED: "cuts of the start", EVEN: "even slabs"}


@dataclass(frozen=True)
class Tank:
    """A column of water, so many cells wide and high, at the end of a tank so many times as long, for so many steps."""

    width: int
    height: int
    times: int
    steps: int

    def scene(self, balance):
        width, height = CELL * self.width, CELL * self.height
        sound_speed = 10.0 * np.sqrt(
            GRAVITY * height
        )  # five times the front's 2 sqrt(g h): density within a few percent
        return pmpm.Scene(
            domain={
                "size": [self.times * width, 1.5 * height], "cell_size": CELL, "gravity": [0.0, -GRAVITY],
                "walls": {"x_min": "slip", "x_max": "slip", "y_min": "slip"},
            },
            time={"end": 1e3},
            materials={"water": {"model": "fluid", "density": 1000.0, "sound_speed": float(sound_speed)}},
            bodies=[
                {"material": "water", "pressure": "hydrostatic",
                 "shape": {"type": "box", "min": [0.0, 0.0], "max": [width, height]}},
            ],
            parallel={"balance": balance},
        )  # fmt: skip


LONG, SHORT = "long", "short"
TANKS = {LONG: Tank(160, 40, 5, 11000), SHORT: Tank(20, 20, 5, 1600)}
QUICK = {LONG: Tank(80, 16, 5, 4200), SHORT: Tank(20, 10, 5, 800)}
RANKS = {LONG: (4, 8), SHORT: (8,)}
RANKS_QUICK = {LONG: (4,), SHORT: (8,)}
SAVED_ON, RESTARTED_ON, RESTARTED_QUICK = 4, (1, 3, 8), (1, 3)


# ---- on the ranks ----------------------------------------------------------------------------------------------------------


def least_imbalance(work, ranks, window):
    """The imbalance that no cuts can beat, tried over all there are: the smallest largest work of up to `ranks` slabs that
    end at each edge, from that of one slab less."""
    below = sums_below(work).astype(float)
    edges = np.arange(len(below))
    slab = np.where(edges[None, :] - edges[:, None] >= window, below[None, :] - below[:, None], np.inf)
    ends, best = slab[0], slab[0, -1]
    for _ in range(ranks - 1):
        ends = np.maximum(ends[:, None], slab).min(axis=0)
        best = min(best, ends[-1])
    return best * ranks / max(below[-1], 1.0)


class Watch:
    """Notes (step, time, edges, imbalance) after every regroup, and profiles of the water. With few layers `reached`, too:
    (imbalance that the decision on new cuts led to, the least there is for the work it was made by, whether cuts moved)."""

    def __init__(self, simulation, steps, save=None):
        self.rows, self.profiles, self.reached = [], [], []
        self.tries_all = simulation.geometry.layers < FEW
        self.work, self.moves = None, simulation.balance.changes
        self.regroups, self.every, self.save = simulation.regroups, max(steps // PROFILES, 1), save or (None, None)
        simulation.every(self, steps=1, at_start=True)

    def __call__(self, simulation):
        step, path = self.save
        if simulation.step_count == step:
            simulation.save(path)
        if simulation.step_count % self.every == 0:
            self.note_profile(simulation)
        if simulation.regroups > self.regroups:
            self.regroups = simulation.regroups
            self.note(simulation)
        if self.tries_all:
            self.work = simulation.counted_work()

    def note(self, simulation):
        edges, balance = simulation.slabs.edges, simulation.balance
        now = imbalance(slab_works(simulation.counted_work(), edges))
        self.rows.append((simulation.step_count, simulation.time, list(edges), now))
        if self.work is not None:
            least = least_imbalance(self.work, simulation.comm.size, simulation.needs.stencil.window)
            self.reached.append((balance.after, least, balance.changes > self.moves))
            self.moves = balance.changes

    def note_profile(self, simulation):
        layer = np.floor(simulation.particles.x[:, 0] / CELL + 0.5).astype(int)
        counts = simulation.comm.sum(np.bincount(layer, minlength=simulation.geometry.layers))
        self.profiles.append((simulation.time, counts.tolist()))


def run_as_a_rank(given):
    """One run, under mpirun or alone; rank 0 leaves what was found in the file `given.result`."""
    comm, tank = from_launcher(), Tank(*map(int, given.tank))
    if given.restart:
        simulation = pmpm.Simulation.restart(given.restart, comm=comm)
    else:
        simulation = pmpm.Simulation(tank.scene(given.cuts == MOVING), comm)
    if given.cuts == EVEN:
        simulation.regroup(edges=np.linspace(0, simulation.geometry.layers, comm.size + 1).round().astype(int))
    watch = Watch(simulation, tank.steps, (tank.steps // 2, given.save) if given.save else None)
    simulation.run(steps=tank.steps - simulation.step_count)
    told = simulation.report()
    found = {
        "hash": bits(simulation, FIELDS), "rows": watch.rows, "profiles": watch.profiles, "reached": watch.reached,
        "particles": told["particles"], "sent": int(np.sum(told["sent"])), "bytes": sum(told["sent_bytes"]),
        "regroups": told["regroups"], "balance": told["balance"], "window": simulation.needs.stencil.window,
        "layers": simulation.geometry.layers, "time": simulation.time,
    }  # fmt: skip
    if comm.rank == 0:
        Path(given.result).write_text(json.dumps(found), encoding="utf-8")


# ---- all runs --------------------------------------------------------------------------------------------------------------


class Runs:
    """Starts runs and keeps what they found: {(tank, ranks, cuts): found}; restarts have cuts "restarted"."""

    def __init__(self, quick, folder):
        self.tanks, self.ranks, self.restarted_on = (
            (QUICK, RANKS_QUICK, RESTARTED_QUICK) if quick else (TANKS, RANKS, RESTARTED_ON)
        )
        self.folder, self.found = Path(folder), {}
        started = sum(1 + len(self.ranks[name]) * len(cuts_of(name)) for name in self.tanks)
        self.progress = Progress(started + len(self.restarted_on))

    def go(self, name, ranks, cuts, *options):
        tank, path = self.tanks[name], self.folder / "found.json"
        given = ["--as-rank", "--tank", *(str(value) for value in (tank.width, tank.height, tank.times, tank.steps))]
        command = [sys.executable, __file__, *given, "--cuts", cuts, "--result", str(path), *options]
        launcher = [mpirun(), "-n", str(ranks)] if ranks > 1 else []
        self.progress.tell(f"{name} tank, {ranks} ranks, {WHAT.get(cuts, cuts)}")
        done = subprocess.run(
            [*launcher, *command], env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True
        )
        if done.returncode != 0:
            sys.exit(f"{' '.join(command)} ended with {done.returncode}\n{done.stdout}{done.stderr}")
        found = self.found[name, ranks, cuts] = json.loads(path.read_text(encoding="utf-8"))
        print("   ", told(found), flush=True)

    def all(self):
        checkpoint = str(self.folder / "half.hdf")
        for name in self.tanks:
            self.go(name, 1, MOVING)
            for ranks in self.ranks[name]:
                for cuts in cuts_of(name):
                    save = name == LONG and ranks == SAVED_ON and cuts == MOVING
                    self.go(name, ranks, cuts, *(["--save", checkpoint] if save else []))
        for ranks in self.restarted_on:
            self.go(LONG, ranks, "restarted", "--restart", checkpoint)


def cuts_of(name):
    return (MOVING, FIXED, EVEN) if name == LONG else (MOVING, EVEN)


def imbalances(found):
    return np.array([row[3] for row in found["rows"]])


def told(found):
    """What is printed of a run."""
    now = imbalances(found)
    return (
        f"{found['regroups']} regroups, imbalance {now[0]:.3f} first, {now.max():.3f} at most, {now[-1]:.3f} last; "
        f"{found['balance']['cuts_moved']} moves of cuts; sent {found['sent']} particles, {found['bytes'] / 1e6:.1f} MB"
    )


def complaints(found):
    """What misses its gate, one line each."""
    missed = []
    for (name, ranks, cuts), run in found.items():
        what = f"{name} tank, {ranks} ranks, {WHAT.get(cuts, cuts)}"
        highest = imbalances(run).max()
        if run["hash"] != found[name, 1, MOVING]["hash"]:
            missed.append(f"{what}: other bits than one rank")
        if name == LONG and ranks > 1 and cuts not in (FIXED, EVEN) and highest > HIGHEST:
            missed.append(f"{what}: imbalance of {highest:.3f}")
        if cuts in (FIXED, EVEN) and highest <= WITHOUT:
            missed.append(f"{what}: imbalance of {highest:.3f} only, the tank shows nothing")
        if name == SHORT and ranks > 1 and cuts == MOVING:
            of_least, at_moves = reached(run)
            if of_least.max() > OF_BEST:
                missed.append(f"{what}: {of_least.max():.3f} times the least imbalance there is")
            if at_moves.max() > EXACT:
                missed.append(f"{what}: cuts moved to {at_moves.max():.4f} times the least imbalance there is")
    return missed


def reached(run):
    """What decisions led to, over the least that any cuts give: (at every regroup, where cuts moved)."""
    after, least, moved = np.array(run["reached"]).T
    return after / least, (after / least)[moved > 0]


# ---- the page --------------------------------------------------------------------------------------------------------------

PAGE = """# Cuts follow the work

`python benchmarks/balance.py --docs docs`, {machine}.
Ranks share the cores of this machine: nothing here is timed.

A column of water, {width} x {height} cells, {particles} particles, runs out along a tank of {layers} layers for {steps} steps.
The work of a rank is counted as `pmpm/parallel/balance.py` does it, by the weight of each particle's law and the nodes that
are reached; imbalance is the work of the busiest rank over the mean of all, 1 is even. It is taken after every regroup, by the
particles that each rank then holds. Cuts move when they have cost the busiest rank more than the moving costs.
"Cuts of the start" is `parallel.balance = false`: even shares of the seeded volume, which then stay. "Even slabs" are of even
width throughout. "Sent" counts particles that changed ranks, and the bytes of their rows in messages.

{table}

Gates: with cuts that move at most {highest:.2f} at every regroup, from the first on; without more than {without:.0f} at some.

![imbalance over time and cuts over the water](../pictures/balance.png)

Above: imbalance at every regroup on 8 ranks, and the gate. Below: the seven cuts that move, over the particles of each layer.

## Where slabs cannot be narrower

A slab is at least {window} layers wide, as many as the planes that a layer's particles may touch. A column of {short_width} x
{short_height} cells in a tank of {short_layers} layers has its work in fewer layers than {short_ranks} ranks take:
no cuts are even. "Reached" is the imbalance of the cuts that stand after a regroup, by the work that was counted for the
decision; "least there is" that of the best of all cuts for the same work, found by trying all of them (a dynamic programme
over layers and ranks that shares no code with pmpm). Gates: at most {of_best:.2f} times the least at every regroup, {exact:.3f}
times where cuts have moved. "After migration" is the imbalance once particles have joined the layers they had moved to.

{short_table}

Of {regroups} regroups, {moves} moved cuts.

## The same bits

SHA-256 over {fields} of all particles at the end of each run, against one rank without MPI. "Restarted" went on, half
way, from the checkpoint of {saved_on} ranks with cuts that move.

{bits}

{verdict}
"""


def as_table(heads, rows):
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in (heads, ["---"] * len(heads), *rows))


def long_table(found):
    rows = []
    for (name, ranks, cuts), run in found.items():
        if name == LONG and ranks > 1 and cuts in WHAT:
            now = imbalances(run)
            values = (f"{value:.3f}" for value in (now[0], np.median(now), now.max(), now[-1]))
            moved = run["balance"]["cuts_moved"], run["sent"], f"{run['bytes'] / 1e6:.1f}"
            rows.append((ranks, WHAT[cuts], run["regroups"], *values, *moved))
    heads = ("ranks", "cuts", "regroups", "first", "median", "largest", "last", "moves", "sent, particles", "sent, MB")
    return as_table(heads, rows)


def short_table(found):
    """Imbalance at some regroups of the short tank."""
    ranks = RANKS[SHORT][0]
    moving, even = (found[SHORT, ranks, cuts] for cuts in (MOVING, EVEN))
    steps = [row[0] for row in moving["rows"]]
    ratio, _ = reached(moving)
    picks = [*np.unique(np.linspace(0, len(steps) - 1, 8).round().astype(int)), int(np.argmax(ratio))]
    rows = []
    for place, n in enumerate(picks):
        after, least, _ = moving["reached"][n]
        values = after, least, ratio[n], moving["rows"][n][3], at(even, steps[n])
        rows.append(
            (f"{steps[n]}{', worst' if place == len(picks) - 1 else ''}", *(f"{value:.3f}" for value in values))
        )
    return as_table(("step", "reached", "least there is", "ratio", "after migration", "even slabs"), rows)


def at(run, step):
    """The imbalance of a run after the last regroup before a step."""
    rows = [row[3] for row in run["rows"] if row[0] <= step]
    return rows[-1] if rows else run["rows"][0][3]


def bits_table(found):
    rows = []
    for (name, ranks, cuts), run in found.items():
        same = "same" if run["hash"] == found[name, 1, MOVING]["hash"] else "DIFFER"
        rows.append((name, ranks, WHAT.get(cuts, cuts) if ranks > 1 else cuts_of_one(cuts), run["hash"][:12], same))
    return as_table(("tank", "ranks", "cuts", "hash", "bits"), rows)


def cuts_of_one(cuts):
    return "" if cuts in WHAT else cuts


def page(tanks, found, missed):
    reference, tank, short = found[LONG, 8, MOVING], tanks[LONG], tanks[SHORT]
    narrow = found[SHORT, RANKS[SHORT][0], MOVING]
    return PAGE.format(
        machine=machine.text(), width=tank.width, height=tank.height, steps=tank.steps, layers=reference["layers"],
        particles=reference["particles"], table=long_table(found), highest=HIGHEST, without=WITHOUT,
        window=reference["window"], short_width=short.width, short_height=short.height, exact=EXACT,
        short_layers=narrow["layers"], short_ranks=RANKS[SHORT][0], of_best=OF_BEST, short_table=short_table(found),
        regroups=narrow["regroups"], moves=narrow["balance"]["cuts_moved"], fields=", ".join(FIELDS), saved_on=SAVED_ON,
        bits=bits_table(found),
        verdict="All gates hold." if not missed else "Gates that fail: " + "; ".join(missed) + ".",
    )  # fmt: skip


def plot(found, path):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (above, below) = pyplot.subplots(2, 1, figsize=(7.5, 6.4), sharex=True, layout="constrained")
    styles = {MOVING: ("tab:blue", "-"), FIXED: ("tab:red", "--"), EVEN: ("tab:orange", ":")}
    for cuts, (colour, line) in styles.items():
        rows = found[LONG, 8, cuts]["rows"]
        above.plot([row[1] for row in rows], [row[3] for row in rows], line, color=colour, label=WHAT[cuts])
    above.axhline(HIGHEST, color="0.6", lw=0.8)
    above.set(ylabel="work of the busiest rank / mean", ylim=(0.9, None))
    above.legend(frameon=False)
    moving = found[LONG, 8, MOVING]
    times, counts = zip(*moving["profiles"], strict=True)
    below.pcolormesh(
        times,
        np.arange(moving["layers"]),
        np.sqrt(np.array(counts).T),
        cmap="Greys",
        shading="nearest",
        rasterized=True,
    )
    edges = np.array([row[2][1:-1] for row in moving["rows"]])
    below.plot([row[1] for row in moving["rows"]], edges, color="tab:blue", lw=0.9, drawstyle="steps-post")
    below.set(xlabel="time (s)", ylabel="layer", ylim=(0, moving["layers"]))
    figure.savefig(path, dpi=140)


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="a coarse tank, short; writes no page")
    options.add_argument("--docs", type=Path, help="write page and picture here")
    options.add_argument("--as-rank", action="store_true", help=argparse.SUPPRESS)
    options.add_argument("--tank", nargs=4, help=argparse.SUPPRESS)
    for name in ("--cuts", "--result", "--save", "--restart"):
        options.add_argument(name, help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.as_rank:
        run_as_a_rank(given)
        return 0
    if given.docs and given.quick:
        options.error("--docs wants the full tank, not --quick")
    with tempfile.TemporaryDirectory() as folder:
        runs = Runs(given.quick, folder)
        runs.all()
    missed = complaints(runs.found)
    print(long_table(runs.found), short_table(runs.found), bits_table(runs.found), sep="\n\n")
    print("\n".join(f"FAILED: {line}" for line in missed) or "all gates hold")
    if given.docs:
        pages.write(given.docs, "balance", page(runs.tanks, runs.found, missed))
        plot(runs.found, given.docs / "pictures" / "balance.png")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
