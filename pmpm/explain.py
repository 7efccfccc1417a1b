"""Explain without running: what a scene will cost and what it leaves out, and which materials there are."""

import math

from pmpm import estimate
from pmpm.estimate import bytes_per_particle
from pmpm.guard import unknown_work, watches_energy
from pmpm.kernels.needs import labels
from pmpm.parallel.slabs import room
from pmpm.physics.materials import LAWS, python_law
from pmpm.populate import rehearse
from pmpm.scene.errors import SceneError
from pmpm.scene.shapes import shapes_in
from pmpm.state.fields import OPTIONAL

ELASTIC_STATE = {"F", "J", "hencky_strain", "elastic_strain"}
WITHIN = 1e-6  # a run in float32 knows the stable step no better


def explain(scene, ranks, backend="cpu"):
    """Text of `pmpm check`: particles, memory per rank, time step, what particles hold, which kernels there are, and what was
    left out; with the backend cuda memory and kernels of the cards too. Raises SceneError."""
    needs, geometry, dt = first_look(scene)
    counted = estimate.places_to_try(scene) <= estimate.MOST_COUNTED
    counts = rehearse(scene, geometry) if counted else estimate.particles(scene)
    total, ranks = counts.sum(), max(ranks, 1)
    streams = [estimate.stream(scene, inflow) for inflow in scene.inflows]
    most = total + sum(stream.total for stream in streams)
    taken = estimate.memory(scene, needs, geometry, counts)
    lines = [
        f"title         {scene.title or '-'}",
        f"dimension     {scene.dim}-D{' plane strain' if scene.dim == 2 else ''}, {' x '.join(map(str, scene.cells))} cells "
        f"of {scene.domain.cell_size:g} m, slabs across {'xyz'[geometry.axes[0]]}",
        f"particles     {count_text(total)} in {len(scene.bodies)} bodies, {count_text(total // ranks)} per rank on "
        f"{ranks} ranks",
        *(
            f"inflow        {count_text(s.first)} particles at t = {inflow.start:g} s, then {count_text(s.rate)} per s, "
            f"{count_text(s.total)} in all"
            for inflow, s in zip(scene.inflows, streams, strict=True)
        ),
        *mesh_lines(scene),
        *(f"warning       {line}" for line in estimate.caught(scene)),
        *memory_lines(taken, ranks),
        *grid_lines(scene),
        f"time step     {dt:.3g} s at the start{' (fixed)' if scene.time.step else f', cfl {scene.time.cfl:g}'}",
        f"cost          about {math.ceil(scene.time.end / dt)} steps, {'at most ' if streams else ''}"
        f"{math.ceil(scene.time.end / dt) * most:.3g} particle-steps",
        f"ranks         room for {geometry.layers // geometry.stencil.window or 1}",
        f"method        {scene.method.transfer}, {scene.method.shape_function} splines, {scene.method.precision}",
        f"guard         {guard_text(scene)}",
        f"laws          {', '.join(law_text(law) for law in needs.laws)}",
        *contact_lines(scene),
        f"left out      {', '.join(left_out(scene, needs)) or 'nothing'}",
        "bytes of a particle",
        *aligned(byte_rows(needs)),
        "compiled kernels",
        *(f"  {who:20s} {', '.join(names)}" for who, names in compiled_kernels(scene, needs, ranks).items()),
    ]
    if backend == "cuda":
        on_each = estimate.on_cards(needs, taken, float(total)) / ranks
        lines += [
            "on the cards",
            f"  {'memory':20s} about {estimate.amount(on_each)} on each of {ranks}",
            *(f"  {who:20s} {', '.join(names)}" for who, names in card_kernels(scene, needs, ranks).items()),
        ]
    return "\n".join(lines)


def first_look(scene):
    """(needs, geometry, first time step in s) of a scene. Raises SceneError for what a run would refuse at its start, but for
    memory."""
    from pmpm.scene.needs import grid_geometry, law_table, scene_needs

    needs = scene_needs(scene)
    geometry = grid_geometry(scene, needs)
    tables = [law_table(scene, law) for law in needs.laws]
    dt = estimate.first_step(scene, needs, tables)
    estimate.refuse_steps(scene.time, dt)
    refuse_fixed_step(scene, needs, tables)
    return needs, geometry, dt


