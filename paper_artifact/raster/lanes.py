"""Vectors in numba kernels: values of several float32, int32 or bool that one instruction works on.

    @numba.njit
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

    a + b, a - b, a * b, a / b, -a       fadd, fsub, fmul, fdiv; add, sub, mul on int32; rounded as scalars
    are
    fma(a, b, c) = a·b + c               llvm.fmuladd: one rounding where the machine has FMA, else mul and
    add, and never the
                                         call of libm that llvm.fma becomes there
    a < b, <=, >, >=, ==, !=             fcmp ordered (!= unordered), icmp signed → BOOL
    m & n, m | n, m ^ n, ~m              on BOOL, and on int32 (bitwise)
    a << k, a >> k                       shl, lshr (the sign bit is not repeated) on int32
    select(m, a, b)                      a where m, else b
    minimum(a, b), maximum(a, b)         select on a < b, a > b: one vminps; b where either is NaN
    absolute, floor, square_root         llvm.fabs, llvm.floor, llvm.sqrt (exact)
    splat(x), splat8(x), splat_int(x)    the number x in all lanes
    iota()                               int32 0 … 15
    to_float(a), to_int(a)               sitofp, fptosi (towards 0; the value must fit)
    first(n)                             BOOL: the first n lanes (none when n <= 0)
    bits(m)                              the mask as an integer, lane k is bit k: `if bits(m)` asks for any
    popcount(k), trailing_zeros(k)       of such an integer: ctpop, cttz (16 for 0)
    total(a)                             sum of the lanes in a fixed order: halves onto each other
    lane(a, k)                           element k, k constant or not
    low(a), high(a), join(a, b)          the halves of 16 lanes as 8, and back
    shifted(a, b, k)                     lanes k … k + 15 of the 32 lanes a, b; k a constant: one valignd
    zip_low(a, b), zip_high(a, b)        a0 b0 a1 b1 … a7 b7, and a8 b8 … a15 b15
    evens(a, b), odds(a, b)              back again: the lanes of even (odd) number of the 32 lanes a, b
    compress(a, m)                       the lanes of a where m, moved together to the front; the rest is
    undefined

Memory. Arrays are C-contiguous with elements of the vector's type; an index counts elements from the array's
first, whatever its shape. Nothing is checked.

    load(x, i), load8(x, i)              16 (8) elements from index i, of any alignment; float32 or int32 as x
    has them
    load_part(x, i, n)                   lanes >= n are 0 and not read (n may exceed 16)
    store(x, i, a), store_part(x, i, a, n)
    load_unit_part(x, i, n)              as float32 in [0,1]: float32 elements as they are, uint8 ones / 255
    gather(x, indices, m)                x[indices] where m, else 0: as many loads, none for lanes outside m
    scatter(x, indices, a, m)            the later lane wins where indices repeat
    load_rows(x, indices)                rows of x (n,16) as the tuple of their sixteen columns: sixteen loads
    and 64 shuffles, about
                                         a quarter of what sixteen gathers cost
    add_to_rows(x, indices, columns)     x[indices] += such a tuple, one row after another, so indices may
    repeat; x float32 or
                                         float64

To see what became of a kernel: `kernel.inspect_llvm(kernel.signatures[0])` holds "<16 x float>" and no
"extractelement" in its loops; `kernel.inspect_asm(…)` names zmm or ymm registers. NUMBA_CPU_NAME=haswell
compiles for AVX2. Nothing here asks LLVM to reorder anything: bits depend on whether the machine has FMA, on
nothing else.
"""
# A kernel elsewhere that is cached does not notice a change here: numba's cache looks at the kernel's own
# file only.

from __future__ import annotations

import operator

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.extending import intrinsic, lower_builtin, lower_cast, models, register_model
from numba.core.typing.templates import AbstractTemplate, infer_global, signature

WIDTH = 16
# Decorator of a kernel's helper: LLVM puts it where it is called. It borrows its arrays, that is, must make
# none itself: counting references to each argument, atomically, would cost more than most helpers do.
inlined = numba.njit(forceinline=True, _nrt=False)
_ELEMENT = {"f32": ir.FloatType(), "i32": ir.IntType(32), "bool": ir.IntType(1)}


class Lanes(types.Type):
    """The numba type of `width` lanes of kind "f32", "i32" or "bool"."""

    def __init__(self, kind: str, width: int) -> None:
        self.kind, self.width = kind, width
        super().__init__(name=f"Lanes({kind}x{width})")

    @property
    def llvm(self) -> ir.VectorType:
        """The LLVM type, such as <16 x float>."""
        return ir.VectorType(_ELEMENT[self.kind], self.width)

    @property
    def suffix(self) -> str:
        """How LLVM's intrinsics name the type, such as v16f32."""
        return f"v{self.width}{ {'f32': 'f32', 'i32': 'i32', 'bool': 'i1'}[self.kind] }"


