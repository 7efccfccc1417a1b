"""Every command of README.md and docs/ is run as it stands there, page by page and in its order, so that pages cannot rot.

Runs are cut to a few steps, by more options after those of the page; launchers of ranks and jobs are left out (that ranks
change no bit is tested elsewhere). What cannot be run in CI is in NOT_RUN, each with its reason, and nothing else is left out.
"""

import re
import shlex
from pathlib import Path

import pytest
from drop import DROP
from launch import ROOT

from pmpm.cli import main

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), ROOT / "jobs" / "README.md"]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# The file that a page says a block is put into, in the last words before it.
PUT_INTO = re.compile(r"[Pp]ut this into\s+`([\w.]+)`:\s*$")
LAUNCHER = re.compile(r"^(mpirun|srun)( -\w \d+)* (?=pmpm )")
NOT_RUN = {
    r"^python3 -m venv .venv && .*": "CI runs these two lines of the README themselves, in a clean clone",
    r"^(python3 -m venv|\. .*/activate$|pip install|HDF5_MPI=ON|module load)": "installs, on a machine that is not this one",
    r"^sbatch ": "needs Slurm: tests/slurm runs the job scripts",
    r"^python benchmarks/scaling\.py ": "measures for minutes; tests/unit/test_scaling.py and tests/slurm run it",
    r"^python docs/make_": "writes into docs/, and tests compare what it writes",
    r"--backend cuda": "needs a graphics card; tests/test_on_card.py has its kernels simulated",
}
NOT_RUN_PYTHON = {
    "docs/scene.md 3": "tests/unit/test_python_law.py runs it",
    "docs/scene.md 4": "tests/unit/test_own_law.py runs it",
    "docs/study.md 1": "sixteen runs of a scene of the reader's; tests/unit/test_study.py has smaller ones",
}
# More options, after those of the page, by which a command takes moments.
SHORTER = {
    "run": ["--steps", "3", "--quiet"],
    "study": ["--levels", "2", "--repeat", "1", "--transfer", "apic", "--until", "0.002", "--quiet"],
    "render": ["--quiet"],
}
# What a page takes for granted, put there before its first command: files, and commands.
FILES = {
    "README.md": {"my_scene.toml": None},
    "docs/reliability.md": {"SCENE": DROP},
    "docs/clusters.md": {"scene.toml": DROP},
}
BEFORE = {
    "README.md": ["pmpm run dam_break"],
    "docs/reliability.md": ["pmpm run SCENE --out DIR"],
    "docs/api.md": [],
    "docs/paraview.md": ["pmpm run dam_break_3d"],
}
# Runs of the gallery are those of docs/make_gallery.py, which calls these very commands: here scenes are checked.
ONLY_CHECKED = ("docs/gallery.md",)


def name_of(page):
    return str(page.relative_to(ROOT))


def blocks_of(page):
    """[(language, text, what stands before it)] of the fenced blocks of a page."""
    text = page.read_text(encoding="utf-8")
    return [(found[1], found[2], text[: found.start()]) for found in BLOCK.finditer(text)]


def commands_of(page):
    """The lines of a page's shell blocks without comments, backslashes joined."""
    text = "".join(block for language, block, _ in blocks_of(page) if language in ("sh", "console"))
    lines = [re.sub(r"(^|\s+)#.*", "", line).strip() for line in text.replace("\\\n", " ").splitlines()]
    return [line.removeprefix("$ ") for line in lines if line]


def reason(line):
    """Why a command is not run; None if it is."""
    return next((why for pattern, why in NOT_RUN.items() if re.search(pattern, line)), None)


def lay_out(page, folder):
    """Put into a folder what a page says or takes for granted."""
    given = FILES.get(name_of(page), {})
    tables = [text for language, text, _ in blocks_of(page) if language == "toml"]
    for file, text in given.items():
        (folder / file).write_text(text or tables[0], encoding="utf-8")
    for _, text, before in blocks_of(page):
        if found := PUT_INTO.search(before):
            (folder / found[1]).write_text(text, encoding="utf-8")


def run(line, page, capsys):
    """Run one `pmpm` command in this process; its exit status must be 0."""
    command, _, into = LAUNCHER.sub("", line).partition(" > ")
    arguments = shlex.split(command)[1:]
    found = re.search(r"checkpoints/(\d+)\.hdf", command)
    if found:  # whatever number the page has taken from a run of its own
        newest = sorted(Path("DIR/checkpoints").glob("*.hdf"))[-1].stem
        arguments = [argument.replace(found[1], newest) for argument in arguments]
    if name_of(page) in ONLY_CHECKED:
        if arguments[0] != "run":
            return
        arguments = ["check", *arguments[1:]]
    else:
        arguments += SHORTER.get(arguments[0], [])
    try:
        status = main(arguments)
    except SystemExit as end:  # of --help, and of options that are wrong
        status = end.code or 0
    said = capsys.readouterr()
    assert status == 0, f"{line}\n{said.err}{said.out[-2000:]}"
    if into:
        Path(into).write_text(said.out, encoding="utf-8")


@pytest.mark.parametrize("page", [page for page in PAGES if commands_of(page)], ids=name_of)
def test_every_command_of_a_page_works(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PMPM_MEMORY_LIMIT", str(1 << 40))
    lay_out(page, tmp_path)
    for line in [*BEFORE.get(name_of(page), ()), *commands_of(page)]:
        if reason(line) is None:
            assert re.match(r"pmpm ", LAUNCHER.sub("", line)), f"{line}: is neither run nor in NOT_RUN"
            run(line, page, capsys)


def test_what_is_not_run_is_still_there_and_has_a_reason():
    lines = [line for page in PAGES for line in commands_of(page)]
    left = {line: reason(line) for line in lines if reason(line)}
    print("\n".join(f"not run: {line}\n    {why}" for line, why in left.items()))
    for pattern, why in NOT_RUN.items():
        assert why
        assert any(re.search(pattern, line) for line in lines), f"{pattern}: no page has such a command any more"
    assert len(left) < len(lines) / 2


def python_blocks(page):
    """{name of the page and number: block} of its Python, those that are not run left out."""
    texts = [text for language, text, _ in blocks_of(page) if language == "python"]
    named = {f"{name_of(page)} {number}": text for number, text in enumerate(texts, 1)}
    return {name: text for name, text in named.items() if name not in NOT_RUN_PYTHON}


@pytest.mark.parametrize("page", [page for page in PAGES if python_blocks(page)], ids=name_of)
def test_the_python_of_a_page_works(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    lay_out(page, tmp_path)
    for line in [*BEFORE.get(name_of(page), ()), *(line for line in commands_of(page) if "pmpm run" in line)][:3]:
        if reason(line) is None:
            run(line, page, capsys)
    for number, text in python_blocks(page).items():
        module = tmp_path / f"block_{number.split()[-1]}.py"
        module.write_text(text, encoding="utf-8")  # functions of laws are compiled from their source
        exec(compile(text, str(module), "exec"), {"__name__": "__main__"})


def test_python_that_is_not_run_is_still_there():
    counted = {name_of(page): sum(b[0] == "python" for b in blocks_of(page)) for page in PAGES}
    for name in NOT_RUN_PYTHON:
        page, number = name.split()
        assert int(number) <= counted[page], name
