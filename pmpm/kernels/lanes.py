"""`Lanes(element, 16)`: a numba value that holds one number for each particle of a block (SIMD), and its words.

Physics written for one particle (`a * b`, `where(a < b, c, d)`, `sqrt`, `exp`, `abs`, `min` ...) works on it unchanged: each
operation is one LLVM instruction on 16 numbers, which LLVM cuts into registers of the width the machine has. Both precisions
have 16 lanes: with float64 that is two 512-bit registers, which hide each other's latency. A comparison gives a `Mask`; masks
combine with `&` and `|` and are read by `where` and `any_of`. A Python `if` on a mask does not compile.

Errors in units in the last place (largest found over the normal range, tests/unit/test_lanes.py): + - * / sqrt 0.5,
exp 0.95, log and log1p 1.1, expm1 1.9; sin and cos are within one eps of 1 up to 1e4. Only numba.extending, numba's typing
templates and llvmlite are used.
"""

import math
import operator
import platform

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, models, register_model

from pmpm.kernels.targets import FAST

WIDTH = 16
FLAGS = tuple(sorted(FAST))
BITS = ir.IntType(32)
ON_CPU = {"target": "cpu"}  # numba tries these meanings of a function first; its own, for any target, are many


class Lanes(types.Type):
    """16 numbers of one numba type: float32, float64, int32 or int64."""

    def __init__(self, element, width):
        self.element, self.width = element, width
        super().__init__(name=f"Lanes({element},{width})")

    def can_convert_from(self, typingctx, other):
        """A plain number fits: it is repeated over the lanes."""
        return typingctx.can_convert(other, self.element) if isinstance(other, types.Number) else None


class Mask(types.Type):
    """16 truth values."""

    def __init__(self, width):
        self.width = width
        super().__init__(name=f"Mask({width})")


ELEMENTS = {
    types.float32: ir.FloatType(),
    types.float64: ir.DoubleType(),
    types.int32: ir.IntType(32),
    types.int64: ir.IntType(64),
}


def llvm_type(numba_type):
    element = ir.IntType(1) if isinstance(numba_type, Mask) else ELEMENTS[numba_type.element]
    return ir.VectorType(element, numba_type.width)


@register_model(Lanes)
@register_model(Mask)
class VectorModel(models.PrimitiveModel):
    def __init__(self, manager, numba_type):
        super().__init__(manager, numba_type, llvm_type(numba_type))


def lanes_among(arguments):
    """The one Lanes type among the argument types, or None if absent, ambiguous or mixed with other things."""
    found = {a for a in arguments if isinstance(a, Lanes)}
    plain = all(isinstance(a, Lanes | types.Number) for a in arguments)
    return found.pop() if len(found) == 1 and plain else None


def is_real(vector):
    return isinstance(vector.element, ir.FloatType | ir.DoubleType)


