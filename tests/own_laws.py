"""Laws of one's own with a state, for tests: neo-Hookean rubber that loses its stiffness as it is strained."""

import pmpm
from pmpm.physics import tensors2 as la
from pmpm.physics.words import exp, log

SMALLEST = 1e-10


def stored(F, mu, lam):
    """Energy of the undamaged solid, J/m3."""
    log_J = log(max(la.det(F), SMALLEST))
    return 0.5 * mu * (la.trace_symmetric(la.left_cauchy_green(F)) - la.DIM) + (0.5 * lam * log_J - mu) * log_J


def stress(F, damage, mu, lam):
    whole = la.scale_plus_diagonal(mu, la.left_cauchy_green(F), lam * log(max(la.det(F), SMALLEST)) - mu)
    return la.scale_plus_diagonal(1.0 - damage, whole, 0.0)


def grow(F, G, dt, damage, most, mu, lam, strength=1e3):
    """Damage after a step, which never heals; and the largest load (energy over strength) and the time so far."""
    F = la.add(F, la.matmul(G, F))
    load = stored(F, mu, lam) / strength
    return F, max(damage, 1.0 - exp(-load)), (max(most[0], load), most[1] + dt)


def energy(F, damage, mu, lam):
    return (1.0 - damage) * stored(F, mu, lam)


def unbroken(F, damage):
    return damage < 1.0


BREAKING = pmpm.Law(
    stress, advance=grow, energy=energy, valid=unbroken, state={"damage": 0.0, "most": (0.0, 0.0)}, name="breaking"
)
MATERIAL = {"model": BREAKING, "density": 1000.0, "mu": 400.0, "lam": 600.0}


def scene(dim=2, **more):
    """A ball that hits a wall and breaks; in 3-D and 2-D."""
    return pmpm.Scene(
        domain={"size": [0.8] + [0.4] * (dim - 1), "cell_size": 0.04, "walls": {"x_min": "slip"}},
        time={"end": 0.2},
        materials={"glass": MATERIAL},
        bodies=[
            {
                "material": "glass",
                "shape": {"type": "sphere", "center": [0.4] + [0.2] * (dim - 1), "radius": 0.13},
                "velocity": [-2.5] + [0.3] * (dim - 1),
            }
        ],
        **more,
    )
