"""The pictures of docs/results/work_precision.md: error over time, particle-steps and step."""

from dataclasses import replace

from precision_plan import COMMON, DT_SWEEP, DT_TRANSFERS, FAST, SWEPT_CELLS, Point

COLOURS = {"pic": "tab:gray", "flip 1": "tab:red", "flip 0.95": "tab:orange", "aflip 0.99": "tab:purple"}
COLOURS |= {"apic": "tab:green", "mls": "tab:blue"}
PEER_COLOURS = {"taichi": "black", "warp": "tab:brown", "kratos": "tab:cyan"}
LOAD_STEP_DASHES = {"static 1": "-", "static 4": "--", "static 16": ":"}
DASHES = {"linear": ":", "quadratic": "-", "cubic": "--"}


def look(point):
    """Colour, dashes and label of a scheme's line."""
    if point.code != "pmpm":
        if point.code == "kratos":
            return PEER_COLOURS["kratos"], LOAD_STEP_DASHES[point.transfer], f"kratos {point.transfer}"
        dashes = "-" if point.precision == "float32" else "--"
        return PEER_COLOURS[point.code], dashes, f"{point.code} {point.precision}"
    blend = "" if point.blend is None else f" {point.blend:g}"
    name = f"{point.transfer}{blend}"
    if point.precision == "float32":
        return "deepskyblue", DASHES[point.degree], f"{name} {point.degree} float32"
    return COLOURS[name], DASHES[point.degree], f"{name} {point.degree}"


def drawn(found, case, cfl):
    """Lines of a case at a step: every transfer and spline at 2 per direction, and peers."""
    lines = [runs for (_, at), runs in found.series(case).items() if at == cfl or (at == 0.0 and cfl == FAST)]
    return [runs for runs in lines if runs[0].point.per_direction == 2]


def plot_lines(axes, found, case, across):
    """Error over `across(run)`; thin at the common step, with markers at the fast one."""
    for cfl, width, size, alpha in ((COMMON, 0.7, 1.5, 0.5), (FAST, 1.3, 3.0, 1.0)):
        for runs in drawn(found, case, cfl):
            colour, dashes, _ = look(runs[0].point)
            x, y = [across(run) for run in runs], [run.error for run in runs]
            axes.plot(x, y, dashes, color=colour, lw=width, marker="o", ms=size, alpha=alpha)
    logarithmic(axes)


def logarithmic(axes):
    """Both axes, with labels that do not run into each other on short ones."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set(xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=(1.0, 3.0) if high < 30.0 * low else (1.0,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3)


def bars(axes, found, case):
    """From the fastest to the slowest run."""
    for runs in drawn(found, case, FAST):
        for run in runs:
            axes.plot([min(run.times), max(run.times)], [run.error] * 2, color=look(run.point)[0], lw=2.5, alpha=0.3)


def legend_of(found, cases, pyplot):
    """Handles and labels of all lines in these cases."""
    looks = {}
    for case in cases:
        for cfl in (COMMON, FAST):
            for runs in drawn(found, case, cfl):
                colour, dashes, label = look(runs[0].point)
                looks[label] = pyplot.Line2D([], [], color=colour, ls=dashes)
    ordered = sorted(looks, key=lambda label: [label.split()[0] in PEER_COLOURS, label])
    return [looks[label] for label in ordered], ordered


def plot_main(found, path):
    """The waves in 2-D: error over time, over particle-steps, and over the step at a fixed grid."""
    pyplot = headless()
    figure, (by_time, by_work, by_step) = pyplot.subplots(1, 3, figsize=(13, 5.2), layout="constrained", sharey=True)
    case = "waves 2-D" if "waves 2-D" in found.cases else found.cases[0]
    plot_lines(by_time, found, case, lambda run: run.seconds)
    bars(by_time, found, case)
    by_time.set(xlabel="seconds of stepping, one core", ylabel="e_u, largest over time", title=f"{case}: time")
    plot_lines(by_work, found, case, lambda run: run.particle_steps)
    by_work.set(xlabel="particle-steps", title="work, on any machine")
    for transfer, blend in DT_TRANSFERS:
        point = Point("waves 2-D", SWEPT_CELLS, transfer=transfer, blend=blend)
        runs = [run for cfl in DT_SWEEP if (run := found.runs.get(replace(point, cfl=cfl)))]
        if runs:
            colour, dashes, _ = look(point)
            x, y = [run.point.cfl for run in runs], [run.error for run in runs]
            by_step.plot(x, y, dashes, color=colour, marker="o", ms=3)
            if max(x) < max(DT_SWEEP):
                by_step.plot(x[-1], y[-1], "x", color=colour, ms=9)
    by_step.set(xlabel="cfl", title=f"the step, at {SWEPT_CELLS} cells (x: longer ones stop)")
    logarithmic(by_step)
    figure.legend(*legend_of(found, [case], pyplot), frameon=False, fontsize=8, ncols=7, loc="outside lower center")
    figure.suptitle(f"thick: cfl {FAST:g}; thin: cfl {COMMON:g}", fontsize=9)
    figure.savefig(path, dpi=130)
    pyplot.close(figure)


def plot_cases(found, path):
    """Error over time in the other cases."""
    pyplot = headless()
    cases = [case for case in found.cases if case != "waves 2-D"] or found.cases
    rows = -(-len(cases) // 3)
    figure, panels = pyplot.subplots(rows, 3, figsize=(13, 3.8 * rows), layout="constrained", squeeze=False)
    for axes, case in zip(panels.flat, cases, strict=False):
        plot_lines(axes, found, case, lambda run: run.seconds)
        axes.set(title=case, xlabel="seconds of stepping", ylabel="e_u")
    for axes in panels.flat[len(cases) :]:
        axes.set_axis_off()
    figure.legend(*legend_of(found, cases, pyplot), frameon=False, fontsize=8, ncols=7, loc="outside lower center")
    figure.savefig(path, dpi=130)
    pyplot.close(figure)


def headless():
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot
