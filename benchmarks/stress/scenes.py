"""Short ways to write the scenes of the matrix."""

import math

import numpy as np

import pmpm

CELLS_PASSED = 1e6  # by a wave at the end of a scene: runs are ended before, by their cases


def solid(model="neo_hookean", density=1000.0, youngs_modulus=1e6, poisson_ratio=0.3, **keys):
    return {
        "model": model, "density": density, "youngs_modulus": youngs_modulus, "poisson_ratio": poisson_ratio, **keys,
    }  # fmt: skip


def lame(material):
    """(mu, lam) in Pa."""
    E, nu = material["youngs_modulus"], material["poisson_ratio"]
    return E / (2.0 * (1.0 + nu)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


def wave_speed(material):
    """Of P waves at rest, m/s."""
    mu, lam = lame(material)
    return math.sqrt((lam + 2.0 * mu) / material["density"])


def signal_speed(material):
    """m/s: of P waves in a solid, of sound in a fluid."""
    return material["sound_speed"] if material["model"] == "fluid" else wave_speed(material)


def box(low, high, material="m", **keys):
    return {"material": material, "shape": {"type": "box", "min": list(low), "max": list(high)}, **keys}


def disk(center, radius, material="m", **keys):
    return {"material": material, "shape": {"type": "sphere", "center": list(center), "radius": radius}, **keys}


def simulation(scheme, size, cell_size, bodies, materials, time=None, method=None, comm=None, **rest):
    """`materials`: one, called m, or a table of several; further keys that are not the scene's are the domain's."""
    materials = {"m": materials} if "model" in materials else materials
    end = CELLS_PASSED * cell_size / max(map(signal_speed, materials.values()))
    scene = {key: rest.pop(key) for key in ("motions", "body_force") if key in rest}
    return pmpm.Simulation(
        pmpm.Scene(
            domain={"size": list(size), "cell_size": cell_size, **rest},
            method=scheme.method | (method or {}),
            time={"end": end} | (time or {}),
            materials=materials,
            bodies=bodies,
            **scene,
        ),
        comm,
    )


def set_in_motion(run, center, gradient, drift=0.0):
    """Give particles v = drift + A (x - center), the affine field of APIC included."""
    x = run.particles.x - center
    run.particles.v = x @ np.asarray(gradient).T + drift
    if run.needs.scheme.affine:
        run.particles.C = np.broadcast_to(gradient, (len(x), run.dim, run.dim))


def by_id(run, *names):
    """float64 rows of these fields in the order of the particles' ids."""
    order = np.argsort(run.particles.id)
    return [np.asarray(getattr(run.particles, name), float)[order] for name in names]


def root_mean_square(values):
    return float(np.sqrt(np.mean(np.asarray(values) ** 2)))