def count_text(number):
    """A number of particles: whole if they were counted, rounded if they were estimated."""
    return f"about {number:.3g}" if isinstance(number, float) else str(number)


def mesh_lines(scene):
    """What is known of each shape that comes out of a file."""
    told = [(key, shape) for key, shape in shapes_in(scene) if hasattr(shape, "told")]
    return [f"{'files' if n == 0 else '':14s}{key}: {shape.told()}" for n, (key, shape) in enumerate(told)]


def memory_lines(taken, ranks):
    """What a rank takes, and whether this machine has it for all of them."""
    available = estimate.available_memory()
    text = f"about {taken.particles / ranks / 1e6:.1f} MB of particles and {taken.grid / ranks / 1e6:.1f} MB of grid per rank"
    lines = [f"memory        {text}"]
    if taken.copy:
        lines.append(f"              and {taken.copy / ranks / 1e6:.1f} MB of the copy that guard.keep_copy keeps")
    if taken.fields:
        lines.append(
            f"              and {taken.fields / ranks / 1e6:.1f} MB of output.grid_fields while they are written"
        )
    if taken.most > available:
        lines.append(
            f"              more than this machine has: {estimate.amount(taken.most)} on all ranks at the start, "
            f"{estimate.amount(available)} available"
        )
    return lines


def grid_lines(scene):
    """What the fields on nodes will take on the disk."""
    if not scene.output.grid_fields:
        return []
    told = estimate.grid_fields(scene)
    return [
        f"grid fields   {', '.join(scene.output.grid_fields)} on {' x '.join(map(str, told.nodes))} nodes, "
        f"{estimate.amount(told.file)} with each snapshot"
    ]


def refuse_fixed_step(scene, needs, tables):
    """Raise SceneError where a fixed step is beyond the stable one already of undeformed particles at rest."""
    stressed = any(b.deformation is not None or b.stress is not None or b.pressure != "zero" for b in scene.bodies)
    # Of stressed particles only the run knows the waves.
    if scene.time.step is None or scene.time.force_step or stressed:
        return
    bound = min(estimate.stable_bounds(scene, needs, tables))
    if scene.time.step > bound * (1.0 + WITHIN):
        raise SceneError(
            f"time.step = {scene.time.step} s is longer than the stable step of {bound:.6g} s at t = 0 s: give a shorter step, "
            "or cfl instead"
        )


def guard_text(scene):
    """What a run is stopped for besides particles that fail."""
    work, guard = unknown_work(scene), scene.guard
    if guard.energy_gain == 0.0:
        return "energy not watched: guard.energy_gain = 0"
    if work is not None:
        return f"energy not watched: nobody adds up the work of {work}"
    return f"energy, every {guard.interval} steps: at most {guard.energy_gain:g} of what moves may come out of nothing"


def contact_lines(scene):
    """Which materials move on their own where they touch, in the order of their laws; nothing where all are bonded."""
    if scene.contact is None:
        return []
    from pmpm.scene.needs import velocity_fields

    of_field: dict[int, list[str]] = {}
    for material, field in velocity_fields(scene).items():
        of_field.setdefault(field, []).append(material)
    return [f"contact       between {' and '.join(' with '.join(names) for names in of_field.values())}"]


def law_text(law):
    return f"{law.model} (keeps {', '.join(law.state)})"


def byte_rows(needs):
    """Table of bytes_per_particle, a head and a row per law; "-" where a law has no such field."""
    held = bytes_per_particle(needs)
    names = list(dict.fromkeys(name for fields in held for name in fields if name != "id"))
    common = [name for name in names if all(name in fields for fields in held)]
    names = [*common, *(name for name in names if name not in common), "id"]
    rows = [["", *names, "total"]]
    for label, fields in zip(labels(needs.laws), held, strict=True):
        rows.append([label, *(str(fields.get(name, "-")) for name in names), str(sum(fields.values()))])
    return rows


