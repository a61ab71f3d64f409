"""The numba type behind `lanes`: its LLVM form, its operators, and what operations are built from."""

from __future__ import annotations

import operator

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.extending import lower_builtin, lower_cast, models, register_model
from numba.core.typing.templates import AbstractTemplate, infer_global, signature

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
