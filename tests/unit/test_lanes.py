"""The words of the loops on SIMD lanes: each means for 16 numbers at once what it means in Python for one.

What belongs to one element type is compiled as one function, because compiling takes longer than all else here.
"""

import functools
import math
from math import cos, exp, expm1, log, log1p, sin, sqrt

import law_examples
import numba
import numpy as np
import pytest
from llvm_text import arithmetic_in

from pmpm.kernels import lanes, targets
from pmpm.kernels.lane_loops import FIELD_TUPLES, put
from pmpm.kernels.lanes import (
    flush_denormals,
    in_all_lanes,
    lanes_below,
    largest_lane,
    load,
    load_repeated,
    load_transposed,
    prefetch,
    repeat_mass,
    restore_denormals,
    store,
    store_quads,
    sum_nodes,
    to_int32,
    to_integer,
    to_real,
    with_mass_of,
)
from pmpm.physics import hencky, words
from pmpm.physics.materials import neo_hookean
from pmpm.physics.words import any_of, where

REALS, INTEGERS = (np.float32, np.float64), (np.int32, np.int64)
REAL_OF = {np.int32: np.float32, np.int64: np.float64}
INTEGER_OF = {np.float32: np.int32, np.float64: np.int64}
on_each_real = pytest.mark.parametrize("real", REALS)
on_each_element = pytest.mark.parametrize("element", REALS + INTEGERS)


def compile_lanes(function, element, **choices):
    """A function of arrays, compiled as the kernels are; its decimal literals become `element` or the real beside it."""
    return targets.lanes(REAL_OF.get(element, element), **choices).compile(function)


# ---- words that treat each lane by itself -------------------------------------------------------------------------------


def added(x, y):
    x += y
    return x


def subtracted(x, y):
    x -= y
    return x


def multiplied(x, y):
    x *= y
    return x


def divided(x, y):
    x /= y
    return x


def both(m, n):
    m &= n
    return m


def either(m, n):
    m |= n
    return m


NUMBERS = (
    "x + y", "x - y", "x * y", "-x", "+x", "min(x, y)", "max(x, y)", "added(x, y)", "subtracted(x, y)", "multiplied(x, y)",
    "x + 3", "3 - x", "x * 2", "min(x, 1)", "max(1, x)",
    "where(x < y, x, y)", "where(x < y, 5, y)", "where(x < y, x, 5)", "where(yes, x, y)", "where(no, x, y)",
    "where(yes, x, 5)", "where(no, x, 5)",
)  # fmt: skip
ONLY_REALS = (
    "x / y", "divided(x, y)", "abs(x)", "fabs(x)", "sqrt(x)", "floor(x)", "x + 0.1", "0.1 - x", "x / 3.0", "3.0 / x",
    "min(x, 0.1)", "max(0.1, x)", "where(x < 0.1, 0.1, x)", "where(x < y, 0.1, 0.2)",
)  # fmt: skip
ONLY_INTEGERS = ("x << 3", "x >> 1", "x >> 3", "(x - y) >> 2")
TRUTHS = (
    "x < y", "x <= y", "x > y", "x >= y", "x == y", "x != y", "x < 1", "1 < x", "x != x",
    "(x < y) & (x < 1)", "(x < y) | (x < 1)", "~(x < y)", "~(x < y) & (y != 1)", "both(x < y, x < 1)", "either(x < y, x < 1)",
)  # fmt: skip
SOME_REALS = (0.0, -0.0, 1.0, -1.0, 0.1, 0.7, -0.7, 2.5, -2.5, 3.0, 1e-30, 1e30, 123456.7, np.inf, -np.inf, np.nan)
SOME_INTEGERS = (0, 1, -1, 2, -2, 3, -3, 7, -7, 8, -8, 9, 1000, -1000, 32767, -32768)
IN_PYTHON = {
    "sqrt": np.sqrt, "floor": np.floor, "fabs": abs, "added": added, "subtracted": subtracted, "multiplied": multiplied,
    "divided": divided, "both": both, "either": either, "where": where, "yes": np.True_, "no": np.False_,
}  # fmt: skip


def expressions(element):
    """{expression: what is stored of it}."""
    own = ONLY_REALS if element in REALS else ONLY_INTEGERS
    return {e: e for e in NUMBERS + own} | {e: f"where({e}, ONE, ZERO)" for e in TRUTHS}


