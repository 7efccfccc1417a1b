"""A law as a scene gives it from Python: its functions, what a particle keeps, and the copies of them that kernels call.

Every function takes the deformation gradient F first, and then by name what it needs, in any order: state variables and
parameters, and `advance` also G and dt. Kernels know a state as one flat tuple and the parameters as another; `bound` writes
the functions that take those apart.
"""

from dataclasses import dataclass
from functools import cache
from types import FunctionType
from typing import Any

from pmpm.physics import tensors2
from pmpm.physics.materials.keys import StateField

FUNCTIONS = ("stress", "advance", "energy", "wave_speed", "valid")
OF_A_STEP = ("G", "dt")  # what advance takes besides


@dataclass(frozen=True, repr=False)
class Law:
    """A constitutive law of your own, for the `model` of a material: see 'A law of your own' in docs/scene.md.

    `stress`: Kirchhoff stress in Pa. `state`: what a particle keeps besides F, name -> value at rest, a number or a tuple of
    numbers. `advance`: F and the state variables after a step; without it F follows the motion and the others stay.
    `energy` in J/m3, `wave_speed` in m/s, `valid`: whether a state has a meaning; all three may be left out.
    """

    stress: Any
    advance: Any = None
    energy: Any = None
    wave_speed: Any = None
    valid: Any = None
    state: Any = ()
    name: str | None = None

    def __post_init__(self):
        if isinstance(self.state, dict):
            own = tuple((name, tuple(rest) if isinstance(rest, list) else rest) for name, rest in self.state.items())
            object.__setattr__(self, "state", own)

    def __repr__(self):
        return f"Law {self.title}"

    @property
    def title(self):
        return self.name or getattr(self.stress, "__name__", "law")

    @property
    def functions(self):
        """Those that are given, by name."""
        return {name: getattr(self, name) for name in FUNCTIONS if getattr(self, name) is not None}

    @property
    def own(self):
        """Name -> values at rest, a tuple, of what a particle keeps besides F."""
        return {name: rest if isinstance(rest, tuple) else (rest,) for name, rest in self.state}

    @property
    def own_size(self):
        return sum(map(len, self.own.values()))

    @property
    def fields(self):
        """The StateFields of what a particle keeps besides F."""
        return tuple(
            StateField(name, "numbers" if isinstance(rest, tuple) else "scalar", "-", f"state of {self.title}", rest)
            for name, rest in self.state
        )

    @property
    def parameters(self):
        """Name -> default, or None, of the keys that a material of this law has besides its density."""
        found = {}
        for kind, function in self.functions.items():
            names = argument_names(function)
            defaults = function.__defaults__ or ()
            given = dict(zip(names[len(names) - len(defaults) :], defaults, strict=True)) if defaults else {}
            for name in names[1:]:
                if name not in self.own and not (kind == "advance" and name in OF_A_STEP):
                    found[name] = given.get(name) if found.get(name) is None else found[name]
        return found


def argument_names(function):
    """Names of a function's arguments, F the first."""
    return function.__code__.co_varnames[: function.__code__.co_argcount]


def of_model(model):
    """The Law of a model, which may be a function of F that gives the stress."""
    return model if isinstance(model, Law) else Law(model)


def call_text(law, kind):
    """The call of one of the functions, on `state` and `params` as kernels know them; params begin with another number."""
    places, first = {}, 0
    for name, rest in law.state:
        size = len(rest) if isinstance(rest, tuple) else 1
        places[name] = f"la.after_tensor(state)[{f'{first}:{first + size}' if isinstance(rest, tuple) else first}]"
        first += size
    for number, name in enumerate(law.parameters):
        places[name] = f"params[{number + 1}]"
    if kind == "advance":
        places |= {name: name for name in OF_A_STEP}
    names = argument_names(law.functions[kind])[1:]
    return f"given({', '.join(['la.tensor_part(state)', *(places[name] for name in names)])})"


def written(name, arguments, lines, **known):
    """A function from its text, which the targets compile as if it stood in this file."""
    space = {"__name__": __name__, "la": tensors2, **known}
    exec("\n    ".join([f"def {name}({arguments}):", *lines]), space)
    function = space[name]
    assert isinstance(function, FunctionType)
    return function


@cache
def raw(law, kind):
    """One of the functions, of flat tuples, returning what it returns."""
    arguments = {"advance": "state, G, dt, params", "valid": "state"}.get(kind, "state, params")
    return written(f"given_{kind}", arguments, [f"return {call_text(law, kind)}"], given=law.functions[kind])


@cache
def bound(law):
    """The choices of `python_law` for a law: name -> function of flat tuples, or flag."""
    functions = law.functions
    found = {
        "OWN_STATE": law.own_size > 0,
        "ADVANCES": "advance" in functions,
        "KNOWS_ENERGY": "energy" in functions,
        "KNOWS_SPEED": "wave_speed" in functions,
        "CHECKS": "valid" in functions or law.own_size > 0,
        "user_stress": raw(law, "stress"),
    }
    if "energy" in functions:
        found["user_energy"] = raw(law, "energy")
    if "wave_speed" in functions:
        found["user_wave_speed"] = raw(law, "wave_speed")
    if law.own_size:
        rest = ", ".join(f"zero + {float(number)!r}" for numbers in law.own.values() for number in numbers)
        found["user_rest"] = written("user_rest", "zero", [f"return ({rest},)"])
    if "advance" in functions:
        found["user_advance"] = flat_advance(law)
    if found["CHECKS"]:
        own = [f"(own[{n}] - own[{n}] == 0.0)" for n in range(law.own_size)]
        lines = ["own = la.after_tensor(state)"] if own else []
        checks = own + ([call_text(law, "valid")] if "valid" in functions else [])
        lines.append(f"return {' & '.join(checks)}")
        found["user_valid"] = written("user_valid", "state", lines, given=functions.get("valid"))
    return found


def flat_advance(law):
    """`advance` with a flat tuple for the new state. A constant that it returns becomes a number of the particle."""
    lines = [f"new = {call_text(law, 'advance')}"]
    if law.own_size:
        entries = []
        for variable, (_, rest) in enumerate(law.state, 1):
            entries += (
                [f"new[{variable}][{n}]" for n in range(len(rest))] if isinstance(rest, tuple) else [f"new[{variable}]"]
            )
        kept = ", ".join(f"(own[{n}] - own[{n}]) + {entry}" for n, entry in enumerate(entries))
        lines += ["own = la.after_tensor(state)", f"return new[0] + ({kept},)"]
    else:
        lines.append("return new")
    return written("user_advance", "state, G, dt, params", lines, given=law.functions["advance"])
