"""What one core can do at most: float32 fused multiply-adds, and the bandwidth of its memory; both measured, in numba."""

import time

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

CHAINS = 12  # independent multiply-adds in flight: more than latency x pipes, and few enough to stay in registers
STREAM = 50_000_000  # numbers per array: far beyond the caches


def multiply_adds(width):
    """Compiled f(factor, repeats): CHAINS vectors of `width` float32 go through `repeats` multiply-adds each."""

    @intrinsic
    def loop(typing_context, factor, repeats):
        def code(context, builder, signature, arguments):
            vector = ir.VectorType(ir.FloatType(), width)
            zero = ir.Constant(ir.IntType(32), 0)
            first = builder.insert_element(ir.Constant(vector, ir.Undefined), arguments[0], zero)
            lanes = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
            factors = builder.shuffle_vector(first, first, lanes)
            shape = ir.FunctionType(vector, [vector] * 3)
            fma = cgutils.get_or_insert_function(builder.module, shape, f"llvm.fma.v{width}f32")
            # Chains that began alike would be merged into one.
            begins = [builder.fmul(factors, ir.Constant(vector, [1.0 + n] * width)) for n in range(CHAINS)]
            sums = [cgutils.alloca_once_value(builder, begin) for begin in begins]
            with cgutils.for_range(builder, arguments[1]):
                for place in sums:
                    builder.store(builder.call(fma, [builder.load(place), factors, factors]), place)
            total = builder.load(sums[0])
            for place in sums[1:]:
                total = builder.fadd(total, builder.load(place))
            return builder.extract_element(total, zero)

        return types.float32(types.float32, types.int64), code

    return numba.njit(lambda factor, repeats: loop(factor, repeats))


@numba.njit(fastmath=True, error_model="numpy")
def triad(a, b, c, factor):
    for i in range(a.size):
        a[i] = b[i] + factor * c[i]


def shortest(call, repeats=5):
    """Seconds of the fastest of several calls, after one that compiles."""
    call()
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def peak_flops():
    """float32 operations per second, two for a multiply-add; the better of 256 and 512 bits."""
    repeats, best = 10_000_000, 0.0
    for width in (8, 16):
        run = multiply_adds(width)
        seconds = shortest(lambda run=run: run(np.float32(0.5), repeats))
        best = max(best, 2.0 * width * CHAINS * repeats / seconds)
    return best


def bandwidth():
    """Bytes per second of a = b + s c, three streams counted."""
    a, b, c = (np.ones(STREAM, np.float32) for _ in range(3))
    return 3.0 * a.nbytes / shortest(lambda: triad(a, b, c, np.float32(2.0)))
