"""F-bar: volume changes averaged over nodes leave uniform strain alone, vanish with the cell size, and keep pressure smooth."""

import math

import fast_and_scalar as agreement
import numpy as np
import pytest

from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation


def simulation(size, low, high, poisson_ratio, f_bar, **domain):
    """A box of shear modulus and density one in cells of an eighth."""
    method, dx = dict(domain.pop("method", {})), domain.pop("dx", 0.125)
    return Simulation(
        Scene(
            domain={"size": size, "cell_size": dx, **domain},
            method={"f_bar": f_bar, **method},
            time={"end": 1e6},
            materials={
                "material": {
                    "model": "neo_hookean",
                    "density": 1.0,
                    "youngs_modulus": 2.0 * (1.0 + poisson_ratio),
                    "poisson_ratio": poisson_ratio,
                }
            },
            bodies=[{"material": "material", "shape": {"type": "box", "min": low, "max": high}}],
        )
    )


@pytest.mark.parametrize(
    "A", [[[0.1, 0.0], [0.0, 0.1]], [[0.2, 0.3], [-0.1, 0.05]]], ids=["dilation", "dilation, shear and spin"]
)
def test_a_uniform_velocity_gradient_is_left_as_it_is(A):
    """Patch test: also at the edges of a body, where nodes hold the volume of few particles."""
    body = simulation([2.0, 2.0], [0.55, 0.52], [1.45, 1.4], 0.49, True)
    # At random places, of which those at the edges share their nodes with few others.
    body.particles.x = body.particles.x + np.random.default_rng(1).uniform(-0.03, 0.03, body.particles.x.shape)
    body.particles.v = body.particles.x @ np.transpose(A)
    body.particles.C = np.broadcast_to(A, (body.rows(), 2, 2))
    body.step()
    assert np.abs(body.particles.F - np.eye(2) - body.dt * np.array(A)).max() < 50.0 * np.finfo(float).eps


def frequency(cells, f_bar):
    """Of the first standing wave of pressure in a periodic box at nu = 0.3, times that of theory."""
    dx = 1.0 / cells
    box = [1.0, 8.0 * dx]
    run = simulation(box, [0.0, 0.0], box, 0.3, f_bar, periodic=["x", "y"], dx=dx)
    k, speed = 2.0 * math.pi, math.sqrt(2.0 * (1.0 - 0.3) / (1.0 - 2.0 * 0.3))
    v = np.zeros((run.rows(), 2))
    v[:, 0] = 1e-5 * np.sin(k * run.particles.x[:, 0])
    run.particles.v = v
    before, zeros = (0.0, 1.0), []
    while len(zeros) < 2:
        run.step()
        now = run.time, float(run.particles.v[:, 0] @ np.sin(k * run.particles.x[:, 0]))
        if now[1] * before[1] < 0.0:
            zeros.append(before[0] - before[1] * (now[0] - before[0]) / (now[1] - before[1]))
        before = now
    return math.pi / (k * speed * (zeros[1] - zeros[0]))


def test_at_a_poisson_ratio_of_0_3_f_bar_is_a_change_of_second_order():
    coarse, fine = (frequency(cells, True) - frequency(cells, False) for cells in (16, 32))
    assert coarse < 0.0  # averages are softer; measured -1.3 % and -0.34 %
    assert 1.8 < math.log2(coarse / fine) < 2.2


def spurious_pressure(f_bar):
    """Root mean square, in shear moduli times strain, of a square in Lame's mode at nu = 0.4999, which changes no volume.

    u = (cos kx sin ky, -sin kx cos ky), k = pi / a, omega = sqrt(2) k c_s; at a quarter of a period.
    """
    k, strain = math.pi, 1e-4
    run = simulation([2.0, 2.0], [0.53, 0.53], [1.53, 1.53], 0.4999, f_bar)
    x = k * (run.particles.x - 0.53)
    c, s = np.cos(x), np.sin(x)
    run.particles.v = math.sqrt(2.0) * strain * np.stack([c[:, 0] * s[:, 1], -s[:, 0] * c[:, 1]], axis=-1)
    a, b = k * s[:, 0] * s[:, 1], k * c[:, 0] * c[:, 1]
    run.particles.C = math.sqrt(2.0) * strain * np.stack([-a, b, -b, a], axis=-1).reshape(-1, 2, 2)
    run.run(until=0.5 * math.pi / (math.sqrt(2.0) * k))
    return float(np.sqrt(np.mean(run.fields(["pressure"])["pressure"] ** 2))) / strain


def test_near_incompressibility_f_bar_takes_away_most_of_the_noise_of_pressure():
    plain, averaged = spurious_pressure(False), spurious_pressure(True)
    assert averaged < 0.3 * plain  # measured 0.37 of 1.88


def test_f_bar_averages_in_fast_and_scalar_kernels_alike():
    row = {"material": "neo_hookean", "dim": 2, **agreement.PLAIN, "precision": "float64"}
    plain = agreement.scene(row)
    averaged = Scene(**(plain.model_dump() | {"method": {"f_bar": True}}))
    fast, scalar = (agreement.run(averaged, loops) for loops in ("lanes", "scalar"))
    apart = agreement.distances(fast, scalar)
    assert {name: distance for name, distance in apart.items() if not distance <= agreement.BOUND} == {}
    assert agreement.distances(agreement.run(plain, "lanes"), fast)["F"] > 1e6  # it does average
