"""What NVIDIA's assembler says of a kernel: registers, stack and spills, without a card."""

import importlib.util
import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

SAID = {
    "registers": r"Used (\d+) registers",
    "stack": r"(\d+) bytes stack frame",
    "spills": r"(\d+) bytes spill stores",
    "shared": r"(\d+) bytes smem",
}


@dataclass(frozen=True)
class Assembled:
    """Of one kernel for one compute capability: registers of a thread, bytes of stack and spilled by it, bytes of shared memory
    of a block of threads, places with double arithmetic, places with atomics."""

    registers: int
    stack: int
    spills: int
    shared: int
    doubles: int
    atomics: int


def ptxas():
    """The assembler: that of the package nvidia-cuda-nvcc, which knows what its own compiler writes, else one on PATH."""
    spec = importlib.util.find_spec("nvidia")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        for found in Path(folder).glob("cu*/bin/ptxas"):
            return found
    return shutil.which("ptxas")


def assemble(ptx, capability):
    """The Assembled of a kernel's PTX. Raises RuntimeError with what the assembler complains about."""
    with tempfile.TemporaryDirectory() as folder:
        program, source = Path(folder) / "ptxas", Path(folder) / "kernel.ptx"
        source.write_text(ptx, encoding="utf-8")
        program.symlink_to(ptxas())
        known = ptxas()
        if not os.access(known, os.X_OK):  # wheels do not always keep the bit
            program.unlink()
            shutil.copy(known, program)
            program.chmod(0o755)
        target = "sm_{}{}".format(*capability)
        done = subprocess.run(
            [program, f"-arch={target}", "-v", source, "-o", Path(folder) / "kernel.cubin"],
            capture_output=True,
            text=True,
        )
    if done.returncode:
        raise RuntimeError(done.stderr)
    found = {name: int(match[1]) if (match := re.search(said, done.stderr)) else 0 for name, said in SAID.items()}
    return Assembled(**found, doubles=len(re.findall(r"\.f64", ptx)), atomics=len(re.findall(r"\b(?:atom|red)\.", ptx)))
