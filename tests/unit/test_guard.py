"""Runs that still compute but make no sense are stopped: steps that shrink without end, and energy out of nothing."""

import re

import numpy as np
import pytest

import pmpm
from pmpm import guard, readout
from pmpm.explain import explain
from pmpm.failure import NumericalFailure
from pmpm.parallel.comm import Alone
from pmpm.physics.words import cos, sin
from pmpm.run import run_scene
from pmpm.scene.errors import SceneError
from pmpm.scene.schema import ENERGY_GAIN
from pmpm.timestep import LAG, RECENT

RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
SNOW = {"model": "snow", "density": 400.0, "youngs_modulus": 1.4e5, "poisson_ratio": 0.2}
BLOCK = {"material": "m", "shape": {"type": "box", "min": [8.0, 8.0], "max": [16.0, 16.0]}}
STEP = 0.019  # s: 0.7 of the longest stable step of RUBBER


def scene(material=RUBBER, body=BLOCK, time=None, **parts):
    domain = {"size": [24.0, 24.0], "cell_size": 1.0} | parts.pop("domain", {})
    time = {"end": 100.0} | (time or {})
    return pmpm.Scene(domain=domain, time=time, materials={"m": material}, bodies=[body], **parts)


def stable_step(simulation):
    return min(simulation.control.bounds(simulation.drive.acceleration(simulation.time)))


# ---- the step ------------------------------------------------------------------------------------------------------------


def test_gravity_alone_moves_a_particle_at_rest_a_fifth_of_a_cell_in_the_first_step():
    # a dt^2 = 0.2 dx, where the wave, 36 m/s, would allow ten times as long a step.
    simulation = pmpm.Simulation(scene(domain={"gravity": [0.0, -1e5]}))
    simulation.step()
    assert simulation.dt == pytest.approx(np.sqrt(0.2 / 1e5), rel=1e-12)


def test_a_load_bounds_the_step_as_gravity_does():
    load = {"shape": BLOCK["shape"], "acceleration": [6e4, -8e4]}
    simulation = pmpm.Simulation(scene(loads=[load]))
    simulation.step()
    assert simulation.dt == pytest.approx(np.sqrt(0.2 / 1e5), rel=1e-12)


def rising(x, X, t):
    """1e5 m/s2 after a moment without."""
    return (1e5 * min(max(1e6 * (t - 0.02), 0.0), 1.0) + 0.0 * x[0], 0.0 * x[1])


@pytest.mark.parametrize("loops", ["lanes", "scalar"])
def test_a_body_force_that_sets_in_bounds_the_step_two_steps_later(loops, monkeypatch):
    monkeypatch.setenv("PMPM_LOOPS", loops)
    simulation = pmpm.Simulation(scene(body_force=rising, time={"cfl": 0.01}))
    while simulation.time < 0.02:
        simulation.step()
    assert simulation.control.bounds(0.0)[2] == np.inf
    simulation.run(steps=4)
    assert simulation.control.recent[3] == pytest.approx(1e5, rel=1e-9)
    assert simulation.control.bounds(0.0)[2] == pytest.approx(np.sqrt(0.2 / 1e5), rel=1e-9)


def steady(x, X, t):
    return (1e5 + 0.0 * x[0], 0.0 * x[1])


def test_a_body_force_bounds_the_first_step():
    simulation = pmpm.Simulation(scene(body_force=steady))
    simulation.step()
    assert simulation.dt == pytest.approx(np.sqrt(0.2 / 1e5), rel=1e-12)


def test_gravity_that_grows_bounds_the_step_as_far_as_it_has_grown():
    simulation = pmpm.Simulation(scene(domain={"gravity": [0.0, -1e5]}, time={"ramp": 1.0}))
    assert simulation.drive.acceleration(0.25) == pytest.approx(0.25e5)


@pytest.mark.parametrize("loops", ["lanes", "scalar"])
def test_no_particle_is_strained_by_more_than_a_tenth_in_a_step(loops, monkeypatch):
    monkeypatch.setenv("PMPM_LOOPS", loops)
    simulation = pmpm.Simulation(scene(method={"transfer": "mls"}))  # whose velocity gradient is C
    C = np.zeros((len(simulation.particles.id), 2, 2))
    C[7] = [[300.0, 0.0], [0.0, -400.0]]
    simulation.particles.C = C
    simulation.step()
    assert simulation.dt == pytest.approx(0.1 / 500.0, rel=1e-12)