def shuffled(builder, a, b, index):
    """Lanes `index` of a (0 .. n-1) and b (n .. 2n-1)."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(BITS, len(index)), index))


def repeated(builder, number, vector):
    """A number in every lane."""
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), number, ir.Constant(BITS, 0))
    return shuffled(builder, first, first, [0] * vector.count)


def constant(vector, value):
    return ir.Constant(vector, [value] * vector.count)


@lower_cast(types.Number, Lanes)
def number_to_lanes(context, builder, source, target, value):
    return repeated(builder, context.cast(builder, value, source, target.element), llvm_type(target))


def intrinsic_call(builder, name, *values):
    vector = values[0].type
    bits = 32 if isinstance(vector.element, ir.FloatType) else 64
    kind = ir.FunctionType(vector, [vector] * len(values))
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{vector.count}f{bits}")
    return builder.call(function, values, fastmath=FLAGS)


def define(function, emit, arity, result=lambda lanes: lanes):
    """Teach numba `function(lanes, ...)`; `emit(builder, *vectors)` writes the instruction."""

    @infer_global(function)
    class Template(AbstractTemplate):
        metadata = ON_CPU

        def generic(self, arguments, keywords):
            lanes = lanes_among(arguments) if len(arguments) == arity else None
            return signature(result(lanes), *[lanes] * arity) if lanes else None

    def lower(context, builder, sig, arguments):
        return emit(builder, *arguments)

    lower_builtin(function, *[Lanes] * arity)(lower)


def arithmetic(real, integer):
    """An instruction for reals and one for integers (None: there is none)."""

    def emit(builder, x, y):
        if is_real(x.type):
            return getattr(builder, real)(x, y, flags=FLAGS)
        return getattr(builder, integer)(x, y)

    return emit


for symbol, in_place, real, integer in (
    (operator.add, operator.iadd, "fadd", "add"),
    (operator.sub, operator.isub, "fsub", "sub"),
    (operator.mul, operator.imul, "fmul", "mul"),
    (operator.truediv, operator.itruediv, "fdiv", None),
):
    define(symbol, arithmetic(real, integer), 2)
    define(in_place, arithmetic(real, integer), 2)
define(operator.lshift, lambda b, x, y: b.shl(x, y), 2)
define(operator.rshift, lambda b, x, y: b.ashr(x, y), 2)


def compare(builder, symbol, x, y):
    """A comparison as Python's: with nan, only != holds."""
    if not is_real(x.type):
        return builder.icmp_signed(symbol, x, y)
    return (builder.fcmp_unordered if symbol == "!=" else builder.fcmp_ordered)(symbol, x, y)


def defined_by_comparison(symbol):
    """min or max as Python's: the second where it is smaller (larger), else the first, nan included."""
    return lambda builder, x, y: builder.select(compare(builder, symbol, y, x), y, x)


def negative(builder, x):
    return builder.fneg(x, flags=FLAGS) if is_real(x.type) else builder.neg(x)


define(min, defined_by_comparison("<"), 2)
define(max, defined_by_comparison(">"), 2)
define(operator.neg, negative, 1)
define(operator.pos, lambda builder, x: x, 1)
for function, name in (abs, "fabs"), (math.fabs, "fabs"), (math.sqrt, "sqrt"), (math.floor, "floor"):
    define(function, lambda b, x, name=name: intrinsic_call(b, name, x), 1)
for function, symbol in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    define(function, lambda b, x, y, symbol=symbol: compare(b, symbol, x, y), 2, lambda lanes: Mask(lanes.width))


def define_on_masks(function, emit, arity):
    @infer_global(function)
    class MaskTemplate(AbstractTemplate):
        metadata = ON_CPU

        def generic(self, arguments, keywords):
            if len(arguments) == arity and isinstance(arguments[0], Mask) and len(set(arguments)) == 1:
                return signature(arguments[0], *arguments)
            return None

    lower_builtin(function, *[Mask] * arity)(lambda context, builder, sig, arguments: emit(builder, *arguments))


define_on_masks(operator.and_, lambda b, x, y: b.and_(x, y), 2)
define_on_masks(operator.or_, lambda b, x, y: b.or_(x, y), 2)
define_on_masks(operator.iand, lambda b, x, y: b.and_(x, y), 2)
define_on_masks(operator.ior, lambda b, x, y: b.or_(x, y), 2)
define_on_masks(operator.invert, lambda b, x: b.not_(x), 1)


@intrinsic
def where(typingctx, condition, a, b):
    """`a` where the condition holds, else `b`, lane by lane; a plain bool decides for all lanes."""
    result = lanes_among((a, b))
    if result is None:
        result = Lanes(a, condition.width) if isinstance(condition, Mask) else a

    def lower(context, builder, sig, arguments):
        return builder.select(*arguments)

    return result(condition, result, result), lower


@intrinsic
def any_of(typingctx, condition):
    """Whether the condition holds in at least one lane; a plain bool is returned as it is."""

    def lower(context, builder, sig, arguments):
        if not isinstance(condition, Mask):
            return arguments[0]
        word = builder.bitcast(arguments[0], ir.IntType(condition.width))
        return builder.icmp_unsigned("!=", word, ir.Constant(ir.IntType(condition.width), 0))

    return types.boolean(condition), lower


