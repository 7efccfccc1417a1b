"""P2G and G2P on clouds of random particles: what they conserve (Jiang et al. 2015) and reproduce, kernel by kernel."""

import numpy as np
import pytest

import pmpm

CELLS = 12
DX = 0.25
# Each compiles its kernels; float32 takes the same source, so one scheme per dimension is enough.
SCHEMES = [
    (2, "apic", "quadratic", "float64"),
    (2, "mls", "quadratic", "float64"),
    (3, "apic", "quadratic", "float64"),
    (3, "mls", "quadratic", "float64"),
    (2, "mls", "cubic", "float64"),
    (3, "apic", "cubic", "float64"),
    (2, "apic", "quadratic", "float32"),
    (3, "mls", "cubic", "float32"),
    (2, "apic", "linear", "float64"),
    (3, "apic", "linear", "float32"),
    (3, "aflip", "quadratic", "float64"),
]
# Without an affine field there is no angular momentum to conserve, nor one that a velocity field could be told by.
PLAIN_SCHEMES = [
    (2, "pic", "quadratic", "float64"),
    (3, "flip", "quadratic", "float64"),
    (2, "flip", "cubic", "float32"),
    (3, "pic", "linear", "float64"),
]


def cloud(dim, transfer, shape, precision, stressed=True):
    """Particles of random position, velocity, C and deformation, far from the walls of their box."""
    low, high = 3.0 * DX, (CELLS - 3.0) * DX
    scene = pmpm.Scene(
        domain={"size": [CELLS * DX] * dim, "cell_size": DX},
        method={"transfer": transfer, "shape_function": shape, "precision": precision},
        time={"end": 1.0, "step": 1e-4},
        materials={"rubber": {"model": "neo_hookean", "density": 700.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}},
        bodies=[
            {
                "material": "rubber",
                "shape": {"type": "box", "min": [low] * dim, "max": [high] * dim},
                "particles_per_cell": 4 if dim == 2 else 1,
            }
        ],
    )
    simulation = pmpm.Simulation(scene)
    random, count = np.random.default_rng(dim), simulation.rows()
    simulation.particles.x = random.uniform(low, high, (count, dim))
    simulation.particles.v = random.normal(size=(count, dim))
    if simulation.needs.scheme.affine:
        simulation.particles.C = random.normal(size=(count, dim, dim)) / DX
    if stressed:
        simulation.particles.F = np.eye(dim) + 0.1 * random.normal(size=(count, dim, dim))
    return simulation


def scatter(simulation, dt):
    """P2G alone. Returns (positions (n, dim), mass (n,), momentum (n, dim)) of the nodes, float64."""
    simulation.lay_out()
    if simulation.needs.scheme.blends:
        simulation.keep_velocities(dt)
    simulation.scatter(dt, "p2g")
    simulation.finish_halo()
    return places(simulation), *mass_and_vector(simulation)


def gather(simulation, dt=0.0):
    """G2P alone, from what the nodes hold as velocities."""
    layers = simulation.last_layer - simulation.first_layer
    simulation.processor.g2p([(0, layers)], simulation.real(dt))
    assert simulation.failure is None


def mass_and_vector(simulation):
    nodes = simulation.patch.nodes[0].astype(float)
    return nodes[:, 3], nodes[:, : simulation.dim]


def places(simulation):
    """(n, dim) node positions in m, in the order of the patch."""
    geometry, patch = simulation.geometry, simulation.patch
    slab, middle, row = geometry.axes
    low = geometry.stencil.reach_low
    index = patch.nodes_of(slice(None))
    x = np.empty((4 * patch.quads, geometry.dim))
    x[:, slab] = index[0] + patch.first_plane
    x[:, row] = index[2] - low
    if middle >= 0:
        x[:, middle] = index[1] - low
    return x * geometry.cell_size


def moment(x, p):
    """Total angular momentum as the antisymmetric matrix sum of x p^T - p x^T."""
    M = x.T @ p
    return M - M.T


def particle_totals(simulation):
    """(mass, momentum, angular momentum with that of the affine fields)."""
    particles = simulation.particles
    m, x, v = (np.asarray(getattr(particles, name), float) for name in ("mass", "x", "v"))
    affine = np.zeros((x.shape[1], x.shape[1]))
    if simulation.needs.scheme.affine:
        inertia = np.full(x.shape, 1.0 / (simulation.needs.stencil.inertia or 1.0))
        if simulation.needs.shape_function == "linear":
            inertia = (x / DX - np.floor(x / DX)) * (1.0 - (x / DX - np.floor(x / DX)))
        affine = np.einsum("p,pij,pj->ji", m, np.asarray(particles.C, float), inertia * DX**2)
    return m.sum(), m @ v, moment(x, m[:, None] * v) + affine - affine.T


def tolerance(simulation, scale):
    """Round-off of a sum over the cloud: 100 eps of the sum of what is added up."""
    return 100.0 * np.finfo(simulation.real).eps * scale


def size_of_sums(simulation):
    particles = simulation.particles
    speed = np.abs(particles.v).sum()
    if simulation.needs.scheme.affine:
        speed += DX * np.abs(particles.C).sum()
    return float(particles.mass[0] * speed)


@pytest.mark.parametrize(("dim", "transfer", "shape", "precision"), SCHEMES + PLAIN_SCHEMES)
def test_p2g_conserves_mass_and_momentum(dim, transfer, shape, precision):
    simulation = cloud(dim, transfer, shape, precision)
    mass, momentum, _ = particle_totals(simulation)
    _, m, p = scatter(simulation, dt=1e-3)
    assert abs(m.sum() - mass) < tolerance(simulation, mass) / 10.0
    # Internal forces are part of p: they sum to zero.
    assert np.abs(p.sum(axis=0) - momentum).max() < tolerance(simulation, size_of_sums(simulation))


