"""The command line. Heavy things are imported by the command that needs them, so that `pmpm --help` answers at once."""

import argparse
import contextlib
import os
import sys
import time
import traceback

from pmpm import __version__

FINISHED, FAILED, WRONG_INPUT, STOPPED = 0, 1, 2, 3
MOST_THREADS = 1024  # per rank: more than any machine has cores
BEGAN = time.time()  # from which --walltime counts


def main(arguments=None):
    """Run the command line; returns the exit status."""
    from pmpm.parallel import comm as communication

    try:
        comm = communication.from_launcher()
    except communication.LaunchError as error:
        return complain(error, communication.launched(communication.LAUNCHER_RANK) or 0)
    options = parser(comm.rank).parse_args(numbers_joined(sys.argv[1:] if arguments is None else arguments))
    try:
        return command(options, comm)
    except BaseException:
        if comm.size == 1:
            raise
        # The other ranks may be waiting for this one: end them all.
        traceback.print_exc()
        comm.abort(FAILED)
        raise


def numbers_joined(arguments):
    """Arguments with `--option -1e-2` as `--option=-1e-2`: argparse takes a negative number with an exponent for an option."""
    joined: list[str] = []
    for argument in arguments:
        option = joined[-1] if joined else ""
        if option == "--range" and is_number(argument):
            joined[-1] = f"{option}={argument}"
        elif option.startswith("--range=") and "," not in option and is_number(argument):
            joined[-1] = f"{option},{argument}"
        elif argument.startswith("-") and is_number(argument) and option.startswith("--") and "=" not in option:
            joined[-1] = f"{option}={argument}"
        else:
            joined.append(argument)
    return joined


def two_numbers(text):
    """LO,HI as two numbers: what `numbers_joined` makes of the two arguments of --range."""
    low, high = map(float, text.split(","))
    return low, high


def is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


def command(options, comm):
    """Carry out one command; what is wrong with the input becomes one message and exit status 2."""
    from pmpm.output.files import OutputError
    from pmpm.scene.errors import SceneError

    try:
        return COMMANDS[options.command](options, comm)
    except (SceneError, OutputError) as error:
        return complain(error, comm.rank)


def say(text, rank):
    """Print what a command has found. A reader that has seen enough, such as head, is no error; a full disk is one."""
    from pmpm.output.files import OutputError, explain

    if rank != 0:
        return
    try:
        print(text, flush=True)
    except OSError as error:
        # Python flushes once more when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            raise OutputError(f"standard output cannot be written: {explain(error)}") from error


def complain(error, rank, status=WRONG_INPUT):
    if rank == 0:
        with contextlib.suppress(OSError):  # nobody listens: the status still tells
            print(f"pmpm: {error}", file=sys.stderr, flush=True)
    return status


class RankParser(argparse.ArgumentParser):
    """A parser of which only rank 0 speaks."""

    rank = 0

    def _print_message(self, message, file=None):
        if self.rank == 0:
            super()._print_message(message, file)


