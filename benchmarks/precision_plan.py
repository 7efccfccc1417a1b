"""Which runs benchmarks/work_precision.py makes, and about how long each takes."""

from dataclasses import asdict, dataclass, replace

TRANSFERS = (("pic", None), ("flip", 1.0), ("flip", 0.95), ("aflip", 0.99), ("apic", None), ("mls", None))
DEGREES = ("linear", "quadratic", "cubic")
COMMON, FAST = (
    0.4,
    0.8,
)  # cfl at which all run, and the largest of those tried that leaves room for waves that get faster
CFLS = (0.1, 0.2, COMMON, FAST)
DT_SWEEP = (0.05, 0.1, 0.2, 0.4, 0.8, 1.0, 1.2, 1.4, 1.7, 2.0)
DT_TRANSFERS = (("pic", None), ("flip", 1.0), ("apic", None), ("mls", None))
PER_DIRECTION = (1, 2, 3, 4)
PEER_CASES = ("waves 2-D", "waves 3-D", "vortex")
GRID_CASES = PEER_CASES  # with every transfer and spline; the others vary one factor at a time
# Cells: of all schemes; the finest, of the best ones only.
SIZES = {
    "waves 2-D": ((16, 32, 64, 128), (256,)),
    "waves 3-D": ((8, 12, 16, 20), (32, 48)),
    "vortex": ((14, 20, 40, 80), (160,)),
    "bar": ((7, 13, 26, 52), ()),
    "column": ((4, 8, 16, 32), (64,)),
    "fluid": ((16, 32, 64, 128), ()),
    "sand": ((10, 14, 20), ()),
}
QUICK_SIZES = {
    "waves 2-D": ((16, 32, 64), (128,)),
    "waves 3-D": ((8, 16), (24,)),
    "vortex": ((14, 20, 40), (80,)),
    "bar": ((7, 13, 26), ()),
    "column": ((4, 8, 16), ()),
    "fluid": ((16, 32), ()),
    "sand": ((10,), ()),
}
QUICK_CASES = ("waves 2-D", "waves 3-D", "vortex", "column", "sand")
SWEPT_CELLS = 64  # of the waves in 2-D whose step is varied
REFERENCE = {"sand": 4}  # times finer, of the run that takes the place of an exact solution
LOAD_STEPS = (1, 4, 16)  # of Kratos
KRATOS_CELLS, QUICK_KRATOS_CELLS = (8, 16, 32, 64), (8, 16)
PEERS = (("taichi", "float32"), ("taichi", "float64"), ("warp", "float32"), ("warp", "float64"))


@dataclass(frozen=True)
class Point:
    """One run: `code` pmpm or a peer, `per_direction` particles per cell and direction, `cfl` of the wave speed at rest."""

    case: str
    cells: int
    code: str = "pmpm"
    transfer: str = "mls"
    blend: float | None = None
    degree: str = "quadratic"
    precision: str = "float64"
    per_direction: int = 2
    cfl: float = COMMON

    @property
    def scheme(self):
        """What a line of a figure is: everything but cells and cfl."""
        blend = "" if self.blend is None else f" {self.blend:g}"
        code = "" if self.code == "pmpm" else f"{self.code} "
        extra = "" if self.precision == "float64" else f" {self.precision}"
        extra += "" if self.per_direction == 2 else f" {self.per_direction} per direction"
        return f"{code}{self.transfer}{blend} {self.degree}{extra}"

    @property
    def key(self):
        return f"{self.case}, {self.scheme}, cfl {self.cfl:g}, {self.cells} cells"

    @property
    def table(self):
        return asdict(self)


def schemes():
    """(transfer, blend, degree) of all pairs there are."""
    return [(t, b, d) for d in DEGREES for t, b in TRANSFERS if (t, d) != ("mls", "linear")]


def full_grid(base, cfls=(COMMON, FAST)):
    """Every transfer with every spline, at each of these steps."""
    return [
        replace(base, transfer=transfer, blend=blend, degree=degree, cfl=cfl)
        for cfl in cfls
        for transfer, blend, degree in schemes()
    ]


def one_factor(base):
    """One factor at a time changed."""
    changed = [replace(base, transfer=transfer, blend=blend) for transfer, blend in TRANSFERS]
    changed += [replace(base, transfer="apic", degree="linear"), replace(base, degree="cubic")]
    changed += [replace(base, precision="float32"), replace(base, precision="float32", cfl=FAST)]
    changed += [replace(base, per_direction=number) for number in PER_DIRECTION]
    return changed + [replace(base, cfl=cfl) for cfl in CFLS]


def few(base):
    """What is worth a look where time is short."""
    changed = [replace(base, transfer=transfer, blend=blend) for transfer, blend in (("flip", 0.95), ("apic", None))]
    return [base, *changed, replace(base, precision="float32"), *best_ones(base)]


