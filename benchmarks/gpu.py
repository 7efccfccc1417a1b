"""What pmpm asks of a graphics card, and, where there is one, how fast it is.

    python benchmarks/gpu.py [--docs docs]              counts and assembler figures: no card needed
    python benchmarks/gpu.py --run [--docs docs]        times W1 to W3 beside Taichi and Warp on this machine's card as well
    python benchmarks/gpu.py --rehearse                 the same timing, small and on the processor: no card needed

Without a card: of every kernel of the built-in scenes in float32, for A100 (sm_80) and H100 (sm_90), registers, stack, spills
and double arithmetic, by NVIDIA's own assembler; bytes and atomics per particle-step of W1 to W3 (docs/results/kernels.md),
derived, and counted in numba's simulator; what bandwidth then allows at most. Needs the extras `cuda` and `test`, with --run
and --rehearse also `bench`. Exits with 1 where a kernel of the elastic, water or sand law spills, has a stack or computes in
double precision, or counts differ from what was derived. With --docs the page is results/cuda.md.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import assembler  # noqa: E402
import contest  # noqa: E402
import machine  # noqa: E402
import numpy as np  # noqa: E402
import pages  # noqa: E402
import sum_schemes  # noqa: E402
from peers.pmpm_mpm import MATERIALS  # noqa: E402
from workloads import LAWS, Workload  # noqa: E402

import pmpm  # noqa: E402
from pmpm.processors.plan import kernels_of  # noqa: E402
from pmpm.scene.files import builtin_scenes  # noqa: E402

CAPABILITIES = {"A100": (8, 0), "H100": (9, 0)}
CLEAN = {"neo_hookean", "fluid", "drucker_prager"}  # laws whose kernels must neither spill nor have a stack
BANDWIDTH = {"A100 80GB": 2.04e12, "H100 SXM": 3.35e12}  # bytes/s, NVIDIA's data sheets
FIELDS = {"W1": 9, "W2": 7, "W3": 1}  # state: F; Hencky strain and v_c; J
DIM, NODES, REAL = 3, 27, 4
PER_CELL = 8
NODE_BYTES = (
    5 * 4 * REAL / PER_CELL + 2 * 24 / 16
)  # of nodes, read and written five times, and of the record of a block
SUMMED = {"column_collapse_3d": 800, "dam_break_3d": 400, "mixed_materials": 400}  # steps
RUN_CELLS, REHEARSED_CELLS, RUN_STEPS, ROUNDS, COMPARED = 256, 32, 50, 5, 20
CONTESTANTS = {"pmpm": "peers.pmpm_mpm", "Taichi": "peers.taichi_mpm", "Warp": "peers.warp_mpm"}


COUNT_COLUMNS = ("", "P2G reads, derived", "counted", "atomics, derived", "counted", "tiled", "G2P reads, derived", "counted",
                 "G2P writes, derived", "counted")  # fmt: skip


def small_block(name):
    """A block of a workload's law, small enough for the simulator: 216 particles, quadratic splines, MLS, float32."""
    return pmpm.Scene(
        domain={"size": [0.8] * 3, "cell_size": 0.1, "gravity": [0.0, -9.81, 0.0]},
        method={"precision": "float32", "transfer": "mls"},
        time={"end": 1.0},
        materials={"block": MATERIALS[name]},
        bodies=[{"material": "block", "shape": {"type": "box", "min": [0.2] * 3, "max": [0.5] * 3}}],
    )


def derived(name):
    """Bytes of a particle's own fields and atomics per particle-step: P2G reads x, v, C and state and adds momentum and mass to
    27 nodes; G2P reads x, state and the velocities of 27 nodes, and writes x, v, C and state."""
    x, v, C, state = DIM, DIM, DIM * DIM, FIELDS[name]
    return {
        "p2g particle bytes read": REAL * (x + v + C + state),
        "p2g atomics on nodes": NODES * (DIM + 1),
        "g2p particle bytes read": REAL * (x + state),
        "g2p node bytes read": REAL * NODES * DIM,
        "g2p particle bytes written": REAL * (x + v + C + state),
    }


def counted(name, sums):
    """What the simulator counts, by particle-step; sums: tiled or direct."""
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1"}
    paths = os.pathsep.join(filter(None, [str(HERE), str(HERE.parent), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, HERE / "count_accesses.py", name, sums], env=environment | {"PYTHONPATH": paths}, capture_output=True,
        text=True,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))


def table(head, rows):
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in (head, ["---"] * len(head), *rows))


def kernel_rows(progress):
    """(rows of the table of kernels, what missed): each kernel once, however many scenes call it."""
    rows, missed, seen = [], [], set()
    for scene_name in builtin_scenes():
        scene = pmpm.Scene.builtin(scene_name, {"method.precision": "float32"})
        models = sorted({material.model for material in scene.materials.values()})
        for noted in kernels_of(scene):
            if (noted.function.__qualname__, noted.types) in seen:
                continue
            seen.add((noted.function.__qualname__, noted.types))
            figures = {card: assembler.assemble(noted.ptx(cc), cc) for card, cc in CAPABILITIES.items()}
            text = [f"{made.registers} / {made.stack} / {made.spills} / {made.doubles}" for made in figures.values()]
            rows.append([scene_name, ", ".join(models), noted.name, figures["H100"].atomics, *text])
            clean = set(models) <= CLEAN
            bad = [made for made in figures.values() if made.doubles or (clean and (made.spills or made.stack))]
            missed += [f"{scene_name}: {noted.name}"] * bool(bad)
        progress(f"{scene_name}: {len(seen)} kernels so far")
    return rows, missed


