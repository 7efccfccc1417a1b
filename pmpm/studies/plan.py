"""What a study is to run: the schemes that are compared, and the scene of each at every level; all checked beforehand."""

import itertools
import math
from dataclasses import asdict, dataclass, field
from typing import Any

from pmpm import estimate
from pmpm.explain import first_look
from pmpm.kernels.needs import TRANSFERS
from pmpm.restart import EITHER_OR
from pmpm.scene.errors import SceneError
from pmpm.scene.materials import PythonMaterial
from pmpm.scene.messages import known_text
from pmpm.scene.recorded import PREFIX
from pmpm.scene.schema import Scene

SPACE, TIME = "space", "time"
# Option of a study -> key of the scene that its values go to.
AXES = {
    "transfer": "method.transfer",
    "shape_function": "method.shape_function",
    "precision": "method.precision",
    "cfl": "time.cfl",
}
MOST_LEVELS, MOST_REPEATS, MOST_RUNS = 12, 1000, 1000


@dataclass(frozen=True)
class Options:
    """What is asked of a study; an axis without values keeps what the scene says. Raises SceneError for what makes no sense."""

    levels: int = 3
    refine: str = SPACE
    transfer: tuple[str, ...] = ()
    shape_function: tuple[str, ...] = ()
    precision: tuple[str, ...] = ()
    cfl: tuple[float, ...] = ()
    until: float | None = None
    repeat: int = 1

    def __post_init__(self):
        for name, most in (("levels", MOST_LEVELS), ("repeat", MOST_REPEATS)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
                raise SceneError(f"--{name} {value}: must be a whole number from 1 to {most}")
        if self.refine not in (SPACE, TIME):
            known = known_text(self.refine, (SPACE, TIME), "known are")
            raise SceneError(f"--refine {self.refine}: is not known; {known}")
        if self.until is not None and not 0.0 < self.until < math.inf:
            raise SceneError(f"--until {self.until}: must be a number > 0 s")
        for name in AXES:
            values = getattr(self, name)
            twice = [value for number, value in enumerate(values) if value in values[:number]]
            if twice:
                raise SceneError(f"--{name.replace('_', '-')}: {twice[0]} is named twice")

    @property
    def axes(self) -> dict[str, tuple[Any, ...]]:
        """{option: its values} of what differs between schemes, or is set for all of them."""
        return {name: getattr(self, name) for name in AXES if getattr(self, name)}

    def table(self) -> dict[str, Any]:
        """Return the options as plain values."""
        return asdict(self)


@dataclass(frozen=True)
class Entry:
    """One run of a study: a scheme at a level."""

    number: int
    scheme: str
    level: int
    scene: Scene
    estimated_steps: float
    estimated_particles: float


@dataclass(frozen=True)
class Plan:
    """All runs, coarse levels first; `left_out`: {scheme: why it cannot be}; `base`: the scene of level 0 as it was given."""

    entries: tuple[Entry, ...]
    base: Scene
    options: Options
    left_out: dict[str, str] = field(default_factory=dict)

    @property
    def schemes(self):
        """Labels in the order in which they were asked for."""
        return tuple(dict.fromkeys(entry.scheme for entry in self.entries))

    @property
    def particle_steps(self):
        """About how many there are in all."""
        return sum(entry.estimated_steps * entry.estimated_particles for entry in self.entries)


def plan(scene, options, comm):
    """The Plan of a study of a Scene, or of a function that gives the Scene of a level for 1, 2, 4 ... Collective.

    Raises SceneError for what any of the runs would be refused for, before anything is run.
    """
    factors = [2**level if options.refine == SPACE else 1 for level in range(options.levels)]
    given = [level_scene(scene, factor) for factor in factors]
    refuse_other_domains(given)
    refuse_flows(given[0])
    if options.until is not None and options.until > given[0].time.end:
        raise SceneError(f"--until {options.until}: must be at most time.end = {given[0].time.end} s")
    choices = [dict(zip(options.axes, values, strict=True)) for values in itertools.product(*options.axes.values())]
    if len(choices) * options.levels > MOST_RUNS:
        raise SceneError(f"study: {len(choices) * options.levels} runs, at most {MOST_RUNS}")
    schemes, left_out = possible(given[0], choices, options)
    entries: list[Entry] = []
    for level, base in enumerate(given):
        for label, choice in schemes.items():
            made = variant(base, choice, options, level)
            try:
                steps, particles = cost(made, comm)
            except SceneError as error:
                raise SceneError(f"study: level {level} of {label}: {error}") from None
            entries.append(Entry(len(entries), label, level, made, steps, particles))
    return Plan(tuple(entries), given[0], options, left_out)


def level_scene(scene, factor):
    """The scene with cells a `factor` smaller, as it was given."""
    if callable(scene):
        return scene(factor)
    if factor == 1:
        return scene
    return changed(scene, {"domain.cell_size": scene.domain.cell_size / factor} | halved_step(scene, factor))


def halved_step(scene, factor):
    return {} if scene.time.step is None else {"time.step": scene.time.step / factor}


def refuse_other_domains(scenes):
    """Raise SceneError where levels of a scene without an exact solution are not refinements of the first one."""
    first = scenes[0]
    for scene in scenes[1:]:
        ratios = {fine / coarse for fine, coarse in zip(scene.cells, first.cells, strict=True)}
        nested = len(ratios) == 1 and ratios.pop() % 1.0 == 0.0 and scene.domain.size == first.domain.size
        if first.exact is None and not nested:
            raise SceneError(
                "study: without an exact solution all levels must have the same domain.size and whole refinements of the "
                "first one's cells"
            )


def refuse_flows(scene):
    """Levels are compared by the same material, which must be there from the start to the end."""
    opened = [face for face, wall in scene.domain.walls.items() if wall.type == "open"]
    if opened or scene.inflows:
        what = f"domain.walls.{opened[0]} is open" if opened else "inflows bring material"
        raise SceneError(f"study: {what}: levels are compared by material that is there from the start to the end")


def possible(scene, choices, options):
    """({label: choice} of the schemes that can be, {label: complaint} of those that cannot).

    Raises SceneError where no scheme can be that has one of the values: then the value is wrong, not the combination.
    """
    schemes, complaints = {}, {}
    for choice in choices:
        try:
            variant(scene, choice, options, 0)
            schemes[label_of(scene, choice, options)] = choice
        except SceneError as error:
            complaints[label_of(scene, choice, options)] = (choice, str(error))
    for choice, text in complaints.values():
        for name, value in choice.items():
            if not any(other[name] == value for other in schemes.values()):
                raise SceneError(text)
    if not schemes:
        raise SceneError(next(iter(complaints.values()))[1])
    return schemes, {label: text for label, (_, text) in complaints.items()}


def label_of(scene, choice, options):
    """What a scheme is called: its transfer, and whatever else differs between schemes."""
    words = [str(choice.get("transfer", scene.method.transfer))]
    for name in ("shape_function", "precision"):
        words += [choice[name]] if len(options.axes.get(name, ())) > 1 else []
    words += [f"cfl {choice['cfl']:g}"] if len(options.cfl) > 1 else []
    return " ".join(words)


def variant(scene, choice, options, level):
    """The scene of one run. Raises SceneError."""
    changes = {AXES[name]: value for name, value in choice.items()}
    if options.until is not None:
        changes["time.end"] = options.until
    if options.refine == TIME and level:
        if "cfl" in choice or scene.time.step is None:
            changes["time.cfl"] = choice.get("cfl", scene.time.cfl) / 2**level
        else:
            changes |= halved_step(scene, 2**level)
    return changed(scene, changes)


def changed(scene, changes):
    """A scene with other values of dotted keys. Raises SceneError."""
    table = table_of(scene)
    for key in changes:
        if key in EITHER_OR:
            table["time"].pop(EITHER_OR[key], None)
    transfer = changes.get("method.transfer")
    if transfer is not None and not getattr(TRANSFERS.get(transfer), "blends", True):
        table["method"].pop("flip_blend", None)
    return Scene.from_table(table, "scene", changes)


def table_of(scene):
    """The nested tables of a scene, with its functions as they are, so that it can be made again."""
    table = scene.model_dump(exclude_none=True)
    for name, material in scene.materials.items():
        if isinstance(material, PythonMaterial):
            table["materials"][name] = material
    return with_functions(table, scene)


def with_functions(value, original):
    """Nested tables in which functions have taken the place of their records."""
    if isinstance(value, dict):
        return {key: with_functions(item, held(original, key)) for key, item in value.items()}
    if isinstance(value, list):
        return [with_functions(item, held(original, n)) for n, item in enumerate(value)]
    return original if isinstance(value, str) and value.startswith(PREFIX) else value


def held(original, key):
    """An entry of a table, list or part; None where a dump says more than there is."""
    if isinstance(original, dict | list | tuple):
        return original[key]
    return getattr(original, key, None) if isinstance(key, str) else None


def cost(scene, comm):
    """(steps, particles) of a run, about. Collective. Raises SceneError for what would be refused at its start."""
    needs, geometry, dt = first_look(scene)
    estimate.refuse_memory(scene, needs, geometry, comm)
    return math.ceil(scene.time.end / dt), float(estimate.particles(scene).sum())
