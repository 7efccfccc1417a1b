"""B-spline shape functions on the grid: how far a particle reaches, and with what weight.

`g` is the distance, in cells, of the particle from the centre node of its stencil (the nearest node for quadratic, the one
below for linear and cubic); node n of the stencil lies at n - LOW from the centre.
Source: Steffen, Kirby, Berzins, Int. J. Numer. Meth. Eng. 76 (2008) 922.
"""

NODES_QUADRATIC = 3  # nodes of the stencil per axis
LOW_QUADRATIC = 1  # of them, below the centre node
ROUND_QUADRATIC = 0.5  # centre = floor(x / dx + ROUND)
INERTIA_QUADRATIC = 4.0  # 1 / sum of w d d over the stencil, in 1 / cells^2 (APIC's D^-1 dx^2)
ORIGINS_QUADRATIC = (
    0.5,
    0.0,
    -0.5,
)  # of a node, the g where its weight or slope vanishes: in powers of the distance from
# there, small weights and slopes keep their digits, which force over mass of a lone particle needs


def weights_quadratic(g):
    return (0.5 * (0.5 - g) * (0.5 - g), 0.75 - g * g, 0.5 * (0.5 + g) * (0.5 + g))


def slopes_quadratic(g):
    """dN/dx of the nodes' shape functions at the particle, in 1 / cells."""
    return (g - 0.5, -2.0 * g, g + 0.5)


NODES_LINEAR, LOW_LINEAR, ROUND_LINEAR = 2, 0, 0.0
INERTIA_LINEAR = 0.0  # none: g (1 - g) differs from particle to particle, and vanishes on nodes
ORIGINS_LINEAR = (1.0, 0.0)


def weights_linear(g):
    return (1.0 - g, g)


def slopes_linear(g):
    return (0.0 * g - 1.0, 0.0 * g + 1.0)


NODES_CUBIC, LOW_CUBIC, ROUND_CUBIC, INERTIA_CUBIC = 4, 1, 0.0, 3.0
ORIGINS_CUBIC = (1.0, 0.0, 1.0, 0.0)


def weights_cubic(g):
    h = 1.0 - g
    return (
        h * h * h * (1.0 / 6.0),
        (0.5 * g - 1.0) * g * g + (2.0 / 3.0),
        (0.5 * h - 1.0) * h * h + (2.0 / 3.0),
        g * g * g * (1.0 / 6.0),
    )


def slopes_cubic(g):
    h = 1.0 - g
    return (-0.5 * h * h, (1.5 * g - 2.0) * g, (2.0 - 1.5 * h) * h, 0.5 * g * g)