@functools.cache
def each_lane(element):
    """{expression: its values on lanes}, and the x and y they were computed of: every pair of some numbers."""
    stored = expressions(element)
    source = "def all_words(a, b, yes, no, out):\n for k in range(16):\n  x, y = load(a, 16 * k), load(b, 16 * k)\n"
    for row, value in enumerate(stored.values()):
        source += f"  store(out, 16 * (16 * {row} + k), {value})\n"
    space = globals() | {"fabs": math.fabs, "floor": words.floor, "ONE": element(1), "ZERO": element(0)}
    exec(source, space)
    some = np.array(SOME_REALS if element in REALS else SOME_INTEGERS, element)
    x, y = np.tile(some, 16), np.repeat(some, 16)
    out = np.full((len(stored), 256), 77, element)
    compile_lanes(space["all_words"], element)(x, y, True, False, out.reshape(-1))
    return dict(zip(stored, out, strict=True)), x, y


@pytest.mark.parametrize(
    ("element", "expression"),
    [(e, text) for e in REALS + INTEGERS for text in expressions(e)],
    ids=lambda part: getattr(part, "__name__", part),
)
def test_a_word_gives_in_each_lane_what_python_gives(element, expression):
    """Bit by bit, nan and infinity included; only the sign of zero is left open."""
    results, xs, ys = each_lane(element)
    with np.errstate(all="ignore"):
        expected = [eval(expression, IN_PYTHON | {"x": x, "y": y}) for x, y in zip(xs, ys, strict=True)]
    np.testing.assert_array_equal(results[expression], np.array(expected).astype(element))


# ---- words across lanes -------------------------------------------------------------------------------------------------


def across(values, limit, count, out):
    x = load(values, 0)
    out[0] = largest_lane(x)
    out[1] = 1 if any_of(x > limit) else 0
    out[2] = 1 if any_of(out[0] > limit) else 0
    store(out, 16, where(lanes_below(count), x, in_all_lanes(limit)))


@functools.cache
def compiled_across(element):
    return compile_lanes(across, element)


def results_across(element, values, limit=0, count=0):
    out = np.zeros(32, element)
    compiled_across(element)(np.array(values, element), element(limit), count, out)
    return out


@on_each_element
def test_the_largest_lane_is_found_in_every_place(element):
    for first in range(16):
        values = np.roll(np.arange(-8, 8), first)
        assert results_across(element, values)[0] == 7


@on_each_element
def test_any_of_sees_one_lane_among_16_in_every_place(element):
    for place in range(16):
        values = np.arange(16) == place
        assert results_across(element, values)[1] == 1
        assert results_across(element, values, 1)[1] == 0


@on_each_element
def test_any_of_a_plain_truth_is_that_truth(element):
    assert results_across(element, np.full(16, 3), 2)[2] == 1
    assert results_across(element, np.full(16, 3), 4)[2] == 0


@on_each_element
@pytest.mark.parametrize("count", [-1, 0, 1, 7, 15, 16, 40])
def test_lanes_below_a_count_are_its_first_and_all_lanes_hold_a_repeated_number(element, count):
    values = np.arange(1, 17)
    expected = np.where(np.arange(16) < count, values, 99)
    np.testing.assert_array_equal(results_across(element, values, 99, count)[16:], expected)


# ---- conversions --------------------------------------------------------------------------------------------------------


def conversions(reals, integers, as_integers, as_reals, as_int32):
    store(as_integers, 0, to_integer(load(reals, 0)))
    store(as_reals, 0, to_real(load(integers, 0)))
    store(as_int32, 0, to_int32(load(integers, 0)))


@functools.cache
def converted(real):
    reals = np.array([0.0, 0.9, -0.9, 1.0, -1.0, 2.5, -2.5, 3.99, -3.99, 1e6, -1e6, 0.5, -0.5, 12.0, 1.5, -1.5], real)
    integers = np.array([0, 1, -1, 2**24, -(2**24), 12345, -12345, *range(9)], INTEGER_OF[real])
    outs = np.zeros(16, INTEGER_OF[real]), np.zeros(16, real), np.zeros(16, np.int32)
    compile_lanes(conversions, real)(reals, integers, *outs)
    return reals, integers, *outs


@on_each_real
def test_reals_become_integers_by_cutting_towards_zero(real):
    reals, _, as_integers, _, _ = converted(real)
    np.testing.assert_array_equal(as_integers, np.trunc(reals).astype(INTEGER_OF[real]))


@on_each_real
def test_integers_become_the_same_reals_and_the_same_integers_of_32_bits(real):
    _, integers, _, as_reals, as_int32 = converted(real)
    np.testing.assert_array_equal(as_reals, integers.astype(real))
    np.testing.assert_array_equal(as_int32, integers.astype(np.int32))


