"""Views into arrays and stacks of tables that a compiled function may return without counting references.

Kernels run without reference counting, and numba then refuses functions that return a part of an array. These two are
built into the caller instead. Both are ordinary functions in Python.
"""

# mypy: disable-error-code="attr-defined"
from __future__ import annotations

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import make_array, populate_array

__all__ = ["columns", "take"]


def columns(flat, rows, n):
    """Return the first ``rows * n`` numbers of the contiguous array `flat` (N,) as a contiguous array (rows, n)."""
    return flat[: rows * n].reshape(rows, n)


def take(base, stack, k):
    """Return draw k of a stack.

    Parameters
    ----------
    base : NamedTuple, tuple, ndarray or number
        The same object for one draw; its type is that of the result.
    stack : same kind as `base`
        Fields that differ between draws have a leading axis more, the others are shared by all draws.
    k : int
        Which draw.
    """
    if isinstance(base, tuple):
        parts = [take(b, s, k) for b, s in zip(base, stack, strict=True)]
        return type(base)(*parts) if hasattr(base, "_fields") else tuple(parts)
    return stack[k] if np.ndim(stack) > np.ndim(base) else stack


@type_callable(columns)
def _type_columns(context):
    def typer(flat, rows, n):
        if isinstance(flat, types.Array) and flat.ndim == 1 and flat.layout == "C":
            return flat.copy(ndim=2)
        return None

    return typer


@lower_builtin(columns, types.Array, types.Integer, types.Integer)
def _lower_columns(context, builder, signature, arguments):
    kind = signature.args[0]
    rows, n = (
        context.cast(builder, value, given, types.intp)
        for value, given in zip(arguments[1:], signature.args[1:], strict=True)
    )
    source = make_array(kind)(context, builder, arguments[0])
    view = make_array(signature.return_type)(context, builder)
    populate_array(
        view,
        data=source.data,
        shape=cgutils.pack_array(builder, [rows, n]),
        strides=cgutils.pack_array(builder, [builder.mul(n, source.itemsize), source.itemsize]),
        itemsize=source.itemsize,
        meminfo=source.meminfo,
        parent=source.parent,
    )
    return impl_ret_borrowed(context, builder, signature.return_type, view._getvalue())


def _has_axis_more(base, stack):
    return isinstance(stack, types.Array) and stack.ndim > getattr(base, "ndim", 0)


def _fits(base, stack):
    if isinstance(base, types.BaseTuple):
        return isinstance(stack, types.BaseTuple) and all(map(_fits, base.types, stack.types))
    return base == stack or (_has_axis_more(base, stack) and stack.layout == "C")


@type_callable(take)
def _type_take(context):
    def typer(base, stack, k):
        return base if isinstance(k, types.Integer) and _fits(base, stack) else None

    return typer


@lower_builtin(take, types.Any, types.Any, types.Integer)
def _lower_take(context, builder, signature, arguments):
    base, stack, given = signature.args
    k = context.cast(builder, arguments[2], given, types.intp)
    value = _one(context, builder, base, stack, arguments[1], k)
    return impl_ret_borrowed(context, builder, base, value)


def _one(context, builder, base, stack, value, k):
    """Build the value of type `base` that is draw `k` of `value`, which is of type `stack`."""
    if isinstance(base, types.BaseTuple):
        parts = [
            _one(context, builder, b, s, builder.extract_value(value, i), k)
            for i, (b, s) in enumerate(zip(base.types, stack.types, strict=True))
        ]
        return context.make_tuple(builder, base, parts)
    if not _has_axis_more(base, stack):
        return value
    source = make_array(stack)(context, builder, value)
    strides = cgutils.unpack_tuple(builder, source.strides)
    data = cgutils.pointer_add(builder, source.data, builder.mul(k, strides[0]))
    if stack.ndim == 1:
        return context.unpack_value(builder, stack.dtype, data)
    view = make_array(base)(context, builder)
    populate_array(
        view,
        data=data,
        shape=cgutils.pack_array(builder, cgutils.unpack_tuple(builder, source.shape)[1:]),
        strides=cgutils.pack_array(builder, strides[1:]),
        itemsize=source.itemsize,
        meminfo=source.meminfo,
        parent=source.parent,
    )
    return view._getvalue()
