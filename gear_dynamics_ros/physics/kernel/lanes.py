"""Vectors of 2, 4 or 8 numbers for compiled functions: both gears, or eight waves, at once.

A compiler finds such vectors in scalar code only by luck; here they are a type of numba's whose arithmetic
becomes vector instructions on every processor. ``+ - * /`` take lanes or a number on either side, ``v[i]`` is
one lane. Only compiled functions can use them. They are
made with numba's own means of extension, which may change between its releases.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

DOUBLE = ir.DoubleType()
INDEX = ir.IntType(32)


class Lanes(types.Type):
    """numba's type of ``count`` float64 lanes."""

    def __init__(self, count: int) -> None:
        self.count = count
        super().__init__(f"Lanes({count})")


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        super().__init__(manager, lanes, ir.VectorType(DOUBLE, lanes.count))  # type: ignore[no-untyped-call]


def _spread(builder: ir.IRBuilder, number: ir.Value, count: int) -> ir.Value:
    """``number`` in every lane."""
    vector = ir.VectorType(DOUBLE, count)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), number, INDEX(0))
    return builder.shuffle_vector(
        first, ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(INDEX, count), [0] * count)
    )


def _define_operator(symbol: Callable[..., Any], instruction: str) -> None:
    """Type and code of a binary operator of lanes with lanes or a float."""

    class Typing(AbstractTemplate):
        key = symbol

        def generic(self, args: tuple[types.Type, ...], kws: dict[str, types.Type]) -> Any:
            lanes = [arg for arg in args if isinstance(arg, Lanes)]
            if not lanes:
                return None
            operands = (arg if isinstance(arg, Lanes) else types.float64 for arg in args)
            return signature(lanes[0], *operands)

    infer_global(symbol)(Typing)

    def code(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
        count = sig.return_type.count
        operands = (
            arg if isinstance(kind, Lanes) else _spread(builder, arg, count)
            for kind, arg in zip(sig.args, args, strict=True)
        )
        return getattr(builder, instruction)(*operands)

    for left, right in ((Lanes, Lanes), (Lanes, types.float64), (types.float64, Lanes)):
        lower_builtin(symbol, left, right)(code)


for _symbol, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _define_operator(_symbol, _instruction)


@infer_global(operator.neg)
class _NegativeTyping(AbstractTemplate):
    def generic(self, args: tuple[types.Type, ...], kws: dict[str, types.Type]) -> Any:
        return signature(args[0], args[0]) if isinstance(args[0], Lanes) else None


@lower_builtin(operator.neg, Lanes)
def _negative(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
    return builder.fneg(args[0])


@infer_global(operator.getitem)
class _LaneTyping(AbstractTemplate):
    def generic(self, args: tuple[types.Type, ...], kws: dict[str, types.Type]) -> Any:
        if isinstance(args[0], Lanes) and isinstance(args[1], types.Integer):
            return signature(types.float64, args[0], types.intp)
        return None


@lower_builtin(operator.getitem, Lanes, types.Integer)
def _lane(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
    return builder.extract_element(args[0], args[1])


def _both(typing: Any, first: types.Type, second: types.Type) -> Any:
    """Two numbers as lanes."""

    def code(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
        vector = ir.Constant(ir.VectorType(DOUBLE, 2), ir.Undefined)
        for lane, number in enumerate(args):
            vector = builder.insert_element(vector, number, INDEX(lane))
        return vector

    return Lanes(2)(types.float64, types.float64), code


def _pointer(typing: Any, array: types.Type) -> Any:
    """Where the float64 of ``array`` begin, without counting a reference: its owner must keep it alive."""

    def code(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
        return context.make_array(array)(context, builder, args[0]).data

    return types.CPointer(types.float64)(array), code


def _copy(typing: Any, source: types.Record, target: types.Record) -> Any:
    """All of one record into another of its type."""

    def code(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
        cgutils.raw_memcpy(builder, args[1], args[0], INDEX(source.size), 1)
        return context.get_dummy_value()

    return types.void(source, source), code


def _address(
    context: Any, builder: ir.IRBuilder, kind: types.Type, value: ir.Value, index: ir.Value, count: int
) -> ir.Value:
    """Address of element ``index`` of an array or pointer, as one of ``count`` lanes."""
    data = value
    if isinstance(kind, types.Array):
        data = context.make_array(kind)(context, builder, value).data
    return builder.bitcast(builder.gep(data, [index]), ir.VectorType(DOUBLE, count).as_pointer())


def _loader(count: int) -> Any:
    def load(typing: Any, array: types.Type, index: types.Type) -> Any:
        def code(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
            address = _address(context, builder, sig.args[0], args[0], args[1], count)
            return builder.load(address, align=8, typ=ir.VectorType(DOUBLE, count))

        return Lanes(count)(array, types.intp), code

    return intrinsic(load)


def _store(typing: Any, array: types.Type, index: types.Type, lanes: types.Type) -> Any:
    """Write all lanes to ``array[index]`` and what follows."""

    def code(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
        value, at, vector = args
        address = _address(context, builder, sig.args[0], value, at, sig.args[2].count)
        builder.store(vector, address, align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), code


def _kind(number: types.Type) -> tuple[int, str]:
    """Lanes of ``number`` and LLVM's name of its type; one lane for a plain float."""
    if isinstance(number, Lanes):
        return number.count, f"v{number.count}f64"
    return 1, "f64"


def _function(name: str) -> Any:
    """An LLVM function of lanes, or of one float."""

    def function(typing: Any, number: types.Type) -> Any:
        def code(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
            kind = ir.FunctionType(args[0].type, [args[0].type])
            full_name = f"llvm.{name}.{_kind(sig.return_type)[1]}"
            return builder.call(cgutils.get_or_insert_function(builder.module, kind, full_name), args)

        return number(number), code

    return intrinsic(function)


def _arctangent_of(typing: Any, number: types.Type) -> Any:
    """atan of each lane, or of one float, by the library."""

    def code(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
        atan = context.get_function(math.atan, types.float64(types.float64))
        if not isinstance(number, Lanes):
            return atan(builder, args)
        vector = args[0]
        for lane in range(number.count):
            result = atan(builder, (builder.extract_element(vector, INDEX(lane)),))
            vector = builder.insert_element(vector, result, INDEX(lane))
        return vector

    return number(number), code


def _at_least(typing: Any, number: types.Type, least: types.Type) -> Any:
    """The greater of both, lane by lane; ``least`` may be one float."""

    def code(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
        value, bound = args
        if isinstance(number, Lanes) and not isinstance(least, Lanes):
            bound = _spread(builder, bound, number.count)
        return builder.select(builder.fcmp_ordered(">", value, bound), value, bound)

    return number(number, least if isinstance(least, Lanes) else types.float64), code


def _any_negative(typing: Any, number: types.Type) -> Any:
    """Whether any lane, or the one float, is below zero."""

    def code(context: Any, builder: ir.IRBuilder, sig: Any, args: tuple[ir.Value, ...]) -> ir.Value:
        below = builder.fcmp_ordered("<", args[0], ir.Constant(args[0].type, None))
        count = _kind(number)[0]
        if count == 1:
            return below
        bits = ir.IntType(count)
        return builder.icmp_unsigned("!=", builder.bitcast(below, bits), bits(0))

    return types.boolean(number), code


# What compiled functions call. Their types are numba's, of which type checkers know nothing.
load2: Any = _loader(2)
load4: Any = _loader(4)
load8: Any = _loader(8)
square_root: Any = _function("sqrt")
absolute: Any = _function("fabs")
both: Any = intrinsic(_both)
pointer: Any = intrinsic(_pointer)
copy_record: Any = intrinsic(_copy)
store: Any = intrinsic(_store)
arctangent_of: Any = intrinsic(_arctangent_of)
at_least: Any = intrinsic(_at_least)
any_negative: Any = intrinsic(_any_negative)
