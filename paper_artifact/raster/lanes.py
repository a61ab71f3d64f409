"""Vectors in numba kernels: values of several float32, int32 or bool that one instruction works on.

    @njit(cache=True)
    def scale(x, out):  # out = 2·x + 1, any length
        for i in range(0, len(x), WIDTH):
            v = load_part(x, i, len(x) - i)
            store_part(out, i, fma(splat(2.0), v, splat(1.0)), len(x) - i)

LLVM's own loop vectoriser gives up as soon as it cannot prove arrays apart or meets a branch; these
intrinsics emit LLVM's vector instructions directly, so a kernel is as wide as it is written. LLVM fits every
vector to the machine:

    type     lanes   AVX-512     AVX2         SSE, NEON
    F32, I32   16    1 zmm       2 ymm        4 xmm / v
    F32X8       8    1 ymm       1 ymm        2 xmm / v
    BOOL       16    1 k mask    2 ymm        4 xmm / v

Operations, for vectors a, b, c of one type (numbers mix in as constants of all lanes: `0.5 * a`):

    a + b, a - b, a * b, a / b, -a       fadd, fsub, fmul, fdiv, rounded as scalars are; int32 add, sub, mul
    fma(a, b, c) = a·b + c               llvm.fmuladd: one rounding where the machine has FMA, else mul and
                                         add; never the call of libm that llvm.fma becomes there
    a < b, <=, >, >=, ==, !=             fcmp ordered (!= unordered), icmp signed → BOOL
    m & n, m | n, m ^ n, ~m              on BOOL, and on int32 (bitwise)
    a << k, a >> k                       shl, lshr (the sign bit is not repeated) on int32
    select(m, a, b)                      a where m, else b
    minimum(a, b), maximum(a, b)         select on a < b, a > b: one vminps; b where either is NaN
    absolute, floor, square_root         llvm.fabs, llvm.floor, llvm.sqrt (exact)
    splat(x), splat8(x), splat_int(x)    the number x in all lanes
    iota()                               int32 0 … 15
    to_float(a)                          sitofp
    first(n)                             BOOL: the first n lanes (none when n <= 0)
    bits(m)                              the mask as an integer, lane k is bit k: `if bits(m)` asks for any
    lowest(k)                            the number of such an integer's lowest bit: cttz; k not 0
    total(a)                             sum of the lanes in a fixed order: halves onto each other
    join(a, b)                           two F32X8 as one F32
    zip_low(a, b), zip_high(a, b)        a0 b0 a1 b1 … a7 b7, and a8 b8 … a15 b15
    evens(a, b), odds(a, b)              back again: the lanes of even (odd) number of the 32 lanes a, b

Memory. Arrays are C-contiguous with elements of the vector's type; an index counts elements from the array's
first, whatever its shape. Nothing is checked.

    load(x, i), load8(x, i)              16 (8) elements from index i, of any alignment; F32 or I32 as x is
    load_part(x, i, n)                   lanes >= n are 0 and not read (n may exceed 16)
    store(x, i, a), store_part(x, i, a, n)
    load_unit_part(x, i, n)              as float32 in [0,1]: float32 elements as they are, uint8 ones / 255
    gather(x, indices, m)                x[indices] where m, else 0: as many loads, none for lanes outside m
    scatter(x, indices, a, m)            the later lane wins where indices repeat
    load_rows(x, indices)                rows of x (n,16) as the tuple of their sixteen columns: sixteen loads
                                         and 64 shuffles, about a quarter of what sixteen gathers cost
    add_to_rows(x, indices, columns)     x[indices] += such a tuple, one row after another, so indices may
                                         repeat; x float32 or float64

    aligned_zeros(n)                     a float32 array to work in that begins at a line of the cache

To see what became of a kernel: `kernel.inspect_llvm(kernel.signatures[0])` holds "<16 x float>" and no
"extractelement" in its loops, `kernel.inspect_asm(…)` names zmm or ymm registers (of a kernel just compiled:
numba inspects none that comes from its cache). NUMBA_CPU_NAME=haswell NUMBA_CPU_FEATURES=+avx2,+fma compiles
for AVX2; the name alone does not. Nothing here asks LLVM to reorder anything: bits depend on whether the
machine has FMA, on nothing else. Parts are masked instructions with AVX, one branch a lane elsewhere: use
them at ends.
"""

from __future__ import annotations

from llvmlite import ir
from numba.core import types
from numba.core.extending import intrinsic

from paper_artifact.kernel_cache import njit
from paper_artifact.raster.lane_type import (
    BOOL,
    F32,
    F32X8,
    I32,
    WIDTH,
    Lanes,
    add_to_rows,
    aligned_zeros,
    call,
    first_lanes,
    gather,
    int32,
    load,
    load8,
    load_part,
    load_rows,
    load_unit_part,
    scatter,
    shuffle,
    splatted,
    store,
    store_part,
)

