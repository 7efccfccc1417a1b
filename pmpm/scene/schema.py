"""The scene: validated input, defaults filled in, before anything is allocated or run."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomli_w
from pydantic import Field, ValidationError, field_serializer, model_serializer, model_validator

from pmpm.kernels.needs import STENCILS, TRANSFERS
from pmpm.physics.materials import LAWS, law_of
from pmpm.scene import files, forcing, geostatic, outside, start, watched
from pmpm.scene.colliders import Collider, Surface, named, table_of_type, wrong_names
from pmpm.scene.contact import Contact
from pmpm.scene.exact import Exact, wrong_exact
from pmpm.scene.functions import Unfit
from pmpm.scene.geostatic import Geostatic
from pmpm.scene.inflow import Inflow
from pmpm.scene.materials import AnyMaterial, Material
from pmpm.scene.messages import ABSENT, Problem, Problems, known_text, scene_error, value_text
from pmpm.scene.part import Part
from pmpm.scene.recorded import record
from pmpm.scene.seeding import SEEDINGS, fits_lattice, spread_places
from pmpm.scene.shapes import AXES, Shape, shapes_at, wrong_length
from pmpm.scene.values import (
    CONTROLS,
    Checked,
    Told,
    choice,
    flag,
    names,
    number,
    short_told,
    tables,
    text,
    vector,
    whole,
)
from pmpm.state.fields import OUTPUT_NAMES
from pmpm.state.fields import Field as StoredField

WALLS = ("stick", "slip", "separate", "friction", "free", "open")
CFL = 0.4
DEPTHS = 16  # at which a stress is tried
PLACES_OF_INFLOW = 2000  # that are asked whether they lie in a collider
FLIP_BLEND = 0.99
ENERGY_GAIN = 0.3
SNAPSHOTS, DIAGNOSTICS = 50, 200
# Of the output, absent where they are not asked for.
UNASKED = ("checkpoint_at_end", "probes", "gauges", "maps", "grid_fields")
WALL_INTERVAL = 1800.0
# How far sizes and corners may miss a whole cell or a wall by rounding, relative to the domain.
ROUNDING = 1e-9
MOST_CELLS = 2**31
FACES = tuple(f"{axis}_{end}" for axis in AXES for end in ("min", "max"))
# What snapshots of a scene file may hold: a file has no laws but the built-in ones.
FIELDS = tuple(dict.fromkeys((*OUTPUT_NAMES, *(field.name for law in LAWS.values() for field in law.STATE))))
# What nodes may have: what is a mean over particles, and the mass of a node.
NO_MEANS = ("id", "x", "material", "volume")
GRID_FIELDS = ("mass", *(name for name in FIELDS if name not in NO_MEANS))
# Default of what is filled in once the rest of the scene is known.
LATER: Any = None


class Wall(Surface):
    """What one face of the domain does to material that reaches it."""

    type: Annotated[str, choice(WALLS)] = Field(description=f"one of {', '.join(WALLS)}")
    velocity: forcing.Velocity = Field(default=None, description="of the wall: vector, or a function of time (m/s)")

    @model_validator(mode="after")
    def check_velocity(self) -> "Wall":
        if self.type in ("free", "open") and self.velocity is not None:
            text = f"belongs to a wall that holds material, not to {self.type}"
            raise Problems(Problem(("velocity",), text, self.velocity))
        return self

    def motion(self) -> dict[str, Any]:
        return {} if self.velocity is None else {"velocity": record(self.velocity)}


def face_table(value: Any) -> Any:
    if not isinstance(value, Mapping) or not all(isinstance(face, str) for face in value):
        raise Problems(Problem((), 'must be a table like { x_min = "slip" }', value))
    return dict(value)


def faces_told(table: Told) -> Told:
    walls = dict.fromkeys(FACES, table["additionalProperties"])
    return {"type": "object", "properties": walls, "additionalProperties": False}


class Domain(Part):
    """The box that the grid fills, the faces around it, and gravity."""

    size: Annotated[tuple[float, ...], vector("m", above=0.0)] = Field(
        description="two edge lengths for 2-D plane strain, three for 3-D (m)"
    )
    cell_size: Annotated[float, number("m", above=0.0)] = Field(description="edge of a grid cell (m)")
    gravity: Annotated[tuple[float, ...], vector("m/s2")] = Field(
        default=LATER, description="acceleration of gravity, zero if not given (m/s2)"
    )
    walls: Annotated[
        dict[str, Annotated[Wall, Checked(table_of_type(WALLS), told=short_told(WALLS))]],
        Checked(face_table, told=faces_told),
    ] = Field(default_factory=dict, description="face -> wall; separate where not given")
    periodic: Annotated[tuple[str, ...], names(AXES)] = Field(
        default=(), description="axes along which the domain repeats"
    )

    @property
    def dim(self) -> int:
        """Number of dimensions, 2 or 3."""
        return len(self.size)

    @property
    def cells(self) -> tuple[int, ...]:
        """Number of cells along each axis."""
        return tuple(round(length / self.cell_size) for length in self.size)

    @property
    def nodes(self) -> tuple[int, ...]:
        """Number of nodes along each axis; those at both ends of a periodic axis are one."""
        return tuple(count + (axis not in self.periodic) for axis, count in zip(AXES, self.cells, strict=False))

    @property
    def periods(self) -> tuple[float, ...]:
        """After how far the domain repeats along each axis, m; infinite where it does not."""
        lengths = zip(AXES, self.size, strict=False)
        return tuple(length if axis in self.periodic else math.inf for axis, length in lengths)

    def wall(self, face: str) -> Wall:
        """Return the wall at a face such as `x_min`; KeyError on a periodic axis, which has none."""
        return self.walls[face]

    @model_validator(mode="after")
    def complete(self) -> "Domain":
        """Check what depends on more than one key and fill in gravity and walls."""
        problems = [*self.wrong_cells(), *self.wrong_faces()]
        if self.gravity is not None:
            problems += wrong_length("gravity", self.gravity, self.dim)
        if problems:
            raise Problems(*problems)
        walled = [axis for axis in AXES[: self.dim] if axis not in self.periodic]
        faces = [f"{axis}_{end}" for axis in walled for end in ("min", "max")]
        separate = Wall(type="separate")
        settle(self, walls={face: self.walls.get(face, separate) for face in faces})
        settle(self, gravity=(0.0,) * self.dim if self.gravity is None else self.gravity)
        return self

    def wrong_cells(self) -> Iterator[Problem]:
        dx = self.cell_size
        # Compared before dividing, so that no quotient overflows.
        if any(length > dx * MOST_CELLS for length in self.size):
            yield Problem(("cell_size",), f"m is too small: more than {MOST_CELLS} cells along an axis", dx)
            return
        counts = [length / dx for length in self.size]
        if math.prod(counts) > MOST_CELLS * max(counts):
            total = f"{math.prod(counts):.3g} cells in all"
            yield Problem(("cell_size",), f"m is too small: {total}, more than {MOST_CELLS} in a plane", dx)
        for axis, (length, count) in enumerate(zip(self.size, counts, strict=True)):
            if count < 1.0 - ROUNDING:
                yield Problem(("cell_size",), f"m must be at most domain.size[{axis}] = {length} m", dx)
            elif abs(count - round(count)) > ROUNDING * count:
                fit = [f"{n * dx:.10g} m ({n} cells)" for n in (int(count), int(count) + 1)]
                text = f"m is not a whole number of cells of {dx} m; the nearest are {' and '.join(fit)}"
                yield Problem(("size", axis), text, length)

    def wrong_faces(self) -> Iterator[Problem]:
        axes = AXES[: self.dim]
        for index, axis in enumerate(self.periodic):
            if axis not in axes:
                yield Problem(
                    ("periodic", index), f"is not an axis of this {self.dim}-D domain: {', '.join(axes)}", axis
                )
        faces = [f"{axis}_{end}" for axis in axes for end in ("min", "max")]
        for face in self.walls:
            if face not in faces:
                yield Problem(("walls", face), f"is not a known face; {known_text(face, faces, 'faces')}")
            elif face[0] in self.periodic:
                yield Problem(("walls", face), f"cannot be given: the domain is periodic along {face[0]}")
            elif self.walls[face].velocity is not None:
                for problem in forcing.wrong_velocity(self.walls[face].velocity, self.dim):
                    yield Problem(("walls", face, *problem.path), problem.text, problem.value)


class Method(Part):
    """The scheme."""

    transfer: Annotated[str, choice(tuple(TRANSFERS))] = Field(
        default="apic", description="transfer scheme between particles and grid"
    )
    flip_blend: Annotated[float | None, number(at_least=0.0, at_most=1.0)] = Field(
        default=None, description=f"part of FLIP, the rest being PIC, of flip and aflip: {FLIP_BLEND} if not given"
    )
    shape_function: Annotated[str, choice(tuple(STENCILS))] = Field(
        default="quadratic", description="B-spline of the grid"
    )
    integrator: Annotated[str, choice(("explicit",), ("implicit",))] = Field(
        default="explicit", description="time integration"
    )
    precision: Annotated[str, choice(("float32", "float64"))] = Field(
        default="float64", description="of particles and grid"
    )

    damping: Annotated[float, number("1/s", at_least=0.0)] = Field(
        default=0.0, description="rate at which all motion dies away, to come to rest in quasi-static scenes (1/s)"
    )

    f_bar: Annotated[bool, flag()] = Field(
        default=False,
        description="average volume changes over nodes, so that solids near nu = 0.5 do not lock",
    )

    @model_validator(mode="after")
    def complete(self) -> "Method":
        """Check what excludes each other and fill in the blend of FLIP."""
        scheme = TRANSFERS[self.transfer]
        if scheme.mls and self.shape_function == "linear":
            text = (
                "needs quadratic or cubic splines: of linear ones the matrix D that it divides by is singular on nodes"
            )
            raise Problems(Problem(("transfer",), text, self.transfer))
        if self.flip_blend is not None and not scheme.blends:
            blending = " and ".join(name for name, other in TRANSFERS.items() if other.blends)
            raise Problems(Problem(("flip_blend",), f"belongs to {blending}, not to {self.transfer}", self.flip_blend))
        if scheme.blends and self.flip_blend is None:
            settle(self, flip_blend=FLIP_BLEND)
        return self


class Time(Part):
    """How long to run and in which steps."""

    end: Annotated[float, number("s", above=0.0)] = Field(description="time at which the run is finished (s)")
    cfl: Annotated[float | None, number(above=0.0, at_most=1.0)] = Field(
        default=None, description=f"fraction of the stable step, {CFL} unless step is given"
    )
    step: Annotated[float | None, number("s", above=0.0)] = Field(default=None, description="a fixed step (s)")
    force_step: Annotated[bool, flag()] = Field(
        default=False, description="take the fixed step although it is longer than the stable one"
    )
    smallest_step: Annotated[float | None, number("s", above=0.0)] = Field(
        default=None,
        description="the run stops when the stable step falls below this, 1e-4 of the first step if not given (s)",
    )
    ramp: Annotated[float, number("s", at_least=0.0)] = Field(
        default=0.0, description="time over which gravity and loads grow from nothing to all of them (s)"
    )

    @model_validator(mode="after")
    def complete(self) -> "Time":
        """Fill in cfl unless a fixed step is asked for."""
        if self.step is not None and self.cfl is not None:
            raise Problems(Problem(("step",), f"s excludes cfl = {self.cfl}: give one of the two", self.step))
        if self.step is None and self.force_step:
            raise Problems(Problem(("force_step",), "belongs to a fixed step: give time.step", self.force_step))
        if self.step is not None and self.smallest_step is not None:
            raise Problems(Problem(("smallest_step",), "s belongs to steps that follow from cfl", self.smallest_step))
        if self.step is None and self.cfl is None:
            settle(self, cfl=CFL)
        return self


class Body(Part):
    """A shape filled with particles of one material."""

    material: Annotated[str, text()] = Field(description="name of one of the materials")
    shape: Shape = Field(description="table with a type and its measures")
    particles_per_cell: Annotated[int, whole(1, 4096)] = Field(
        default=LATER,
        description="number of particles in a full cell, 4 in 2-D and 8 in 3-D if not given",
    )
    seeding: Annotated[str, choice(SEEDINGS)] = Field(
        default=LATER, description="where particles are put: lattice, or jittered where their number fits none"
    )
    velocity: Annotated[Any, start.vector_field("m/s")] = Field(
        default=LATER, description="at the start, zero if not given; from Python also a function of position (m/s)"
    )
    displacement: Annotated[Any, start.vector_field("m")] = Field(
        default=None, description="from the shape to where particles start; from Python also a function of position (m)"
    )
    deformation: Annotated[Any, start.matrix_field()] = Field(
        default=None, description="elastic deformation gradient at the start; from Python also a function of position"
    )
    pressure: Annotated[str, choice(("zero", "hydrostatic"))] = Field(
        default="zero",
        description="at the start; hydrostatic: a fluid at rest under gravity beneath the top of its shape",
    )
    stress: Geostatic | None = Field(default=None, description='at the start, such as { type = "geostatic" }')

    @field_serializer("velocity", "displacement", "deformation")
    def field_or_record(self, value: Any) -> Any:
        return record(value)


class Output(Part):
    """What is written, and how often."""

    snapshot_interval: Annotated[float, number("s", above=0.0)] = Field(
        default=LATER, description=f"between snapshots, end/{SNAPSHOTS} if not given (s)"
    )
    diagnostics_interval: Annotated[float, number("s", above=0.0)] = Field(
        default=LATER, description=f"between rows of diagnostics, end/{DIAGNOSTICS} if not given (s)"
    )
    fields: Annotated[tuple[str, ...], names(FIELDS)] = Field(
        default=("velocity", "pressure", "material"), description="particle fields in a snapshot"
    )
    checkpoint_interval: Annotated[float | None, number("s", above=0.0)] = Field(
        default=None, description="between checkpoints in simulated time, none if not given (s)"
    )
    checkpoint_wall_interval: Annotated[float, number("s", at_least=0.0)] = Field(
        default=WALL_INTERVAL, description="between checkpoints by the clock on the wall, 0 for none (s)"
    )
    checkpoint_keep: Annotated[int, whole(1, 1_000_000)] = Field(
        default=2, description="how many checkpoints are kept; older ones are deleted"
    )
    checkpoint_at_end: Annotated[bool, flag()] = Field(
        default=False, description="whether a finished run leaves a checkpoint, from which a later end continues it"
    )
    probes: Annotated[tuple[watched.Probe, ...], tables("probe", least=0)] = Field(
        default=(), description="one table [[output.probes]] for each point at which material is watched"
    )
    gauges: Annotated[tuple[watched.Gauge, ...], tables("gauge", least=0)] = Field(
        default=(), description="one table [[output.gauges]] for each line or section at which material is watched"
    )
    maps: Annotated[tuple[str, ...], names(watched.MAPS)] = Field(
        default=(), description=f"maps over the whole run: of {', '.join(watched.MAPS)}"
    )
    grid_fields: Annotated[tuple[str, ...], names(GRID_FIELDS)] = Field(
        default=(), description="fields on the nodes of the grid, written beside each snapshot"
    )

    @model_serializer(mode="wrap")
    def without_what_is_not_asked_for(self, dump: Any) -> Any:
        """As it stands in a file: a run that nobody watches so has the scene file that it always had."""
        return {key: value for key, value in dump(self).items() if key not in UNASKED or value}


class Guard(Part):
    """What a run is watched for, and what is kept for the case that it goes wrong."""

    keep_copy: Annotated[bool, flag()] = Field(
        default=False, description="keep a copy of the state in memory, written as a checkpoint if the run fails"
    )
    energy_gain: Annotated[float, number(at_least=0.0)] = Field(
        default=ENERGY_GAIN,
        description="the run stops when more energy than this part of what moves has come out of nothing; 0: never",
    )
    interval: Annotated[int, whole(1, 1_000_000)] = Field(
        default=100, description="steps between two looks at the energy, and between copies"
    )


class Parallel(Part):
    """How the domain is shared out. Results have the same bits for any ranks and cuts, and others for another slab axis."""

    slab_axis: Annotated[str | None, choice(AXES)] = Field(
        default=None, description="axis that is cut into slabs; the one with most cells if not given"
    )
    balance: Annotated[bool, flag()] = Field(
        default=True, description="let the cuts between slabs follow the work while a run goes on"
    )


def material_table(value: Any) -> Any:
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        raise Problems(Problem((), "must be a table with one table for each material, like [materials.sand]", value))
    if not value:
        raise Problems(Problem((), "must have at least one material"))
    if "" in value:
        raise Problems(Problem(("",), "must have a name"))
    odd = [name for name in value if CONTROLS.search(name)]
    if odd:
        raise Problems(*(Problem((name,), "must hold no control characters") for name in odd))
    return dict(value)


class Scene(Part):
    """Everything a run depends on; complete and checked. Raises SceneError, whose text is the message for the user."""

    title: Annotated[str, text()] = Field(default="", description="what the scene shows")
    domain: Domain = Field(description="table with size and cell_size")
    method: Method = Field(default=Method(), description="table of the scheme")
    time: Time = Field(description="table with end")
    materials: Annotated[
        dict[str, AnyMaterial], Checked(material_table, told=lambda table: table | {"minProperties": 1})
    ] = Field(description="one table for each material, like [materials.sand]")
    bodies: Annotated[tuple[Body, ...], tables("body", least=0)] = Field(
        default=(), description="one table [[bodies]] for each body"
    )
    inflows: Annotated[tuple[Inflow, ...], tables("inflow", least=0)] = Field(
        default=(), description="one table [[inflows]] for each region through which material comes in"
    )
    body_force: forcing.BodyForce = Field(
        default=None, description="function b(x, X, t): acceleration (m/s2) at a place, a reference place and a time"
    )
    loads: Annotated[tuple[forcing.Load, ...], tables("load", least=0)] = Field(
        default=(), description="one table [[loads]] for each load on a region"
    )
    motions: Annotated[tuple[forcing.Motion, ...], tables("motion", least=0)] = Field(
        default=(), description="one table [[motions]] for each region of the grid that moves as told"
    )
    colliders: Annotated[tuple[Collider, ...], tables("collider", least=0)] = Field(
        default=(), description="one table [[colliders]] for each rigid thing in the way"
    )
    contact: Contact | None = Field(
        default=None, description="table of contact between materials; without it bodies that touch are bonded"
    )
    exact: Exact | None = Field(
        default=None,
        description="functions of (X, t), from Python: the exact solution, against which errors are measured",
    )
    output: Output = Field(default=Output(), description="table of what is written")
    guard: Guard = Field(default=Guard(), description="table of what a run is watched for")
    parallel: Parallel = Field(default=Parallel(), description="table of how the domain is shared out among ranks")

    @classmethod
    def from_text(
        cls,
        text: str,
        source: str = "scene",
        overrides: Mapping[str, Any] | None = None,
        folder: str | Path | None = None,
    ) -> "Scene":
        """Read a scene from TOML text; `source` is what messages call it, `overrides` are dotted keys and values.

        Relative paths of other files count from `folder`, or from the working directory if it is None.
        """
        return cls.from_table(files.parse_toml(text, source), source, overrides, folder)

    @classmethod
    def from_table(
        cls,
        table: dict[str, Any],
        source: str,
        overrides: Mapping[str, Any] | None = None,
        folder: str | Path | None = None,
    ) -> "Scene":
        """Read a scene from the nested tables of a TOML text, which overrides change in place."""
        overridden = files.override(table, overrides or {}, source)
        try:
            with outside.beside(None if folder is None else Path(folder)):
                return cls.model_validate(table)
        except ValidationError as error:
            raise scene_error(error.errors(include_url=False), source, overridden) from None

    @classmethod
    def from_toml(cls, path: str | Path, overrides: Mapping[str, Any] | None = None) -> "Scene":
        """Read a scene file; `overrides` such as {"time.end": 0.5, "bodies.0.velocity": [1, 0]} are set on top."""
        return cls.from_text(files.read_text(path), str(path), overrides, Path(path).parent)

    @classmethod
    def builtin(cls, name: str, overrides: Mapping[str, Any] | None = None) -> "Scene":
        """Read one of the scenes that come with pmpm."""
        path = files.builtin_path(name)
        return cls.from_text(files.read_text(path), name, overrides, path.parent)

    @property
    def dim(self) -> int:
        """Number of dimensions, 2 or 3."""
        return self.domain.dim

    @property
    def cells(self) -> tuple[int, ...]:
        """Number of cells along each axis."""
        return self.domain.cells

    @property
    def sources(self) -> tuple[Any, ...]:
        """What particles come from: bodies, then inflows. The number of its source is what a particle knows of it."""
        return (*self.bodies, *self.inflows)

    def to_toml(self) -> str:
        """Write the scene with all defaults filled in; reading it back gives an equal scene."""
        return tomli_w.dumps({k: v for k, v in self.model_dump(exclude_none=True).items() if v != []})

    @field_serializer("bodies")
    def list_of_bodies(self, bodies: tuple[Body, ...]) -> list[dict[str, Any]]:
        return [body.model_dump(exclude_none=True) for body in bodies]

    @field_serializer("loads", "motions", "colliders", "inflows")
    def lists_of_parts(self, parts: tuple[Part, ...]) -> list[dict[str, Any]]:
        return [part.model_dump(exclude_none=True) for part in parts]

    @field_serializer("body_force")
    def recorded_force(self, function: Any) -> Any:
        return function and record(function)

    @field_serializer("materials")
    def tables_of_materials(self, materials: dict[str, Material]) -> dict[str, dict[str, Any]]:
        return {name: material.table(self.dim) for name, material in materials.items()}

    @classmethod
    def must_give(cls, key: str, data: Mapping[Any, Any]) -> bool:
        """Say whether a key must be given: bodies, unless the material flows in."""
        return super().must_give(key, data) or (key == "bodies" and not data.get("inflows"))

    @model_validator(mode="after")
    def complete(self) -> "Scene":
        """Check what depends on more than one table and fill in what depends on dimension and duration."""
        problems = [problem for index, body in enumerate(self.bodies) for problem in self.wrong_body(body, index)]
        if not self.sources:
            problems.append(Problem(("bodies",), "must have at least one body", list(self.bodies)))
        problems += self.wrong_fields()
        problems += watched.wrong_watched(self.output, self.domain)
        axis, axes = self.parallel.slab_axis, AXES[: self.dim]
        if axis is not None and axis not in axes:
            text = f"must be one of {', '.join(axes)} in a {self.dim}-D scene"
            problems.append(Problem(("parallel", "slab_axis"), text, axis))
        forced: list[tuple[tuple[str | int, ...], Any]] = [
            (("loads", n), load.misfits(self.dim)) for n, load in enumerate(self.loads)
        ]
        forced += [(("motions", n), motion.misfits(self.dim)) for n, motion in enumerate(self.motions)]
        forced += [(("colliders", n), collider.misfits(self.dim)) for n, collider in enumerate(self.colliders)]
        forced.append((("colliders",), wrong_names(self.colliders)))
        problems += [Problem((*path, *p.path), p.text, p.value) for path, misfits in forced for p in misfits]
        if self.body_force is not None:
            problems += forcing.wrong_body_force(self.body_force, self.dim, self.domain.size)
        problems += [
            problem for index, inflow in enumerate(self.inflows) for problem in self.wrong_inflow(inflow, index)
        ]
        for name, material in self.materials.items():
            problems += [
                Problem(("materials", name, *problem.path), problem.text, problem.value)
                for problem in material.wrong_law(self.dim)
            ]
        if self.contact is not None:
            used = tuple(source.material for source in self.sources)
            wrong = self.contact.wrong_contact(self.materials, used)
            problems += [Problem(("contact", *problem.path), problem.text, problem.value) for problem in wrong]
        if not problems:
            problems += [
                Problem((*path, *problem.path), problem.text, problem.value)
                for path, shape in shapes_at(self)
                if shape.type == "terrain"
                for problem in shape.misses(self.domain.size)
            ]
        if not problems and self.inflows and self.colliders:
            problems += self.blocked_inflows()
        if problems:
            raise Problems(*problems)
        settle(self, materials={name: material.complete(self.dim) for name, material in self.materials.items()})
        settle(self, bodies=tuple(self.complete_body(body) for body in self.bodies))
        settle(self, inflows=tuple(self.complete_inflow(inflow) for inflow in self.inflows))
        settle(self, output=self.complete_output())
        settle(self, colliders=tuple(named(self.colliders)))
        problems = [problem for index, body in enumerate(self.bodies) for problem in self.wrong_start(body, index)]
        if self.exact is not None and self.inflows:
            problems.append(Problem(("inflows",), "exclude exact: what flows in starts at no reference position"))
        elif self.exact is not None:
            problems += wrong_exact(self.exact, self.bodies, self.dim, self.time.end)
        if problems:
            raise Problems(*problems)
        return self

    def complete_body(self, body: Body) -> Body:
        count = 2**self.dim if body.particles_per_cell is None else body.particles_per_cell
        velocity = (0.0,) * self.dim if body.velocity is None else body.velocity
        if body.shape.type == "particles":
            places = None
        else:
            places = body.seeding or ("lattice" if fits_lattice(count, self.dim) else "jittered")
        known = {"particles_per_cell": count, "seeding": places, "velocity": velocity}
        return body.model_copy(update=known | {"stress": self.complete_stress(body)})

    def complete_inflow(self, inflow: Inflow) -> Inflow:
        count = 2**self.dim if inflow.particles_per_cell is None else inflow.particles_per_cell
        until = self.time.end if inflow.until is None else inflow.until
        return inflow.model_copy(update={"particles_per_cell": count, "until": until})

    def complete_stress(self, body: Body) -> Geostatic | None:
        if body.stress is None:
            return None
        surface = body.stress.depth_from
        if surface is None:
            surface = geostatic.free_surface(body.shape, self.domain.gravity)
        return body.stress.model_copy(update={"k0": self.k0(body), "depth_from": surface})

    def k0(self, body: Body) -> float | None:
        material = self.materials[body.material]
        given = body.stress.k0 if body.stress is not None else None
        return geostatic.default_k0(law_of(material.model), material.parameters) if given is None else given

    def complete_output(self) -> Output:
        snapshots, diagnostics = self.output.snapshot_interval, self.output.diagnostics_interval
        defaults = {
            "snapshot_interval": self.time.end / SNAPSHOTS if snapshots is None else snapshots,
            "diagnostics_interval": self.time.end / DIAGNOSTICS if diagnostics is None else diagnostics,
        }
        return self.output.model_copy(update=defaults)

    def wrong_body(self, body: Body, index: int) -> Iterator[Problem]:
        here = ("bodies", index)
        yield from self.wrong_material(body, here)
        if body.material in self.materials:
            yield from self.wrong_pressure(body, here)
        count = body.particles_per_cell
        if body.seeding and body.shape.type == "particles":
            yield Problem((*here, "seeding"), "belongs to shapes that are filled, not to particles", body.seeding)
        if body.seeding in ("lattice", "quadrature") and count and not fits_lattice(count, self.dim):
            side = int(count ** (1 / self.dim))
            nearest = f"{side**self.dim} and {(side + 1) ** self.dim}"
            text = f"fits no lattice, for seeding = {value_text(body.seeding)}; the nearest that do are {nearest}"
            yield Problem((*here, "particles_per_cell"), text, count)
        for problem in start.wrong_start(body, self.dim):
            yield Problem((*here, *problem.path), problem.text, problem.value)
        misfits = body.shape.misfits(self.dim)
        for problem in misfits:
            yield Problem((*here, "shape", *problem.path), problem.text, problem.value)
        if not misfits:
            yield from self.outside(body, (*here, "shape"))

    def wrong_inflow(self, inflow: Inflow, index: int) -> Iterator[Problem]:
        here = ("inflows", index)
        yield from self.wrong_material(inflow, here)
        misfits = list(inflow.misfits(self.dim))
        beyond = [] if misfits else list(self.outside(inflow, (*here, "shape")))
        yield from beyond
        if not misfits and not beyond:
            misfits = list(inflow.too_small(self.dim, self.domain.cell_size))
        for problem in misfits:
            yield Problem((*here, *problem.path), problem.text, problem.value)
        end = self.time.end if inflow.until is None else inflow.until
        if inflow.start >= end:
            yield Problem((*here, "start"), f"s must be < {end} s, when the stream ends", inflow.start)

    def blocked_inflows(self) -> Iterator[Problem]:
        """Yield inflows that lie in colliders at the start: each would undo what the other does to the nodes there."""
        for index, inflow in enumerate(self.inflows):
            low, high = inflow.shape.bounds()
            places = low + (high - low) * spread_places(PLACES_OF_INFLOW, self.dim)
            places = places[inflow.shape.contains(places)]
            for collider in named(self.colliders):
                near = collider.nearest(places, self.domain.periods)
                part = float(np.mean(collider.signed_distance(near, 0.0) < 0.0)) if len(places) else 0.0
                if part > 0.0:
                    yield Problem(
                        ("inflows", index, "shape"), f"lies in the collider {collider.name}, {part:.2g} of it"
                    )

    def wrong_material(self, source: Body | Inflow, here: tuple[str | int, ...]) -> Iterator[Problem]:
        if source.material not in self.materials:
            near = known_text(source.material, self.materials, "materials")
            yield Problem((*here, "material"), f"is not a material of this scene; {near}", source.material)

    def outside(self, body: Body | Inflow, path: tuple[str | int, ...]) -> Iterator[Problem]:
        size = np.array(self.domain.size)
        low, high = body.shape.bounds()
        beyond = (low < -ROUNDING * size) | (high > (1.0 + ROUNDING) * size)
        advice = body.shape.advice(self.domain.size) if beyond.any() and hasattr(body.shape, "advice") else ""
        for axis in np.flatnonzero(beyond):
            reach = f"from {low[axis]:.10g} to {high[axis]:.10g} m along {AXES[axis]}"
            text = f"reaches out of the domain: {reach}, the domain from 0 to {size[axis]:.10g} m{advice}"
            yield Problem(path, text)
            advice = ""

    def wrong_pressure(self, body: Body, here: tuple[str | int, ...]) -> Iterator[Problem]:
        """Yield what keeps a weight from being the stress that a body starts with."""
        material = self.materials[body.material]
        model, law = material.model, law_of(material.model)
        key, value = ("stress", ABSENT) if body.stress is not None else ("pressure", body.pressure)
        if body.pressure == "hydrostatic" and not hasattr(law, "hydrostatic_state"):
            liquids = [name for name, law in LAWS.items() if hasattr(law, "hydrostatic_state")]
            yield Problem((*here, key), f"is for {', '.join(liquids)} only; {body.material} is {model}", body.pressure)
        elif (body.pressure != "zero" or body.stress is not None) and np.count_nonzero(self.domain.gravity) != 1:
            gravity = value_text(self.domain.gravity)
            yield Problem((*here, key), f"needs gravity along exactly one axis; domain.gravity = {gravity} m/s2", value)
        elif body.stress is not None and self.k0(body) is None:
            text = f"is missing: {model} has neither a friction angle nor a Poisson ratio from which to find it"
            yield Problem((*here, "stress", "k0"), text)

    def wrong_start(self, body: Body, index: int) -> Iterator[Problem]:
        """Yield what shows when the functions and the stress that a body starts with are tried on a few particles."""
        law = start.ArrayLaw(self.materials[body.material], self.dim)
        shapes = [other.shape for other in self.bodies[index:]]
        for problem in start.wrong_functions(body, shapes, law):
            yield Problem(("bodies", index, *problem.path), problem.text, problem.value)
        if body.shape.type == "particles":
            for problem in start.wrong_file(body, law):
                yield Problem(("bodies", index, "shape", *problem.path), problem.text, problem.value)
        if body.stress is not None:
            gravity, surface = self.domain.gravity, body.stress.depth_from or 0.0
            tried = geostatic.depths(body.shape, gravity, surface, DEPTHS)
            density = self.materials[body.material].parameters["density"]
            try:
                geostatic.states(law, body.stress, density, gravity, tried)
            except Unfit as complaint:
                yield Problem(("bodies", index, "stress"), str(complaint))

    def wrong_fields(self) -> Iterator[Problem]:
        sizes: dict[str, int] = {}
        for name, material in self.materials.items():
            for field in law_of(material.model).state_fields(material.parameters):
                size = StoredField.of(field).size(self.dim)
                if sizes.setdefault(field.name, size) != size:
                    text = f"keeps {size} numbers as {field.name}, another law of the scene {sizes[field.name]}: rename one"
                    yield Problem(("materials", name, "model"), text)
        known = list(dict.fromkeys((*OUTPUT_NAMES, *sizes)))
        means = ["mass", *(name for name in known if name not in NO_MEANS)]
        asked = {"fields": (known, "fields of this scene"), "grid_fields": (means, "fields on nodes")}
        for key, (allowed, plural) in asked.items():
            for index, name in enumerate(getattr(self.output, key)):
                here, near = ("output", key, index), known_text(name, allowed, plural)
                if name in allowed:
                    reason = self.field_kept_by_nobody(name)
                else:
                    meant = key == "grid_fields" and name in NO_MEANS
                    reason = f"has no mean over particles; {near}" if meant else f"is not a known field; {near}"
                if reason is not None:
                    yield Problem(here, reason, name)

    def field_kept_by_nobody(self, name: str) -> str | None:
        """Return why no particle of this scene has such a field, None if there are some that have."""
        if name == "displacement" and self.exact is None and not forcing.reads_reference(self.body_force):
            return (
                "is known only where particles carry their reference position, for a body_force that reads X or an exact "
                "solution; the first snapshot says by id where each one began"
            )
        if name == "plastic_strain":
            laws = [(law_of(m.model), m.parameters) for m in self.materials.values()]
            kept = [getattr(law, "PLASTIC_STRAIN", None) in [f.name for f in law.state_fields(p)] for law, p in laws]
            if not any(kept):
                return (
                    "is kept by no law of this scene: von_mises keeps it with hardening_modulus > 0, mohr_coulomb with "
                    "softening_strain"
                )
        return None


def settle(part: Part, **values: Any) -> None:
    """Fill in what a part leaves to the rest of the scene; parts are frozen for everyone else."""
    for key, value in values.items():
        object.__setattr__(part, key, value)