F32, I32, BOOL, F32X8 = Lanes("f32", 16), Lanes("i32", 16), Lanes("bool", 16), Lanes("f32", 8)
_OF_ARRAY = {types.float32: "f32", types.int32: "i32"}


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, fe_type.llvm)


def _index(k: int) -> ir.Constant:
    return ir.IntType(32)(k)


def _splat(builder, value, vector: ir.VectorType):
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, _index(0))
    return builder.shuffle_vector(
        one, ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(_index(0).type, vector.count), None)
    )


def _shuffle(builder, a, b, lanes):
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), [_index(k) for k in lanes])
    return builder.shuffle_vector(a, b, mask)


def _call(builder, name: str, result, *arguments):
    kind = ir.FunctionType(result, [argument.type for argument in arguments])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), arguments)


@lower_cast(types.Number, Lanes)
def _number_to_lanes(context, builder, source, target, value):
    element = types.float32 if target.kind == "f32" else types.int32
    return _splat(builder, context.cast(builder, value, source, element), target.llvm)


# Operators: one table row each, LLVM's builder method for float and for integer lanes.


def _operator(function, for_float, for_int, compares: bool = False) -> None:
    class Template(AbstractTemplate):
        def generic(self, arguments, keywords):
            lanes = [each for each in arguments if isinstance(each, Lanes)]
            numbers = [each for each in arguments if isinstance(each, types.Number)]
            if not lanes or len(lanes) + len(numbers) < len(arguments) or lanes[0] != lanes[-1]:
                return None
            result = Lanes("bool", lanes[0].width) if compares else lanes[0]
            return signature(result, *[lanes[0]] * len(arguments))

    def lower(context, builder, sig, arguments):
        emit = for_float if sig.args[0].kind == "f32" else for_int
        return emit(builder, *arguments)

    infer_global(function)(Template)
    lower_builtin(function, *[Lanes] * (1 if function in (operator.neg, operator.invert) else 2))(lower)


_B = ir.IRBuilder
for _function, _float, _int in (
    (operator.add, _B.fadd, _B.add),
    (operator.iadd, _B.fadd, _B.add),
    (operator.sub, _B.fsub, _B.sub),
    (operator.isub, _B.fsub, _B.sub),
    (operator.mul, _B.fmul, _B.mul),
    (operator.imul, _B.fmul, _B.mul),
    (operator.truediv, _B.fdiv, None),
    (operator.neg, _B.fneg, _B.neg),
    (operator.and_, None, _B.and_),
    (operator.or_, None, _B.or_),
    (operator.xor, None, _B.xor),
    (operator.invert, None, _B.not_),
    (operator.lshift, None, _B.shl),
    (operator.rshift, None, _B.lshr),
):
    _operator(_function, _float, _int)
for _function, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):

    def _by_float(builder, a, b, sign=_sign):
        return (builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered)(sign, a, b)

    def _by_int(builder, a, b, sign=_sign):
        return builder.icmp_signed(sign, a, b)

    _operator(_function, _by_float, _by_int, compares=True)


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
    return lambda builder, a, *values: _call(builder, f"llvm.{name}.{a.suffix}", a.llvm, *values)


def _emit_minimum(builder, kind, a, b):
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


def _emit_maximum(builder, kind, a, b):
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _emit_total(builder, kind, a):
    width = kind.width
    while width > 1:
        width //= 2
        a = builder.fadd(
            _shuffle(builder, a, a, range(width)), _shuffle(builder, a, a, range(width, 2 * width))
        )
    return builder.extract_element(a, _index(0))


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
to_int = _lanewise(1, lambda builder, kind, a: builder.fptosi(a, I32.llvm), lambda kind: I32)
low = _lanewise(1, lambda builder, kind, a: _shuffle(builder, a, a, range(8)), lambda kind: F32X8)
high = _lanewise(1, lambda builder, kind, a: _shuffle(builder, a, a, range(8, 16)), lambda kind: F32X8)
zip_low = _lanewise(2, lambda builder, kind, a, b: _shuffle(builder, a, b, _zipped[:WIDTH]))
zip_high = _lanewise(2, lambda builder, kind, a, b: _shuffle(builder, a, b, _zipped[WIDTH:]))
evens = _lanewise(2, lambda builder, kind, a, b: _shuffle(builder, a, b, range(0, 2 * WIDTH, 2)))
odds = _lanewise(2, lambda builder, kind, a, b: _shuffle(builder, a, b, range(1, 2 * WIDTH, 2)))
join = _lanewise(2, lambda builder, kind, a, b: _shuffle(builder, a, b, range(16)), lambda kind: F32)


