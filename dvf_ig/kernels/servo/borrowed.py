"""Arrays whose owner outlives a kernel, taken without reference counts.

numba counts references to every slice of an array with an atomic operation. A tick takes some thirty slices,
and the counts then cost more than the forces. The arrays of a loop are held by the thread that called it, so
the loop may borrow them: a slice of a borrowed array counts nothing.

A kernel that is not inlined takes every number of every array of a tuple as an argument, some 300 in all for
a servo: it is called with the tuple's address instead.
"""

from typing import Any

from llvmlite import ir
from numba import core
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

types: Any = core.types


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    array = context.make_array(kind)(context, builder, value)
    array.meminfo = ir.Constant(array.meminfo.type, None)
    array.parent = ir.Constant(array.parent.type, None)
    return array._getvalue()


def _tuple_without_owners(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    parts = [
        _without_owner(context, builder, part, builder.extract_value(value, k))
        for k, part in enumerate(kind.types)
    ]
    return context.make_tuple(builder, kind, parts)


def _loaded(builder: Any, place: Any) -> Any:
    """Load the value at a place that does not change, number by number: unused ones are then left out."""
    kind = place.type.pointee
    if not isinstance(kind, ir.Aggregate):
        number = builder.load(place)
        number.set_metadata("invariant.load", builder.module.add_metadata([]))
        return number
    value = ir.Constant(kind, ir.Undefined)
    for k in range(len(kind)):
        at = builder.gep(place, [ir.Constant(ir.IntType(32), i) for i in (0, k)], inbounds=True)
        value = builder.insert_value(value, _loaded(builder, at), k)
    return value


@intrinsic
def placed(typing: Any, arrays: Any) -> Any:
    """Address at which a called kernel finds a tuple of arrays; valid until the calling one returns."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = cgutils.alloca_once(builder, args[0].type)
        builder.store(args[0], place)
        return builder.bitcast(place, context.get_value_type(signature.return_type))

    return types.CPointer(arrays)(arrays), build


@intrinsic
def borrowed_from(typing: Any, address: Any) -> Any:
    """The tuple of arrays at an address of `placed`, without owners."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.return_type
        place = builder.bitcast(args[0], context.get_value_type(kind).as_pointer())
        return _tuple_without_owners(context, builder, kind, _loaded(builder, place))

    return address.dtype(address), build


@intrinsic
def borrowed(typing: Any, arrays: Any) -> Any:
    """Arrays, one or a tuple of them, without an owner; valid while the originals live."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args[0]
        if isinstance(kind, types.Array):
            return _without_owner(context, builder, kind, args[0])
        return _tuple_without_owners(context, builder, kind, args[0])

    return arrays(arrays), build


@intrinsic
def borrowed_block(typing: Any, flat: Any, begin: Any, shape: Any) -> Any:
    """C-ordered array of a shape (a tuple) in a flat one, from `begin` on; `reshape` would cost 20 ns."""
    kind = types.Array(flat.dtype, len(shape), "C")

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        source = context.make_array(signature.args[0])(context, builder, args[0])
        lengths = cgutils.unpack_tuple(builder, args[2])
        strides = [source.itemsize]
        for length in lengths[:0:-1]:
            strides.insert(0, builder.mul(strides[0], length))
        out = context.make_array(kind)(context, builder)
        data = builder.gep(source.data, [args[1]])
        populate_array(out, data, lengths, strides, source.itemsize, None)
        return out._getvalue()

    return kind(flat, begin, shape), build
