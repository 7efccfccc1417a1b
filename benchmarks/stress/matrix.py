"""What the matrix is made of: schemes (its columns), cases (its rows) with their variants, and entries, one run each."""

from collections.abc import Callable
from dataclasses import dataclass, field

SURVIVES, STOPPED, FAILED = "S", "E", "F"


@dataclass(frozen=True)
class Scheme:
    """One column."""

    transfer: str
    shape_function: str
    precision: str = "float64"

    def __str__(self):
        return f"{self.transfer} {self.shape_function} {self.precision}"

    @property
    def method(self):
        return {"transfer": self.transfer, "shape_function": self.shape_function, "precision": self.precision}

    @property
    def single(self):
        return self.precision == "float32"

    @property
    def linear(self):
        return self.shape_function == "linear"

    @property
    def held(self):
        """Whether what a row expects is promised: the others are measured as well."""
        return self.transfer in ("apic", "mls") and not self.linear and not self.single


SPLINES = ("linear", "quadratic", "cubic")
TRANSFERS = ("pic", "flip", "aflip", "apic", "mls")
DOUBLE = tuple(Scheme(t, s) for t in TRANSFERS for s in SPLINES if (t, s) != ("mls", "linear"))
SINGLE = tuple(Scheme(s.transfer, s.shape_function, "float32") for s in DOUBLE)
DEFAULT = (Scheme("apic", "quadratic"),)
QUICK = tuple(Scheme(t, s) for t, s in (("apic", "quadratic"), ("mls", "cubic"), ("flip", "quadratic")))


@dataclass(frozen=True, eq=False)
class Case:
    """One kind of run. `run(scheme, variant)` returns what `judge` makes; `expect`: the verdicts that are as they should be,
    of all variants or of each. Linear splines may always stop: their stable step goes to zero at free surfaces.
    """

    row: str
    name: str
    what: str
    variants: tuple[str, ...]
    run: Callable
    expect: str | dict = SURVIVES
    schemes: tuple[Scheme, ...] = DOUBLE
    quick: int = 2  # this many variants, the first and the last of them, with --quick
    limit: float = 120.0  # s of one run
    environment: dict = field(default_factory=dict)

    def expected(self, scheme, variant):
        expect = self.expect if isinstance(self.expect, str) else self.expect.get(variant, SURVIVES)
        return expect + (STOPPED if scheme.linear else "")

    def quick_variants(self):
        count = len(self.variants)
        return tuple(
            self.variants[round(n * (count - 1) / max(self.quick - 1, 1))] for n in range(min(self.quick, count))
        )


@dataclass(frozen=True)
class Entry:
    """One run."""

    case: Case
    scheme: Scheme
    variant: str

    def __str__(self):
        return f"{self.case.row} {self.case.name}, {self.variant}, {self.scheme}"

    @property
    def key(self):
        text = f"{self.case.row}.{self.case.name}.{self.variant}.{self.scheme}"
        return "".join(c if c.isalnum() or c in "._=-+" else "_" for c in text)

    @property
    def expected(self):
        return self.case.expected(self.scheme, self.variant)