@intrinsic
def largest_lane(typingctx, values):
    """The largest of the lanes: halves are compared until one element is left."""
    larger = defined_by_comparison(">")

    def lower(context, builder, sig, arguments):
        (vector,) = arguments
        width = vector.type.count
        while width > 1:
            width //= 2
            low, high = (shuffled(builder, vector, vector, list(range(s, s + width))) for s in (0, width))
            vector = larger(builder, low, high)
        return builder.extract_element(vector, ir.Constant(BITS, 0))

    return values.element(values), lower


@intrinsic
def in_all_lanes(typingctx, number):
    """A number repeated over the lanes."""
    result = Lanes(number, WIDTH)

    def lower(context, builder, sig, arguments):
        return repeated(builder, arguments[0], llvm_type(result))

    return result(number), lower


@intrinsic
def lanes_below(typingctx, count):
    """Mask of the first `count` lanes."""

    def lower(context, builder, sig, arguments):
        vector = ir.VectorType(BITS, WIDTH)
        limit = repeated(builder, context.cast(builder, arguments[0], count, types.int32), vector)
        return builder.icmp_signed("<", ir.Constant(vector, list(range(WIDTH))), limit)

    return Mask(WIDTH)(count), lower


@intrinsic
def to_integer(typingctx, values):
    """Integers of the same size, cut off towards zero; the value must fit."""
    result = Lanes(types.int32 if values.element == types.float32 else types.int64, values.width)

    def lower(context, builder, sig, arguments):
        return builder.fptosi(arguments[0], llvm_type(result))

    return result(values), lower


@intrinsic
def to_real(typingctx, values):
    """Reals of the same size as the integers."""
    result = Lanes(types.float32 if values.element == types.int32 else types.float64, values.width)

    def lower(context, builder, sig, arguments):
        return builder.sitofp(arguments[0], llvm_type(result))

    return result(values), lower


@intrinsic
def to_int32(typingctx, values):
    """The same integers in 32 bits; they must fit."""
    result = Lanes(types.int32, values.width)

    def lower(context, builder, sig, arguments):
        return arguments[0] if values.element == types.int32 else builder.trunc(arguments[0], llvm_type(result))

    return result(values), lower


# ---- exp, log and their relatives: range reduction and a polynomial -----------------------------------------------------


class Format:
    """What the functions need to know of a float format."""

    def __init__(self, vector):
        single = isinstance(vector.element, ir.FloatType)
        self.integers = ir.VectorType(ir.IntType(32 if single else 64), vector.count)
        self.int32 = ir.VectorType(BITS, vector.count)
        self.mantissa_bits, self.bias = (23, 127) if single else (52, 1023)
        self.exp_terms, self.log_terms = (7, 5) if single else (13, 10)
        self.lowest, self.highest = (-87.0, 88.0) if single else (-708.0, 709.0)


LN2_HIGH, LN2_LOW = 0.693359375, -2.12194440054690583e-4  # LN2_HIGH has few bits, so that k * LN2_HIGH is exact


def multiply_add(builder, a, b, c):
    return intrinsic_call(builder, "fmuladd", a, b, c)  # fused where the machine can, never a library call


def polynomial(builder, x, coefficients):
    """Horner; coefficients from the highest power down."""
    value = constant(x.type, coefficients[0])
    for c in coefficients[1:]:
        value = multiply_add(builder, value, x, constant(x.type, c))
    return value


def clamped(builder, x, low, high):
    x = builder.select(compare(builder, "<", x, constant(x.type, high)), x, constant(x.type, high))
    return builder.select(compare(builder, ">", x, constant(x.type, low)), x, constant(x.type, low))