def parser(rank=0):
    from pmpm.point import options
    from pmpm.studies.options import add_study

    RankParser.rank = rank
    top = RankParser(prog="pmpm", description="Distributed Material Point Method solver.", allow_abbrev=False)
    top.add_argument("--version", action="version", version=f"pmpm {__version__}")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="run a scene: a TOML file or the name of a built-in one", allow_abbrev=False)
    add_scene(run, nargs="?")
    run.add_argument("--out", metavar="DIR", help="folder of the run (default: ./<scene name>)")
    run.add_argument("--overwrite", action="store_true", help="replace a run that is in the folder")
    run.add_argument("--until", type=float, metavar="T", help="stop at the first step not before T (s)")
    run.add_argument("--steps", type=int, metavar="N", help="stop after N steps")
    run.add_argument(
        "--restart",
        metavar="PATH",
        help="continue from a checkpoint or the newest good one of a run folder; with a SCENE, begin if there is none yet",
    )
    run.add_argument(
        "--walltime",
        metavar="HH:MM[:SS]",
        help="stop in time with a checkpoint (status 3); inside a Slurm job its end is known, none: do not stop",
    )
    add_backend(run)
    run.add_argument(
        "--threads", type=int, default=1, metavar="N", help="threads per rank; the same bits for any number"
    )
    run.add_argument("--quiet", action="store_true", help="no progress on the screen")

    check = commands.add_parser("check", help="validate and explain a scene, run nothing", allow_abbrev=False)
    add_scene(check)
    add_backend(check)
    commands.add_parser("scenes", help="list the built-in scenes")
    commands.add_parser("materials", help="list material models, their keys, units and sources")
    commands.add_parser("schema", help="print the JSON schema of scene files, by which editors complete and check them")
    options.add_point(commands)
    add_study(commands)
    info = commands.add_parser("info", help="what a run folder or snapshot holds")
    info.add_argument("path", metavar="PATH")
    plot = commands.add_parser("plot", help="draw the diagnostics of a run over time (needs matplotlib)")
    plot.add_argument("path", metavar="DIR")
    plot.add_argument("--out", metavar="FILE", help=".png, .pdf or .svg (default: plot.png in the folder of the run)")
    render = commands.add_parser(
        "render", help="a picture or a film of a run, without ParaView (needs matplotlib, or PyVista)"
    )
    render.add_argument("path", metavar="DIR")
    render.add_argument("--field", metavar="NAME", help="that colours particles (default: speed)")
    render.add_argument("--snapshot", type=int, default=-1, metavar="N", help="which one (default: -1, the last)")
    render.add_argument(
        "--out",
        metavar="FILE",
        help=".png, .pdf, .svg, or a film: .gif, .mp4 (default: render.png in the folder of the run)",
    )
    render.add_argument(
        "--with",
        dest="backend",
        choices=("pyvista", "matplotlib"),
        help="who draws (default: PyVista in 3-D, if it works)",
    )
    render.add_argument(
        "--view",
        default="iso",
        metavar="VIEW",
        help="in 3-D from where: iso, x, y, z, --view=-x, ..., ELEVATION,AZIMUTH",
    )
    render.add_argument(
        "--zoom", type=float, default=1.0, metavar="F", help="2: twice as large (default: 1, the domain)"
    )
    render.add_argument(
        "--range", type=two_numbers, metavar="LO HI", help="of the colours (default: that of all that is drawn)"
    )
    render.add_argument("--colors", metavar="NAME", help="colour map of matplotlib (default: viridis)")
    render.add_argument("--size", type=int, nargs=2, metavar=("W", "H"), help="of the picture in pixels")
    render.add_argument("--no-box", action="store_true", help="do not draw the edges of the domain, or axes")
    render.add_argument("--quiet", action="store_true", help="no progress on the screen")
    return top


def add_scene(command_parser, nargs=None):
    command_parser.add_argument("scene", metavar="SCENE", nargs=nargs)
    command_parser.add_argument(
        "--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="change any key of the scene (repeatable)"
    )
    command_parser.add_argument("--precision", choices=("float32", "float64"), help="of particles and grid")


def add_backend(command_parser):
    command_parser.add_argument(
        "--backend", choices=("cpu", "cuda"), default="cpu", help="cuda: each rank drives a graphics card of its host"
    )


def read_scene(options, comm):
    """The scene of the command line, with its overrides; read by rank 0, the same for all."""
    from pmpm.scene import files
    from pmpm.scene.errors import SceneError
    from pmpm.scene.schema import Scene

    path = text = problem = None
    if comm.rank == 0:
        try:
            path = files.find_scene(options.scene)
            text = files.read_text(path)
        except SceneError as error:
            problem = str(error)
    path, text, problem = comm.broadcast((path, text, problem))
    if problem:
        raise SceneError(problem)
    return Scene.from_text(text, str(path), settings(options), path.parent)


def settings(options):
    """{dotted key: value} set on top of the scene."""
    from pmpm.scene import files

    given = dict(files.parse_setting(text) for text in options.set)
    if options.precision:
        given["method.precision"] = options.precision
    return given


def check_options(options):
    """Raise SceneError for options of `run` that are wrong by themselves."""
    from pmpm.scene.errors import SceneError

    if options.scene is None and options.restart is None:
        raise SceneError("pmpm run: give a SCENE, or --restart PATH to continue one")
    if options.backend == "cuda" and options.threads != 1:
        raise SceneError("--threads: with --backend cuda a rank drives one card from one thread")
    if not 1 <= options.threads <= MOST_THREADS:
        raise SceneError(f"--threads {options.threads}: must be 1 to {MOST_THREADS}")
    for value, name in ((options.until, "--until"), (options.steps, "--steps")):
        if value is not None and not value > 0:
            raise SceneError(f"{name} {value}: must be greater than 0")


def run(options, comm):
    check_options(options)
    from pmpm import requests

    with requests.keeping_signals() as early:
        return run_or_go_on(options, comm, early)