@pytest.mark.parametrize("loops", ["lanes", "scalar"])
def test_the_largest_strain_rate_of_the_last_steps_bounds_the_step(loops, monkeypatch):
    monkeypatch.setenv("PMPM_LOOPS", loops)
    simulation = pmpm.Simulation(scene(method={"transfer": "mls"}))
    C = np.zeros((len(simulation.particles.id), 2, 2))
    C[7] = [[300.0, 0.0], [0.0, -400.0]]
    simulation.particles.C = C
    rates = [500.0]  # after step 0, 1, ...
    for step in range(1, 3 * RECENT):
        simulation.step()
        rates.append(np.sqrt(np.square(simulation.particles.C).sum(axis=(1, 2)).max()))
        told = max(step - LAG, 0)  # all know of this one
        blocks = [max(rates[first : min(first + RECENT, told + 1)]) for first in range(0, told + 1, RECENT)]
        kept = [500.0]  # until there are others, the state at the start counts twice
        for largest in blocks[:-1]:
            kept.append(largest if largest < 0.95 * kept[-1] else max(largest, kept[-1]))
        assert simulation.control.recent[2] == pytest.approx(max(kept[-1], blocks[-1]), rel=1e-12)
    assert simulation.control.recent[2] < 100.0


def test_a_bound_stays_until_it_has_changed_by_more_than_a_twentieth():
    control = pmpm.Simulation(scene()).control
    bounds = []
    for step, speed in enumerate(
        [*[1.0] * RECENT, *[0.97] * RECENT, *[0.96] * RECENT, *[0.9] * (2 * RECENT), 1.1], RECENT
    ):
        control.learn(step, [speed**2, 0.0, 0.0, 0.0, 0.0])
        bounds.append(control.recent[0])
    assert bounds[: 4 * RECENT] == [1.0] * (4 * RECENT)  # at 0.96, too, and until 0.9 has been all for RECENT steps
    assert bounds[4 * RECENT : -1] == pytest.approx([0.9] * RECENT)
    assert bounds[-1] == pytest.approx(1.1)


@pytest.mark.parametrize("transfer", ["apic", "mls"])
def test_a_compressed_particle_of_water_alone_swings_and_stays_whole(transfer):
    water = {"model": "fluid", "density": 1000.0, "sound_speed": 10.0, "tension_cutoff": False}
    drop = {"material": "m", "shape": {"type": "box", "min": [8.0, 8.0], "max": [9.0, 9.0]}, "particles_per_cell": 1}
    simulation = pmpm.Simulation(scene(water, drop, method={"transfer": transfer}))
    simulation.particles.J = np.full(len(simulation.particles.id), 0.5)
    simulation.run(steps=1000)
    assert 0.4 < simulation.particles.J[0] < 30.0


# ---- a step of one's own -------------------------------------------------------------------------------------------------


def test_a_fixed_step_beyond_the_stable_one_is_refused_and_the_message_says_how_to_force_it():
    with pytest.raises(SceneError, match="longer than the stable step of .*time.force_step = true"):
        pmpm.Simulation(scene(time={"step": 2.0 * STEP}))


def test_a_forced_step_is_taken_with_a_warning():
    simulation = pmpm.Simulation(scene(time={"step": 2.0 * STEP, "force_step": True}))
    simulation.step()
    assert simulation.dt == 2.0 * STEP
    assert [note for note in simulation.notes if note.startswith("warning: time.step = 0.038 s is longer")]


def test_a_stable_step_is_taken_without_a_warning():
    assert not pmpm.Simulation(scene(time={"step": STEP, "force_step": True})).notes


@pytest.mark.parametrize(
    ("time", "complaint"),
    [
        ({"force_step": True}, "time.force_step = true belongs to a fixed step"),
        ({"step": 1e-3, "smallest_step": 1e-9}, "time.smallest_step = 1e-09 s belongs to steps that follow from cfl"),
    ],
)
def test_keys_of_the_other_kind_of_step_are_refused(time, complaint):
    with pytest.raises(SceneError, match=re.escape(complaint)):
        scene(time=time)


# ---- steps that shrink without end -----------------------------------------------------------------------------------------


def crushed(J_P, **time):
    """Snow of which one particle has been crushed: it stiffens by exp(xi (1 - J_P))."""
    simulation = pmpm.Simulation(scene(SNOW | {"hardening": 50.0}, time=time))
    J = np.ones(len(simulation.particles.id))
    J[7] = J_P
    simulation.particles.J_P = J
    return simulation, int(simulation.particles.id[7])