def reduce_exponent(builder, x, form):
    """(r, k as int32) with x = r + k ln 2 and |r| <= ln 2 / 2."""
    half = builder.select(
        compare(builder, "<", x, constant(x.type, 0.0)), constant(x.type, -0.5), constant(x.type, 0.5)
    )
    nearest = builder.fptosi(multiply_add(builder, x, constant(x.type, 1 / math.log(2)), half), form.int32)
    k = builder.sitofp(nearest, x.type)
    r = multiply_add(builder, k, constant(x.type, -LN2_HIGH), x)
    return multiply_add(builder, k, constant(x.type, -LN2_LOW), r), nearest


def power_of_two(builder, k, vector, form):
    exponent = builder.add(k, constant(form.int32, form.bias))
    exponent = exponent if form.integers == form.int32 else builder.zext(exponent, form.integers)
    return builder.bitcast(builder.shl(exponent, constant(form.integers, form.mantissa_bits)), vector)


def keep_nan(builder, x, result):
    return builder.select(builder.fcmp_unordered("uno", x, x), x, result)


def emit_exp(builder, x):
    """Saturates at exp(-87) and exp(88) (float32) or exp(-708) and exp(709): no zero, no infinity."""
    form = Format(x.type)
    r, k = reduce_exponent(builder, clamped(builder, x, form.lowest, form.highest), form)
    series = polynomial(builder, r, [1 / math.factorial(n) for n in range(form.exp_terms, -1, -1)])
    result = builder.fmul(series, power_of_two(builder, k, x.type, form))
    return keep_nan(builder, x, result)


def emit_expm1(builder, x):
    """2^k expm1(r) + (2^k - 1): keeps the digits of small x. Saturates as exp does."""
    form = Format(x.type)
    r, k = reduce_exponent(builder, clamped(builder, x, form.lowest, form.highest), form)
    series = polynomial(builder, r, [1 / math.factorial(n) for n in range(form.exp_terms + 1, 1, -1)])
    small = multiply_add(builder, builder.fmul(r, r), series, r)
    power = power_of_two(builder, k, x.type, form)
    result = multiply_add(builder, power, small, builder.fsub(power, constant(x.type, 1.0)))
    return keep_nan(builder, x, result)


def log_of_positive(builder, x, correction):
    """log(x) + correction for normal x > 0; `correction` (a vector or None) is small and joins before the large parts."""
    form = Format(x.type)
    bits = builder.bitcast(x, form.integers)
    exponent = builder.lshr(bits, constant(form.integers, form.mantissa_bits))
    exponent = exponent if form.integers == form.int32 else builder.trunc(exponent, form.int32)
    e = builder.sitofp(builder.sub(exponent, constant(form.int32, form.bias)), x.type)
    mantissa = builder.and_(bits, constant(form.integers, (1 << form.mantissa_bits) - 1))
    m = builder.bitcast(builder.or_(mantissa, constant(form.integers, form.bias << form.mantissa_bits)), x.type)
    upper = compare(builder, ">", m, constant(x.type, math.sqrt(2)))  # x = m 2^e, m in [1, 2)
    one = constant(x.type, 1.0)
    m = builder.select(upper, builder.fmul(m, constant(x.type, 0.5)), m)
    e = builder.select(upper, builder.fadd(e, one), e)  # m in [0.71, 1.41]: no cancellation near x = 1
    f = builder.fsub(m, one)  # exact
    t = builder.fdiv(f, builder.fadd(m, one))
    t2 = builder.fmul(t, t)
    series = polynomial(builder, t2, [2 / (2 * n + 1) for n in range(form.log_terms - 1, 0, -1)])
    # log m = 2 t + t t2 series = f - t (f - t2 series), since 2 t = f - t f: only f, which is exact, is large.
    tail = builder.fmul(t, builder.fsub(builder.fmul(t2, series), f))
    tail = multiply_add(builder, e, constant(x.type, LN2_LOW), tail)
    if correction is not None:
        tail = builder.fadd(tail, correction)
    return multiply_add(builder, e, constant(x.type, LN2_HIGH), builder.fadd(f, tail))


