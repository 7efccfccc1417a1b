"""What each transfer conserves over ten thousand steps: mass, momentum, angular momentum and energy of a free body.

    python benchmarks/conservation.py [--quick] [--docs docs]

A soft neo-Hookean disk (in 3-D a sphere) flies, spins, shears and rings, with nothing around it, for every transfer, spline
and precision in ROWS. With mpirun at hand the same rows run on two ranks, the body on its way across the cut, and must give
the same bits. Prints a row as it is done, then what misses its limit, and exits non-zero if anything does; with --docs it
writes results/conservation.md there. --quick: a tenth of the steps.

Limits in float64; those of round-off are larger in float32 as its eps is (5.4e8 times):
survival          the run comes to its end
mass              exact: no bit may change
mass of the grid  1e-14 of that of the particles, at the end of each step
momentum          1e-13 of sum m |v|, at any time
angular momentum  1e-12 of itself in each step, the affine field's included (Jiang et al. 2015), for APIC and MLS with splines
                  whose D is the same everywhere; PIC loses it and FLIP's parts are not bound to it: reported
energy            never more than 1.05 of what it was; PIC must lose it all the time
"""

import argparse
import contextlib
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pages

import pmpm
from pmpm.failure import NumericalFailure

STEPS, QUICK_STEPS = 10_000, 1_000
BITS_AT = 1_000  # steps after which the bits of two ranks are compared
DX, RADIUS = 0.25, 1.0
SPEED = 3.67  # of waves, m/s
MATERIAL = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
PLACE, CELLS = [2.5, 2.0, 2.0], [48, 24, 24]
FLIGHT = 0.008 * SPEED * np.array([1.0, 0.3, 0.2])
GRID_MASS, MOMENTUM, ANGULAR = 1e-14, 1e-13, 1e-12
HIGHEST_ENERGY = 1.05
# What PIC may gain between two samples: symplectic Euler's energy swings with a wave's phase.
PIC_GAIN = 1e-3
SAMPLE = 100  # steps between two energies


@dataclass(frozen=True)
class Row:
    """One scheme."""

    dim: int
    transfer: str
    shape_function: str
    precision: str
    blend: float | None = None

    def __str__(self):
        blend = "" if self.blend is None else f" {self.blend:g}"
        return f"{self.dim}-D {self.transfer}{blend} {self.shape_function} {self.precision}"

    @property
    def keeps_angular_momentum(self):
        return self.transfer in ("apic", "mls") and self.shape_function != "linear"

    @property
    def eps_ratio(self):
        return float(np.finfo(self.precision).eps / np.finfo("float64").eps)


SCHEMES = (("pic", None), ("flip", 1.0), ("flip", 0.99), ("aflip", 0.99), ("apic", None), ("mls", None))
SPLINES = ("linear", "quadratic", "cubic")
ROWS = (
    *(
        Row(2, transfer, shape, "float64", blend)
        for shape in SPLINES
        for transfer, blend in SCHEMES
        if (transfer, shape) != ("mls", "linear")
    ),
    *(Row(2, transfer, "quadratic", "float32", blend) for transfer, blend in SCHEMES),
    Row(2, "apic", "cubic", "float32"),
    Row(3, "apic", "quadratic", "float64"),
    Row(3, "mls", "quadratic", "float64"),
)


def simulation(row, comm=None):
    """The body at the start: C holds the affine part of its velocity."""
    method = {"transfer": row.transfer, "shape_function": row.shape_function, "precision": row.precision}
    dim, place = row.dim, PLACE[: row.dim]
    found = pmpm.Simulation(
        pmpm.Scene(
            domain={"size": [n * DX for n in CELLS[:dim]], "cell_size": DX},
            method=method | ({} if row.blend is None else {"flip_blend": row.blend}),
            time={"end": 1e6},
            materials={"material": MATERIAL},
            bodies=[{"material": "material", "shape": {"type": "sphere", "center": place, "radius": RADIUS}}],
        ),
        comm,
    )
    r = found.particles.x - place
    A = 0.05 * SPEED * np.array([[0.3, -1.0, 0.1], [0.6, -0.3, 0.2], [0.3, -0.2, 0.0]])[:dim, :dim]
    ringing = 0.01 * SPEED * np.sin(3.0 * np.roll(r, 1, axis=1))
    found.particles.v = FLIGHT[:dim] + r @ A.T + ringing
    if found.needs.scheme.affine:
        found.particles.C = np.broadcast_to(A, (len(r), dim, dim))
    return found


# ---- what is looked at -----------------------------------------------------------------------------------------------------


def momentum(measured, dim):
    return np.array([measured[f"momentum_{axis}"] for axis in "xyz"[:dim]])


def angular_momentum(simulation, measured):
    """About the centre of mass, the affine field's included."""
    m, x = simulation.particles.mass, simulation.particles.x.astype(float)
    centre, p = m @ x / m.sum(), momentum(measured, simulation.dim)
    if simulation.dim == 2:
        return np.array([measured["angular_momentum_z"] - (centre[0] * p[1] - centre[1] * p[0])])
    return np.array([measured[f"angular_momentum_{axis}"] for axis in "xyz"]) - np.cross(centre, p)