def test_a_run_whose_steps_shrink_without_end_stops_and_names_cause_and_particle():
    # exp(50 * 0.7 / 2) = 4e7 times as fast waves.
    simulation, culprit = crushed(0.3)
    with pytest.raises(NumericalFailure) as failure:
        simulation.run(steps=10)
    text = str(failure.value)
    assert re.match(rf"step \d+, t = \S+ s, rank 0: particle {culprit} of material m at \(", text)
    assert "the stable step, " in text
    assert "is below time.smallest_step (not given: 0.0001 of the first step)" in text
    assert "waves run at" in text


def test_hardening_within_the_bounds_goes_on():
    # exp(50 * 0.3 / 2) = 1800 times as fast: a step of 5e-4 of the first.
    simulation, _ = crushed(0.7)
    simulation.run(steps=10)
    assert simulation.dt < 1e-3 * simulation.smallest_step / guard.CRAWL


def test_a_floor_of_ones_own_takes_the_place_of_the_default():
    simulation, _ = crushed(0.7, smallest_step=1e-3)
    with pytest.raises(NumericalFailure, match=r"below time.smallest_step = 0.001 s"):
        simulation.run(steps=10)


# ---- energy out of nothing -------------------------------------------------------------------------------------------------


def shaking(step_ratio, guarded, transfer="apic", end=100.0, **parts):
    """A block that vibrates a little with steps so many times the stated bound: at 1.4 noise grows by a tenth per step."""
    probe = stable_step(pmpm.Simulation(scene()))
    time = {"step": step_ratio * probe, "force_step": True, "end": end}
    simulation = pmpm.Simulation(scene(time=time, guard=guarded, method={"transfer": transfer}, **parts))
    x = simulation.particles.x - 12.0
    simulation.particles.v = 0.01 * np.sin(np.pi * x / 8.0)
    return simulation


def test_energy_out_of_nothing_stops_the_run_within_the_interval_of_forced_steps():
    simulation = shaking(1.4, {})
    with pytest.raises(NumericalFailure) as failure:
        simulation.run(steps=400)
    text = str(failure.value)
    grown = int(re.search(r"out of nothing by step (\d+), more than guard.energy_gain = 0.3 of the", text).group(1))
    assert grown % guard.BEYOND_INTERVAL == 0
    assert simulation.step_count == grown + 2
    assert re.match(rf"step {grown + 3}, t = \S+ s, rank 0: particle \d+ of material m at \(", text)


def test_without_the_guard_the_same_run_goes_wrong_in_silence():
    simulation = shaking(1.4, {"energy_gain": 0.0})
    started = readout.total_energy(simulation.measure())
    simulation.run(steps=400)
    assert readout.total_energy(simulation.measure()) > 100.0 * started


@pytest.mark.parametrize(("ratio", "looks"), [(0.9, 1), (1.1, 12)])
def test_steps_beyond_the_stable_one_are_looked_at_more_often(ratio, looks, monkeypatch):
    simulation, judged = shaking(ratio, {"interval": 90}), []
    monkeypatch.setattr(simulation.energy_watch, "judge", lambda simulation, step, sums: judged.append(step))
    simulation.run(steps=100)
    assert len(judged) == looks


def created(simulation, steps):
    """The largest part of what moves that comes out of nothing."""
    watch, worst = simulation.energy_watch, 0.0
    for _ in range(steps):
        simulation.step()
        sums = watch.sums(simulation)
        watch.active = max(watch.active, int(sums[:2].sum()))
        worst = max(worst, (int(sums[:3].sum() - sums[3]) - watch.first) / watch.active)
    return worst


@pytest.mark.parametrize("transfer", ["apic", "flip"])
def test_a_stable_run_stays_far_from_the_guard(transfer):
    # At 0.9 of the stated bound: 0.127 of FLIP. Symplectic Euler lets the energy of a wave swing by omega dt / 2.
    assert created(shaking(0.9, {}, transfer), 300) < 0.5 * ENERGY_GAIN


def test_the_guard_sums_the_energies_that_are_measured():
    simulation = pmpm.Simulation(scene(domain={"gravity": [1.0, -9.0]}))
    simulation.particles.v = 0.1 * np.random.default_rng(0).normal(size=simulation.particles.v.shape)
    simulation.run(steps=20)
    measured = simulation.measure()
    expected = [measured[name] for name in ("kinetic", "strain", "potential")]
    assert simulation.energies().sum(axis=0) == pytest.approx(expected, rel=1e-9)  # strains of 1e-4 cost digits


def test_a_fall_creates_nothing():
    body = BLOCK | {"velocity": [1.0, 0.0]}
    simulation = pmpm.Simulation(scene(body=body, domain={"gravity": [0.0, -9.0]}))
    assert created(simulation, 50) < 1e-3


