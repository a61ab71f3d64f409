"""The numba type behind `lanes`: its LLVM form, its operators, and reading and writing of arrays."""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.extending import intrinsic, lower_builtin, lower_cast, models, register_model
from numba.core.typing.templates import AbstractTemplate, infer_global, signature

from paper_artifact.kernel_cache import njit

WIDTH = 16
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


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, fe_type.llvm)


def int32(k: int) -> ir.Constant:
    # The int32 k.
    return ir.IntType(32)(k)


def splatted(builder, value, vector: ir.VectorType):
    # The value in all lanes.
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, int32(0))
    return builder.shuffle_vector(
        one, ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(int32(0).type, vector.count), None)
    )


def shuffle(builder, a, b, lanes):
    # These of the lanes of a and b, numbered through.
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), [int32(k) for k in lanes])
    return builder.shuffle_vector(a, b, mask)


def call(builder, name: str, result, *arguments):
    # One of LLVM's intrinsic functions.
    kind = ir.FunctionType(result, [argument.type for argument in arguments])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), arguments)


@lower_cast(types.Number, Lanes)
def _number_to_lanes(context, builder, source, target, value):
    element = types.float32 if target.kind == "f32" else types.int32
    return splatted(builder, context.cast(builder, value, source, element), target.llvm)


def first_lanes(builder, count):
    # Lanes below count, which is any integer.
    count = builder.trunc(count, ir.IntType(32)) if count.type.width > 32 else count
    lanes = ir.Constant(I32.llvm, [int32(k) for k in range(WIDTH)])
    return builder.icmp_signed("<", lanes, splatted(builder, count, I32.llvm))


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


def _comparison(sign: str):
    # The builder's calls that compare float lanes and integer lanes.
    def by_float(builder, a, b):
        return (builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered)(sign, a, b)

    def by_int(builder, a, b):
        return builder.icmp_signed(sign, a, b)

    return by_float, by_int


for _function, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    _operator(_function, *_comparison(_sign), compares=True)


# Arrays.


@njit(cache=True)
def aligned_zeros(count):
    """Return `count` float32 zeros that begin at a multiple of 64 bytes: no vector crosses a cache line."""
    room = np.zeros(count + WIDTH, np.float32)
    start = (-room.ctypes.data % 64) // 4
    return room[start : start + count]


_OF_ARRAY = {types.float32: "f32", types.int32: "i32"}


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
        return _masked_load(builder, pointer, first_lanes(builder, arguments[2]), kind.llvm, kind.suffix)

    return kind(array, types.intp, count), code


@intrinsic
def store_part(typing, array, index, value, count):
    def code(context, builder, sig, arguments):
        pointer = _pointer(context, builder, array, *arguments[:2], value.llvm)
        mask = first_lanes(builder, arguments[3])
        call(
            builder,
            f"llvm.masked.store.{value.suffix}.p0",
            ir.VoidType(),
            arguments[2],
            pointer,
            int32(4),
            mask,
        )

    return types.void(array, types.intp, value, count), code


def _masked_load(builder, pointer, mask, vector, suffix, align: int = 4):
    zero = ir.Constant(vector, None)
    return call(builder, f"llvm.masked.load.{suffix}.p0", vector, pointer, int32(align), mask, zero)


@intrinsic
def load_unit_part(typing, array, index, count):
    is_bytes = array.dtype == types.uint8
    vector, suffix = (ir.VectorType(ir.IntType(8), WIDTH), "v16i8") if is_bytes else (F32.llvm, F32.suffix)

    def code(context, builder, sig, arguments):
        pointer = _pointer(context, builder, array, *arguments[:2], vector)
        loaded = _masked_load(builder, pointer, first_lanes(builder, arguments[2]), vector, suffix, 1)
        if not is_bytes:
            return loaded
        most = splatted(builder, ir.Constant(ir.FloatType(), 255.0), F32.llvm)
        return builder.fdiv(builder.uitofp(loaded, F32.llvm), most)

    return F32(array, types.intp, count), code


def _pointers(context, builder, array_type, array, indices):
    # getelementptr with a vector of indices, for which llvmlite's builder has no method.
    data = context.make_array(array_type)(context, builder, array).data
    base = splatted(builder, data, ir.VectorType(data.type, WIDTH))
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
        return call(builder, name, kind.llvm, pointers, int32(4), arguments[2], zero)

    return kind(array, indices, mask), code


@intrinsic
def scatter(typing, array, indices, value, mask):
    def code(context, builder, sig, arguments):
        pointers = _pointers(context, builder, array, *arguments[:2])
        name = f"llvm.masked.scatter.{value.suffix}.v16p0"
        call(builder, name, ir.VoidType(), arguments[2], pointers, int32(4), arguments[3])

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
                shuffled[k], shuffled[k + distance] = (shuffle(builder, a, b, mask) for mask in masks)
        rows = shuffled
    # What stands in row k now is the column whose number has the lowest two bits of k exchanged.
    return [rows[(k & 1) << 1 | (k & 2) >> 1 | k & 12] for k in range(WIDTH)]


def _row_pointers(context, builder, array_type, array, indices):
    # Pointers to sixteen rows of an array (n,16), and the vector type of its elements.
    element = ir.DoubleType() if array_type.dtype == types.float64 else ir.FloatType()
    vector = ir.VectorType(element, WIDTH)
    data, pointers = context.make_array(array_type)(context, builder, array).data, []
    for k in range(WIDTH):
        row = builder.sext(builder.extract_element(indices, int32(k)), ir.IntType(64))
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
