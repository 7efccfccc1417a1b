"""Explain without running: what a scene will cost and what it leaves out, and which materials there are."""

import math

import numpy as np

from pmpm.physics import stability
from pmpm.physics.materials import LAWS, python_law
from pmpm.scene import seeding, start
from pmpm.scene.errors import SceneError
from pmpm.state.derived import PARAMETERS
from pmpm.state.fields import Layout
from pmpm.timestep import MOVE

ELASTIC_STATE = {"F", "J", "hencky_strain", "elastic_strain"}


def explain(scene, ranks):
    """Text of `pmpm check`: particles, memory per rank, time step, and what was left out. Raises SceneError."""
    from pmpm.scene.needs import grid_geometry, law_table, scene_needs

    needs = scene_needs(scene)
    geometry = grid_geometry(scene, needs)
    counts = seeding.count_per_layer(scene, geometry, 0, geometry.layers)
    for number, count in enumerate(counts.sum(axis=1)):
        if count == 0:
            raise SceneError(f"scene: bodies[{number}] holds no particle")
    total = int(counts.sum())
    real_bytes = np.dtype(needs.precision).itemsize
    layouts = [Layout.of(law, scene.dim, needs.carried(law)) for law in needs.laws]
    per_particle = max(layout.size for layout in layouts) * real_bytes + 8
    nodes = math.prod(geometry.extent(axis) for axis in range(scene.dim))
    dt = estimated_step(scene, needs, [law_table(scene, law) for law in needs.laws])
    steps = math.ceil(scene.time.end / dt)
    lines = [
        f"title         {scene.title or '-'}",
        f"dimension     {scene.dim}-D{' plane strain' if scene.dim == 2 else ''}, {' x '.join(map(str, scene.cells))} cells "
        f"of {scene.domain.cell_size:g} m, slabs across {'xyz'[geometry.axes[0]]}",
        f"particles     {total} in {len(scene.bodies)} bodies, {total // max(ranks, 1)} per rank on {ranks} ranks",
        f"memory        about {total * per_particle / ranks / 1e6:.1f} MB of particles and "
        f"{nodes * 4 * real_bytes / ranks / 1e6:.1f} MB of grid per rank",
        f"time step     {dt:.3g} s at the start{' (fixed)' if scene.time.step else f', cfl {scene.time.cfl:g}'}",
        f"cost          about {steps} steps, {steps * total:.3g} particle-steps",
        f"ranks         room for {geometry.layers // geometry.stencil.window or 1}",
        f"method        {scene.method.transfer}, {scene.method.shape_function} splines, {scene.method.precision}",
        f"laws          {', '.join(law_text(law) for law in needs.laws)}",
        f"left out      {', '.join(left_out(scene, needs)) or 'nothing'}",
    ]
    return "\n".join(lines)


def law_text(law):
    return f"{law.model} (keeps {', '.join(law.state)})"


def left_out(scene, needs):
    """What this scene compiles and stores nothing for."""
    absent = [f"law {name}" for name in LAWS if name not in {law.model for law in needs.laws}]
    if not any("F" in law.state for law in needs.laws):
        absent.append("deformation gradient")
    if all(set(law.state) <= ELASTIC_STATE for law in needs.laws):
        absent.append("plastic state")
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