def swaying(x, X, t):
    return (50.0 * sin(3.0 * t) + 0.0 * x[0], 20.0 * cos(X[0]))


@pytest.mark.parametrize("loops", ["lanes", "scalar"])
def test_the_work_of_body_force_and_loads_is_known(loops, monkeypatch):
    monkeypatch.setenv("PMPM_LOOPS", loops)
    load = {"shape": {"type": "box", "min": [8.0, 8.0], "max": [10.0, 16.0]}, "acceleration": [-30.0, 10.0]}
    simulation = pmpm.Simulation(scene(body_force=swaying, loads=[load], time={"cfl": 0.1}))
    gained = readout.total_energy(simulation.measure())
    simulation.run(steps=300)
    gained = readout.total_energy(simulation.measure()) - gained
    work = simulation.energy_watch.work * simulation.energy_watch.unit
    # What is missing is what the transfers lose: nothing is gained.
    assert 0.9 * work < gained < work


def test_a_run_of_few_steps_is_looked_at_when_it_ends():
    probe = stable_step(pmpm.Simulation(scene()))
    simulation = shaking(1.45, {"interval": 1000}, end=21.5 * 1.45 * probe)
    with pytest.raises(NumericalFailure, match="out of nothing by step 22"):
        simulation.run()


def trembling(x, X, t):
    return (0.05 * sin(3.0 * t) + 0.0 * x[0], 0.0 * x[1])


def test_a_forced_run_that_creates_energy_stops():
    simulation = shaking(1.4, {"interval": 10}, body_force=trembling)
    with pytest.raises(NumericalFailure, match="out of nothing"):
        simulation.run(steps=400)


def moved(t):
    return (0.1, 0.0)


@pytest.mark.parametrize(
    ("parts", "work"),
    [
        ({"motions": [{"shape": BLOCK["shape"], "velocity": [1.0, 0.0]}]}, "motions"),
        ({"domain": {"walls": {"x_min": {"type": "slip", "velocity": [0.1, 0.0]}}}}, "the moving wall x_min"),
        ({"domain": {"periodic": ["y"], "gravity": [0.0, -1.0]}}, "gravity along the periodic axis y"),
    ],
)
def test_where_work_is_unknown_energy_is_not_watched_and_check_says_so(parts, work):
    told = scene(**parts)
    assert pmpm.Simulation(told).energy_watch is None
    assert f"guard         energy not watched: nobody adds up the work of {work}" in explain(told, 1)


def test_a_scene_that_is_not_watched_compiles_no_energies():
    assert "energies" in explain(scene(), 1)
    assert "energies" not in explain(scene(guard={"energy_gain": 0.0}), 1).split("compiled kernels")[1]


def test_a_restart_watches_on_where_the_run_stopped(tmp_path):
    whole = shaking(1.4, {"interval": 10})
    with pytest.raises(NumericalFailure) as expected:
        whole.run(steps=400)
    part = shaking(1.4, {"interval": 10})
    part.run(steps=11)  # one sum is on its way
    part.save(tmp_path / "half.hdf")
    rest = pmpm.Simulation.restart(tmp_path / "half.hdf")
    with pytest.raises(NumericalFailure) as found:
        rest.run(steps=400)
    assert str(found.value) == str(expected.value)


def test_the_failed_state_and_the_newest_checkpoint_are_named(tmp_path):
    step = 1.4 * stable_step(pmpm.Simulation(scene()))
    made = scene(time={"step": step, "force_step": True}, output={"checkpoint_interval": 0.5},
                 body=BLOCK | {"velocity": lambda X: 0.01 * np.sin(np.pi * (X - 12.0) / 8.0)})  # fmt: skip
    with pytest.raises(NumericalFailure, match=r"its state is in .*failed.hdf; the newest good checkpoint is .*\.hdf"):
        run_scene(made, tmp_path / "run", Alone(), quiet=True)


def test_a_run_that_crushes_material_to_nothing_says_so_at_its_end():
    simulation = pmpm.Simulation(scene(RUBBER | {"model": "fixed_corotated"}))
    assert simulation.closing_notes == []
    F = np.tile(np.eye(2), (len(simulation.particles.id), 1, 1))
    F[:3] = [[1e-5, 0.0], [0.0, 1.0]]
    F[3] = [[-1e-7, 0.0], [0.0, 1.0]]
    simulation.particles.F = F
    assert simulation.closing_notes == [
        "warning: 4 particles of m are crushed below 1% of their volume, down to J = 1e-07: more than the law can carry"
    ]
