"""S7: bars that hit a wall, or each other, at up to five times their wave speed."""

from .judge import follow
from .matrix import STOPPED, SURVIVES, Case
from .scenes import box, simulation, solid

LENGTH, HEIGHT = 40.0, 6.0  # cells of 1 m; wave speed 1 m/s, density 1
SPEEDS = (0.1, 0.5, 0.9, 1.1, 2.0, 5.0)
MODULUS = 1.3 * 0.4 / 0.7  # Pa, of a wave speed of 1 m/s at nu = 0.3
LAWS = {
    "neo_hookean": solid(density=1.0, youngs_modulus=MODULUS),
    "fixed_corotated": solid("fixed_corotated", density=1.0, youngs_modulus=MODULUS),
    "hencky": solid("hencky", density=1.0, youngs_modulus=MODULUS),
    "fluid": {"model": "fluid", "density": 1.0, "sound_speed": 1.0},
}
VARIANTS = tuple(f"{law}, V/c={speed:g}" for law in LAWS for speed in SPEEDS)
# Bounded stress at F -> 0: fixed corotated solids have no shock for V >= c, and turn inside out; Hencky's stress falls back to
# zero there.
EXPECT = {v: SURVIVES + STOPPED for v in VARIANTS if "neo" not in v and "fluid" not in v}


def run_until_passed(scheme, variant, bodies, walls):
    law, speed = variant.split(", V/c=")
    run = simulation(scheme, [80.0, HEIGHT], 1.0, bodies(float(speed)), LAWS[law], periodic=["y"], walls=walls)
    found = follow(run, until=LENGTH, invertible=law == "fixed_corotated")
    J = run.particles.J
    found.numbers = {"smallest J": float(J.min()), "largest J": float(J.max())}
    return found


def wall(scheme, variant):
    def bodies(speed):
        return [box([0.0, 0.0], [LENGTH, HEIGHT], velocity=[-speed, 0.0])]

    return run_until_passed(scheme, variant, bodies, {"x_min": "separate"})


def head_on(scheme, variant):
    def bodies(speed):
        return [
            box([20.0, 0.0], [40.0, HEIGHT], velocity=[speed, 0.0]),
            box([40.0, 0.0], [60.0, HEIGHT], velocity=[-speed, 0.0]),
        ]

    return run_until_passed(scheme, variant, bodies, {})


CASES = (
    Case("S7", "wall", "a bar of 40 cells hits a wall", VARIANTS, wall, EXPECT),
    Case("S7", "head-on", "two bars of 20 cells hit each other, each at V", VARIANTS, head_on, EXPECT),
)