# ---- memory and rows of the grid ----------------------------------------------------------------------------------------


def moved_block(source, target, first, second):
    store(target, second, load(source, first))
    store(target, second + 16, source[first])


@functools.cache
def compiled_moved_block(element):
    return compile_lanes(moved_block, element)


@on_each_element
def test_load_and_store_work_at_any_index_and_touch_nothing_else(element):
    source = np.arange(100, 164).astype(element)
    for first in range(17):
        target = np.full(64, -1, element)
        expected = target.copy()
        expected[20 - first : 36 - first] = source[first : first + 16]
        expected[36 - first : 52 - first] = source[first]  # a number is repeated
        compiled_moved_block(element)(source, target, first, 20 - first)
        np.testing.assert_array_equal(target, expected)


def row_words(values, at, out):
    prefetch(values, at + 10**6, False)  # such an element does not exist
    prefetch(values, at - 10**6, True)
    a, b, c, d = load(values, at), load(values, at + 16), load(values, at + 32), load(values, at + 48)
    store(out, 0, load_repeated(values, at))
    store(out, 16, repeat_mass(a))
    store(out, 32, with_mass_of(a, b))
    store(out, 48, sum_nodes(a, b, c, d))
    store_quads(out, 64, a, b, c, d)
    put(out, 128, load_transposed(values, at))


@functools.cache
def rows(real):
    """A table of 16 rows of 16 values from an odd place of an array on, and what the words for rows make of it."""
    values, out = np.arange(300).astype(real), np.zeros(128 + 256, real)
    compile_lanes(row_words, real)(values, 3, out)
    return values[3 : 3 + 256].reshape(16, 16), out


@on_each_real
def test_four_elements_are_repeated_for_each_node(real):
    table, out = rows(real)
    np.testing.assert_array_equal(out[:16], np.tile(table[0, :4], 4))


@on_each_real
def test_the_mass_of_each_node_fills_its_four_components(real):
    table, out = rows(real)
    np.testing.assert_array_equal(out[16:32], np.repeat(table[0, 3::4], 4))


@on_each_real
def test_a_row_keeps_its_masses_and_takes_other_components(real):
    table, out = rows(real)
    expected = np.where(np.arange(16) % 4 == 3, table[0], table[1])
    np.testing.assert_array_equal(out[32:48], expected)


@on_each_real
def test_nodes_are_summed_component_by_component_for_four_rows_at_once(real):
    table, out = rows(real)
    np.testing.assert_array_equal(out[48:64], table[:4].reshape(4, 4, 4).sum(axis=1).ravel())