def _splatting(kind: Lanes, element: types.Number):
    @intrinsic
    def function(typing, value):
        def code(context, builder, sig, arguments):
            return _splat(builder, context.cast(builder, arguments[0], sig.args[0], element), kind.llvm)

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
        return ir.Constant(I32.llvm, [_index(k) for k in range(WIDTH)])

    return I32(), code


def _first(builder, count):
    # Lanes below count, which is any integer.
    count = builder.trunc(count, ir.IntType(32)) if count.type.width > 32 else count
    lanes = ir.Constant(I32.llvm, [_index(k) for k in range(WIDTH)])
    return builder.icmp_signed("<", lanes, _splat(builder, count, I32.llvm))


@intrinsic
def first(typing, count):
    def code(context, builder, sig, arguments):
        return _first(builder, arguments[0])

    return BOOL(count), code


@intrinsic
def popcount(typing, value):
    def code(context, builder, sig, arguments):
        return builder.ctpop(arguments[0])

    return types.int32(types.int32), code


@intrinsic
def trailing_zeros(typing, value):
    def code(context, builder, sig, arguments):
        return builder.cttz(builder.or_(arguments[0], _index(1 << WIDTH)), ir.IntType(1)(1))

    return types.int32(types.int32), code


@intrinsic
def lane(typing, a, k):
    def code(context, builder, sig, arguments):
        return builder.extract_element(*arguments)

    return (types.float32 if a.kind == "f32" else types.int32)(a, k), code


@intrinsic(prefer_literal=True)
def shifted(typing, a, b, k):
    shift = k.literal_value

    def code(context, builder, sig, arguments):
        return _shuffle(builder, arguments[0], arguments[1], range(shift, shift + WIDTH))

    return a(a, b, k), code


@intrinsic
def compress(typing, a, mask):
    def code(context, builder, sig, arguments):
        kind = sig.args[0]
        undefined = ir.Constant(kind.llvm, ir.Undefined)
        return _call(
            builder, f"llvm.experimental.vector.compress.{kind.suffix}", kind.llvm, *arguments, undefined
        )

    return a(a, mask), code


# Memory.


def _pointer(context, builder, array_type, array, index, element):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), element.as_pointer())


def _kind_of(array: types.Array, width: int = WIDTH) -> Lanes:
    return Lanes(_OF_ARRAY[array.dtype], width)


def _loading(width: int):
    @intrinsic
    def function(typing, array, index):
        kind = _kind_of(array, width)

        def code(context, builder, sig, arguments):
            return builder.load(_pointer(context, builder, array, *arguments, kind.llvm), align=4)

        return kind(array, types.intp), code

    return function


load, load8 = _loading(WIDTH), _loading(8)


@intrinsic
def store(typing, array, index, value):
    def code(context, builder, sig, arguments):
        builder.store(arguments[2], _pointer(context, builder, array, *arguments[:2], value.llvm), align=4)

    return types.void(array, types.intp, value), code


@intrinsic
def load_part(typing, array, index, count):
    kind = _kind_of(array)

    def code(context, builder, sig, arguments):
        pointer = _pointer(context, builder, array, *arguments[:2], kind.llvm)
        return _masked_load(builder, pointer, _first(builder, arguments[2]), kind.llvm, kind.suffix)

    return kind(array, types.intp, count), code


@intrinsic
def store_part(typing, array, index, value, count):
    def code(context, builder, sig, arguments):
        pointer = _pointer(context, builder, array, *arguments[:2], value.llvm)
        mask = _first(builder, arguments[3])
        _call(
            builder,
            f"llvm.masked.store.{value.suffix}.p0",
            ir.VoidType(),
            arguments[2],
            pointer,
            _index(4),
            mask,
        )

    return types.void(array, types.intp, value, count), code


def _masked_load(builder, pointer, mask, vector, suffix, align: int = 4):
    zero = ir.Constant(vector, None)
    return _call(builder, f"llvm.masked.load.{suffix}.p0", vector, pointer, _index(align), mask, zero)


@intrinsic
def load_unit_part(typing, array, index, count):
    is_bytes = array.dtype == types.uint8
    vector, suffix = (ir.VectorType(ir.IntType(8), WIDTH), "v16i8") if is_bytes else (F32.llvm, F32.suffix)

    def code(context, builder, sig, arguments):
        pointer = _pointer(context, builder, array, *arguments[:2], vector)
        loaded = _masked_load(builder, pointer, _first(builder, arguments[2]), vector, suffix, 1)
        if not is_bytes:
            return loaded
        most = _splat(builder, ir.Constant(ir.FloatType(), 255.0), F32.llvm)
        return builder.fdiv(builder.uitofp(loaded, F32.llvm), most)

    return F32(array, types.intp, count), code


