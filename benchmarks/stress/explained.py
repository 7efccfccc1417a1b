"""What each row of the matrix is about, in words, for its page."""

ROWS = {
    "S1": """stiffness

One cube, ten moduli: the step shrinks with the root of the modulus (dt c / dx stays), the rebound changes smoothly
and is the same from 1e7 Pa on, where gravity and the speed of the fall have become small.
""",
    "S2": """near incompressibility

The step follows lam: dt c sqrt(2) / dx is the cfl, 0.4, at any nu. A confined column does not lock, and its
settlement is as good at nu = 0.4999 as at 0.3. Pressure noise of the disk is relative to rho (w R)^2; [locking and
F-bar](locking.md) has a page of its own.
""",
    "S3": """unequal bodies

The step is the least of both materials', momentum is kept to 1e-12, and no body sinks into the other by a cell. Cubic
weights sum to one less 8e-17 ([why](conservation.md)): 6e-13 of momentum in 4000 steps.
""",
    "S4": """the length of a step

The step is that ratio of the current bound in every step, beyond 1 too, where `time.cfl` refuses it; a user comes there with
`time.force_step` alone, and is warned at the start. What is F from 1.5 on are forced runs that came to their end with more
energy than they may have: wrong numbers behind a warning. The guard lets 0.3 of the most that moved at any time come out of
nothing; the disk gains 0.11 to 0.13 of what it began with, 0.13 to 0.41 in PIC and FLIP. In the manufactured solution it is the
body force that shakes the body: by the guard's account (its work at P2G) nothing comes out of nothing, by the one here (its
impulse times the mean of the velocities before and after) 0.07 to 0.6 of it does.
""",
    "S5": """inversion

A fixed corotated particle that lies inside out among others that do not stays so: the grid moves all of a cell's
particles alike, and a tenth of them cannot turn. Energy falls, the rest of the strain relaxes. A law without meaning
for det F < 0 stops in the first step.
""",
    "S6": """crushed snow

The step follows the hardened moduli. With xi = 25 and 50 it shrinks so far that the platen does not arrive.
""",
    "S7": """impact

Neo-Hookean solids and fluids have a shock at any speed. Fixed corotated ones have none from V = c on: they turn
inside out and live; stress of Hencky solids falls back to zero when they are crushed.
""",
    "S8": """lone particles

Noise of the volume does not grow, and free flight is straight to round-off. Dust that starts stretched or compressed by 30 %
swings with the highest frequency that there is, and this row found that a step which follows each swing, as late as a
reduction is, pumps: energy grew fivefold in a hundred steps of MLS. Since then the largest of the last 32 to 64 steps bound the
step. APIC with weight gradients lets the swing die.
""",
    "S9": """walls, corners, nodes

`free` walls hold nothing: a particle that passes is named. Cuts between ranks are in S11.
""",
    "S10": "few and many particles\n",
    "S11": """ranks

Every scene has the bits of one rank. Cuts that move while a run goes on (rebalancing) are not built yet; cuts moved
by hand are in [the same bits](same_bits.md).
""",
    "S12": """units

No number in the code has a unit: what is left is round-off, a few hundred steps of it. Scenes that splash or pile up
are left out, since they amplify round-off without bound.
""",
    "S13": "a hundred thousand steps\n",
    "S14": """far from the origin

Positions are integers from a node near by: the same bits 1e4 and 1e6 cells away.
""",
    "S15": """extremes

Survival or a clear stop.
""",
    "S16": """input

Status 2, one line, the key by name.
""",
    "S18": """fluids under tension

Without tension (the default) a fluid flies apart at constant speed. With it, it pulls itself together.
""",
    "S20": "sand at its limits\n",
}
NOT_RUN = """### S17 faults

Killed ranks, full disks, other rank counts at a restart: [nothing is lost](reliability.md), `tests/test_kills.py`,
`tests/test_faults.py`, `tests/test_restart.py`. Not run here.

### S19 implicit steps, and what else is not built

Implicit time steps are not built: S19, and the implicit halves of S1, S4 and S13. Nor are colliders (oblique planes,
beads on arcs) and rebalancing.
"""
