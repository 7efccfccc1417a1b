"""Particles are moved in groups of layers: in little memory, in the same order, into room that grows."""

import gc
import platform
from pathlib import Path

import numpy as np
import pytest
import several_laws

import pmpm
from pmpm.state import memory, particles
from pmpm.state.assembly import Growing
from pmpm.state.particles import LANES, layer_groups

STATUS, REFS = Path("/proc/self/status"), Path("/proc/self/clear_refs")
WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 15.0}


def everything(simulation):
    """Bytes of all particles in their order."""
    return [p.reals.tobytes() + p.id.tobytes() + p.segments.tobytes() for p in simulation.populations]


def filled(rows, first):
    """Blocks of one real, numbered from `first` on."""
    return np.arange(first, first + rows, dtype=np.float64)[:, None, None] * np.ones((1, 1, LANES))


@pytest.mark.parametrize("scene", [several_laws.flat, several_laws.deep, several_laws.tall])
def test_the_size_of_groups_changes_no_bit(scene, monkeypatch):
    """Groups of one layer, by one thread and several at a time, against all layers in one: seeded, sorted twice, moved by hand
    over a periodic axis."""
    found = []
    for size, threads in ((1, 1), (1, 3), (200, 2), (1 << 40, 1)):
        monkeypatch.setattr(particles, "GROUP", size)
        simulation = pmpm.Simulation(scene(), threads=threads)
        seeded = everything(simulation)
        simulation.run(steps=12)
        simulation.regroup()
        slab = simulation.geometry.axes[0]
        x = simulation.particles.x
        if simulation.geometry.periodic[slab]:
            x[:, slab] = (x[:, slab] + 0.37) % scene().domain.size[slab]
        simulation.particles.x = x
        simulation.run(steps=12)
        found.append([seeded, everything(simulation), simulation.measure()])
    assert all(other == found[0] for other in found[1:])


def test_groups_cover_all_layers_once_and_hold_no_more_than_a_group_or_a_layer():
    """Counts beyond 32 bits: sums are of 64."""
    counts = np.array([0, 3, 1 << 15, 1 << 33, 0, 1 << 15, 1 << 15, 1, 0])
    groups = list(layer_groups(counts, 5))
    assert groups == [(5, 8), (8, 9), (9, 12), (12, 14)]


def test_no_layers_are_one_group_of_nothing():
    assert list(layer_groups(np.zeros(0, np.int64), 7)) == [(7, 7)]


def test_blocks_beyond_the_room_keep_those_before():
    rest = np.zeros(1)
    growing = Growing(0, 50, rest, 0)
    for layer in range(50):
        segment = np.array([[0, 16 * 40, 0, 0, 0]])
        begin = growing.take(segment, np.array([0, 1]), layer, 40)
        growing.reals[begin : growing.used], growing.id[begin : growing.used] = filled(40, 40 * layer), layer
    whole = growing.whole()
    assert np.array_equal(whole.reals, filled(2000, 0))
    assert (whole.id[:, 0].tolist(), len(whole)) == ([n // 40 for n in range(2000)], 32000)
    assert whole.segments[:, 0].tolist() == list(range(0, 2000, 40))


def test_rows_that_move_into_wider_room_arrive_whole():
    """Of 40 MB, in ten pieces that are given back one after another."""
    rows = memory.room(10**6, (5,), np.float64)
    rows[:] = np.arange(5e6).reshape(-1, 5)
    wider = memory.moved(rows, 999_999, 1_100_000)
    assert np.array_equal(wider[:999_999], np.arange(5e6 - 5).reshape(-1, 5))


@pytest.fixture
def two_rooms():
    """Twelve MB of numbers and as many zeros, by large pages within: (numbers, zeros, first and last address, another one)."""
    numbers, zeros = memory.room(3, (1 << 19,), np.float64), memory.room(3, (1 << 19,), np.float64)
    numbers[:], zeros[:] = np.arange(3 << 19).reshape(3, -1), 0.0
    first = memory.upwards(numbers.ctypes.data)
    return numbers, zeros, first, first + 2 * memory.PAGE, memory.upwards(zeros.ctypes.data)


@pytest.mark.skipif(platform.system() != "Linux", reason="only Linux hands pages on")
def test_pages_are_handed_on_with_what_they_hold(two_rooms):
    numbers, zeros, first, last, there = two_rooms
    begin, count = (first - numbers.ctypes.data) // 8, (last - first) // 8
    assert memory.hand_on(first, last, there) == last
    found = zeros.reshape(-1)[(there - zeros.ctypes.data) // 8 :][:count]
    assert np.array_equal(found, np.arange(begin, begin + count))
    assert not numbers.reshape(-1)[begin : begin + count].any()
    assert numbers.reshape(-1)[begin - 1] == begin - 1
    assert numbers.reshape(-1)[begin + count] == begin + count


def test_where_pages_cannot_be_handed_on_both_places_stay_usable(two_rooms, monkeypatch):
    monkeypatch.setattr(memory, "HAND_ON", 1 << 20)
    numbers, zeros, first, last, there = two_rooms
    assert memory.hand_on(first, last, there) == first
    assert np.array_equal(numbers.reshape(-1), np.arange(3 << 19))
    zeros[:] = 1.0
    assert zeros.sum() == 3 << 19


def test_room_begins_a_cache_line():
    assert {memory.room(n, (3, 16), np.float32).ctypes.data % 64 for n in range(1, 20)} == {0}


@pytest.mark.skipif(not REFS.exists(), reason="only Linux tells the largest size of a process anew")
def test_a_regroup_takes_a_quarter_of_the_particles_bytes_at_most(monkeypatch):
    """1.3 million particles of 72 bytes: 92 MB, of which a second copy would be all; in small groups and pieces."""
    monkeypatch.setattr(particles, "GROUP", 1 << 13)
    monkeypatch.setattr(memory, "PIECE", memory.PAGE)
    simulation = pmpm.Simulation(
        pmpm.Scene(
            domain={"size": [12.0, 0.5, 0.5], "cell_size": 0.025},
            method={"precision": "float32"},
            time={"end": 1.0},
            materials={"water": WATER},
            bodies=[
                {
                    "material": "water",
                    "shape": {"type": "box", "min": [0.0] * 3, "max": [10.0, 0.5, 0.5]},
                    "particles_per_cell": 8,
                }
            ],
        )
    )
    simulation.regroup()
    gc.collect()
    REFS.write_text("5")
    before = size("VmRSS")
    simulation.regroup()
    assert size("VmHWM") - before < 0.25 * simulation.nbytes


def size(name):
    """Bytes of this process."""
    return 1024 * next(int(line.split()[1]) for line in STATUS.read_text().splitlines() if line.startswith(name))
