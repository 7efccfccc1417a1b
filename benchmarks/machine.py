"""What a page of results says of where its figures come from: processor, cores, versions, commit, date."""

import datetime
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pmpm.studies.report import machine as processor

PACKAGES = ("numba", "numpy")


def versions(packages=PACKAGES):
    """Python's and those of the packages that are installed."""
    found = [f"Python {platform.python_version()}"]
    for name in packages:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)


def commit():
    """Short hash of the source, with a + where files have changed since; "unknown" outside a repository."""
    try:
        return subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--exclude=*"],
            cwd=Path(__file__).parent, capture_output=True, text=True, check=True,
        ).stdout.strip()  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def text(packages=PACKAGES):
    """All of it in a line."""
    return f"{processor()}; {versions(packages)}; commit {commit()}, {datetime.date.today().isoformat()}"
