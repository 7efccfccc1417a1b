"""Explain without running: what a scene will cost and what it leaves out, and which materials there are."""

import math

import numpy as np

from pmpm.kernels.needs import labels
from pmpm.parallel.slabs import room
from pmpm.physics import stability
from pmpm.physics.materials import LAWS, python_law
from pmpm.scene import seeding, start
from pmpm.scene.errors import SceneError
from pmpm.state.derived import PARAMETERS
from pmpm.state.fields import OPTIONAL, Layout
from pmpm.timestep import MOVE

ELASTIC_STATE = {"F", "J", "hencky_strain", "elastic_strain"}
ID_BYTES = 8


def explain(scene, ranks):
    """Text of `pmpm check`: particles, memory per rank, time step, what particles hold, which kernels there are, and what was
    left out. Raises SceneError."""
    from pmpm.scene.needs import grid_geometry, law_table, scene_needs

    needs = scene_needs(scene)
    geometry = grid_geometry(scene, needs)
    counts = seeding.count_per_layer(scene, geometry, 0, geometry.layers)
    for number, count in enumerate(counts.sum(axis=1)):
        if count == 0:
            raise SceneError(f"scene: bodies[{number}] holds no particle")
    total = int(counts.sum())
    real_bytes = np.dtype(needs.precision).itemsize
    held = bytes_per_particle(needs)
    of_body = [needs.laws.index(law_of_body(scene, body)) for body in scene.bodies]
    particle_bytes = sum(
        int(count) * sum(held[law].values()) for law, count in zip(of_body, counts.sum(axis=1), strict=True)
    )
    nodes = math.prod(geometry.extent(axis) for axis in range(scene.dim))
    dt = estimated_step(scene, needs, [law_table(scene, law) for law in needs.laws])
    steps = math.ceil(scene.time.end / dt)
    lines = [
        f"title         {scene.title or '-'}",
        f"dimension     {scene.dim}-D{' plane strain' if scene.dim == 2 else ''}, {' x '.join(map(str, scene.cells))} cells "
        f"of {scene.domain.cell_size:g} m, slabs across {'xyz'[geometry.axes[0]]}",
        f"particles     {total} in {len(scene.bodies)} bodies, {total // max(ranks, 1)} per rank on {ranks} ranks",
        f"memory        about {particle_bytes / ranks / 1e6:.1f} MB of particles and "
        f"{nodes * 4 * real_bytes / ranks / 1e6:.1f} MB of grid per rank",
        f"time step     {dt:.3g} s at the start{' (fixed)' if scene.time.step else f', cfl {scene.time.cfl:g}'}",
        f"cost          about {steps} steps, {steps * total:.3g} particle-steps",
        f"ranks         room for {geometry.layers // geometry.stencil.window or 1}",
        f"method        {scene.method.transfer}, {scene.method.shape_function} splines, {scene.method.precision}",
        f"laws          {', '.join(law_text(law) for law in needs.laws)}",
        f"left out      {', '.join(left_out(scene, needs)) or 'nothing'}",
        "bytes of a particle",
        *aligned(byte_rows(needs)),
        "compiled kernels",
        *(f"  {who:20s} {', '.join(names)}" for who, names in compiled_kernels(scene, needs, ranks).items()),
    ]
    return "\n".join(lines)


def law_text(law):
    return f"{law.model} (keeps {', '.join(law.state)})"


def law_of_body(scene, body):
    """The LawNeeds of a body's material."""
    from pmpm.kernels.needs import law_needs

    material = scene.materials[body.material]
    return law_needs(material.model, material.parameters)


def bytes_per_particle(needs):
    """Of each law {field: bytes that a particle holds of it}, the id included: there is nothing else per particle."""
    layouts = [Layout.of(law, needs.dim, needs.carried(law)) for law in needs.laws]
    real = np.dtype(needs.precision).itemsize
    return [{f.name: f.size(needs.dim) * real for f in layout.fields} | {"id": ID_BYTES} for layout in layouts]


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
    from pmpm.kernels.build import law_entries, shared_entries, wall_entries
    from pmpm.scene.needs import grid_geometry

    layers = grid_geometry(scene, needs).layers
    cuts = needs.periodic[needs.slab_axis] or min(ranks, room(layers, needs.stencil.window)) > 1
    gravity, damped = any(scene.domain.gravity), scene.method.damping > 0.0
    found = {label: law_entries(needs) for label in labels(needs.laws)}
    found["walls"] = wall_entries(needs)
    found["shared"] = shared_entries(gravity, damped, cuts)
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
    if needs.transfer == "mls":
        absent.append("weight gradients")
    if scene.dim == 2:
        absent.append("third dimension")
    return absent


def estimated_step(scene, needs, tables):
    """The first time step in s, from the undeformed wave speeds."""
    if scene.time.step is not None:
        return scene.time.step
    from pmpm.kernels import targets

    dx, wave = scene.domain.cell_size, 0.0
    for law, table in zip(needs.laws, tables, strict=True):
        target = targets.plain(la=needs.tensors, law=law.module, **dict(law.choices))
        identity = tuple(map(float, np.eye(scene.dim).ravel()))
        for row in table[table[:, 0] > 0]:
            params = tuple(row[PARAMETERS:])
            rest = target.compile(law.module.state_at)(identity, params)
            wave = max(wave, target.compile(stability.signal_speed_squared)(rest, params, row[2], 1.0 / dx))
    wave = math.sqrt(wave)
    speed = max(start.largest_speed(body, scene.dim) for body in scene.bodies)
    return min(scene.time.cfl * dx / (wave * math.sqrt(scene.dim)), MOVE * dx / speed if speed > 0 else math.inf)


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