@on_each_real
def test_quads_of_a_lane_lie_side_by_side_in_the_documented_order(real):
    table, out = rows(real)
    for p in range(16):
        at = 64 + 16 * (p % 4) + 4 * (p // 4)
        np.testing.assert_array_equal(out[at : at + 4], table[:4, p])


@on_each_real
def test_a_transposed_table_has_its_columns_in_lanes(real):
    table, out = rows(real)
    np.testing.assert_array_equal(out[128:].reshape(16, 16), table.T)


# ---- exp, log and their relatives ---------------------------------------------------------------------------------------

# In units in the last place, as the head of lanes.py states them, and the range of x from which a finite normal result comes.
BOUNDS = {"exp": 0.95, "expm1": 1.9, "log": 1.1, "log1p": 1.1, "sqrt": 0.5}
LIMITS = {np.float32: (-87.0, 88.0), np.float64: (-708.0, 709.0)}


ANGLES = ("sin", "cos")


def functions(values, out_exp, out_expm1, out_log, out_log1p, out_sqrt, out_sin, out_cos):
    for k in range(len(values) // 16):
        x = load(values, 16 * k)
        store(out_exp, 16 * k, exp(x))
        store(out_expm1, 16 * k, expm1(x))
        store(out_log, 16 * k, log(x))
        store(out_log1p, 16 * k, log1p(x))
        store(out_sqrt, 16 * k, sqrt(x))
        store(out_sin, 16 * k, sin(x))
        store(out_cos, 16 * k, cos(x))


@functools.cache
def compiled_functions(real):
    return compile_lanes(functions, real)


def functions_of(values, real):
    """{name of the function: its values on lanes}."""
    room = -(-len(values) // 16) * 16
    padded = np.ones(room, real)
    padded[: len(values)] = values
    outs = {name: np.zeros(room, real) for name in (*BOUNDS, *ANGLES)}
    compiled_functions(real)(padded, *outs.values())
    return {name: out[: len(values)] for name, out in outs.items()}


def sample(name, real, count=1 << 17):
    """Where the function is defined: all magnitudes of normal numbers, more of them near 0 and 1, and the very ends."""
    rng, form = np.random.default_rng(3), np.finfo(real)
    low, high = LIMITS[real]
    all_sizes = np.exp2(rng.uniform(form.minexp, form.maxexp, count))
    near_zero = np.exp2(rng.uniform(-form.nmant - 3, 1, count))
    near_one = 1.0 + rng.choice([-1, 1], count) * near_zero / 2.0
    steps = 1.0 + np.arange(-2000, 2000) * float(form.eps) / 2.0
    worst = rng.uniform(0.6, 0.8, count)  # where errors of log, and by x - 1 of log1p, were found to be largest
    ends = np.array([form.tiny, form.max, form.eps, 0.5, 1.0, 2.0, math.sqrt(0.5), math.sqrt(2.0)])
    x = np.concatenate([all_sizes, near_zero, near_one, worst, worst - 1.0, steps, ends]).astype(real)
    if name in ("exp", "expm1"):
        between = np.concatenate([rng.uniform(low, high, count), np.arange(-100, 101) * math.log(2) / 2, [low, high]])
        x = np.concatenate([x, -x, between.astype(real)])
        return x[(x >= low) & (x <= high)]
    if name == "log1p":
        x = np.concatenate([x, -x])
        return x[x > -1.0]
    return x[x > 0.0]


def units_in_the_last_place(result, exact, real):
    """Distance in units of the binade of the exact value."""
    form = np.finfo(real)
    exponent = np.maximum(np.frexp(exact)[1] - 1, form.minexp)
    return np.abs(result.astype(np.longdouble) - exact) / np.ldexp(np.longdouble(1.0), exponent - form.nmant)


@on_each_real
@pytest.mark.parametrize("name", BOUNDS)
def test_functions_are_as_accurate_as_stated(name, real):
    if np.finfo(np.longdouble).nmant < np.finfo(real).nmant + 11:
        pytest.skip("numpy has no wider format here to compare with")
    x = sample(name, real)
    exact = getattr(np, name)(x.astype(np.longdouble))
    exact_is_normal = np.abs(exact) >= np.finfo(real).tiny
    found = units_in_the_last_place(functions_of(x, real)[name], exact, real)[exact_is_normal]
    assert found.max() <= BOUNDS[name] + 2.0**-10  # the wider format is rounded too


@on_each_real
@pytest.mark.parametrize("name", ANGLES)
def test_sine_and_cosine_are_within_one_eps_up_to_1e4(name, real):
    """In units of the eps of 1, their largest value; around their zeros, too, and for tiny angles to the last place."""
    rng = np.random.default_rng(8)
    x = np.concatenate(
        [rng.uniform(-1e4, 1e4, 1 << 17), rng.uniform(-4.0, 4.0, 1 << 17), np.arange(-999, 999) * math.pi / 2]
    )
    x = x.astype(real)
    exact = getattr(np, name)(x.astype(np.longdouble))
    assert np.abs(functions_of(x, real)[name] - exact).max() <= np.finfo(real).eps
    tiny = np.exp2(-rng.uniform(1.0, 100.0, 1000)).astype(real)
    found = functions_of(tiny, real)
    assert (np.abs(found["sin"] - np.sin(tiny.astype(np.longdouble))) <= 1.5 * np.spacing(tiny)).all()


@on_each_real
@pytest.mark.parametrize("name", ANGLES)
def test_sine_and_cosine_of_what_is_no_angle_are_nan(name, real):
    assert np.isnan(functions_of(np.array([np.inf, -np.inf, np.nan, 2.0**31, -(2.0**31)], real), real)[name]).all()


@on_each_real
@pytest.mark.parametrize("name", ["exp", "expm1"])
def test_exponentials_saturate(name, real):
    """No zero, no infinity."""
    low, high = LIMITS[real]
    beyond = functions_of(np.array([1.01 * low, -np.inf, 1.01 * high, np.inf], real), real)[name]
    ends = functions_of(np.array([low, low, high, high], real), real)[name]
    np.testing.assert_array_equal(beyond, ends)
    assert np.isfinite(beyond).all()


@on_each_real
@pytest.mark.parametrize("name", BOUNDS)
def test_functions_of_nan_are_nan(name, real):
    assert np.isnan(functions_of(np.array([np.nan, -np.nan], real), real)[name]).all()


@on_each_real
def test_logarithms_and_roots_where_there_is_none_are_nan(real):
    """Of numbers below the smallest normal one too, which are below zero all the same."""
    below = np.array([-1.0, -np.inf, -2.0 * np.finfo(real).tiny, -np.finfo(real).max], real)
    results = functions_of(below, real)
    assert np.isnan(results["log"]).all()
    assert np.isnan(results["sqrt"]).all()
    assert np.isnan(
        functions_of(np.array([-1.5, -np.inf, np.nextafter(real(-1), real(-2))], real), real)["log1p"]
    ).all()


@on_each_real
def test_the_logarithm_of_zero_and_of_denormal_numbers_is_finite_and_below_all_others(real):
    tiny = np.finfo(real).tiny
    results = functions_of(np.array([0.0, np.finfo(real).smallest_subnormal, tiny / 2, tiny], real), real)["log"]
    assert np.isfinite(results).all()
    assert (results[:3] < results[3]).all()


# ---- denormal numbers ---------------------------------------------------------------------------------------------------


def products(a, b, out):
    for i in range(len(a)):
        out[i] = a[i] * b[i]


def products_flushed(a, b, inside, after):
    before = flush_denormals()
    products(a, b, inside)
    restore_denormals(before)
    products(a, b, after)


@functools.cache
def flushed(real):
    """Products that are denormal, and products of denormal numbers: with flushing, and after it."""
    tiny = np.finfo(real).tiny
    a, b = np.full(64, tiny, real), np.full(64, 0.25, real)
    a[32:], b[32:] = tiny / 8, 4096.0
    inside, after = np.ones(64, real), np.ones(64, real)
    compile_lanes(products_flushed, real)(a, b, inside, after)
    return a, b, inside, after


only_x86 = pytest.mark.skipif(not lanes.ON_X86, reason="denormals are flushed on x86 only")


@only_x86
@on_each_real
def test_denormal_results_and_operands_are_zero_while_flushed(real):
    _, _, inside, _ = flushed(real)
    assert not inside.any()


@on_each_real
def test_denormal_numbers_are_back_after_a_function_that_flushes(real):
    """In what it computes after `restore_denormals`, and in numpy in this thread."""
    a, b, _, after = flushed(real)
    assert (a * b).all()
    np.testing.assert_array_equal(after, a * b)


# ---- what is refused ----------------------------------------------------------------------------------------------------


def law_with_an_if(J):
    if J < 1.0:
        return 1.0 - J
    return J


def law_with_where(J):
    return where(J < 1.0, 1.0 - J, J)


def on_a_block(values, out):
    store(out, 0, the_law(load(values, 0)))


the_law = None  # replaced by each target


@on_each_real
def test_an_if_on_the_state_of_a_law_does_not_compile(real):
    values, out = np.linspace(0.5, 1.5, 16).astype(real), np.zeros(16, real)
    with pytest.raises(numba.core.errors.TypingError):
        compile_lanes(on_a_block, real, the_law=law_with_an_if)(values, out)
    assert not out.any()


def test_the_same_law_with_where_does_compile():
    values, out = np.linspace(0.5, 1.5, 16), np.zeros(16)
    compile_lanes(on_a_block, np.float64, the_law=law_with_where)(values, out)
    np.testing.assert_array_equal(out, np.where(values < 1.0, 1.0 - values, values))


# ---- laws ---------------------------------------------------------------------------------------------------------------

law = neo_hookean  # what stands here is replaced by each target
load_state = load_gradient = STATE_SIZE = GRADIENT_SIZE = None
BLOCKS = 8
each_case = pytest.mark.parametrize(
    ("example", "real"),
    [(example, real) for example in law_examples.each_example() for real in REALS],
    ids=law_examples.identify,
)


def advance_then_stress(state, G, params):
    advanced = law.advance(state, G, 1e-3, params)
    return advanced + law.kirchhoff_stress(advanced, params)


def blocks_by_law(states, gradients, params, out):
    for k in range(len(states) // (16 * STATE_SIZE)):
        state = load_state(states, 16 * STATE_SIZE * k)
        results = advance_then_stress(state, load_gradient(gradients, 16 * GRADIENT_SIZE * k), params)
        put(out, 16 * len(results) * k, results)


@functools.cache
def compiled_law(example, real):
    gradient = example.dim * example.dim
    return compile_lanes(
        blocks_by_law,
        real,
        **example.words,
        load_state=FIELD_TUPLES[example.state_size],
        load_gradient=FIELD_TUPLES[gradient],
        STATE_SIZE=example.state_size,
        GRADIENT_SIZE=gradient,
    )


def by_lanes(example, real, states, gradients):
    """advance and kirchhoff_stress of particles (rows), a block being 16 rows."""

    def in_blocks(rows):
        return np.ascontiguousarray(rows.reshape(-1, 16, rows.shape[1]).swapaxes(1, 2), real).reshape(-1)

    size = example.state_size + example.dim * (example.dim + 1) // 2
    out = np.zeros(len(states) * size, real)
    params = tuple(real(p) for p in example.params)
    compiled_law(example, real)(in_blocks(states), in_blocks(gradients), params, out)
    return out.reshape(-1, size, 16).swapaxes(1, 2).reshape(-1, size)


def particles(example, real):
    return tuple(rows.astype(real) for rows in example.particles(16 * BLOCKS))


@each_case
def test_a_law_on_lanes_agrees_with_plain_python(example, real):
    """To BOUND eps: strains and volume ratios, which are of order 1, as they are, stresses in units of the stiffness."""
    states, gradients = particles(example, real)
    plain = targets.plain(**example.words).compile(advance_then_stress)
    expected = np.array([
        plain(tuple(map(float, s)), tuple(map(float, g)), example.params) for s, g in zip(states, gradients, strict=True)
    ])  # fmt: skip
    scale = np.where(np.arange(expected.shape[1]) < example.state_size, 1.0, law_examples.STIFFNESS)
    errors = (
        np.abs(by_lanes(example, real, states, gradients) - expected)
        / scale
        / np.maximum(np.abs(expected) / scale, 1.0)
    )
    assert errors.max() <= law_examples.BOUND[example.label] * np.finfo(real).eps


@pytest.mark.parametrize("dim", [2, 3])
def test_blocks_of_sand_hold_particles_for_both_ways_to_the_trial_strain(dim):
    """So the claims above and below are about blocks in which they are mixed."""
    example = law_examples.Example("drucker_prager", dim)
    states, gradients = example.particles(16 * BLOCKS)
    bound = law_examples.TENSORS[dim].row_sum_bound
    far = np.array([bound(tuple(s)) > hencky.SWITCH for s in states]).reshape(-1, 16)
    assert (far.sum(axis=1) >= 1).all()
    assert (far.sum(axis=1) <= 15).all()


@each_case
def test_a_particle_gives_the_same_bits_whatever_stands_in_the_other_lanes(example, real):
    states, gradients = particles(example, real)
    before = by_lanes(example, real, states, gradients)
    order = np.random.default_rng(7).permutation(len(states))
    np.testing.assert_array_equal(by_lanes(example, real, states[order], gradients[order]), before[order])


@each_case
@pytest.mark.parametrize("neighbour", [0.0, 3.0, np.nan], ids=["at zero", "far", "nan"])
def test_a_particle_gives_the_same_bits_among_strange_neighbours(example, real, neighbour):
    """Beside a far particle the careful way is computed for all of a block, beside near ones alone it is not."""
    states, gradients = particles(example, real)
    before = by_lanes(example, real, states, gradients)
    kept = np.arange(len(states)) % 16 == np.arange(len(states)) // 16  # lane k of block k
    results = by_lanes(example, real, np.where(kept[:, None], states, neighbour).astype(real), gradients)
    np.testing.assert_array_equal(results[kept], before[kept])


@each_case
def test_a_particle_gives_the_same_bits_in_a_block_of_its_own(example, real):
    """Where all lanes hold the same particle, no branch is taken on account of another one."""
    states, gradients = particles(example, real)
    before = by_lanes(example, real, states, gradients)
    for n in range(0, len(states), 11):
        alone = by_lanes(example, real, np.tile(states[n], (16, 1)), np.tile(gradients[n], (16, 1)))
        np.testing.assert_array_equal(alone, np.tile(before[n], (16, 1)))


@pytest.mark.parametrize("example", law_examples.each_example(), ids=law_examples.identify)
def test_a_law_in_float32_holds_no_double_arithmetic(example):
    compiled = compiled_law(example, np.float32)
    by_lanes(example, np.float32, *particles(example, np.float32))
    text = "\n".join(compiled.inspect_llvm().values())
    assert arithmetic_in(text, "double") == []
    assert arithmetic_in(text, "float")  # the search looks at the right text