@pytest.mark.parametrize(("dim", "transfer", "shape", "precision"), SCHEMES)
def test_p2g_conserves_angular_momentum_with_internal_forces(dim, transfer, shape, precision):
    simulation = cloud(dim, transfer, shape, precision)
    _, _, angular = particle_totals(simulation)
    x, _, p = scatter(simulation, dt=1e-3)
    assert np.abs(moment(x, p) - angular).max() < tolerance(simulation, size_of_sums(simulation) * CELLS * DX)


@pytest.mark.parametrize(("dim", "transfer", "shape", "precision"), SCHEMES)
def test_g2p_conserves_momentum_and_angular_momentum(dim, transfer, shape, precision):
    simulation = cloud(dim, transfer, shape, precision)
    x, m, _ = scatter(simulation, dt=0.0)
    velocity = np.random.default_rng(3).normal(size=(len(m), dim)).astype(simulation.real)
    simulation.patch.nodes[0, :, :dim] = velocity
    grid = m[:, None] * velocity
    gather(simulation, dt=1e-4)
    _, momentum, angular = particle_totals(simulation)
    if transfer == "aflip":
        return  # it takes from the grid only what has changed
    assert np.abs(momentum - grid.sum(axis=0)).max() < tolerance(simulation, np.abs(grid).sum())
    # That the particles have moved as well adds dt sum m v x v = 0, but of linear splines it moves D.
    if shape != "linear":
        assert np.abs(angular - moment(x, grid)).max() < tolerance(simulation, np.abs(grid).sum() * CELLS * DX)


@pytest.mark.parametrize(("dim", "transfer", "shape", "precision"), SCHEMES)
def test_an_affine_velocity_field_is_reproduced_exactly(dim, transfer, shape, precision):
    simulation = cloud(dim, transfer, shape, precision, stressed=False)
    random = np.random.default_rng(4)
    v0, A = random.normal(size=dim), random.normal(size=(dim, dim))
    before = simulation.particles.x
    simulation.particles.v = v0 + before @ A.T
    simulation.particles.C = np.broadcast_to(A, (simulation.rows(), dim, dim))
    x, m, p = scatter(simulation, dt=0.0)
    eps, size = np.finfo(simulation.real).eps, np.abs(A).max() * CELLS * DX
    # Light nodes hold sums of few small terms: their quotient is as accurate as any other.
    touched = m > 0.0
    nodes = p[touched] / m[touched, None]
    assert np.abs(nodes - v0 - x[touched] @ A.T).max() < 100.0 * eps * size
    simulation.processor.update_planes((0, simulation.patch.planes), 0.0)
    dt = 1e-3
    gather(simulation, dt)
    assert np.abs(simulation.particles.v - v0 - before @ A.T).max() < 100.0 * eps * size
    assert np.abs(simulation.particles.C - A).max() < 400.0 * eps * size / DX
    # Forward Euler of dF/dt = A F, from F = I.
    assert np.abs(simulation.particles.F - np.eye(dim) - dt * A).max() < 10.0 * eps


@pytest.mark.parametrize(("dim", "transfer", "shape", "precision"), SCHEMES + PLAIN_SCHEMES)
def test_a_step_conserves_mass_momentum_and_of_affine_schemes_angular_momentum(dim, transfer, shape, precision):
    simulation = cloud(dim, transfer, shape, precision)
    mass, momentum, angular = particle_totals(simulation)
    scale = size_of_sums(simulation)
    for _ in range(3):
        simulation.step()
    mass_after, momentum_after, angular_after = particle_totals(simulation)
    assert mass_after == mass
    assert np.abs(momentum_after - momentum).max() < tolerance(simulation, scale)
    if transfer in ("apic", "mls") and shape != "linear":
        assert np.abs(angular_after - angular).max() < tolerance(simulation, scale * CELLS * DX)


@pytest.mark.parametrize("blend", [0.0, 0.7, 1.0])
def test_flip_adds_the_change_of_the_grid_to_what_the_grid_does_not_hold(blend):
    """v = PIC + blend (v_p - PIC of the velocities before): the limits are PIC and pure FLIP (Zhu and Bridson 2005)."""
    pic, flip = cloud(2, "pic", "quadratic", "float64"), cloud(2, "flip", "quadratic", "float64")
    before = flip.particles.v
    flip.blend = blend
    for simulation in (pic, flip):
        scatter(simulation, dt=1e-3)
        simulation.processor.update_planes((0, simulation.patch.planes), 0.0)
        gather(simulation, 0.0)
    smoothed = cloud(2, "pic", "quadratic", "float64")
    scatter(smoothed, dt=0.0)
    smoothed.processor.update_planes((0, smoothed.patch.planes), 0.0)
    gather(smoothed, 0.0)
    expected = pic.particles.v + blend * (before - smoothed.particles.v)
    assert np.abs(flip.particles.v - expected).max() < 1e-13 * np.abs(expected).max()


@pytest.mark.parametrize("transfer", ["apic", "mls"])
def test_measured_totals_are_those_of_the_particles(transfer):
    simulation = cloud(2, transfer, "quadratic", "float64")
    mass, momentum, angular = particle_totals(simulation)
    measured = simulation.measure()
    assert measured["mass"] == pytest.approx(mass, rel=1e-13)
    assert [measured["momentum_x"], measured["momentum_y"]] == pytest.approx(momentum, rel=1e-11)
    assert measured["angular_momentum_z"] == pytest.approx(angular[0, 1], rel=1e-11)