# fmt: off
__all__ = [
    "BOOL", "F32", "F32X8", "I32", "WIDTH", "Lanes", "absolute", "add_to_rows", "aligned_zeros", "bits",
    "evens", "first", "floor", "fma", "gather", "inlined", "iota", "join", "load", "load8",
    "load_part", "load_rows", "load_unit_part", "lowest", "maximum", "minimum", "odds", "scatter",
    "select", "splat", "splat8", "splat_int", "square_root", "store", "store_part",
    "to_float", "total", "zip_high", "zip_low",
]
# fmt: on

# Decorator of a kernel's helper: LLVM puts it where it is called. It borrows its arrays, that is, must make
# none itself: counting references to each argument, atomically, would cost more than most helpers do.
inlined = njit(forceinline=True, _nrt=False)


def _lanewise(count: int, emit, result_of=lambda kind: kind):
    # An intrinsic of `count` vectors, of which some may be numbers: emit(builder, type, *values) gives its
    # value.
    def declare(*arguments):
        kind = next(each for each in arguments if isinstance(each, Lanes))

        def code(context, builder, sig, values):
            return emit(builder, kind, *values)

        return result_of(kind)(*[kind] * count), code

    if count == 1:
        return intrinsic(lambda typing, a: declare(a))
    if count == 2:
        return intrinsic(lambda typing, a, b: declare(a, b))
    return intrinsic(lambda typing, a, b, c: declare(a, b, c))


def _math(name: str):
    return lambda builder, a, *values: call(builder, f"llvm.{name}.{a.suffix}", a.llvm, *values)


def _emit_minimum(builder, kind, a, b):
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


def _emit_maximum(builder, kind, a, b):
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _emit_total(builder, kind, a):
    width = kind.width
    while width > 1:
        width //= 2
        a = builder.fadd(
            shuffle(builder, a, a, range(width)), shuffle(builder, a, a, range(width, 2 * width))
        )
    return builder.extract_element(a, int32(0))


def _emit_bits(builder, kind, a):
    return builder.zext(builder.bitcast(a, ir.IntType(kind.width)), ir.IntType(32))


_zipped = [k // 2 + WIDTH * (k % 2) for k in range(2 * WIDTH)]
fma = _lanewise(3, _math("fmuladd"))
absolute = _lanewise(1, _math("fabs"))
floor = _lanewise(1, _math("floor"))
square_root = _lanewise(1, _math("sqrt"))
minimum = _lanewise(2, _emit_minimum)
maximum = _lanewise(2, _emit_maximum)
total = _lanewise(1, _emit_total, lambda kind: types.float32)
bits = _lanewise(1, _emit_bits, lambda kind: types.int32)
to_float = _lanewise(1, lambda builder, kind, a: builder.sitofp(a, F32.llvm), lambda kind: F32)
zip_low = _lanewise(2, lambda builder, kind, a, b: shuffle(builder, a, b, _zipped[:WIDTH]))
zip_high = _lanewise(2, lambda builder, kind, a, b: shuffle(builder, a, b, _zipped[WIDTH:]))
evens = _lanewise(2, lambda builder, kind, a, b: shuffle(builder, a, b, range(0, 2 * WIDTH, 2)))
odds = _lanewise(2, lambda builder, kind, a, b: shuffle(builder, a, b, range(1, 2 * WIDTH, 2)))
join = _lanewise(2, lambda builder, kind, a, b: shuffle(builder, a, b, range(16)), lambda kind: F32)


def _splatting(kind: Lanes, element: types.Number):
    @intrinsic
    def function(typing, value):
        def code(context, builder, sig, arguments):
            return splatted(builder, context.cast(builder, arguments[0], sig.args[0], element), kind.llvm)

        return kind(value), code

    return function


splat, splat8, splat_int = (
    _splatting(F32, types.float32),
    _splatting(F32X8, types.float32),
    _splatting(I32, types.int32),
)


@intrinsic
def select(typing, mask, a, b):
    def code(context, builder, sig, arguments):
        return builder.select(*arguments)

    kind = a if isinstance(a, Lanes) else b  # either side may be a number
    return kind(mask, kind, kind), code


@intrinsic
def iota(typing):
    def code(context, builder, sig, arguments):
        return ir.Constant(I32.llvm, [int32(k) for k in range(WIDTH)])

    return I32(), code


@intrinsic
def first(typing, count):
    def code(context, builder, sig, arguments):
        return first_lanes(builder, arguments[0])

    return BOOL(count), code


@intrinsic
def lowest(typing, value):
    def code(context, builder, sig, arguments):
        return builder.cttz(arguments[0], ir.IntType(1)(1))

    return types.int32(types.int32), code
