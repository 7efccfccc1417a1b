"""Strong and weak scaling of any scene, and what two ranks lose against two separate processes.

    python benchmarks/scaling.py strong SCENE --ranks 1,2 [--steps 200] [--rounds 3] [--threads N] [--set KEY=VALUE]
    python benchmarks/scaling.py weak SCENE --ranks 1,2 [--length 1]   the scene grows along the slab axis with the ranks
    python benchmarks/scaling.py pairs [--rounds 8]                    scaling_pairs.py; status 1 where its gate is missed
    python benchmarks/scaling.py table RUN [RUN ...]                   of runs that are there already

SCENE is a built-in name or a TOML file. Runs are `pmpm run` under LAUNCH, the mpirun beside this Python, srun in a Slurm
job, or the mpirun on PATH; on one host each rank is pinned to cores of its own. Rank counts take turns in every round. With
--out DIR the runs are DIR/<ranks>, with table.md, runs.csv and scaling.png beside them; with --docs DIR the page is
results/strong_scaling.md (weak_scaling, pairs), the picture pictures/strong_scaling.png. --quick: 20 steps, one round, no
gate. Exits with 2 for wrong input.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

import machine
import pages
import scaling_tables
from scaling_runs import RunError, can_pin, cores, read, run
from scaling_tables import Row
from stages import Progress

from pmpm.parallel.slabs import room
from pmpm.scene.errors import SceneError

QUICK_STEPS = 20


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the arguments in one line."""

    def error(self, message):
        self.exit(2, f"scaling: {message}\n")


def counts(text):
    """Numbers of ranks, as in 1,2,4."""
    try:
        found = sorted(set(map(int, text.split(","))))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers like 1,2,4") from None
    if found[0] < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: a run has at least 1 rank")
    return found


def checked(kind, wanted, allowed):
    """A reader of numbers for argparse: `wanted` says which are `allowed`."""

    def read(text):
        try:
            number = kind(text)
        except ValueError:
            number = None
        if number is None or not allowed(number):
            raise argparse.ArgumentTypeError(f"{text!r} is not {wanted}")
        return number

    return read


positive = checked(int, "a whole number of at least 1", lambda number: number >= 1)
length = checked(float, "a positive number", lambda number: 0.0 < number < float("inf"))


def parser():
    top = Parser(description=__doc__.splitlines()[0], allow_abbrev=False)
    commands = top.add_subparsers(dest="command", required=True, metavar="strong | weak | pairs | table")
    for name, what in (("strong", "one scene of one size"), ("weak", "a scene that grows with the ranks")):
        one = commands.add_parser(name, help=what, allow_abbrev=False)
        one.add_argument("scene", metavar="SCENE")
        one.add_argument(
            "--ranks", type=counts, metavar="N,N", help="numbers of ranks (1, 2, 4 .. as many as there are cores)"
        )
        one.add_argument("--steps", type=positive, default=200, metavar="N")
        one.add_argument("--threads", type=positive, default=1, metavar="N", help="per rank")
        one.add_argument(
            "--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="change a key of the scene"
        )
        one.add_argument("--out", type=Path, metavar="DIR", help="folder of the runs (default: a temporary one)")
        if name == "weak":
            one.add_argument(
                "--length", type=length, default=1.0, metavar="F", help="of a rank's piece, in lengths of the scene"
            )
        add_common(one, rounds=3)
    pairs = commands.add_parser("pairs", help="two ranks against two separate processes", allow_abbrev=False)
    add_common(pairs, rounds=8)
    tables = commands.add_parser("table", help="of runs that are there", allow_abbrev=False)
    tables.add_argument("runs", nargs="+", metavar="RUN", type=Path)
    return top


def add_common(command, rounds):
    command.add_argument("--rounds", type=positive, default=rounds, metavar="N")
    command.add_argument("--docs", type=Path, metavar="DIR", help="write page and picture here")
    command.add_argument("--quick", action="store_true", help=f"{QUICK_STEPS} steps, one round, no gate")


def doubled(most):
    """1, 2, 4, ... and `most`."""
    found = [1]
    while 2 * found[-1] < most:
        found.append(2 * found[-1])
    return sorted({*found, most})


# ---- scenes ----------------------------------------------------------------------------------------------------------------


def scene_of(given):
    """The Scene that the command line means. Raises SceneError."""
    from pmpm.scene import files
    from pmpm.scene.schema import Scene

    path = files.find_scene(given.scene)
    return Scene.from_text(files.read_text(path), str(path), dict(map(files.parse_setting, given.set)))


def stretched(scene, factor):
    """Settings that make a scene `factor` times as long along its slab axis, boxes of material with it.

    Raises SceneError for what does not grow with the domain: other shapes, loads and motions of regions.
    """
    from pmpm.scene.needs import grid_geometry, scene_needs

    axis = grid_geometry(scene, scene_needs(scene)).axes[0]
    for name in ("loads", "motions", "colliders"):
        if getattr(scene, name, None):
            raise SceneError(f"weak scaling: {name} do not grow with the domain")
    settings = [f"parallel.slab_axis={'xyz'[axis]}", f"domain.size={longer(scene.domain.size, axis, factor)}"]
    for number, body in enumerate(scene.bodies):
        if body.shape.type != "box":
            raise SceneError(f"weak scaling: bodies.{number} is a {body.shape.type}; only boxes grow with the domain")
        for corner in ("min", "max"):
            settings.append(f"bodies.{number}.shape.{corner}={longer(getattr(body.shape, corner), axis, factor)}")
    return settings


