"""What benchmarks/verification.py prints and writes: lines, the page and its pictures."""

import pages
from cases import Check, Table, short
from kernels_page import markdown

PAGE = """# Verification

`python benchmarks/verification.py{size} --docs docs` wrote this page from what each case left behind; a case is run by itself
with `--case`, on n ranks under `mpirun -n n`. ✔ a gate is met, ✘ it is missed, no mark: there is none.

- e_u: error of the displacement, sqrt(sum V0 |x - X - u|^2 / sum V0 |u|^2), with the largest such mean of the
  exact solution; the largest over all steps unless said otherwise. e_v of the velocity, e_F of F - I likewise
- order: slope of log error over log cell size, least squares
- N: cells along the domain or body

"""


def mark(check):
    return "" if not check.judged else ("✔" if check.met else "✘")


def line(row):
    """One line of what is printed while the suite runs."""
    if isinstance(row, Check):
        return f"{mark(row) or '-'} {row.what}: {short(row.value)} ({row.gate})"
    return f"  {row.title}"


def counted(results):
    """How many checks of a case are met, and of how many."""
    judged = [row for row in results if isinstance(row, Check) and row.judged]
    return sum(row.met for row in judged), len(judged)


def overview(cases, kept):
    rows = []
    for case in cases:
        if case.name not in kept:
            rows.append((case.name, case.title, "not run", "", "", "", ""))
            continue
        found = kept[case.name]
        met, judged = counted(found["results"])
        rows.append(
            (
                f"[{case.name}](#{anchor(case)})",
                case.title,
                f"{met} of {judged} " + ("✔" if met == judged else "✘"),
                str(found["ranks"]),
                f"{found['seconds']:.0f}",
                f"{found['commit']}, {found['date']}",
                f"{found['machine']}; {found['versions']}",
            )
        )
    return markdown(("", "case", "gates met", "ranks", "s", "commit, date", "machine; versions"), rows)


def heading(case):
    return f"{case.name}: {case.title}"


def anchor(case):
    """What a heading is called in a link, as GitHub does it."""
    kept = (letter for letter in heading(case).lower() if letter.isalnum() or letter in " -_")
    return "".join(kept).replace(" ", "-")


def section(case, found, pictures):
    """Text, checks, tables and pictures of a case."""
    checks = [row for row in found["results"] if isinstance(row, Check)]
    rows = [(check.what, short(check.value), f"{check.gate} {mark(check)}".strip(), check.reason) for check in checks]
    parts = [f"## {heading(case)}", case.about.strip(), markdown(("", "measured", "gate", "why"), rows)]
    for table in (row for row in found["results"] if isinstance(row, Table)):
        cells = [[short(cell) for cell in row] for row in table.rows]
        parts += [f"{table.title}:", markdown(table.head, cells)]
    parts += [f"![{title}](../pictures/{name})" for title, name in pictures]
    return "\n\n".join(parts)


def write(docs, cases, kept, size):
    """results/verification.md and pictures/verification_*.png in the folder `docs`."""
    for folder in ("results", "pictures"):
        (docs / folder).mkdir(parents=True, exist_ok=True)
    parts = [PAGE.format(size="" if size == "standard" else f" --size {size}") + overview(cases, kept)]
    for case in cases:
        if case.name in kept:
            found = kept[case.name]
            plots = [row for row in found["results"] if not isinstance(row, Check | Table)]
            parts.append(section(case, found, [draw(docs, case, number, plot) for number, plot in enumerate(plots, 1)]))
    pages.write(docs, "verification", "\n\n".join(parts) + "\n")


def draw(docs, case, number, plot):
    """(title, name) of the picture of a plot, drawn in docs/pictures."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6.4, 4.2), layout="constrained")
    for label, (x, y) in plot.lines.items():
        marked = "o" if len(x) < 20 else ""
        axes.plot(x, y, marker=marked, ms=4, lw=1.2, label=label)
    axes.set(xlabel=plot.x, ylabel=plot.y, title=plot.title)
    axes.set_xscale("log" if plot.scale in ("loglog", "logx") else "linear")
    axes.set_yscale("log" if plot.scale in ("loglog", "logy") else "linear")
    axes.grid(alpha=0.3, which="both")
    axes.legend(frameon=False, fontsize=8)
    name = f"verification_{case.name}_{number}.png"
    figure.savefig(docs / "pictures" / name, dpi=130)
    pyplot.close(figure)
    return plot.title, name