def best_ones(base):
    """Those that go on to the finest grids."""
    fast = replace(base, cfl=FAST)
    return [fast, replace(fast, precision="float32")]


def points_of(case, quick, rounds):
    """dict Point -> how many timed runs of it."""
    usual, finest = (QUICK_SIZES if quick else SIZES)[case]
    if case == "sand":
        return sand_points(usual, rounds)
    base = Point(case, 0)
    wanted = few(base) if quick else one_factor(base)
    if case in GRID_CASES and not quick:
        wanted = full_grid(base) + wanted
    elif case == "waves 2-D":
        wanted = full_grid(base, [FAST]) + wanted
    found = {replace(point, cells=cells): rounds for point in wanted for cells in usual}
    return found | {replace(point, cells=cells): rounds for point in best_ones(base) for cells in finest}


def sand_points(sizes, rounds):
    """A few schemes, each with a run that takes the place of an exact solution."""
    found = {}
    for transfer, blend in (("mls", None), ("apic", None), ("flip", 0.95)):
        base = Point("sand", 0, transfer=transfer, blend=blend)
        found |= {replace(base, cells=cells): rounds for cells in sizes}
        found[replace(base, cells=REFERENCE["sand"] * max(sizes))] = 0
    return found


def dt_sweep():
    """dict Point -> 0: their times are not asked for."""
    return {
        Point("waves 2-D", SWEPT_CELLS, transfer=transfer, blend=blend, cfl=cfl): 0
        for transfer, blend in DT_TRANSFERS
        for cfl in DT_SWEEP
    }


def peer_points(case, quick, rounds):
    """Peers at the sizes of all schemes; in float32 and at the fast step also at a finer one."""
    usual, finest = (QUICK_SIZES if quick else SIZES)[case]
    found = {}
    for code, precision in PEERS:
        if quick and precision == "float64":
            continue
        base = Point(case, 0, code=code, precision=precision)
        for cfl in (COMMON, FAST):
            found |= {replace(base, cells=cells, cfl=cfl): rounds for cells in usual}
        if not quick and case == "waves 3-D" and precision == "float32":
            found[replace(base, cells=finest[0], cfl=FAST)] = rounds
    return found


def kratos_points(quick, rounds):
    """A static code: its transfer is said to be its number of load steps, and its cfl is none."""
    base = Point("column", 0, code="kratos", degree="linear", cfl=0.0)
    return {
        replace(base, transfer=f"static {steps}", cells=cells): rounds
        for steps in LOAD_STEPS
        for cells in (QUICK_KRATOS_CELLS if quick else KRATOS_CELLS)
    }


def plan(quick, peers, cases=None, rounds=None):
    """dict Point -> how many timed runs, beside the one that takes the error; in the order in which they are run."""
    rounds = rounds or (3 if quick else 5)
    found = dict.fromkeys(dt_sweep(), 0) if cases is None or "waves 2-D" in cases else {}
    for case in cases or (QUICK_CASES if quick else SIZES):
        found |= points_of(case, quick, rounds)
        if peers and case in PEER_CASES:
            found |= peer_points(case, quick, rounds)
        if peers and case == "column":
            found |= kratos_points(quick, rounds)
    return found


# ---- how long it takes -----------------------------------------------------------------------------------------------------

NS = {2: 45.0, 3: 80.0}  # per particle-step of pmpm: mls, quadratic, float64, with a body force
OF_DEGREE = {"linear": 0.7, "quadratic": 1.0, "cubic": 1.4}
OF_PEER = {("taichi", 2): 230.0, ("taichi", 3): 620.0, ("warp", 2): 90.0, ("warp", 3): 220.0}
PER_STEP = 1.5e-4  # s of Python in a step
TO_BUILD = {"pmpm": 0.15, "taichi": 1.0, "warp": 0.5, "kratos": 0.2}  # s of one simulation, kernels compiled
TO_COMPILE = {
    ("pmpm", 2): 6.0, ("pmpm", 3): 12.0, ("taichi", 2): 1.2, ("taichi", 3): 7.5, ("warp", 2): 2.0, ("warp", 3): 2.5,
    ("kratos", 2): 0.0,
}  # fmt: skip


def seconds_of(point, particles, steps):
    """About how long the steps of one run take."""
    dim = 3 if point.case == "waves 3-D" else 2
    if point.code == "kratos":
        return 0.5
    if point.code != "pmpm":
        return steps * (PER_STEP + 1e-9 * particles * OF_PEER[point.code, dim])
    cost = NS[dim] * OF_DEGREE[point.degree] * (0.6 if point.precision == "float32" else 1.0)
    cost *= 1.7 if point.blend is not None else 1.0
    return steps * (PER_STEP + 1e-9 * particles * cost)


def kernels_of(point):
    """What decides whether kernels are compiled anew: of a peer everything, since its numbers are compiled in."""
    if point.code != "pmpm":
        return point
    return replace(point, cells=0, cfl=0.0, per_direction=0)
