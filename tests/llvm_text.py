"""Arithmetic of one precision in the LLVM text of a compiled function."""

import re

ARITHMETIC = r"\bf(add|sub|mul|div|rem|neg|cmp)\b[^\n]*\b{0}\b"  # of single numbers and of vectors: <16 x double>
CALLS = (
    r"\bcall\b[^\n@]*\b{0}>? @(?!PyFloat_)"  # llvm.fmuladd, llvm.sqrt ...; Python's floats are double, kernels are not
)


def arithmetic_in(text, kind):
    return [match.group() for part in (ARITHMETIC, CALLS) for match in re.finditer(part.format(kind), text)]
