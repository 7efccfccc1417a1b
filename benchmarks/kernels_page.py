"""What benchmarks/kernels.py prints and writes: its tables, the page and the bar chart."""

import statistics
from dataclasses import dataclass

import pages
from workloads import LAWS

# Useful operations per particle-step, counted once from the machine code of a forerunner of these kernels.
FLOPS = {"W1": 1600, "W3": 1450}
CODES = ("Taichi", "Warp", "pmpm")
PACES = ("ordinary", "fast")
PHASES = ("clear", "layout", "p2g", "halo", "halo wait", "nodes", "g2p", "regroup")
# Measured once on the same kind of machine, +-15 %: double precision, 3-D, quadratic, 8 per cell, g++ -O3 -march=native.
CPP = (
    ("W3 water", "ExaMPM + Cabana + Kokkos Serial, APIC, 983k", "961 - 1067; 586 on 2 ranks", "432 at the peak"),
    ("W1 jelly", "matter, APIC, 1e6", "3438", "412"),
    ("W2 sand", "matter, APIC, 1e6", "3536", "412"),
    ("W1 jelly", "ExaGOOP on AMReX, FLIP, 195k", "9325", "1149"),
    ("W3 water", "ExaGOOP on AMReX, FLIP, 195k", "8639", "1149"),
)

PAGE = """# Speed of a time step

`python benchmarks/kernels.py --docs docs` wrote this page in {minutes:.0f} minutes.
{processor}; {versions}.

A block of 51^3 cells with 8 particles per cell at random places (1.06 million) in a unit cube of 128^3 cells, float32,
dt = 1e-4 s; W1 neo-Hookean, W2 Drucker-Prager, W3 fluid. All codes solve the same equations (MLS-MPM, quadratic splines),
start from the same particles in cell order, and took turns within one call. Times are medians over the rounds, ratios are
ratios of medians. A step of pmpm is all of `Simulation.step()`, sorting included.
✔ the must is met, ✔✔ the stretch too, ✘ it fails.

"""
NOTES = """## Notes

- Taichi is written as its mpm3d example is (one field per quantity, atomic `+=`), Warp with one launch per phase and
  `atomic_add`; both clear and update the whole grid, as their users do. Neither sorts. Warp has one CPU thread.
- Flops are useful ones with factored stencils, counted once from the machine code of a forerunner of these kernels; bytes moved
  are 3 x touched: P2G reads them, G2P reads and writes them. Both ceilings were measured in this call.
- The ordered sum gives the same bits on any number of ranks: P2G adds a layer's particles to planes of its own first, and then
  adds these to the nodes. Its cost is that second addition.
- `p2g` of pmpm clears the grid, its `g2p` updates the nodes. `rest` is the choice of dt and what lies between.
- Flying, the block moves as a whole: shearing it that fast would stretch it until its waves allow no step of 1e-4 s.
- 2-D: neo-Hookean, 1.05 million particles, 4 per cell, the same cell size, step and speeds. Shuffled: pmpm sorts particles when
  their positions are assigned, so the row shows steps after that first sort.
- AVX2: NUMBA_CPU_NAME=x86-64-v3 without AVX-512, beside Taichi with all that the processor has.
- Positions may differ by one last place (6e-8) of a float32 in [0.5, 1) per step: the peers keep metres, and lose half of it.
- C++ figures were taken once on the same kind of machine, +-15 %, and are not part of this call; schemes differ.
"""


@dataclass
class Goal:
    """A number that must be reached, and one that would be better; `reached` None: there is nothing to measure yet."""

    text: str
    reached: float | None
    must: float
    stretch: float | None = None
    at_least: bool = True
    spread: list | None = None  # the ratio in each round

    def beats(self, limit):
        return self.reached is not None and (self.reached >= limit if self.at_least else self.reached <= limit)

    @property
    def met(self):
        return self.beats(self.must)

    def verdict(self):
        if self.stretch is not None and self.beats(self.stretch):
            return "✔✔"
        return "✔" if self.met else "✘"