def _pointers(context, builder, array_type, array, indices):
    # getelementptr with a vector of indices, for which llvmlite's builder has no method.
    data = context.make_array(array_type)(context, builder, array).data
    base = _splat(builder, data, ir.VectorType(data.type, WIDTH))
    step = ir.FloatType() if array_type.dtype == types.float32 else ir.IntType(32)
    pointers = ir.instructions.GEPInstr(builder.block, base, [indices], False, "", source_etype=step)
    builder._insert(pointers)
    return pointers


@intrinsic
def gather(typing, array, indices, mask):
    kind = _kind_of(array)

    def code(context, builder, sig, arguments):
        pointers = _pointers(context, builder, array, *arguments[:2])
        zero = ir.Constant(kind.llvm, None)
        name = f"llvm.masked.gather.{kind.suffix}.v16p0"
        return _call(builder, name, kind.llvm, pointers, _index(4), arguments[2], zero)

    return kind(array, indices, mask), code


@intrinsic
def scatter(typing, array, indices, value, mask):
    def code(context, builder, sig, arguments):
        pointers = _pointers(context, builder, array, *arguments[:2])
        name = f"llvm.masked.scatter.{value.suffix}.v16p0"
        _call(builder, name, ir.VoidType(), arguments[2], pointers, _index(4), arguments[3])

    return types.void(array, indices, value, mask), code


def _transposed(builder, rows):
    # Sixteen vectors as the rows of a matrix → its columns. First inside each quarter of a register, then
    # whole quarters: no shuffle but vunpck and vshuf is needed.
    def quarters(*lanes):
        return [4 * q + k for q in range(4) for k in lanes]

    low, high = quarters(0, WIDTH, 1, WIDTH + 1), quarters(2, WIDTH + 2, 3, WIDTH + 3)
    low_pair, high_pair = quarters(0, 1, WIDTH, WIDTH + 1), quarters(2, 3, WIDTH + 2, WIDTH + 3)
    even, odd = (
        [4 * q + k for q in (first, first + 2, first + 4, first + 6) for k in range(4)] for first in (0, 1)
    )
    for distance, masks in ((1, (low, high)), (2, (low_pair, high_pair)), (4, (even, odd)), (8, (even, odd))):
        shuffled = list(rows)
        for k in range(WIDTH):
            if not k & distance:
                a, b = rows[k], rows[k + distance]
                shuffled[k], shuffled[k + distance] = (_shuffle(builder, a, b, mask) for mask in masks)
        rows = shuffled
    # What stands in row k now is the column whose number has the lowest two bits of k exchanged.
    return [rows[(k & 1) << 1 | (k & 2) >> 1 | k & 12] for k in range(WIDTH)]


def _row_pointers(context, builder, array_type, array, indices):
    # Pointers to sixteen rows of an array (n,16), and the vector type of its elements.
    element = ir.DoubleType() if array_type.dtype == types.float64 else ir.FloatType()
    vector = ir.VectorType(element, WIDTH)
    data, pointers = context.make_array(array_type)(context, builder, array).data, []
    for k in range(WIDTH):
        row = builder.sext(builder.extract_element(indices, _index(k)), ir.IntType(64))
        pointers.append(
            builder.bitcast(builder.gep(data, [builder.shl(row, row.type(4))]), vector.as_pointer())
        )
    return vector, pointers


@intrinsic
def load_rows(typing, array, indices):
    def code(context, builder, sig, arguments):
        _, pointers = _row_pointers(context, builder, array, *arguments)
        rows = [builder.load(pointer, align=4) for pointer in pointers]
        return context.make_tuple(builder, sig.return_type, _transposed(builder, rows))

    return types.UniTuple(F32, WIDTH)(array, indices), code


@intrinsic
def add_to_rows(typing, array, indices, columns):
    def code(context, builder, sig, arguments):
        rows = _transposed(builder, cgutils.unpack_tuple(builder, arguments[2], WIDTH))
        vector, pointers = _row_pointers(context, builder, array, *arguments[:2])
        for pointer, row in zip(pointers, rows, strict=True):
            row = builder.fpext(row, vector) if array.dtype == types.float64 else row
            builder.store(builder.fadd(builder.load(pointer, align=4), row), pointer, align=4)

    return types.void(array, indices, columns), code