def count_rows(progress):
    """(rows of the table of counts, what missed)."""
    rows, missed = [], []
    for name in LAWS:
        wanted, found, tiled = derived(name), counted(name, "direct"), counted(name, "tiled")
        own = found["p2g bytes read"]
        rows.append([
            f"{name} {LAWS[name]}", wanted["p2g particle bytes read"], f"{own:.0f}", wanted["p2g atomics on nodes"],
            f"{found['p2g atomic add']:.2f}", f"{tiled['p2g atomic add']:.1f}",
            wanted["g2p particle bytes read"] + wanted["g2p node bytes read"], f"{found['g2p bytes read']:.0f}",
            wanted["g2p particle bytes written"], f"{found['g2p bytes written']:.1f}",
        ])  # fmt: skip
        if found["p2g atomic add"] != wanted["p2g atomics on nodes"]:
            missed.append(f"{name}: {found['p2g atomic add']} atomics, {wanted['p2g atomics on nodes']} derived")
        if not 0.0 <= found["g2p bytes written"] - wanted["g2p particle bytes written"] < 2.0:  # and block maxima
            missed.append(
                f"{name}: {found['g2p bytes written']} bytes written, not {wanted['g2p particle bytes written']}"
            )
        if own < wanted["p2g particle bytes read"]:
            missed.append(f"{name}: {own} bytes read by P2G, less than its fields")
        progress(f"{name}: counted")
    return rows, missed


def predicted(name):
    """Bytes per particle-step that must come from memory: a particle's fields, and its share of nodes that are cleared, summed,
    divided and gathered once each if the rest stays in the cache."""
    wanted = derived(name)
    own = sum(value for key, value in wanted.items() if "particle" in key)
    return own + NODE_BYTES


def predicted_if_fused(name):
    """The same if one kernel did G2P and the next step's P2G: v and C would stay in registers, x and the state be read and
    written once."""
    return REAL * 2 * (DIM + FIELDS[name]) + NODE_BYTES


def prediction_rows():
    rows = []
    for name in LAWS:
        for label, size in ((f"{name} {LAWS[name]}", predicted(name)), ("if fused", predicted_if_fused(name))):
            rows.append([label, f"{size:.0f}", *(f"*{rate / size / 1e9:.1f}*" for rate in BANDWIDTH.values())])
    return rows


def scheme_rows(progress):
    """Rows of the table of ways to sum: built-in scenes at their start and later."""
    rows = []
    for name, steps in SUMMED.items():
        simulation = pmpm.Simulation(pmpm.Scene.builtin(name, {"method.precision": "float32"}))
        for until in (0, steps):
            simulation.run(steps=until)
            since = simulation.step_count - simulation.control.regroup_step
            found, without_room = sum_schemes.sums(simulation)
            counts = (f"{found[scheme]:.1f}" for scheme in sum_schemes.SCHEMES)
            rows.append([name, until, since, *counts, f"{100 * without_room:.1f}"])
        progress(f"{name}: ways to sum")
    return rows


def timed(device, cells, progress):
    """(rows of measured particle-steps per second, complaints): pmpm, Taichi and Warp in turns on the same device."""
    rows, absent = [], []
    for name in LAWS:
        children = {
            who: contest.Child(module, [name, cells, "--device", device], [min(os.sched_getaffinity(0))])
            for who, module in CONTESTANTS.items()
        }
        seconds: dict[str, list[float]] = {who: [] for who in children}
        particles, places = Workload(name, cells).particles, {}
        for act in ("facts", "start", "compare", *["time"] * ROUNDS):
            progress(f"{name}: {act}")
            for who in list(children):
                try:
                    take_turn(children[who], act, seconds[who], who, places)
                except contest.ContestantError as error:
                    absent.append(f"{name}, {who}: {error}")
                    children.pop(who).end()
        for child in children.values():
            child.end()
        pace = {who: particles / statistics.median(of_steps) / 1e6 for who, of_steps in seconds.items() if of_steps}
        for who in pace:
            apart = np.abs(places[who] - places["pmpm"]).max() * cells if "pmpm" in places else math.nan
            ratio = f"{pace['pmpm'] / pace[who]:.2f}" if "pmpm" in pace else "-"
            rows.append([f"{name} {LAWS[name]}", who, particles, f"{pace[who]:.1f}", ratio, f"{apart:.1e}"])
            progress(" | ".join(map(str, rows[-1])))
    return rows, absent


def take_turn(child, act, seconds, who, places):
    """One contestant's part of `timed`."""
    if act == "facts":
        child.read()
    elif act == "start":
        child.ask(do="start", fast=False)
    elif act == "compare":
        child.ask(do="step", steps=COMPARED)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "x.npy"
            child.ask(do="positions", path=str(path))
            places[who] = np.load(path).astype(np.float64)
    else:
        seconds += child.ask(do="step", steps=RUN_STEPS)["seconds"]