def energy(simulation, measured):
    """Kinetic, that of the affine field included, and strain energy."""
    affine = 0.0
    if simulation.needs.scheme.affine:
        derived = simulation.derived(np.float64)[0]
        C = derived.field("C").reshape(-1, simulation.dim, simulation.dim)
        affine = 0.5 * float((derived.mass()[:, None, None] * C * derived.spin()).sum())
    return measured["kinetic"] + measured["strain"] + affine


def bits(simulation, names=("id", "x", "velocity", "deformation_gradient")):
    """A hash of these fields of all particles of all ranks in the one global order. Collective."""
    rows = simulation.fields(names)
    arrived = [simulation.comm.gather(values) for values in rows.values()]
    text = b"".join(np.concatenate(values).tobytes() for values in arrived)
    return hashlib.sha256(text).hexdigest()


def follow(row, steps):
    """dict of what a row is judged by, over its steps."""
    run = simulation(row)
    dim, first = run.dim, run.measure()
    mass, p0, L0, E0 = first["mass"], momentum(first, dim), angular_momentum(run, first), energy(run, first)
    scale = float((run.particles.mass[:, None] * np.abs(run.particles.v.astype(float))).sum())
    size = float(np.abs(L0).max())
    found = dict.fromkeys(("grid_mass", "momentum", "angular_step", "gain"), 0.0) | {"mass": True, "highest": 1.0}
    found |= {"angular": 0.0, "energy": 1.0}
    L_before, lowest = L0, E0
    for step in range(1, steps + 1):
        try:
            run.step()
        except NumericalFailure as failure:
            found["stopped"] = str(failure)
            break
        found["steps"] = step
        measured = run.measure()
        on_grid = float(run.patch.nodes[..., 3].astype(float).sum())
        L = angular_momentum(run, measured)
        found["mass"] = found["mass"] and measured["mass"] == mass
        found["grid_mass"] = max(found["grid_mass"], abs(on_grid / mass - 1.0))
        found["momentum"] = max(found["momentum"], float(np.abs(momentum(measured, dim) - p0).max()) / scale)
        found["angular_step"] = max(found["angular_step"], float(np.abs(L - L_before).max()) / size)
        found["angular"] = max(found["angular"], float(np.abs(L - L0).max()) / size)
        L_before = L
        if step % SAMPLE == 0:
            E = energy(run, measured)
            found["gain"] = max(found["gain"], (E - lowest) / E0)
            found["highest"] = max(found["highest"], E / E0)
            lowest, found["energy"] = min(lowest, E), E / E0
        if step == BITS_AT:
            found["bits"] = bits(run)
    found["cells"] = float(np.abs(FLIGHT[0]) * run.time / DX)
    return found


# ---- two ranks --------------------------------------------------------------------------------------------------------------


def run_as_a_rank(path):
    """Run all rows under mpirun and leave their hashes in a file."""
    from mpi4py import MPI

    comm, hashes = MPI.COMM_WORLD, {}
    for row in ROWS:
        run = simulation(row, comm)
        with contextlib.suppress(NumericalFailure):
            run.run(steps=BITS_AT)
            hashes[str(row)] = bits(run)
        sent = run.report()["sent"]
        if comm.rank == 0:
            moved = sum(sum(counts) for counts in sent) - sum(sent[rank][rank] for rank in range(comm.size))
            hashes[str(row) + " crossings"] = moved
            print(f"{comm.size} ranks: {row}, {moved} crossings of the cut", flush=True)
    if comm.rank == 0:
        path.write_text(json.dumps(hashes), encoding="utf-8")


