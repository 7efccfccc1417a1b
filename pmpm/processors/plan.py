"""What a graphics card would run and compile, found without one: a step of a simulation whose kernels are noted, not run."""

from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np

from pmpm.kernels.spans import FULL, QUADS
from pmpm.processors.cuda import Cuda


class Held(np.ndarray):
    """An array in the place of one on the card."""

    def copy_to_host(self, there=None, stream=None):
        if there is None:
            return np.array(self)
        there[...] = self
        return there

    def copy_to_device(self, values, stream=None):
        self[...] = values


class Nothing:
    """A stream or an event of a card that is not there."""

    def synchronize(self):
        pass

    def record(self, stream):
        pass

    def wait(self, stream):
        pass


class NoCard:
    """What gives memory in the place of a card."""

    stream = Nothing
    event = Nothing
    pinned_array = staticmethod(np.zeros)
    to_device = staticmethod(lambda array: np.array(array).view(Held))
    device_array = staticmethod(lambda shape, dtype: np.zeros(shape, dtype).view(Held))


class Plan(Cuda):
    """The processor of a simulation that only notes which kernels run on which types: {name: Noted}."""

    card = NoCard

    def __init__(self, simulation):
        self.noted: dict[str, Noted] = {}
        super().__init__(simulation)

    def mark(self, marks, slack):
        """All nodes: nobody has looked where particles are."""
        super().mark(marks, slack)
        full = (1 << self.patch.row_quads) - 1
        marks[...] = [(full >> QUADS * word) & FULL for word in range(marks.shape[2])]

    def launch(self, kernel, count, *arguments):
        name = next(name for name, entry in self.on_card.entries.items() if entry is kernel)
        types = tuple(numba.typeof(np.asarray(a) if isinstance(a, np.ndarray) else a) for a in arguments)
        self.noted.setdefault(name, Noted(name, kernel.py_func, types))


@dataclass(frozen=True)
class Noted:
    """A kernel and the types of its arguments."""

    name: str
    function: Any
    types: tuple

    def ptx(self, capability):
        """PTX for a compute capability (major, minor). Needs no card, but NVIDIA's compiler (the extra `cuda`)."""
        from numba import cuda

        with pretended_card(capability):
            return cuda.compile_ptx(self.function, numba.void(*self.types), device=False, cc=capability)[0]


@contextmanager
def pretended_card(capability):
    """numba asks the card for nothing but its compute capability when one function of a kernel calls another."""
    from numba.cuda import dispatcher

    original = dispatcher.get_current_device
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=capability)
    try:
        yield
    finally:
        dispatcher.get_current_device = original


def kernels_of(scene):
    """The Noted of a step of a scene."""
    from pmpm.simulation import Simulation

    simulation = Simulation(scene, backend="plan")
    simulation.step()
    simulation.energies()
    simulation.regroup()
    return list(simulation.processor.noted.values())
