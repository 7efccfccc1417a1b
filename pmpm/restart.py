"""From a checkpoint on the disk back to a simulation: which checkpoint, with which scene, and what may have changed in it."""

import contextlib
import os
import re
from dataclasses import dataclass
from pathlib import Path

from pmpm.output import manifests, run_directory
from pmpm.output.checkpoints import CheckpointFile
from pmpm.output.files import OutputError, on_every_rank, on_rank_zero
from pmpm.output.run_directory import CHECKPOINTS, read_record, read_status
from pmpm.restore import SCENE, Continuation
from pmpm.scene import files
from pmpm.scene.errors import SceneError
from pmpm.scene.messages import path_text, value_text
from pmpm.scene.schema import Scene

# What may change at a restart: keys that change no particle and no node, and of those the ones that act on what moves.
WATCHING = r"title|time\.end|output\..+|guard\..+|parallel\..+|exact\..+"
DRIVING = (
    r"time\.(cfl|step|ramp)|domain\.gravity.*|domain\.walls\..+|method\.(damping|flip_blend|precision)"
    r"|materials\.[^.]+\.(?!model$|density$).+|motions\[\d+\]\.velocity.*"
    r"|colliders\[\d+\]\.(surface.*|velocity.*|angular_velocity.*)"
    r"|inflows\[\d+\]\.(velocity.*|until|limit)|contact\.friction|contact\.pairs.*"
)
MARKS = {"file": "checksum", "depth": "depth_checksum"}  # what knows a file again that lies elsewhere now
EITHER_OR = {"time.step": "cfl", "time.cfl": "step"}  # of which a scene gives one


@dataclass
class Origin:
    """Where a restart begins: a good checkpoint file, the folder of the run that it lies in or None, the scene in it as text,
    complaints about newer ones, and the numbers of all checkpoints that lay beside it."""

    path: Path
    run: Path | None
    text: str
    complaints: list[tuple[int, str]]
    beside: list[int]

    @property
    def number(self):
        """The number of the checkpoint in its run."""
        return int(self.path.stem)

    @property
    def newer(self):
        """Numbers of checkpoints of its run that came later and are not known to be damaged, newest first."""
        damaged = {number for number, _ in self.complaints}
        return [number for number in self.beside if number > self.number and number not in damaged]

    def notes(self, simulation):
        """What to tell of a restart, one line each."""
        lines = [f"warning: {complaint}: an older checkpoint is taken" for _, complaint in self.complaints]
        lines.append(f"restart from {self.path}, step {simulation.step_count}, t = {simulation.time:.6g} s")
        changed = changes(self, simulation.scene)
        lines += [f"changed since: {', '.join(changed)}"] if changed else []
        if "method.precision" in changed:
            lines.append("warning: in another precision the run goes on with rounded numbers, not bit for bit")
        return lines


@dataclass
class Begin:
    """What a command is to run: a scene (None: nothing), into which folder, from which Origin (None: from the start).

    `anew`: the folder holds a run without checkpoints, which is replaced; `message`: what to say before.
    """

    scene: Scene | None
    out: str | Path
    origin: Origin | None = None
    anew: bool = False
    message: str = ""


def begin(path, scene, overrides, out, overwrite, comm):
    """What --restart PATH means, with the scene given or None, and overrides for the checkpoint's own. Collective.

    Where no run is yet, the scene given begins there; where a run is without a checkpoint, it begins anew; where a run has
    finished, and nothing is to change, there is nothing to do. So one command serves every start of a job.
    """
    out = path if out is None else out
    in_place = on_rank_zero(comm, lambda: os.path.realpath(out) == os.path.realpath(path))
    is_file, status, scene_file, held = on_rank_zero(comm, lambda: look(path))
    if not is_file and not held:
        return begin_without_checkpoint(path, scene, overrides, out, in_place, status, scene_file)
    origin = find(path, comm)
    if is_file and in_place:
        if origin.run is None:
            raise SceneError(f"--restart {path}: does not lie in a run's folder: give an output folder (--out DIR)")
        out = origin.run
    scene = scene or scene_of(origin, overrides)
    changed = changes(origin, scene)
    if status == "finished" and not changed and in_place and not overwrite:
        return Begin(
            None,
            out,
            message=f"{path} has finished, nothing is left to do; --set time.end=T with a later T would continue it",
        )
    return Begin(scene, out, origin)


def look(path):
    """(whether it is a file, status of the run in it or None, text of its scene or None, numbers of its checkpoints)."""
    place = Path(path)
    if place.is_file():
        return True, None, None, []
    if place.suffix == ".hdf" and not place.is_dir():
        raise OutputError(f"--restart {path}: there is no such checkpoint")
    status = read_status(place) if read_record(place) is not None else None
    scene_file = place / run_directory.SCENE
    text = scene_file.read_text(encoding="utf-8", errors="replace") if status and scene_file.is_file() else None
    return False, status, text, manifests.numbers(place / CHECKPOINTS)


def begin_without_checkpoint(path, scene, overrides, out, in_place, status, text):
    if status is None and scene is None:
        raise SceneError(f"--restart {path}: holds neither a run nor a checkpoint, and no SCENE is given to begin one")
    if status is None:
        return Begin(scene, out)
    if scene is None and text is None:
        raise SceneError(
            f"--restart {path}: holds no checkpoint and no scene.toml, and no SCENE is given to begin anew"
        )
    scene = scene or Scene.from_text(text, f"{path}/{run_directory.SCENE}", overrides)
    if status == "finished":
        if text == scene.to_toml():
            return Begin(None, out, message=f"{path} has finished, nothing is left to do")
        raise SceneError(
            f"--restart {path}: has finished and holds no checkpoint from which to go on with a changed scene; "
            "output.checkpoint_at_end = true would have left one; --overwrite without --restart begins anew"
        )
    return Begin(scene, out, None, in_place, f"{path} holds no checkpoint yet: the run begins anew")