def emit_log(builder, x):
    """nan for nan and negative x; zero and denormal x give a finite number below log of the smallest normal number."""
    result = log_of_positive(builder, x, None)
    return builder.select(compare(builder, ">=", x, constant(x.type, 0.0)), result, constant(x.type, math.nan))


def emit_log1p(builder, x):
    """log(u) + (x - (u - 1)) / u with u = 1 + x rounded: keeps the digits of small x. nan for x < -1."""
    one = constant(x.type, 1.0)
    u = builder.fadd(one, x)
    lost = builder.fdiv(builder.fsub(x, builder.fsub(u, one)), u)
    result = log_of_positive(builder, u, lost)
    return builder.select(compare(builder, ">", x, constant(x.type, -1.0)), result, constant(x.type, math.nan))


# pi / 2 as a sum, the first parts with few bits, so that their products with the number of a quadrant are exact up to 2^15.
HALF_PI_SINGLE = (1.5703125, 4.837512969970703125e-4, 7.549789948768648e-8)
HALF_PI_DOUBLE = (1.57079625129699707031, 7.54978941586159635335e-8, 5.39030285815811905290e-15)


def emit_sine(quarters):
    """sin(x + quarters pi / 2); off by what is lost of x itself beyond 1e4. nan beyond 2^30 and for infinities."""

    def emit(builder, x):
        form = Format(x.type)
        single = form.mantissa_bits == 23
        half = builder.select(
            compare(builder, "<", x, constant(x.type, 0.0)), constant(x.type, -0.5), constant(x.type, 0.5)
        )
        bounded = clamped(builder, x, -(2.0**30), 2.0**30)
        quadrant = builder.fptosi(multiply_add(builder, bounded, constant(x.type, 2.0 / math.pi), half), form.int32)
        k, r = builder.sitofp(quadrant, x.type), bounded
        for part in HALF_PI_SINGLE if single else HALF_PI_DOUBLE:
            r = multiply_add(builder, k, constant(x.type, -part), r)
        square, terms = builder.fmul(r, r), 4 if single else 8
        sine = [(-1) ** n / math.factorial(2 * n + 1) for n in range(terms, 0, -1)]
        cosine = [(-1) ** n / math.factorial(2 * n) for n in range(terms + 1, 0, -1)]
        s = multiply_add(builder, builder.fmul(r, square), polynomial(builder, square, sine), r)
        c = multiply_add(builder, square, polynomial(builder, square, cosine), constant(x.type, 1.0))
        turn = builder.add(quadrant, constant(form.int32, quarters))
        zero = constant(form.int32, 0)
        odd = builder.icmp_signed("!=", builder.and_(turn, constant(form.int32, 1)), zero)
        lower = builder.icmp_signed("!=", builder.and_(turn, constant(form.int32, 2)), zero)
        value = builder.select(odd, c, s)
        value = builder.select(lower, builder.fneg(value), value)
        here = compare(builder, "<=", intrinsic_call(builder, "fabs", x), constant(x.type, 2.0**30))
        return builder.select(here, value, constant(x.type, math.nan))

    return emit


define(math.exp, emit_exp, 1)
define(math.sin, emit_sine(0), 1)
define(math.cos, emit_sine(1), 1)
define(math.expm1, emit_expm1, 1)
define(math.log, emit_log, 1)
define(math.log1p, emit_log1p, 1)


# ---- memory: flat arrays, indices counted in elements -------------------------------------------------------------------


def pointer(context, builder, array_type, array, index_type, index, target):
    data = cgutils.create_struct_proxy(array_type)(context, builder, value=array).data
    place = builder.gep(data, [context.cast(builder, index, index_type, types.intp)])
    return builder.bitcast(place, target.as_pointer())


