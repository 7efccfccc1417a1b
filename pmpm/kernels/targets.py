"""One plain Python source, several targets: copies of the physics with the target's words, precision and the scene's choices.

`Target.compile(function)` copies a function and, recursively, every plain function it names. Each copy sees
  - the target's words (`where`, `exp`, ...) and the scene's choices (`la = tensors2`, `MLS = True`) as globals, which numba
    reads as constants, so that what a scene does not choose is removed before it is typed;
  - its decimal literals in the scene's precision: `0.5 * x` stays float32.
`__qualname__` carries the target and a hash over everything the copy reaches. numba's own cache key ignores globals and other
files; the hash repairs both, so that a second process finds the compiled kernel and an edited law misses.
This file and parts.py are the ones that lean on numba's internals; pyproject.toml pins numba for them.
"""

import dis
import hashlib
import math
import os
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from pmpm.physics import words

FAST = {"contract", "nsz"}  # never nnan or ninf: guards such as `abs(x) <= limit` must hold for nan
PRECISION_WORDS: dict = {
    np.dtype("float32"): {
        "EPS": 2.0**-23,
        "TINY": 1e-19,
        "SWEEPS": 5,
        "HALLEY_STEPS": 3,
        "EXPM1_OF_TWICE": words.EXPM1_OF_TWICE[-12:],
        "EXP_OF_TWICE_LESS_EXP": words.EXP_OF_TWICE_LESS_EXP[-11:],
        "ATANH_OVER_ROOT": words.ATANH_OVER_ROOT[-11:],
    },
    np.dtype("float64"): {
        name: getattr(words, name)
        for name in (
            "EPS",
            "TINY",
            "SWEEPS",
            "HALLEY_STEPS",
            "EXPM1_OF_TWICE",
            "EXP_OF_TWICE_LESS_EXP",
            "ATANH_OVER_ROOT",
        )
    },
}
ENTRY, CALLED, PART = "entry", "called", "part"  # called by Python and kept on disk, only called, only called by others
PARTS: dict = {}  # compiled in this process, by module and name
OUTSIDE = ("numba", "numpy", "math", "builtins")  # modules whose functions are taken as they are


def in_precision(value, real):
    """`value` with every float in it, also inside tuples, as a `real`."""
    if isinstance(value, float):
        return real(value)
    if isinstance(value, tuple):
        return tuple(in_precision(item, real) for item in value)
    return value


def in_pmpm(module):
    return (module or "").startswith("pmpm.")


def bound_copy(function, mark, real, names):
    """A copy of `function` with the globals `names` replaced, literals in precision `real`, and `mark` in its name."""
    if function.__closure__:
        raise TypeError(f"{function.__name__} must not close over variables: make them arguments or module-level names")
    code = function.__code__.replace(co_consts=tuple(in_precision(c, real) for c in function.__code__.co_consts))
    copy = FunctionType(code, function.__globals__ | names, function.__name__, function.__defaults__)
    copy.__qualname__ = f"{function.__name__}_{mark}"
    # A compiled kernel found on disk imports the modules of all it was made of: a user's may be missing in that process.
    copy.__module__ = function.__module__ if in_pmpm(function.__module__) else __name__
    return copy