def mpirun():
    """The launcher beside this Python, else on the path; None without one."""
    return shutil.which("mpirun", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")


def hashes_of_two_ranks():
    """{row: hash, "row crossings": number} of two ranks; empty without mpirun."""
    launcher = mpirun()
    if launcher is None:
        return {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hashes.json"
        subprocess.run([launcher, "-n", "2", sys.executable, __file__, "--as-rank", str(path)], check=True)
        return json.loads(path.read_text(encoding="utf-8"))


# ---- verdicts ---------------------------------------------------------------------------------------------------------------


def failures(row, found, two):
    """Names of the columns that miss their limits."""
    ratio, wrong = row.eps_ratio, []
    if "stopped" in found:
        wrong.append("survival")
    if not found["mass"]:
        wrong.append("mass")
    if not found["grid_mass"] <= GRID_MASS * ratio:
        wrong.append("grid_mass")
    if not found["momentum"] <= MOMENTUM * ratio:
        wrong.append("momentum")
    if row.keeps_angular_momentum and not found["angular_step"] <= ANGULAR * ratio:
        wrong.append("angular_step")
    gains = found["highest"] > HIGHEST_ENERGY or (row.transfer == "pic" and found["gain"] > PIC_GAIN)
    if gains and "stopped" not in found:
        wrong.append("energy")
    if two and two.get(str(row)) != found.get("bits"):
        wrong.append("bits")
    return wrong


def cells_of(row, found, two):
    """Table cells of a row, each with its mark; without a mark: reported, no limit."""
    wrong = failures(row, found, two)

    def mark(name):
        return " ✘" if name in wrong else " ✔"

    energies = [f"{found['energy']:.4f}", f"{found['highest'] - 1.0:+.1%}" + mark("energy")]
    if "stopped" in found:
        energies = ["-", "-"]
    angular = f"{found['angular_step']:.0e}" + (mark("angular_step") if row.keeps_angular_momentum else "")
    bits_text = ("same" if "bits" not in wrong else "differ") + mark("bits") if two and "bits" in found else "not run"
    blend = "" if row.blend is None else f" {row.blend:g}"
    return [
        f"{row.transfer}{blend}", f"{row.shape_function}, {row.dim}-D", row.precision,
        f"step {found['steps']}" + mark("survival"),
        ("exact" if found["mass"] else "changed") + mark("mass"), f"{found['grid_mass']:.0e}" + mark("grid_mass"),
        f"{found['momentum']:.0e}" + mark("momentum"), angular, f"{found['angular']:.1e}",
        *energies, bits_text,
    ]  # fmt: skip


HEAD = (
    "transfer", "spline", "precision", "came to", "mass", "grid mass", "momentum", "L in a step", "L over the run",
    "energy left", "highest", "bits",
)  # fmt: skip


def table(results, two):
    lines = ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
    lines += ["| " + " | ".join(cells_of(row, found, two)) + " |" for row, found in results.items()]
    return "\n".join(lines)


STOPPED = """
Runs that stopped. A linear spline has its full slope at the far end of its cell, where its weight goes to zero, and with it the
mass of a node that holds nothing else: at a free edge the stable step goes to zero as well. The method's bound does not follow
it there. With cfl = 0.4 APIC stops after 1.2 s, with 0.1 after 3.1 s; with 0.025 it comes through the first 6 s.

"""
DRIFTS = """
Momentum of cubic splines. Their weights are made of 1/6 and 2/3, both rounded down in float64, up in float32: they sum to one
less 7.9e-17, or one and 4e-8. What takes the whole of its velocity from the grid in each step (PIC, APIC, MLS) loses, or gains,
that much of its momentum in each; FLIP does not. With quadratic splines the sum has no such bias.
"""


def page(results, two, steps, verdict):
    flown = max(found["cells"] for row, found in results.items() if row.dim == 2)
    crossed = [two[f"{row} crossings"] for row in results if str(row) in two] or [0]
    drifts = any(row.shape_function == "cubic" and "momentum" in failures(row, results[row], two) for row in results)
    stopped = [f"- {row}: {found['stopped']}" for row, found in results.items() if "stopped" in found]
    return f"""# What transfers conserve

`python benchmarks/conservation.py --docs docs` wrote this page: a soft elastic disk (3-D: a sphere) of radius
{RADIUS / DX:g} cells that flies {flown:.0f} cells, spins, shears and rings for {steps} steps with nothing around it.
✔ the limit is met, ✘ it fails, no mark: there is none. Limits stand in that file; in float32 those of round-off are as much
larger as its eps is.

- grid mass: largest difference from the particles' at the end of any step, relative
- momentum: largest drift at any time, of sum m |v|
- L in a step, L over the run: largest change of the angular momentum about the centre of mass, affine field included, within
  one step and since the start, relative. APIC and MLS conserve it; with linear splines it takes a D that changes as
  particles move
- energy left: kinetic (of the affine field, too) and strain energy at the end; highest: at any time, above that of the start
- bits: of 1 and 2 ranks after {min(steps, BITS_AT)} steps, {min(crossed)} to {max(crossed)} crossings of the cut

{table(results, two)}

{verdict}
{DRIFTS if drifts else ""}{STOPPED if stopped else ""}{chr(10).join(stopped)}
"""


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="a tenth of the steps")
    options.add_argument("--docs", type=Path, help="write the page here")
    options.add_argument("--as-rank", type=Path, help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.as_rank:
        run_as_a_rank(given.as_rank)
        return 0
    steps, results = QUICK_STEPS if given.quick else STEPS, {}
    for number, row in enumerate(ROWS, 1):
        results[row] = follow(row, steps)
        print(f"{number}/{len(ROWS)} {row}: " + ", ".join(f"{k} {v}" for k, v in results[row].items()), flush=True)
    two = hashes_of_two_ranks()
    print(table(results, two))
    missed = [f"{row}: {', '.join(wrong)}" for row, found in results.items() if (wrong := failures(row, found, two))]
    verdict = (
        "All limits are met." if not missed else "Limits that fail:\n\n" + "\n".join(f"- {line}" for line in missed)
    )
    print(verdict)
    if given.docs:
        pages.write(given.docs, "conservation", page(results, two, steps, verdict))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
