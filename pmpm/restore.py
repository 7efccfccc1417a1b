"""What a simulation needs to go on as if it had never stopped: taken out of one, and put into another on any ranks.

Kept are the particles in their one global order and segments, and the few numbers on which the next decisions depend. In the
same precision the simulation that is filled with them takes the same steps, bit for bit; cuts may differ.
"""

import json
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pmpm import estimate, readout
from pmpm.kernels.loops import FARTHEST, OVERFLOW
from pmpm.kernels.needs import labels
from pmpm.kernels.places import FORMATS
from pmpm.output.datasets import Later
from pmpm.output.files import OutputError, on_every_rank
from pmpm.output.layout import snapshot_attributes, topology
from pmpm.parallel.balance import best_edges
from pmpm.scene.errors import SceneError
from pmpm.state.assembly import Growing, leaving
from pmpm.state.particles import LANES, Ordered, Population, layer_groups, segment_bases

OWN = "restart"  # the group of a checkpoint that a snapshot has not
RECORD, SCENE = f"{OWN}/record", f"{OWN}/scene"
STORED_ELSEWHERE = ("x", "v")  # fields of a layout that lie under other names

MOST = 1 << 62  # that a count may be
Count = Annotated[int, Field(ge=0, le=MOST)]
Units = Annotated[int, Field(gt=-(MOST << 30), lt=MOST << 30)]  # which sums in two parts can hold
Size = Annotated[float, Field(ge=0.0)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Numbers(BaseModel):
    """Numbers of a checkpoint, checked: nobody says who has written the file."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Disorder(Numbers):
    """Of timestep.Disorder."""

    step: Count
    sorted_runs: Count | None
    excess: Count
    particles: Count
    pending: tuple[Count, Count, Count] | None


class Control(Numbers):
    """Of timestep.StepControl."""

    largest: tuple[tuple[Size, Size, Size, Size], tuple[Size, Size, Size, Size]]
    moving: Size
    travel: Size
    drift: Size
    drift_travel: Size
    regroup_travel: Size
    begun: Count
    regroup_step: Count
    pending: Annotated[list[tuple[Count, Size, Size, Size, Size, Size, Size]], Field(max_length=8)]
    disorder: Disorder


class Energy(Numbers):
    """Of guard.EnergyWatch."""

    unit: Size
    first: int
    active: int
    work: int
    pending: tuple[Count, int, int, int, int] | None


class Obstacle(Numbers):
    """Of collision.Obstacle."""

    shift: list[Finite]
    turn: list[list[Finite]]
    impulse: list[Units]
    told_time: Size
    told: list[Units]
    unit: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]

    def fits(self, dim):
        """Whether it is of a scene of `dim` dimensions."""
        parts = 3 if dim == 2 else 6
        lengths = [len(self.shift), len(self.turn), *map(len, self.turn)], [len(self.impulse), len(self.told)]
        if lengths != ([dim] * (2 + dim), [parts] * 2):
            return False
        turn = np.array(self.turn)
        return bool(np.abs(turn).max() < 2.0 and np.abs(turn @ turn.T - np.eye(dim)).max() < 1e-6)


class Flow(Numbers):
    """Of flow.Flow."""

    left: list[Count]
    left_steps: list[Count]
    emitted: list[Count]
    last: list[list[Finite] | None]
    unknown: list[tuple[Count, Size]]
    taken: dict[str, Finite]
    brought: dict[str, Finite]


class Record(Numbers):
    """All of it. `axes`: of the grid (slab, middle, row), by which layers and segments are counted; `counts`: of each regular
    output (interval in s, number of the next time it is due); `outputs`: how many snapshots and lines of diagnostics there
    were, and after which step the last ones came."""

    axes: tuple[int, int, int]
    time: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    step_count: Count
    dt: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    first_energy: float
    regroups: Count
    control: Control
    energy: Energy | None
    travelled: list[list[Finite]]
    obstacles: list[Obstacle] = []
    flow: Flow | None = None
    counts: dict[str, tuple[Size, Count]]
    outputs: dict[str, Count]


@dataclass
class State:
    """A simulation at rest between two steps: its numbers, the same on all ranks, and this rank's particles of each law."""

    record: dict
    populations: list[Population]

    @property
    def rows(self):
        """How many particles this rank holds."""
        return sum(map(len, self.populations))

    def copy(self):
        """The same, for later: the simulation's own particles move on."""
        return State(self.record, [population.copy() for population in self.populations])


def state(simulation, outputs=None):
    """What the simulation needs to go on. Collective. Raises NumericalFailure if a particle has failed."""
    simulation.check()
    record = {
        "axes": simulation.geometry.axes,
        "time": simulation.time,
        "step_count": simulation.step_count,
        "dt": float(simulation.dt),
        "first_energy": simulation.first_energy,
        "regroups": simulation.regroups,
        "control": simulation.control.state(),
        "energy": simulation.energy_watch and simulation.energy_watch.state(),
        "travelled": [region.travelled.tolist() for region in simulation.drive.regions],
        "obstacles": [obstacle.state(simulation.comm) for obstacle in simulation.drive.obstacles],
        "counts": {o.name: (o.seconds, o.count) for o in simulation.observers if o.name and o.seconds is not None},
        "outputs": outputs or {},
    } | ({"flow": simulation.flow.state()} if simulation.flow else {})
    return State(record, simulation.populations)


# ---- into a file ----


def datasets(simulation, held):
    """({dataset: this rank's rows}, {group: attributes}) of a checkpoint that holds a State. Collective."""
    first, count = simulation.comm.offsets(held.rows)
    names, kernels = labels(simulation.needs.laws), simulation.kernels
    found = topology(simulation.comm, first, held.rows, count) | common_rows(simulation, held)
    for label, population, layout in zip(names, held.populations, simulation.layouts, strict=True):
        for field in layout.fields:
            if field.name not in STORED_ELSEWHERE:
                found[f"pmpm/{label}/{field.name}"] = field_rows(population, kernels, layout.where(field.name))
        found[f"{OWN}/{label}/place"] = place_rows(population, kernels, simulation.dim)
        found[f"{OWN}/{label}/segments"] = population.segment_table()
    for name, text in ((RECORD, json.dumps(held.record)), (SCENE, simulation.scene.to_toml())):
        found[name] = np.frombuffer(text.encode() if simulation.comm.rank == 0 else b"", np.uint8)
    now = (held.record[name] for name in ("time", "step_count", "dt"))
    return found, snapshot_attributes(simulation.scene, *now)


def field_rows(population, kernels, where):
    """Rows of a stored field: numbers of one, vectors of several columns."""
    columns = () if where.stop - where.start == 1 else (where.stop - where.start,)

    def make():
        return (rows.reshape(-1, *columns) for rows in population.unpacked(kernels, where))

    return Later((len(population), *columns), population.reals.dtype, make)


def place_rows(population, kernels, dim):
    """The integers that positions are, from the base nodes of the segments."""
    integer = population.places.dtype

    def make():
        return (rows.view(integer) for rows in population.unpacked(kernels, slice(0, dim)))

    return Later((len(population), dim), integer, make)


def common_rows(simulation, held):
    """Rows in the one global order: of all laws what ParaView shows, x, id, v and the material."""
    geometry, scene, kernels = simulation.geometry, simulation.scene, simulation.kernels
    materials = np.array([simulation.material_names.index(body.material) for body in scene.sources], np.int32)
    populations, rows, velocity = held.populations, held.rows, simulation.layouts[0].where("v")

    def joined(columns, dtype, groups_of):
        def make():
            if len(populations) == 1:
                yield from groups_of(populations[0])
                return
            counts, first = sum(p.layer_counts for p in populations), populations[0].first_layer
            for layers in layer_groups(counts, first):
                parts = [population.part(*layers) for population in populations]
                nothing = np.empty((0, *columns), dtype)
                found = np.concatenate([nothing, *(group for part in parts for group in groups_of(part))])
                yield found[readout.order_of(parts)]

        return Later((rows, *columns), np.dtype(dtype), make)

    return {
        "VTKHDF/Points": joined((3,), simulation.real, lambda p: p.points(kernels, geometry.axes, geometry.cell_size)),
        "VTKHDF/PointData/id": joined((), np.int64, lambda p: p.ids(kernels)),
        "VTKHDF/PointData/velocity": joined((3,), simulation.real, lambda p: p.unpacked(kernels, velocity, 3)),
        "VTKHDF/PointData/material": joined((), np.int32, lambda p: p.of_table_rows(materials)),
    }


# ---- out of a file ----


class Continuation:
    """Fills a simulation from a checkpoint: the other way to begin beside populate.Beginning.

    `file`: an output.checkpoints.CheckpointFile. `changed`: whether the scene now drives the particles otherwise than the one
    that wrote it, so that the next step must be chosen anew. Raises OutputError where the file does not fit.
    `own_layers`: which layers this rank reads, where the checkpoint was cut across another axis than the scene is now;
    otherwise those that it owns.
    """

    def __init__(self, file, changed=False):
        self.file, self.changed = file, changed
        self.own_layers = (0, 0)
        try:
            self.record = Record.model_validate_json(file.bytes_of(RECORD))
        except ValidationError as error:
            raise OutputError(f"{file.path} is damaged: {RECORD}: {error.errors()[0]['msg']}") from error

    def count_per_layer(self, simulation):
        """(layers, laws) particles over all ranks; reads where the particles of each law lie. Collective. SceneError for
        too many."""
        estimate.refuse_memory(simulation.scene, simulation.needs, simulation.geometry, simulation.comm)
        comm = simulation.comm
        on_every_rank(comm, lambda: self.read_tables(simulation))
        if self.geometry.axes == simulation.geometry.axes:
            return self.counts
        edges = best_edges(self.counts.sum(axis=1), comm.size, 1)
        self.own_layers = edges[comm.rank], edges[comm.rank + 1]
        return comm.sum(on_every_rank(comm, lambda: self.count_turned(simulation)))

    def count_turned(self, simulation):
        """(layers, laws) particles that this rank reads, by the layers of the slab axis that the scene has now; nearly."""
        geometry, form = simulation.geometry, FORMATS[np.dtype(self.file.precision)]
        slab, found = geometry.axes[0], np.zeros((geometry.layers, len(self.tables)), np.int64)
        first, last = self.own_layers
        for layers in layer_groups(self.counts[first:last].sum(axis=1), first):
            for number, (table, label) in enumerate(zip(self.tables, self.labels, strict=True)):
                begin, end, here = rows_of(table, *layers)
                place = self.file.rows(f"{OWN}/{label}/place", begin, end, (simulation.dim,), form.integer)
                base = np.repeat(segment_bases(here[:, 0], here, self.geometry.axes)[:, slab], here[:, 1])
                layer = np.clip(base + (place[:, slab] >> form.fraction), 0, geometry.layers - 1)
                np.add.at(found[:, number], layer, 1)
        return found

    def read_tables(self, simulation):
        """Read the segments of each law, and count its particles in each layer."""
        self.labels = labels(simulation.needs.laws)
        if sorted(self.record.axes) != sorted(simulation.geometry.axes):
            raise OutputError(
                f"{self.file.path} is damaged: {self.record.axes} are no axes of a {simulation.dim}-D grid"
            )
        self.geometry = replace(simulation.geometry, axes=self.record.axes)
        self.tables = [self.segments(simulation, number) for number in range(len(self.labels))]
        self.counts = np.zeros((self.geometry.layers, len(self.tables)), np.int64)
        for number, table in enumerate(self.tables):
            np.add.at(self.counts[:, number], table[:, 0], table[:, 1])
        total = self.file.shape("VTKHDF/PointData/id")[0]
        if self.counts.sum() != total:
            raise OutputError(
                f"{self.file.path} is damaged: {total} particles, but {self.counts.sum()} lie in segments"
            )

    def segments(self, simulation, number):
        """(m, 5) segments of a law over all ranks, checked."""
        label = self.labels[number]
        table = self.file.rows(f"{OWN}/{label}/segments").astype(np.int64)
        geometry = self.geometry
        of_law = simulation.tables[number][:, 0] > 0.0
        _, middle, row = geometry.axes
        homes = [geometry.layers, None, len(of_law), geometry.homes(middle) if middle >= 0 else 1, geometry.homes(row)]
        sound = table.ndim == 2 and table.shape[1] == len(homes) and (table >= 0).all()
        sound = sound and all((table[:, k] < size).all() for k, size in enumerate(homes) if size is not None)
        sound = sound and of_law[table[:, 2]].all() and (table[:, 1] > 0).all() and (np.diff(table[:, 0]) >= 0).all()
        rows = self.file.shape(f"{OWN}/{label}/place")[0]
        if not sound or table[:, 1].sum(dtype=np.float64) != rows or table[:, 1].sum() != rows:
            raise OutputError(
                f"{self.file.path} is damaged: the segments of {label} do not fit its particles or the grid"
            )
        return table

    def fill(self, simulation):
        """Give every rank the particles of its layers, in their order, and the simulation its numbers. Collective."""
        record, end = self.record, simulation.scene.time.end
        if record.time > end:
            raise SceneError(
                f"{self.file.path}: time.end = {end} s lies before the checkpoint, t = {record.time:.6g} s"
            )
        turned = self.geometry.axes != simulation.geometry.axes
        if not turned:
            self.own_layers = simulation.first_layer, simulation.last_layer
        simulation.populations = on_every_rank(simulation.comm, lambda: self.populations(simulation))
        simulation.held = simulation.rows()
        simulation.time, simulation.step_count, simulation.dt = record.time, record.step_count, record.dt
        simulation.first_energy, simulation.regroups = record.first_energy, record.regroups
        simulation.counts, simulation.outputs = dict(record.counts), dict(record.outputs)
        self.move_regions(simulation)
        self.resume_flow(simulation)
        simulation.control.resume(record.control.model_dump())
        if turned:
            found = [leaving(p, self.geometry, simulation.kernels, 0, 0) for p in simulation.populations]
            simulation.regroup(clouds=[of_law.others for of_law in found])
        else:
            simulation.share_layers()
        simulation.note_loads()
        if simulation.energy_watch is not None and record.energy is not None:
            simulation.energy_watch.resume(record.energy.model_dump())
        elif simulation.energy_watch is not None:
            simulation.energy_watch.begin(simulation.measure())
        newly_open = simulation.flow is not None and self.record.flow is None
        if self.file.precision != simulation.scene.method.precision or newly_open:
            simulation.regroup()  # what has been rounded may lie on the other side of a layer's end, or beyond a face
        if self.changed or self.file.precision != simulation.scene.method.precision:
            simulation.changed_by_hand()

    def populations(self, simulation):
        """This rank's particles of each law, read in groups of layers."""
        first, last = self.own_layers
        growing = []
        for table, layout in zip(self.tables, simulation.layouts, strict=True):
            blocks = int((-(-rows_of(table, first, last)[2][:, 1] // LANES)).sum())
            growing.append(Growing(first, last - first, simulation.pad_values(layout), blocks))
        for layers in layer_groups(self.counts[first:last].sum(axis=1), first):
            ids, velocities = self.common(simulation, layers)
            for number, made in enumerate(growing):
                ordered = self.ordered(simulation, number, layers, ids[number], velocities[number])
                part = Population.of_ordered(ordered, layers[0], layers[1] - layers[0], made.rest, simulation.dim)
                begin = made.take(part.segments, part.layer_start, layers[0] - first, len(part.reals))
                made.reals[begin : made.used], made.id[begin : made.used] = part.reals, part.id
        return [made.whole() for made in growing]

    def move_regions(self, simulation):
        regions, travelled = simulation.drive.regions, self.record.travelled
        if [len(where) for where in travelled] != [simulation.dim] * len(regions):
            raise OutputError(
                f"{self.file.path} is damaged: {len(travelled)} regions have travelled, not {len(regions)}"
            )
        for region, where in zip(regions, travelled, strict=True):
            region.travelled[:] = where
        obstacles, found = simulation.drive.obstacles, self.record.obstacles
        if len(found) != len(obstacles) or not all(state.fits(simulation.dim) for state in found):
            raise OutputError(f"{self.file.path} is damaged: its colliders are not those of its scene")
        for obstacle, state in zip(obstacles, found, strict=True):
            obstacle.resume(state.model_dump(), simulation.comm.rank)

    def resume_flow(self, simulation):
        if simulation.scene.inflows and self.record.flow is None:
            raise OutputError(f"{self.file.path} is damaged: it does not tell what has come in")
        if simulation.flow is not None and self.record.flow is not None:
            try:
                simulation.flow.resume(self.record.flow.model_dump())
            except ValueError as complaint:
                raise OutputError(f"{self.file.path} is damaged: {complaint}") from None

    def common(self, simulation, layers):
        """([ids of each law], [velocities (n, dim) of each law]) of the particles of some layers."""
        first, last = layers
        begin, end = (int(self.counts[:layer].sum()) for layer in (first, last))
        mine = self.counts[first:last]
        law = np.repeat(np.tile(np.arange(mine.shape[1]), len(mine)), mine.reshape(-1))
        ids = self.file.rows("VTKHDF/PointData/id", begin, end, (), np.int64)
        v = self.file.rows("VTKHDF/PointData/velocity", begin, end, (3,), np.floating)[:, : simulation.dim]
        return tuple(zip(*((ids[law == number], v[law == number]) for number in range(len(self.tables))), strict=True))

    def ordered(self, simulation, number, layers, ids, velocities):
        """Rows of a law in some layers."""
        file, real, layout = self.file, simulation.real, simulation.layouts[number]
        label = self.labels[number]
        begin, end, table = rows_of(self.tables[number], *layers)
        ordered = Ordered(np.empty((end - begin, layout.size), real), ids, table)
        theirs, ours = FORMATS[np.dtype(file.precision)], FORMATS[np.dtype(real)]
        place = file.rows(f"{OWN}/{label}/place", begin, end, (simulation.dim,), theirs.integer)
        ordered.places[:, layout.where("x")] = ours.moved_from(theirs, place)
        self.check_places(simulation, number, ordered)
        ordered.reals[:, layout.where("v")] = velocities
        wanted = [field for field in layout.fields if field.name not in STORED_ELSEWHERE]
        held = file.names(f"pmpm/{label}")
        if sorted(held) != sorted(field.name for field in wanted):
            names = ", ".join(field.name for field in wanted)
            raise OutputError(f"{file.path}: particles of {label} hold {', '.join(held)}, this scene asks for {names}")
        with np.errstate(over="ignore"):
            for field in wanted:
                size = field.size(simulation.dim)
                shape = () if size == 1 else (size,)
                values = file.rows(f"pmpm/{label}/{field.name}", begin, end, shape, np.floating)
                ordered.reals[:, layout.where(field.name)] = values.reshape(-1, size)
        return ordered

    def check_places(self, simulation, number, ordered):
        """Raise OutputError for particles further from their layer than P2G may find them, or outside the domain."""
        stencil, slab = self.geometry.stencil, self.geometry.axes[0]
        form, bases = FORMATS[ordered.reals.dtype], ordered.bases(self.geometry.axes)
        place = ordered.places[:, : simulation.dim].astype(np.int64)
        drift = np.abs(place[:, slab] - form.whole(0.5 - stencil.round))
        sixty_fourths = 64 * bases + (place >> (form.fraction - 6))
        low, high = simulation.limits.T
        inside = (sixty_fourths >= low - 1) & (sixty_fourths <= high) & (np.abs(place) < form.whole(OVERFLOW))
        if not inside.all() or (drift > form.whole(FARTHEST / 64)).any():
            raise OutputError(
                f"{self.file.path} is damaged: a particle of {self.labels[number]} is not where its layer is"
            )


def rows_of(table, first, last):
    """(first row, last row + 1, segments) of layers first .. last - 1 in the segments of a law."""
    begin, end = np.searchsorted(table[:, 0], (first, last))
    return int(table[:begin, 1].sum()), int(table[:end, 1].sum()), table[begin:end]