def find(path, comm):
    """The Origin that a user means by `path`: a checkpoint file, or the newest good one of a run directory. Collective.

    Raises OutputError if there is none.
    """
    path, is_file = on_rank_zero(comm, lambda: (Path(path).resolve(), Path(path).is_file()))
    if is_file:
        complaint = manifests.complaint_about(path, comm)
        if complaint is not None:
            other = manifests.newest_good(path.parent, comm)[0]
            raise OutputError(complaint + (f"; the newest good checkpoint beside it is {other}" if other else ""))
        return origin_at(path, [], comm)
    good, complaints = manifests.newest_good(path / CHECKPOINTS, comm)
    if good is None:
        told = "; ".join(complaint for _, complaint in complaints)
        raise OutputError(f"{path} holds no good checkpoint{': ' + told if told else ''}")
    return origin_at(good, complaints, comm)


def origin_at(path, complaints, comm):
    """The Origin of a good checkpoint file. Collective."""
    run, text, beside = on_rank_zero(comm, lambda: (run_of(path), scene_text(path), manifests.numbers(path.parent)))
    return Origin(path, run, text, complaints, beside)


def run_of(path):
    """The folder of the run in which a checkpoint file lies, or None.

    A folder that holds nothing of a run but checkpoints, copied from somewhere, is none: what else is there must not be cut.
    """
    place = path.parent.parent
    numbered = path.parent.name == CHECKPOINTS and path.stem.isdecimal()
    return place if numbered and run_directory.is_run(place) else None


def check_folder(out, overwrite, origin):
    """The absolute path of the folder for a run; OutputError if it may not be written there. Changes nothing."""
    if origin is None or os.path.realpath(out) != str(origin.run):
        return run_directory.check_new(out, overwrite)
    place = origin.run
    run_directory.check_writable(place)
    run_directory.check_unlocked(place)
    if origin.newer and not overwrite:
        raise OutputError(
            f"{place} holds newer checkpoints than {origin.path.name} (up to {origin.newer[0]:06d}): --restart {place} "
            "continues from the newest; give another output folder (--out DIR), or --overwrite to lose what came later"
        )
    return place


def scene_text(path):
    file = CheckpointFile(path)
    try:
        return file.bytes_of(SCENE).decode("utf-8")
    except UnicodeDecodeError as error:
        raise OutputError(f"{path} is damaged: its scene is no text") from error
    finally:
        file.close()


def scene_of(origin, overrides):
    """The scene of a checkpoint with overrides {dotted key: value} on top. Raises SceneError."""
    table = files.parse_toml(origin.text, str(origin.path))
    for key, other in EITHER_OR.items():
        if key in overrides:
            table.get("time", {}).pop(other, None)
    return Scene.from_table(table, str(origin.path), overrides)


def changes(origin, scene):
    """Dotted keys of what differs between a scene and the one of the checkpoint. Raises SceneError if a run cannot take it."""
    before, after = (leaves(files.parse_toml(text, str(origin.path))) for text in (origin.text, scene.to_toml()))
    differing = [key for key in dict.fromkeys((*before, *after)) if before.get(key) != after.get(key)]
    wrong = [
        key
        for key in differing
        if not (re.fullmatch(f"{WATCHING}|{DRIVING}", key) or same_file(key, before, after)) or closes(key, before)
    ]
    if wrong:
        key = wrong[0]
        was, now = (value_text(held[key]) if key in held else "absent" for held in (before, after))
        raise SceneError(
            f"{origin.path}: {key} = {now} cannot change at a restart (it is {was} in the checkpoint): particles and grid are "
            "what they are. These can: title, time.*, output.*, guard.*, parallel.*, exact.*, domain.gravity, "
            "domain.walls.* that are not open, method.damping, method.flip_blend, method.precision, "
            "materials.*.* but model and density, motions[n].velocity, "
            "inflows[n].velocity, inflows[n].until, inflows[n].limit, contact.friction, contact.pairs, "
            "colliders[n].surface, colliders[n].velocity, colliders[n].angular_velocity, and where a file of a shape lies"
        )
    return differing


def same_file(key, before, after):
    """Whether a key tells where a file lies that is the same in both."""
    where, _, last = key.rpartition(".")
    mark = f"{where}.{MARKS.get(last)}"
    return mark in before and before[mark] == after.get(mark)


def closes(key, before):
    """Whether a change of a key closes a face that was open: particles may be beyond it."""
    return key.startswith("domain.walls.") and before.get(key) == "open"


def leaves(value, path=()):
    """{dotted key: value} of nested tables and lists; lists of numbers and text are values."""
    if isinstance(value, dict):
        return {key: leaf for name, item in value.items() for key, leaf in leaves(item, (*path, name)).items()}
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return {key: leaf for n, item in enumerate(value) for key, leaf in leaves(item, (*path, n)).items()}
    return {path_text(path): value}


@contextlib.contextmanager
def opened(origin, scene, comm):
    """What fills a simulation of this scene from a checkpoint. Collective. SceneError for changes that a run cannot take."""
    drives = any(re.fullmatch(DRIVING, key) for key in changes(origin, scene))
    continuation = on_every_rank(comm, lambda: Continuation(CheckpointFile(origin.path), drives))
    try:
        yield continuation
    finally:
        continuation.file.close()