def longer(numbers, axis, factor):
    return [float(f"{value * factor:.12g}") if number == axis else value for number, value in enumerate(numbers)]


def check_room(scene, ranks):
    """Raise SceneError where some of so many ranks would stay idle."""
    from pmpm.scene.needs import grid_geometry, scene_needs

    needs = scene_needs(scene)
    layers = grid_geometry(scene, needs).layers
    space = room(layers, needs.stencil.window)
    if ranks > space:
        raise SceneError(f"--ranks {ranks}: {layers} layers of cells have room for {space} ranks")


def plan(given):
    """{ranks: settings} of the runs. Raises SceneError for a scene that is wrong, or too short for the ranks."""
    scene, found = scene_of(given), {}
    for ranks in given.ranks:
        settings = list(given.set)
        if given.command == "weak":
            settings += stretched(scene, ranks * given.length)
        check_room(scene_of(argparse.Namespace(scene=given.scene, set=settings)), ranks)
        found[ranks] = settings
    return found


# ---- measuring -------------------------------------------------------------------------------------------------------------


def measure(given, settings, folder):
    """Rows of the runs, in turns, a line for each as it is done."""
    progress = Progress(given.rounds * len(settings))
    runs, failures = {ranks: [] for ranks in settings}, {}
    for number in range(given.rounds):
        for ranks, chosen in settings.items():
            if ranks in failures:
                continue
            try:
                runs[ranks].append(run(given.scene, folder / str(ranks), ranks, given.steps, chosen, given.threads))
                last = runs[ranks][-1]
                told = f"{last.rate / 1e6:.4g} million particle-steps/s, {last.rate_per_core / 1e6:.4g} per core"
            except RunError as error:
                failures[ranks] = told = str(error)
            progress.tell(f"round {number + 1} of {given.rounds}, {ranks} ranks: {told}")
    return [Row(str(ranks), [] if ranks in failures else runs[ranks], failures.get(ranks, "")) for ranks in settings]


def remarks(given):
    """What a reader must know of how ranks were placed."""
    most = max(given.ranks) * given.threads
    if can_pin(most):
        return "Each rank was pinned to cores of its own."
    if most > len(cores()) and "SLURM_JOB_ID" not in os.environ and "LAUNCH" not in os.environ:
        return f"{most} ranks and threads shared {len(cores())} cores: these are no figures of scaling."
    return "Ranks were placed by the launcher."


def scaling(given):
    """The commands strong and weak; returns the exit status."""
    if given.ranks is None:
        given.ranks = doubled(int(os.environ.get("SLURM_NTASKS", max(1, len(cores()) // given.threads))))
    if given.quick:
        given.steps, given.rounds = QUICK_STEPS, 1
    if given.docs and given.quick:
        raise SceneError("--docs wants a full measurement, not --quick")
    settings = plan(given)
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.out or Path(temporary)
        rows = measure(given, settings, folder)
        if scaling_tables.reference(rows) is not None:
            print("\n".join(scaling_tables.table(rows)))
            report(given, rows)
    failed = [row.failure for row in rows if row.failure]
    print("\n".join(f"FAILED: {failure}" for failure in failed) or "all runs ended well")
    return 1 if failed else 0


def report(given, rows):
    """Write table, CSV and picture beside the runs, and the page."""
    title = f"{given.command} scaling of {given.scene}"
    lines = scaling_tables.table(rows)
    if given.out:
        (given.out / "table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
        scaling_tables.write_csv(rows, given.out / "runs.csv")
        print(scaling_tables.plot(rows, given.out / "scaling.png", title) or f"picture: {given.out / 'scaling.png'}")
    if given.docs:
        name = f"{given.command}_scaling"
        said = scaling_tables.plot(rows, given.docs / "pictures" / f"{name}.png", title)
        picture = said or f"![{title}](../pictures/{name}.png)"
        text = f"# {title[0].upper()}{title[1:]}\n\n`{command(given)}` wrote this page.\n{machine.text()}.\n\n"
        text += f"{given.steps} steps, medians of {given.rounds} rounds in which the numbers of ranks take turns. "
        text += f"{remarks(given)}\n\n"
        text += f"{picture}\n\n" + "\n".join(lines) + f"\n\n{scaling_tables.NOTES}"
        pages.write(given.docs, name, text)


def command(given):
    words = ["python benchmarks/scaling.py", given.command, given.scene, "--ranks", ",".join(map(str, given.ranks))]
    words += ["--steps", given.steps, "--rounds", given.rounds, *(f"--set {setting}" for setting in given.set)]
    words += ["--threads", given.threads] if given.threads > 1 else []
    words += [f"--length {given.length:g}"] if getattr(given, "length", 1.0) != 1.0 else []
    return " ".join(map(str, [*words, "--docs docs"]))


def show_table(given):
    """The command table."""
    rows = [Row(one.name, [one]) for one in map(read, given.runs)]
    print("\n".join(scaling_tables.table(rows)))
    return 0


def show_pairs(given):
    """The command pairs."""
    import scaling_pairs

    return scaling_pairs.compare(1 if given.quick else given.rounds, given.quick, given.docs)


COMMANDS = {"strong": scaling, "weak": scaling, "pairs": show_pairs, "table": show_table}


def main(arguments=None):
    given = parser().parse_args(arguments)
    try:
        return COMMANDS[given.command](given)
    except SceneError as error:
        print(f"scaling: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except RunError as error:
        print(f"scaling: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