def measured_text(device, cells, progress):
    """The section of what has been measured on a device."""
    from pmpm.parallel.comm import Alone
    from pmpm.processors import cards

    name = cards.take(Alone()).text if device == "cuda" else "the processor, which is a rehearsal"
    rows, absent = timed(device, cells, progress)
    text = (
        f"\n## Measured\n\nOn {name}. Medians of {ROUNDS} turns of {RUN_STEPS} steps in float32; `apart`: the largest\n"
    )
    text += f"distance of a particle from pmpm's after {COMPARED} steps, in cells.\n\n"
    text += table(["", "code", "particles", "million particle-steps/s", "pmpm over it", "apart"], rows) + "\n"
    return text + "".join(f"\nOut: {complaint}.\n" for complaint in absent)


SCHEME_COLUMNS = ("", "step", "since the last regroup", "plain", "warp", "tiles", "blocks without room (%)")
RUN_ON = {
    True: "What has been measured stands at the end.",
    False: "**No card has run it yet but\nnumba's simulator**: what follows is what can be known without one, and "
    "predictions are marked so.",
}
PAGE = """\
# On a graphics card

`python benchmarks/gpu.py{options} --docs docs` wrote this page.
{machine}.

`--backend cuda` keeps particles and nodes on the card; loops are in `kernels/cuda_loops.py`, one thread per particle, and
what is done to a particle or node is compiled from the same functions as on the CPU. Regroups (`kernels/cuda_sorting.py`) sort
and move particles on the card; only those that go to other ranks pass through the host. {run_on}

## Kernels

Of the built-in scenes in float32; registers / bytes of stack / bytes spilled / places with double arithmetic, by NVIDIA's
assembler. {verdict}

{kernels}

## Bytes and atomics per particle-step

3-D, quadratic splines, MLS-MPM, float32. Derived: P2G reads x, v, C and the state and adds momentum and mass to 27 nodes; G2P
reads x, the state and 27 velocities and writes x, v, C and the state. Counted: all accesses of the kernels in the simulator,
for 216 particles. What is read beyond the derived is the table of materials, the blocks' records and the starts of rows, which
the card's cache holds, and fields that a kernel names twice, which the compiler reads once. `tiled`: atomics in the card's
memory where a block of 128 threads sums in shared memory first, as runs do; the columns before are without.

{counts}

### Ways to sum

Sums in the card's memory per particle-step, worked out from where the particles of built-in scenes lie (`sum_schemes.py`, which
for the case above gives what the simulator counts). plain: each particle adds to its nodes. warp: particles of a warp with the
same stencil are summed first. tiles: a block of 128 threads sums in shared memory; where its box finds no room there, each
particle adds to the nodes itself. Tiles need the fewest, and few more when particles have drifted since the last regroup: that
is what runs do, and why disorder is not counted on a card.

{schemes}

## Predicted

Bytes that must come from memory if each particle's fields are read twice and written once and nodes stay in the cache, and
the particle-steps per second (10^9) that bandwidth then allows **at most**: *predictions*, before the cost of atomics, which on
plain global sums are the likelier limit. Published: JAX-MPM 0.12 x 10^9 in float32 and 0.028 x 10^9 in float64 on a GPU that
its abstract does not name (2.7 million particles, 1000 steps, 22 s and 98 s). `if fused`: one kernel for G2P and the next
step's P2G, as claymore does. By bytes alone it would pay; it is not built: it allows no F-bar and no blend, needs a second grid
and lets nothing run while the halo is on its way, and sums, not bytes, may well be the limit, which only a card can tell.

{predictions}
{measured}"""


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--run", action="store_true", help="time W1 to W3 on the card of this machine")
    options.add_argument(
        "--rehearse", action="store_true", help="only that, small and on the processor; writes no page"
    )
    options.add_argument("--docs", type=Path)
    given = options.parse_args()

    def progress(text):
        print(text, flush=True)

    if given.rehearse:
        print(measured_text("cpu", REHEARSED_CELLS, progress))
        return 0
    kernels, missed = kernel_rows(progress)
    counts, differ = count_rows(progress)
    missed += differ
    measured = measured_text("cuda", RUN_CELLS, progress) if given.run else ""
    verdict = "All meet the gates." if not missed else f"Missed: {'; '.join(missed)}."
    text = PAGE.format(
        options=" --run" if given.run else "", machine=machine.text(("numba", "numba-cuda")), verdict=verdict,
        kernels=table(["first met in", "laws", "kernel", "atomics in the code", *CAPABILITIES], kernels),
        counts=table(COUNT_COLUMNS, counts),
        schemes=table(SCHEME_COLUMNS, scheme_rows(progress)),
        predictions=table(["", "bytes", *BANDWIDTH], prediction_rows()), measured=measured,
        run_on=RUN_ON[given.run],
    )  # fmt: skip
    print(text)
    if given.docs:
        pages.write(given.docs, "cuda", text)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
