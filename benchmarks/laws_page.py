"""What benchmarks/laws.py prints and writes: its tables, the page and the bar chart."""

import statistics

import pages
from kernels_page import markdown, number

PAGE = """# What each law costs

`python benchmarks/laws.py --docs docs` wrote this page in {minutes:.0f} minutes.
{processor}, one core; {versions}.

A block of 30^3 cells with 8 particles per cell at random places ({particles} of them), 3-D, quadratic splines, MLS. It is
sheared by 0.2 % in every step. Half of the particles, at random, have been sheared that way before and yield; the others come
from the opposite direction, so that every 16 that are computed together hold some of both kinds: the dear case, since a
return to the yield surface is skipped where none of the 16 yields. `yielding` is the fraction measured in the last step.

- `law`: advance, stress, validity and wave speed alone, in ns per particle, from states in the cache; `at rest`: the same where
  nothing yields.
- `step`: P2G, nodes and G2P of all particles, in ns per particle-step, without sorting.
- `ratio`: to the step of the neo-Hookean solid that ran before it, median (least .. largest) of {rounds} rounds; it must be at
  most {most}, or the reason is stated.

Times are processor time and the machine's; ratios hold on a shared machine too, but figures to quote are to be taken on a
quiet one.

"""


def tables(found, most, reasons):
    """A table for each precision, as one markdown text."""
    parts = []
    for precision in dict.fromkeys(precision for _, precision in found):
        chosen = {label: timing for (label, p), timing in found.items() if p == precision}
        parts.append(f"## {precision}\n\n{table(chosen, most, reasons)}")
    return "\n\n".join(parts)


def table(timings, most, reasons):
    rows = []
    for label, timing in timings.items():
        yielding = "-" if timing.yielding is None else f"{timing.yielding:.0%}"
        alone = [number(statistics.median(seconds)) for seconds in (timing.alone, timing.at_rest)]
        ratio = f"{timing.ratio():.2f} ({min(timing.ratios):.2f} .. {max(timing.ratios):.2f})"
        reason = "" if timing.ratio() <= most else reasons.get(label, "✘ no reason stated")
        rows.append((label, str(timing.state_bytes), yielding, *alone, number(timing.step()), ratio, reason))
    head = ("law", "state, bytes", "yielding", "law", "law, at rest", "step", "ratio", "")
    return markdown(head, rows)


def failed(found, most, reasons):
    """Laws that are dearer than `most` says, without a reason."""
    return [
        f"{label}, {precision}: {timing.ratio():.2f} times the neo-Hookean step, more than {most} and no reason stated"
        for (label, precision), timing in found.items()
        if timing.ratio() > most and label not in reasons
    ]


def write(docs, found, most, reasons, minutes, complaints, machine):
    """results/laws.md and pictures/laws.png in the folder `docs`."""
    for folder in ("results", "pictures"):
        (docs / folder).mkdir(parents=True, exist_ok=True)
    plot(found, most, docs / "pictures" / "laws.png")
    first = next(iter(found.values()))
    processor, versions = machine
    intro = PAGE.format(
        minutes=minutes,
        processor=processor,
        versions=versions,
        particles=first.particles,
        rounds=len(first.ratios),
        most=most,
    )
    above = sum(timing.ratio() > most for timing in found.values())
    verdict = f"No law is above {most}." if not above else f"{above} above {most}, each with its reason."
    if complaints:
        verdict = "Musts that fail:\n\n" + "\n".join(f"- {text}" for text in complaints)
    picture = "![ns per particle-step by law](../pictures/laws.png)"
    page = "\n\n".join([intro + verdict, picture, tables(found, most, reasons)])
    pages.write(docs, "laws", page + "\n")


def plot(found, most, path):
    """A bar for each law in float32: the neo-Hookean step times its ratio, so that all are of one speed of the machine."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    timings = {label: timing for (label, precision), timing in found.items() if precision == "float32"}
    unit = timings["neo_hookean"].step()
    figure, axes = pyplot.subplots(figsize=(6.4, 0.6 + 0.23 * len(timings)), layout="constrained")
    steps = [unit * timing.ratio() for timing in timings.values()]
    own = [statistics.median(timing.alone) for timing in timings.values()]
    bars = axes.barh(range(len(steps)), steps, color="tab:blue", alpha=0.45, label="whole step")
    axes.barh(range(len(steps)), own, height=0.4, color="tab:blue", label="the law alone, in the caches")
    axes.bar_label(bars, [f"{timing.ratio():.2f}" for timing in timings.values()], fontsize=8, padding=2)
    axes.axvline(most * unit, color="tab:red", lw=1.2, label=f"{most} times neo-Hookean")
    axes.set_yticks(range(len(steps)), list(timings), fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel="ns per particle-step, float32 (times neo-Hookean)", xlim=(0, 1.15 * most * unit))
    if max(steps) > most * unit:
        axes.set_xlim(0, 1.15 * max(steps))
    axes.grid(axis="x", alpha=0.3)
    axes.set_axisbelow(True)
    figure.legend(frameon=False, fontsize=8, ncols=3, loc="outside upper center")
    figure.savefig(path, dpi=150)