def run_or_go_on(options, comm, early):
    """Carry out `run`; `early`: list of signals that have come, as long as nobody else takes them."""
    from pmpm import requests
    from pmpm.failure import NumericalFailure
    from pmpm.output.files import OutputError
    from pmpm.run import OutputFailure, run_scene
    from pmpm.watching import STOP

    deadline = requests.deadline_of(options.walltime, BEGAN, comm.rank)
    begin = where_to_begin(options, comm)
    if begin.message:
        complain(begin.message, comm.rank)
    if begin.scene is None:
        return FINISHED
    if options.backend == "cuda":
        take_card(begin.scene, options, comm)
    overwrite = options.overwrite or begin.anew
    try:
        simulation = run_scene(
            begin.scene, begin.out, comm, options.until, options.steps, overwrite, options.quiet, begin.origin, deadline,
            early, options.threads, options.backend,
        )  # fmt: skip
    except (NumericalFailure, OutputFailure) as failure:
        return complain(f"stopped: {failure}", comm.rank, FAILED)
    stopped = simulation.asked >= STOP and not simulation.finished
    if stopped:
        complain(f"stopped on request ({requests.reason(simulation.asked)}) after step {simulation.step_count}, "
                 f"t = {simulation.time:.6g} s, with a checkpoint: --restart {begin.out} continues", comm.rank)  # fmt: skip
    elif not options.quiet:
        out = begin.out
        with contextlib.suppress(OutputError):  # the run itself is whole
            say(f"{out}: open {out}/snapshots.xdmf in ParaView, or run: pmpm info {out}", comm.rank)
    return STOPPED if stopped else FINISHED


def take_card(scene, options, comm):
    """Let this rank have a card, and say which. Raises SceneError where there is none, or too little memory on it."""
    from pmpm.processors import cards

    card = cards.take(comm)
    cards.refuse_memory(scene, card.free, comm.size)
    if card.warning:
        complain(card.warning, comm.rank)
    if not options.quiet:
        say(f"cards: {card.text}", comm.rank)


def where_to_begin(options, comm):
    """What `run` is to run, from where, into which folder."""
    from pathlib import Path

    from pmpm import restart
    from pmpm.restart import Begin

    given = read_scene(options, comm) if options.scene is not None else None
    if options.restart is None:
        return Begin(given, options.out or Path(options.scene).stem)
    return restart.begin(options.restart, given, settings(options), options.out, options.overwrite, comm)


def check(options, comm):
    scene = read_scene(options, comm)
    from pmpm.explain import explain

    say(explain(scene, max(comm.size, 1), options.backend), comm.rank)
    return FINISHED


def scenes(options, comm):
    from pmpm.scene.files import builtin_scenes
    from pmpm.scene.schema import Scene

    say("\n".join(f"{name:22s} {Scene.builtin(name).title}" for name in builtin_scenes()), comm.rank)
    return FINISHED


def materials(options, comm):
    from pmpm.explain import material_lines

    say("\n".join(material_lines()), comm.rank)
    return FINISHED


def schema(options, comm):
    from pmpm.scene.json_schema import schema_text

    say(schema_text(), comm.rank)
    return FINISHED


def point(options, comm):
    from pmpm.point.command import point as drive

    text, failure = drive(options) if comm.rank == 0 else ("", None)
    say(text, comm.rank)
    return complain(f"stopped: {failure}", comm.rank, FAILED) if failure else FINISHED


def study(options, comm):
    from pathlib import Path

    from pmpm import requests

    scene = read_scene(options, comm)
    from pmpm.run import OutputFailure
    from pmpm.studies.plan import Options
    from pmpm.studies.study import StudyStopped, carry_out

    asked = Options(options.levels, options.refine, options.transfer, options.shape_function, options.precisions,
                    options.cfl, options.until, options.repeat)  # fmt: skip
    out = options.out or f"{Path(options.scene).stem}_study"
    with requests.keeping_signals() as early:
        try:
            found = carry_out(scene, asked, out, comm, options.overwrite, options.quiet, early)
        except StudyStopped as stopped:
            return complain(stopped, comm.rank, STOPPED)
        except OutputFailure as failure:
            return complain(f"stopped: {failure}", comm.rank, FAILED)
    say(found.text, comm.rank)
    return FINISHED


def info(options, comm):
    from pmpm.output.reader import describe

    say(describe(options.path), comm.rank)
    return FINISHED


def plot(options, comm):
    from pmpm.output.plot import plot as draw

    say(draw(options.path, options.out) if comm.rank == 0 else "", comm.rank)
    return FINISHED


def render(options, comm):
    from pmpm.output.render import Asked
    from pmpm.output.render import render as draw

    pixels = options.size and tuple(options.size)
    asked = Asked(options.field, options.backend, options.view, options.zoom, options.range, options.colors, pixels,
                  not options.no_box)  # fmt: skip
    drawn = draw(options.path, asked, options.snapshot, options.out, options.quiet) if comm.rank == 0 else ""
    say(drawn, comm.rank)
    return FINISHED


COMMANDS = {
    "run": run, "check": check, "scenes": scenes, "materials": materials, "point": point, "study": study, "info": info,
    "plot": plot, "render": render, "schema": schema,
}  # fmt: skip
