"""One source for every law: compiled by numba where present, plain Python elsewhere.

`PTNSBC_JIT=0` selects the interpreted form. The compiled form is kept on disk by `compile_cache`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, MutableSequence, Sequence
from typing import Any, ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def _compiler() -> Callable[..., Any] | None:
    """Compile with options of numba's `njit`; None when kernels are interpreted."""
    if os.environ.get("PTNSBC_JIT", "1") == "0":
        return None
    try:
        import numba
    except ImportError:
        return None
    from ptnsbc_core.compile_cache import CacheFolder, KernelCache, cache_root, source_digest

    folder = CacheFolder(cache_root(), source_digest())

    def compiled(law: Callable[..., Any], **options: bool) -> Any:
        dispatcher = numba.njit(error_model="numpy", **options)(law)
        dispatcher._cache = KernelCache(law, folder)
        return dispatcher

    return compiled


_COMPILE = _compiler()
COMPILED: bool = _COMPILE is not None
"""True if kernels run compiled in this process."""


def kernel(law: Callable[P, R]) -> Callable[P, R]:
    """Mark a law as a kernel: scalars, tuples, float64 arrays and NamedTuples in and out, no I/O, no globals."""
    return law if _COMPILE is None else _COMPILE(law)


def inline_kernel(law: Callable[P, R]) -> Callable[P, R]:
    """A short kernel that becomes part of its caller.

    Between two compiled functions every array travels as seven words and a reference count; within one the
    compiler drops most of both. Long kernels stay apart, or each caller would compile them again.
    """
    return law if _COMPILE is None else _COMPILE(law, forceinline=True)


def prepared(law: Callable[P, R], *arguments: Any) -> Callable[P, R]:
    """The kernel `law` for arguments of the types of `arguments`, which no call checks.

    A call of a kernel first finds out the types of its arguments: of a KernelList that takes longer than to hand
    it over (`bench --only step` shows a step without it).
    """
    if not COMPILED:
        return law
    from numba import typeof

    kinds, dispatcher = tuple(typeof(argument) for argument in arguments), cast(Any, law)
    dispatcher.compile(kinds)
    return cast(Callable[P, R], dispatcher.overloads[kinds].entry_point)


def _lend() -> Callable[..., Any]:
    if not COMPILED:
        return lambda value: value
    from numba.core import cgutils, types
    from numba.extending import intrinsic

    def lent(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            array = context.make_array(kind)(context, builder, value)
            array.meminfo = cgutils.get_null_value(array.meminfo.type)
            return array._getvalue()
        if isinstance(kind, types.containers.BaseTuple):
            for k, inner in enumerate(kind):
                one = lent(context, builder, inner, builder.extract_value(value, k))
                value = builder.insert_value(value, one, k)
            return value
        context.nrt.incref(builder, kind, value)
        return value

    @intrinsic
    def lend(_: Any, value: Any) -> Any:
        return value(value), lambda context, builder, signature, args: lent(
            context, builder, signature.args[0], args[0]
        )

    return cast(Callable[..., Any], lend)


borrowed: Callable[[T], T] = _lend()
"""The same arrays, alone or in tuples, without a count of references; call it inside kernels only.

Of a loop that slices the arrays which its caller holds, atomic reference counts took a quarter of the time.
The caller has to hold them for as long as the borrowed ones are used.
"""


def _list_type() -> Any:
    if not COMPILED:
        return list
    from numba.typed import List

    return List


KernelList: Any = _list_type()
"""A list that kernels make, read and write in place; call it inside kernels only.

Handing a NamedTuple of arrays to a compiled kernel unpacks every field at every call, which costs more than
the laws; a list is handed over as one pointer, and its length is no part of the compiled type.
"""


@kernel
def _listed(item: Any) -> Any:
    out = KernelList()
    out.append(item)
    return out


@kernel
def _append(items: Any, item: Any) -> None:
    items.append(item)


def kernel_list(items: Sequence[T]) -> MutableSequence[T]:
    """A KernelList of at least one item.

    Filled by kernels: the methods of numba's list called from Python are compiled anew in every process.
    """
    out: MutableSequence[T] = _listed(items[0])
    for item in items[1:]:
        _append(out, item)
    return out