def markdown(head, rows):
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def number(value):
    """A value with as many places as a reader needs; a dash for None."""
    if value is None:
        return "-"
    if value == 0.0 or isinstance(value, int):
        return f"{value:.0f}"
    if abs(value) < 1e-2:
        return f"{value:.1e}"
    return f"{value:#.3g}" if abs(value) < 100.0 else f"{value:.1f}" if abs(value) < 1000.0 else f"{value:.0f}"


def spread_text(rounds):
    return " / ".join(number(v) for v in (min(rounds), statistics.median(rounds), max(rounds))) if rounds else "-"


def law(name):
    return f"{name} {LAWS[name]}"


def tables(measured, goals, names):
    """All tables, as one markdown text."""
    parts = [
        ("What must be reached", goal_table(goals)),
        ("Whole step, ns per particle-step", cost_table(measured, names, "ordinary")),
        ("The same with the block flying at 0.19 cells per step", cost_table(measured, names, "fast")),
        ("Other forms of the same step", form_table(measured, names)),
        ("Phases, ns per particle-step", phase_table(measured, names)),
        ("Memory, the ordered sum, and what the machine can do", ceiling_table(measured, names)),
        ("Beside C++ codes in double precision", cpp_table(measured, names)),
        ("The same results", difference_table(measured, names)),
    ]
    return "\n\n".join(f"## {title}\n\n{text}" for title, text in parts)


def goal_table(goals):
    rows = []
    for goal in goals:
        sign = "≥" if goal.at_least else "≤"
        stretch = f"{sign} {number(goal.stretch)}" if goal.stretch is not None else "-"
        limits = f"{sign} {number(goal.must)}", stretch
        rows.append((goal.text, *limits, number(goal.reached), spread_text(goal.spread), goal.verdict()))
    return markdown(("", "must", "stretch", "reached", "rounds: min / median / max", ""), rows)


def cost_table(measured, names, pace):
    rows = []
    for name in names:
        timings = {code: measured.timings.get((name, pace, code)) for code in CODES}
        row = [law(name), *(number(t and t.cost()) for t in timings.values())]
        for peer in ("Taichi", "Warp"):
            ratio = measured.ratio(name, peer, "pmpm", pace)
            row.append(f"{number(ratio[0])} ({spread_text(ratio[1])})" if ratio else "-")
        own = timings["pmpm"]
        row.append(f"{sum(own.steps)}, {own.sorts}" if own else "-")
        rows.append(row)
    return markdown(("", *CODES, "Taichi / pmpm", "Warp / pmpm", "steps, sorts of pmpm"), rows)


def form_table(measured, names):
    rows = []
    for (name, pace, label), timing in measured.timings.items():
        if pace == "ordinary" and label not in CODES:
            ratio = measured.ratio(name, label, "pmpm")
            rows.append((law(name), label, number(timing.cost()), number(ratio and ratio[0])))
    for (name, label), why in measured.absent.items():
        rows.append((law(name), label, "-", f"missing: {' '.join(why.split())}"))
    return markdown(("", "", "ns per particle-step", "time / time of pmpm, float32, 1 core"), rows)


def phase_table(measured, names):
    rows = []
    for name in names:
        for code in CODES:
            timing = measured.timings.get((name, "ordinary", code))
            if timing:
                known = [timing.phase(phase) if phase in timing.phase_names() else None for phase in PHASES]
                rest = sum(timing.seconds) / sum(timing.steps) / timing.particles * 1e9 - sum(filter(None, known))
                rows.append((law(name), code, *map(number, known), f"{rest:.1f}"))
    return markdown(("", "", *PHASES, "rest"), rows)


def ceiling_table(measured, names):
    """Fractions of the peak; the traffic counts every touched byte read by P2G, and read and written by G2P."""
    rows = []
    for name in names:
        timing, facts = measured.timings.get((name, "ordinary", "pmpm")), measured.facts.get((name, "pmpm"))
        if timing and facts:
            seconds, traffic = timing.cost() * 1e-9, 3.0 * facts["touched"]
            of_peak = f"{FLOPS[name] / seconds / measured.flops:.0%}" if name in FLOPS else "not counted"
            of_stream = f"{traffic / seconds / measured.bandwidth:.0%}"
            flops = str(FLOPS.get(name, "-"))
            rows.append((law(name), f"{facts['touched']:.1f}", f"{facts['held']:.1f}", flops, of_peak))
            rows[-1] += (f"{traffic:.0f}", of_stream, f"{facts['ordered sum']:.2f}")
    peak, stream = f"{measured.flops / 1e9:.0f} GF/s", f"{measured.bandwidth / 1e9:.1f} GB/s"
    head = (
        "",
        "bytes touched",
        "bytes held",
        "flops per step",
        f"of {peak}",
        "bytes moved per step",
        f"of {stream}",
        "ordered sum, ns",
    )
    return markdown(head, rows)