def aligned(rows):
    """Lines of a table: the first column to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        f"  {row[0]:20s} " + "  ".join(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))
        for row in rows
    ]


def compiled_kernels(scene, needs, ranks):
    """{law, "walls", "shared": names of the entry kernels that a run calls, hence compiles}."""
    from pmpm.kernels.build import collider_entries, contact_entries, law_entries, shared_entries, wall_entries
    from pmpm.scene.needs import grid_geometry

    layers = grid_geometry(scene, needs).layers
    cuts = needs.periodic[needs.slab_axis] or min(ranks, room(layers, needs.stencil.window)) > 1
    gravity, damped = any(scene.domain.gravity), scene.method.damping > 0.0
    found = {label: law_entries(needs, watches_energy(scene)) for label in labels(needs.laws)}
    found["walls"] = wall_entries(needs)
    found["colliders"] = collider_entries(needs)
    found["shared"] = shared_entries(gravity, damped, cuts, needs.open, contact_entries(needs))
    return {who: names for who, names in found.items() if names}


def card_kernels(scene, needs, ranks=1):
    """{law, "walls", "nodes", "regroup": names of the kernels that a step or a regroup calls on a card, hence compiles}; see
    kernels.build_cuda."""
    from pmpm.kernels.build import contact_entries
    from pmpm.kernels.build_cuda import SORTING

    touching = ["p2g_volumes"] if needs.contact else []
    blended = ["p2g_before"] if needs.scheme.blends else []
    averaged = ["p2g_divergence", "measure_divergence"] if needs.f_bar else []
    guarded = ["sum_energies"] if watches_energy(scene) else []
    found = {label: ["p2g", "g2p", *blended, *touching, *averaged, *guarded] for label in labels(needs.laws)}
    walls = sorted(needs.wall_types)
    found["walls"] = [f"{part} {name}" for part in ("wall", "image") for name in walls]
    found["colliders"] = [f"collider {name}" for name in needs.collider_types]
    optional = {
        "add_gravity": any(scene.domain.gravity),
        "damp": scene.method.damping > 0.0,
        "sum_images": any(repeats for axis, repeats in enumerate(needs.periodic) if axis != needs.slab_axis),
        "copy": needs.scheme.blends or needs.f_bar or needs.contact,
        **dict.fromkeys(contact_entries(needs), True),
        "impose": bool(scene.motions or scene.inflows),
        "add_received": ranks > 1 or needs.periodic[needs.slab_axis],
        "clear_reals": needs.driven or bool(guarded),
    }
    always = ["mark", "clear", "divide_by_mass", "forget", "clear_words"]
    found["nodes"] = [*always, *(name for name, needed in optional.items() if needed)]
    found["regroup"] = list(SORTING)
    return {who: names for who, names in found.items() if names}


def left_out(scene, needs):
    """What this scene compiles and stores nothing for."""
    absent = [f"law {name}" for name in LAWS if name not in {law.model for law in needs.laws}]
    if not any("F" in law.state for law in needs.laws):
        absent.append("deformation gradient")
    if all(set(law.state) <= ELASTIC_STATE for law in needs.laws):
        absent.append("plastic state")
    carried = {name for law in needs.laws for name in needs.carried(law)}
    absent += [f"field {field.name}" for field in OPTIONAL if field.name not in carried]
    absent += [f"wall {name}" for name in ("stick", "slip", "separate", "friction") if name not in needs.wall_types]
    if not scene.colliders:
        absent.append("colliders")
    if not needs.contact:
        absent.append("contact")
    if needs.transfer == "mls":
        absent.append("weight gradients")
    if scene.dim == 2:
        absent.append("third dimension")
    return absent


def material_lines():
    """Text of `pmpm materials`."""
    lines = []
    for name, law in (LAWS | {"a Python function": python_law}).items():
        lines += [f"{name}: {(law.__doc__ or '').strip().splitlines()[0]}", f"    source: {law.SOURCE}"]
        lines += [f"    {key.name:20s} {key.unit:6s} {key.meaning}{default_text(key)}" for key in law.KEYS]
        kept = ", ".join(f"{field.name} ({field.meaning})" for field in law.STATE)
        lines += [f"    a particle keeps: {kept}", ""]
    return lines[:-1]


def default_text(key):
    if key.default is not None:
        return f"; default {key.default}" + ("; other values are not built yet" if key.only is not None else "")
    return "; optional" if key.optional else ""
