"""A field may be asked for of a law that no body has: it is there, and not a number."""

import numpy as np
import several_laws

from pmpm.simulation import Simulation


def test_a_state_that_no_particle_keeps_is_not_a_number():
    simulation = Simulation(several_laws.short())
    found = simulation.fields(["hencky_strain", "v_c"])
    assert (found["hencky_strain"].shape, found["v_c"].shape) == ((simulation.rows(), 3), (simulation.rows(),))
    assert np.isnan(found["hencky_strain"]).all()