def cpp_table(measured, names):
    rows = []
    for name in names:
        timing, facts = (source.get(key) for source, key in double_precision(measured, name))
        if timing and facts:
            rows.append((law(name), "pmpm, MLS, 1.06e6", number(timing.cost()), f"{facts['held']:.0f} held"))
    rows += [row for row in CPP if row[0][:2] in names]
    return markdown(("", "", "ns per particle-step", "bytes per particle"), sorted(rows, key=lambda row: row[0]))


def double_precision(measured, name):
    return (measured.timings, (name, "ordinary", "pmpm float64")), (measured.facts, (name, "pmpm float64"))


def difference_table(measured, names):
    """max |x - x of pmpm in float32| after the compared steps."""
    rows = []
    for (name, pace, label), difference in measured.differences.items():
        moved = measured.moved[name, pace]
        rows.append((law(name), pace, label, f"{difference:.1e}", f"{difference / moved:.1e}"))
    return markdown(("", "", "against pmpm", "largest difference (m)", "of the longest way moved"), rows)


def write(docs, tables_text, measured, goals, machine, minutes, failed):
    """results/kernels.md and pictures/kernels.png in the folder `docs`."""
    for folder in ("results", "pictures"):
        (docs / folder).mkdir(parents=True, exist_ok=True)
    plot(measured, goals, docs / "pictures" / "kernels.png")
    processor, versions = machine
    intro = PAGE.format(minutes=minutes, processor=processor, versions=versions)
    verdict = "All musts hold." if not failed else "Musts that fail:\n\n" + "\n".join(f"- {text}" for text in failed)
    picture = "![ns per particle-step](../pictures/kernels.png)\n"
    page = "\n\n".join([intro + verdict, picture + "\n" + tables_text, NOTES])
    pages.write(docs, "kernels", page)


def plot(measured, goals, path):
    """Bars on a logarithmic scale; a red line over each pmpm bar at the time that meets both musts."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    colours = {"Taichi": "tab:gray", "Warp": "tab:olive", "pmpm": "tab:blue"}
    figure, axes = pyplot.subplots(figsize=(6.4, 4.0), layout="constrained")
    for place, name in enumerate(LAWS):
        for shift, code in enumerate(CODES):
            timing = measured.timings.get((name, "ordinary", code))
            if timing:
                bars = axes.bar(place + 0.27 * (shift - 1), timing.cost(), 0.25, color=colours[code])
                axes.bar_label(bars, fmt="%.0f", fontsize=8)
        if limit := slowest_allowed(measured, goals, name):
            axes.plot([place + 0.13, place + 0.41], [limit] * 2, color="tab:red", lw=1.5)
    axes.set_yscale("log")
    axes.set_xticks(range(len(LAWS)), [law(name) for name in LAWS])
    axes.set(ylabel="ns per particle-step, one core", ylim=(10, 5000))
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)
    handles = [pyplot.Rectangle((0, 0), 1, 1, color=colour) for colour in colours.values()]
    handles.append(pyplot.Line2D([], [], color="tab:red"))
    axes.legend(handles, [*colours, "must of pmpm"], frameon=False, ncols=4, loc="upper center", fontsize=9)
    figure.savefig(path, dpi=150)


def slowest_allowed(measured, goals, name):
    """ns per particle-step at which pmpm meets its musts against both peers; None without a peer's time."""
    limits = []
    for peer in ("Taichi", "Warp"):
        timing = measured.timings.get((name, "ordinary", peer))
        musts = [
            goal.must for goal in goals if goal.text.startswith(f"{law(name)}: {peer}") and "AVX2" not in goal.text
        ]
        if timing and musts:
            limits.append(timing.cost() / musts[0])
    return min(limits, default=None)
