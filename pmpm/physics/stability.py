"""How fast a particle's material carries signals, from which the stable time step follows.

A wave that symplectic Euler follows at omega dt < 2 is damped by viscosity at the rate r = 4/3 nu k^2; the step is stable for
2 r dt + (omega dt)^2 < 4 (Jury's criterion for the two roots). With the grid's omega = 2 c sqrt(d) / dx and k^2 = 4 d / dx^2
both bounds become one, that of a wave of speed a + sqrt(a^2 + c^2), a = 4/3 nu sqrt(d) / dx.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.materials import neo_hookean as law
from pmpm.physics.words import sqrt

VISCOUS = False


def signal_speed_squared(state, params, density, inv_dx):
    """Square of the wave speed that bounds the step, m2/s2."""
    wave = law.wave_speed_squared(state, params, density)
    if VISCOUS:
        a = (4.0 / 3.0) * sqrt(la.DIM) * inv_dx * law.kinematic_viscosity(state, params, density)
        speed = a + sqrt(a * a + wave)
        return speed * speed
    return wave