def globals_named_in(function):
    """Names that a function loads from its module: not those of attributes, which may be called like the function itself."""
    return {step.argval for step in dis.get_instructions(function) if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")}


def means_word(owner, name, value):
    """Whether a word of the target may take the place of `name` in the module `owner`, where it stands for `value`.

    In pmpm always; in a user's module where it is pmpm's, math's or built in: a user's own ROW or weights stays.
    """
    if in_pmpm(owner) or value is None or value is getattr(words, name, None):
        return True
    origin = str(getattr(value, "__module__", None) or getattr(value, "__name__", ""))
    return origin == "math" or origin.startswith("pmpm.physics")


class Target:
    """A way to compile: `label` and `real` (a numpy scalar type), `target_words`, `jit(function, role)`, and choices.

    `sources`: fingerprint of everything else the result depends on.
    """

    def __init__(self, label, real, target_words, jit, choices, sources=""):
        self.sources = sources
        self.label, self.real, self.jit = f"{label}_{np.dtype(real).name}", real, jit
        self.words = {
            name: in_precision(value, real)
            for name, value in (target_words | PRECISION_WORDS[np.dtype(real)] | choices).items()
        }
        self.compiled = {}

    def compile(self, function):
        """The specialisation of a plain function, for Python to call."""
        return self.specialise(function, CALLED)[0]

    def entry(self, function):
        """The same, which numba's targets keep in the cache on disk."""
        return self.specialise(function, ENTRY)[0]

    def specialise(self, function, role=PART):
        """(compiled copy, fingerprint of everything it reaches)."""
        key = function, role
        if key not in self.compiled:
            code = function.__code__
            names, marks = (
                {},
                [self.label, self.sources, code.co_code.hex(), repr(code.co_names), repr(code.co_consts)]
                + [repr(function.__defaults__)],
            )
            for name in sorted(globals_named_in(function)):
                if name in self.words or name in function.__globals__:
                    own = function.__globals__.get(name)
                    names[name], mark = self.replace(function.__module__, name, own, set(code.co_names))
                    marks.append(f"{name}:{mark}")
            digest = hashlib.sha256("|".join(marks).encode()).hexdigest()[:12]
            copy = bound_copy(function, f"{self.label}_{digest}", self.real, names)
            self.compiled[key] = self.jit(copy, role), digest
        return self.compiled[key]

    def replace(self, owner, name, value, names):
        """(replacement, fingerprint) of the global `name` of the module `owner`, in a function that uses `names`."""
        if means_word(owner, name, value):
            value = self.words.get(name, value)
        if isinstance(value, FunctionType) and value.__module__.split(".")[0] not in OUTSIDE:
            return self.specialise(value, PART)
        if isinstance(value, float):
            value = self.real(value)
        if isinstance(value, ModuleType) and value.__name__.split(".")[0] not in OUTSIDE[:2]:
            space, marks = ModuleType(f"{value.__name__}_{self.label}"), []
            for attribute in sorted(names & set(vars(value))):
                inside, mark = self.replace(value.__name__, attribute, getattr(value, attribute), names)
                setattr(space, attribute, inside)
                marks.append(f"{attribute}:{mark}")
            return space, "".join(marks)
        return in_precision(value, self.real), getattr(value, "__qualname__", None) or repr(value)


def jit(function, role):
    """Compile with numba: entries are kept on disk, parts become part of them.

    Copies of one name are the same all through: what one kernel has compiled of a part serves the others of this process.
    """
    import numba

    from pmpm.kernels import parts

    options: dict[str, Any] = {"error_model": "numpy", "fastmath": FAST, "boundscheck": None}
    if role == PART:
        name = function.__module__, function.__qualname__
        if name not in PARTS:
            PARTS[name] = parts.Part(function, options | {"forceinline": True})
        return PARTS[name]
    options |= {"cache": role == ENTRY, "nogil": True, "no_cfunc_wrapper": True}
    return numba.njit(function, pipeline_class=parts.EntryCompiler, **options)


def scalar(real, **choices):
    """Scalar numba on the CPU: the readable reference."""
    return Target("scalar", real, {"floor": np.floor, "real": real}, jit, choices, intrinsics())


def intrinsics():
    """Fingerprint of what the kernels reach that is not plain Python."""
    files = (Path(__file__).with_name(name) for name in ("lanes.py", "parts.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def lanes(real, **choices):
    """Numba on SIMD lanes: a value is a block of 16 particles."""
    from pmpm.kernels import lanes as words_of_lanes

    lane_words = {"where": words_of_lanes.where, "any_of": words_of_lanes.any_of, "floor": math.floor, "real": real}
    return Target("lanes", real, lane_words, jit, choices, intrinsics())


def cuda(real, **choices):
    """numba on graphics cards: one particle per thread. Parts are plain functions where the card is simulated."""
    from numba import cuda as card

    def compile_for_card(function, role):
        if role == PART:
            return function if card_is_simulated() else card.jit(function, device=True, forceinline=True)
        return card.jit(function, cache=role == ENTRY and not card_is_simulated())

    words_of_card = {"floor": math.floor, "real": real, "word": np.uint32}
    return Target("cuda", real, words_of_card, compile_for_card, choices)


def card_is_simulated():
    """Whether numba runs CUDA kernels in Python: NUMBA_ENABLE_CUDASIM=1."""
    import numba

    return bool(numba.config.ENABLE_CUDASIM)  # type: ignore[attr-defined]


def arrays(real, **choices):
    """Plain numpy over whole arrays, nothing compiled: for output and measurements, off the hot path."""
    array_words = {
        name: getattr(np, name)
        for name in ("where", "floor", "sqrt", "exp", "log", "expm1", "log1p", "sin", "cos", "abs")
    }
    array_words |= {"min": np.minimum, "max": np.maximum, "any_of": np.any, "real": real}
    return Target("arrays", real, array_words, lambda function, role: function, choices)


def plain(**choices):
    """The source as it is, on Python floats: what tests compare the others with."""
    return Target("plain", np.float64, {"real": float}, lambda function, role: function, choices)


def count_cache(kernels):
    """(how many signatures of these entry kernels were compiled, how many came from the cache on disk)."""
    stats = [kernel.stats for kernel in dict.fromkeys(kernels) if hasattr(kernel, "stats")]
    return sum(sum(s.cache_misses.values()) for s in stats), sum(sum(s.cache_hits.values()) for s in stats)


def use_cache_folder():
    """Keep compiled kernels in PMPM_CACHE_DIR, or in the user's cache folder; call it before the first kernel is made.

    Not beside the source, as numba would: an uninstalled package would leave them behind, and the folder they lie in would
    then pass for an empty package. Where the folder cannot be written, numba looks for another place.
    """
    import numba

    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = os.environ.get("PMPM_CACHE_DIR") or os.path.join(home, "pmpm")
    numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]