@intrinsic
def load(typingctx, array, index):
    """16 consecutive elements of a flat array."""
    result = Lanes(array.dtype, WIDTH)

    def lower(context, builder, sig, arguments):
        source = pointer(context, builder, sig.args[0], arguments[0], sig.args[1], arguments[1], llvm_type(result))
        return builder.load(source, align=array.dtype.bitwidth // 8)

    return result(array, index), lower


@intrinsic
def store(typingctx, array, index, value):
    """Write 16 consecutive elements of a flat array; a number is repeated."""
    lanes = Lanes(array.dtype, WIDTH)

    def lower(context, builder, sig, arguments):
        target = pointer(context, builder, sig.args[0], arguments[0], sig.args[1], arguments[1], llvm_type(lanes))
        builder.store(arguments[2], target, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, index, lanes), lower


@intrinsic
def gather(typingctx, array, indices, first, shift):
    """Elements indices[first] + shift, indices[first + 1] + shift ... of a flat array; `indices` is an array of int64."""
    result = Lanes(array.dtype, WIDTH)

    def lower(context, builder, sig, arguments):
        values = ir.Constant(llvm_type(result), ir.Undefined)
        long = ir.IntType(64)
        for lane in range(WIDTH):
            number = builder.add(arguments[2], ir.Constant(arguments[2].type, lane))
            place = pointer(context, builder, sig.args[1], arguments[1], sig.args[2], number, long)
            index = builder.add(builder.load(place), context.cast(builder, arguments[3], sig.args[3], types.int64))
            source = pointer(context, builder, sig.args[0], arguments[0], types.int64, index, values.type.element)
            values = builder.insert_element(values, builder.load(source), ir.Constant(BITS, lane))
        return values

    return result(array, indices, first, shift), lower


@intrinsic(prefer_literal=True)
def prefetch(typingctx, array, index, written):
    """Ask for the cache line of an element, which need not exist; `written` (a literal bool): to write to it."""
    if not isinstance(written, types.Literal):
        return None

    def lower(context, builder, sig, arguments):
        byte = ir.IntType(8)
        place = pointer(context, builder, sig.args[0], arguments[0], sig.args[1], arguments[1], byte)
        kind = ir.FunctionType(ir.VoidType(), [byte.as_pointer(), BITS, BITS, BITS])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        flags = [ir.Constant(BITS, flag) for flag in (int(written.literal_value), 3, 1)]
        builder.call(function, [place, *flags])
        return context.get_dummy_value()

    return types.void(array, index, written), lower


# ---- rows of the grid: 4 nodes x (3 components, mass) -------------------------------------------------------------------


@intrinsic
def load_repeated(typingctx, array, index):
    """Four elements of a flat array, repeated for each of the four nodes of a row."""
    result = Lanes(array.dtype, WIDTH)

    def lower(context, builder, sig, arguments):
        four = ir.VectorType(llvm_type(result).element, 4)
        source = pointer(context, builder, sig.args[0], arguments[0], sig.args[1], arguments[1], four)
        value = builder.load(source, align=array.dtype.bitwidth // 8)
        return shuffled(builder, value, value, [0, 1, 2, 3] * 4)

    return result(array, index), lower


@intrinsic
def repeat_mass(typingctx, row):
    """The fourth component of each node, in all four components."""

    def lower(context, builder, sig, arguments):
        return shuffled(builder, arguments[0], arguments[0], [4 * (i // 4) + 3 for i in range(WIDTH)])

    return row(row), lower


@intrinsic
def with_mass_of(typingctx, row, values):
    """The three components of each node from `values`, the fourth from `row`."""

    def lower(context, builder, sig, arguments):
        return shuffled(builder, arguments[0], arguments[1], [i if i % 4 == 3 else WIDTH + i for i in range(WIDTH)])

    return row(row, row), lower


@intrinsic
def sum_nodes(typingctx, a, b, c, d):
    """(sum of the four nodes of a | of b | of c | of d), each with its four components."""

    def groups(*numbers):
        return [4 * g + component for g in numbers for component in range(4)]

    def lower(context, builder, sig, arguments):
        def fold(x, y):
            low, high = shuffled(builder, x, y, groups(0, 2, 4, 6)), shuffled(builder, x, y, groups(1, 3, 5, 7))
            return builder.fadd(low, high, flags=FLAGS)

        a, b, c, d = arguments
        return fold(fold(a, b), fold(c, d))

    return a(a, b, c, d), lower


@intrinsic
def store_quads(typingctx, array, index, a, b, c, d):
    """Write the four values of each lane side by side: lane p's lie from index + 16 (p % 4) + 4 (p // 4) on."""
    lanes = Lanes(array.dtype, WIDTH)

    def lower(context, builder, sig, arguments):
        rows = list(arguments[2:])
        for step in 2, 1:  # a 4 x 4 transpose of every fourth lane: shuffles that stay within 128 bits
            low, high = transposing(step, 4)
            for r in range(4):
                if not r & step:
                    x, y = rows[r], rows[r | step]
                    rows[r], rows[r | step] = shuffled(builder, x, y, low), shuffled(builder, x, y, high)
        for r in range(4):
            number = builder.add(arguments[1], ir.Constant(arguments[1].type, 16 * r))
            target = pointer(context, builder, sig.args[0], arguments[0], sig.args[1], number, llvm_type(lanes))
            builder.store(rows[r], target, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, index, lanes, lanes, lanes, lanes), lower


def transposing(step, size):
    """Shuffles that exchange the off-diagonal blocks of size `step` of `size` x `size` matrices side by side."""
    low = [j if not j & step else WIDTH + (j ^ step) for j in range(WIDTH)]
    high = [(j | step) if not j & step else WIDTH + j for j in range(WIDTH)]
    return low, high


@intrinsic
def load_transposed(typingctx, array, index):
    """A tuple of 16 Lanes: lane p of number k is element index + 16 p + k of a flat array."""
    lanes = Lanes(array.dtype, WIDTH)
    result = types.UniTuple(lanes, WIDTH)

    def lower(context, builder, sig, arguments):
        rows = []
        for r in range(WIDTH):
            number = builder.add(arguments[1], ir.Constant(arguments[1].type, 16 * r))
            source = pointer(context, builder, sig.args[0], arguments[0], sig.args[1], number, llvm_type(lanes))
            rows.append(builder.load(source, align=array.dtype.bitwidth // 8))
        for step in 8, 4, 2, 1:
            low, high = transposing(step, WIDTH)
            for r in range(WIDTH):
                if not r & step:
                    x, y = rows[r], rows[r | step]
                    rows[r], rows[r | step] = shuffled(builder, x, y, low), shuffled(builder, x, y, high)
        return context.make_tuple(builder, result, rows)

    return result(array, index), lower


# ---- denormal numbers ---------------------------------------------------------------------------------------------------

FLUSH = 0x8040  # MXCSR: results flush to zero, operands are taken as zero


ON_X86 = platform.machine().lower() in ("x86_64", "amd64")


@intrinsic
def flush_denormals(typingctx):
    """Let this thread take denormal numbers as zero; returns the control word to give to `restore_denormals`.

    Sand at rest makes them by the million, and the processor is slow with each. x86 only; elsewhere nothing happens.
    """

    def lower(context, builder, sig, arguments):
        word = cgutils.alloca_once_value(builder, ir.Constant(BITS, 0))
        control_word(builder, "stmxcsr", word)
        before = builder.load(word)
        builder.store(builder.or_(before, ir.Constant(BITS, FLUSH)), word)
        control_word(builder, "ldmxcsr", word)
        return before

    return types.uint32(), lower


@intrinsic
def restore_denormals(typingctx, before):
    """Undo `flush_denormals`."""

    def lower(context, builder, sig, arguments):
        word = cgutils.alloca_once_value(builder, arguments[0])
        control_word(builder, "ldmxcsr", word)
        return context.get_dummy_value()

    return types.void(types.uint32), lower


def control_word(builder, name, word):
    if not ON_X86:
        return
    kind = ir.FunctionType(ir.VoidType(), [ir.IntType(8).as_pointer()])
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.x86.sse.{name}")
    builder.call(function, [builder.bitcast(word, ir.IntType(8).as_pointer())])
