"""Compilation of the kernels by numba: in two steps, and with pointers in the place of wide tuples.

Promise: the first flight of a fresh installation compiles in some 20 s of a processor. By numba's own way it took 70 to
100 s. numba optimises and emits every function on its own, with wrappers for Python, although it does all of it again
where the function is a part of another one. It passes a NamedTuple field by field: the constants of a UAV were 149
arguments of each law. And a vector operation of one line is a function like any other.

- A kernel that a kernel calls is a *part*: its LLVM code is linked into the kernel that Python calls, which alone is
  optimised, emitted and kept on disk. Two classes of libraries override what numba does with a finished module.
- A `Pointer` is a pointer to the words of a NamedTuple. A field is read where it is used.
- A *formula* is run once on numbers that are not known yet. What it does with them is its code.

No operation on floats moves or changes, so the bits of a flight are those of every other way to compile it.
"""

from __future__ import annotations

import gc
import math
import operator
import os
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from types import FunctionType
from typing import Any

os.environ.setdefault(
    "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1"
)  # it colours messages that nobody sees

import llvmlite.ir as ir
import numba
import numpy as np
from numba import _dynfunc, types
from numba.core import cgutils, event
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.core.typed_passes import NativeLowering
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_global, signature
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_builtin,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)
from numba.np.arrayobj import make_array, populate_array

from ptnsbc_core.compile_cache import CacheFolder, KernelCache, cache_root, source_digest

FOLDER = CacheFolder(cache_root(), source_digest())


class _Part(JITCodeLibrary):
    """The code of a kernel that only kernels call: neither optimised nor emitted."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        self._raise_if_finalized()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0


class _Whole(JITCodeLibrary):
    """The code of a kernel that Python calls, with all of its parts."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        passes, builder = self._codegen._module_pass_manager()
        with self._recorded_timings.record("Module passes", builder):
            passes.run(self._final_module, builder)

    def add_linking_library(self, library: Any) -> None:
        if library not in self._linking_libraries:
            super().add_linking_library(library)
            if isinstance(library, _Part):
                for part in library._linking_libraries:
                    self.add_linking_library(part)


class _Lowering(NativeLowering):
    """numba's lowering, into a library of our own."""

    library: type[JITCodeLibrary]

    def run_pass(self, state: Any) -> bool:
        name = state.func_id.func_qualname
        state.library = self.library(state.targetctx.codegen(), name)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


@register_pass(mutates_CFG=True, analysis_only=False)
class _LoweringOfWhole(_Lowering):
    _name = "lower_whole_kernel"
    library = _Whole


@register_pass(mutates_CFG=True, analysis_only=False)
class _LoweringOfPart(_Lowering):
    _name = "lower_part_of_kernel"
    library = _Part

    def run_pass(self, state: Any) -> bool:
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        code, of = lowered.fndesc, (state.library,)
        known = _dynfunc.make_function(
            code.lookup_module(), code.qualname, "", 0, lowered.env, of
        )  # by this numba finds the part
        state.targetctx.insert_user_function(known, code, [state.library])
        state["cr"] = lowered._replace(cfunc=known)
        return True


def _pipeline(lowering: type[_Lowering]) -> type[CompilerBase]:
    class Pipeline(CompilerBase):
        def define_pipelines(self) -> list[Any]:
            passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.passes = [
                (lowering if one is NativeLowering else one, why) for one, why in passes.passes
            ]
            passes.finalize()
            return [passes]

    return Pipeline


_WHOLE, _PART = _pipeline(_LoweringOfWhole), _pipeline(_LoweringOfPart)


class _WholeKernel(CPUDispatcher):
    """A law as Python calls it; kernels see its part."""

    def __init__(self, law: Callable[..., Any], error_model: str) -> None:
        options = {"nopython": True, "error_model": error_model, "no_cfunc_wrapper": True}
        super().__init__(law, targetoptions=options, pipeline_class=_WHOLE)
        self._part = _PartOfKernel(law, inline=False)

    @property
    def _numba_type_(self) -> types.Dispatcher:
        return types.Dispatcher(self._part)

    def compile(self, sig: Any) -> Any:
        """As numba's, without collections of garbage: they would go through millions of objects that stay."""
        collects = gc.isenabled()
        gc.disable()
        try:
            return super().compile(sig)
        finally:
            if collects:
                gc.enable()


class _PartOfKernel(CPUDispatcher):
    """A law as kernels see it."""

    def __init__(self, law: Callable[..., Any], *, inline: bool) -> None:
        options = {"nopython": True, "error_model": "numpy", "forceinline": inline}
        wrappers = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(law, targetoptions={**options, **wrappers}, pipeline_class=_PART)

    def compile(self, sig: Any) -> Any:
        """As numba's, without its clocks: every call of LLVM would tell those of all functions around it."""
        kinds, result = normalize_signature(sig)
        if kinds in self.overloads:
            return self.overloads[kinds].entry_point
        details = {"dispatcher": self, "args": kinds, "return_type": result}
        with (
            global_compiler_lock,
            self._compiling_counter,
            event.trigger_event("numba:compile", details),
        ):
            compiled = self._compiler.compile(kinds, result)
            self.add_overload(compiled)
        return compiled.entry_point


def compiled(
    law: Callable[..., Any], folder: CacheFolder | None = FOLDER, error_model: str = "numpy"
) -> CPUDispatcher:
    """A law for Python; its machine code is kept in `folder`, where there is one."""
    whole = _WholeKernel(law, error_model)
    if folder is not None:
        whole._cache = KernelCache(law, folder)
    return whole


def inline(law: Callable[..., Any]) -> None:
    """Have kernels contain a law wherever they call it."""
    part = _PartOfKernel(law, inline=True)
    vars(law).update(
        _part=part, _numba_type_=types.Dispatcher(part)
    )  # the type alone does not keep it


# References ----------------------------------------------------------------------------------------------------------

_BY_VALUE = 20
"""A field of more words than this is a reference too."""


class Pointer(types.Type):
    """Type of a pointer to a NamedTuple, as words of 64 bits. Whoever made it keeps its arrays."""

    def __init__(self, target: Any) -> None:
        self.target = target
        super().__init__(_name("reference", target))


class Records(types.Type):
    """Type of a pointer to several NamedTuples, one after the other."""

    def __init__(self, target: Any) -> None:
        self.target = target
        super().__init__(_name("records", target))


def _name(kind: str, target: Any) -> str:
    return f"{kind}({target.instance_class.__name__}, {zlib.crc32(str(target).encode()):08x})"


def _is_pointed_at(kind: Any) -> bool:
    return isinstance(kind, types.BaseNamedTuple) and words(kind) > _BY_VALUE


@cache
def words(kind: Any) -> int:
    """Size of a value: an array has its address, shape and strides."""
    if isinstance(kind, types.BaseTuple):
        return sum(words(part) for part in kind)
    if isinstance(kind, types.Array):
        return 1 + 2 * int(kind.ndim)
    return 0 if isinstance(kind, types.NoneType) else 1


@cache
def _field(target: Any, name: str) -> tuple[int, Any]:
    """Offset [words] and type of a field."""
    at = target.fields.index(name)
    parts = list(target)
    return sum(words(part) for part in parts[:at]), parts[at]


@register_model(Pointer)
@register_model(Records)
class _PointerModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, cgutils.voidptr_t)


def _word(builder: Any, pointer: Any, at: int) -> Any:
    return builder.gep(pointer, [ir.Constant(ir.IntType(64), 8 * at)], inbounds=True)


def _load(context: Any, builder: Any, pointer: Any, kind: Any) -> Any:
    """The value of a type at a pointer; its arrays have no count of references."""
    if isinstance(kind, types.BaseTuple):
        values, at = [], 0
        for part in kind:
            values.append(_load(context, builder, _word(builder, pointer, at), part))
            at += words(part)
        return context.make_tuple(builder, kind, values)
    if isinstance(kind, types.NoneType):
        return context.get_dummy_value()
    if isinstance(kind, types.Array):
        array = make_array(kind)(context, builder)
        numbers = [
            builder.load(
                builder.bitcast(_word(builder, pointer, 1 + k), cgutils.intp_t.as_pointer())
            )
            for k in range(2 * kind.ndim)
        ]
        data_type = array.data.type
        data = builder.load(builder.bitcast(pointer, data_type.as_pointer()))
        size = context.get_abi_sizeof(context.get_data_type(kind.dtype))
        populate_array(
            array,
            data=data,
            shape=numbers[: kind.ndim],
            strides=numbers[kind.ndim :],
            itemsize=ir.Constant(cgutils.intp_t, size),
            meminfo=None,
        )
        return array._getvalue()
    if isinstance(kind, types.Boolean):
        number = builder.load(builder.bitcast(pointer, ir.IntType(64).as_pointer()))
        return builder.trunc(number, ir.IntType(1))
    place = builder.bitcast(pointer, context.get_value_type(kind).as_pointer())
    return builder.load(place)


def _store(context: Any, builder: Any, pointer: Any, kind: Any, value: Any, copy: bool) -> None:
    """Write a value; of an array its address, or with `copy` its numbers into the array that is there."""
    if isinstance(kind, types.BaseTuple):
        at = 0
        for k, part in enumerate(kind):
            inner = builder.extract_value(value, k)
            _store(context, builder, _word(builder, pointer, at), part, inner, copy)
            at += words(part)
    elif isinstance(kind, types.NoneType):
        pass
    elif isinstance(kind, types.Array):
        array = make_array(kind)(context, builder, value)
        place = builder.bitcast(pointer, array.data.type.as_pointer())
        if copy:
            there = builder.load(place)
            with builder.if_then(builder.icmp_unsigned("!=", there, array.data)):
                size = builder.mul(array.nitems, array.itemsize)
                cgutils.raw_memmove(builder, there, array.data, size, 1)
            return
        builder.store(array.data, place)
        numbers = [
            *cgutils.unpack_tuple(builder, array.shape),
            *cgutils.unpack_tuple(builder, array.strides),
        ]
        for k, number in enumerate(numbers):
            word = _word(builder, pointer, 1 + k)
            builder.store(number, builder.bitcast(word, cgutils.intp_t.as_pointer()))
    elif isinstance(kind, types.Boolean):
        number = builder.zext(value, ir.IntType(64))
        builder.store(number, builder.bitcast(pointer, ir.IntType(64).as_pointer()))
    else:
        builder.store(value, builder.bitcast(pointer, value.type.as_pointer()))


@infer_getattr
class _Fields(AttributeTemplate):
    key = Pointer

    def generic_resolve(self, kind: Any, name: str) -> Any:
        if name not in kind.target.fields:
            return None
        _, part = _field(kind.target, name)
        return Pointer(part) if _is_pointed_at(part) else part


@lower_getattr_generic(Pointer)
def _get_field(context: Any, builder: Any, kind: Any, value: Any, name: str) -> Any:
    at, part = _field(kind.target, name)
    place = _word(builder, value, at)
    return place if _is_pointed_at(part) else _load(context, builder, place, part)


@infer_global(operator.getitem)
class _GetRecord(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        records, row = args
        if isinstance(records, Records) and isinstance(row, types.Integer):
            return signature(Pointer(records.target), records, types.intp)
        return None


def _record(builder: Any, kind: Any, records: Any, row: Any) -> Any:
    size = ir.Constant(row.type, 8 * words(kind.target))
    return builder.gep(records, [builder.mul(row, size)], inbounds=True)


@lower_builtin(operator.getitem, Records, types.Integer)
def _get_record(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return _record(builder, sig.args[0], *args)


@infer_global(operator.setitem)
class _SetRecord(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        records, row, value = args
        if not (isinstance(records, Records) and isinstance(row, types.Integer)):
            return None
        fits = isinstance(value, Pointer) or words(value) == words(records.target)
        return signature(types.none, records, types.intp, value) if fits else None


@lower_builtin(operator.setitem, Records, types.Integer, types.Any)
def _set_record(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    records, row, value = args
    place, kind = _record(builder, sig.args[0], records, row), sig.args[2]
    if isinstance(kind, Pointer):
        value, kind = _load(context, builder, value, kind.target), kind.target
    _store(context, builder, place, kind, value, copy=True)
    return context.get_dummy_value()


@unbox(Pointer)
@unbox(Records)
def _address(kind: Any, value: Any, c: Any) -> Any:
    number = c.pyapi.object_getattr_string(value, "address")
    pointer = c.pyapi.long_as_voidptr(number)
    c.pyapi.decref(number)
    return NativeValue(pointer)


def reference(law: Callable[..., Any]) -> None:
    """Have kernels take a call of `law` for a pointer to its NamedTuple; anything else stays as it is."""

    class ByReference(AbstractTemplate):
        key = law

        def generic(self, args: Any, kws: Any) -> Any:
            (value,) = args
            return signature(
                Pointer(value) if isinstance(value, types.BaseNamedTuple) else value, value
            )

    @lower_builtin(law, types.Any)
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = sig.args[0]
        if not isinstance(kind, types.BaseNamedTuple):
            context.nrt.incref(builder, kind, args[0])
            return args[0]
        block = cgutils.alloca_once(builder, ir.IntType(64), size=max(words(kind), 1))
        place = builder.bitcast(block, cgutils.voidptr_t)
        _store(context, builder, place, kind, args[0], copy=False)
        return place

    vars(law)["_numba_type_"] = types.Function(ByReference)


# Formulas ------------------------------------------------------------------------------------------------------------


class _Number:
    """A number of a formula that is being traced: what is done with it becomes LLVM code."""

    __slots__ = ("kind", "trace", "value")

    def __init__(self, trace: _Trace, kind: Any, value: Any) -> None:
        self.trace, self.kind, self.value = trace, kind, value

    def __add__(self, other: Any) -> _Number:
        return self.trace.binary("add", self, other)

    def __radd__(self, other: Any) -> _Number:
        return self.trace.binary("add", other, self)

    def __sub__(self, other: Any) -> _Number:
        return self.trace.binary("sub", self, other)

    def __rsub__(self, other: Any) -> _Number:
        return self.trace.binary("sub", other, self)

    def __mul__(self, other: Any) -> _Number:
        return self.trace.binary("mul", self, other)

    def __rmul__(self, other: Any) -> _Number:
        return self.trace.binary("mul", other, self)

    def __truediv__(self, other: Any) -> _Number:
        return self.trace.binary("div", self, other)

    def __rtruediv__(self, other: Any) -> _Number:
        return self.trace.binary("div", other, self)

    def __neg__(self) -> _Number:
        return self.trace.unary("neg", self)

    def __abs__(self) -> _Number:
        return self.trace.unary("fabs", self)

    def __bool__(self) -> bool:
        raise TypeError("a formula has no branches: make it an inline_kernel")


class _Row:
    """An array of a formula, or a row of it."""

    __slots__ = ("kind", "pointer", "strides", "trace", "value")

    def __init__(self, trace: _Trace, kind: Any, value: Any, pointer: Any, strides: Any) -> None:
        self.trace, self.kind, self.value = trace, kind, value
        self.pointer, self.strides = pointer, strides

    def __getitem__(self, at: Any) -> Any:
        if isinstance(at, tuple):
            return self[at[0]][at[1:]] if len(at) > 1 else self[at[0]]
        pointer = self.trace.element(self, at)
        if len(self.strides) > 1:
            return _Row(self.trace, self.kind, None, pointer, self.strides[1:])
        builder = self.trace.builder
        value = None if builder is None else self.trace.read(pointer, self.kind.dtype)
        return _Number(self.trace, self.kind.dtype, value)

    def __setitem__(self, at: Any, number: Any) -> None:
        pointer = self.trace.element(self, at)
        if self.trace.builder is not None:
            value = self.trace.of_kind(number, self.kind.dtype)
            self.trace.builder.store(
                value, self.trace.builder.bitcast(pointer, value.type.as_pointer())
            )


class _Pointed:
    """A reference of a formula."""

    __slots__ = ("kind", "trace", "value")

    def __init__(self, trace: _Trace, kind: Any, value: Any) -> None:
        self.trace, self.kind, self.value = trace, kind, value

    def __getattr__(self, name: str) -> Any:
        at, part = _field(self.kind.target, name)
        context, builder, value = self.trace.context, self.trace.builder, None
        if builder is not None:
            value = _word(builder, self.value, at)
        if _is_pointed_at(part):
            return _Pointed(self.trace, Pointer(part), value)
        if builder is not None:
            value = _load(context, builder, value, part)
        return self.trace.argument(part, value)


class _Trace:
    """One run of a formula on numbers that are not known yet; without a builder only their types come out."""

    def __init__(self, context: Any, builder: Any) -> None:
        self.context, self.builder = context, builder

    def argument(self, kind: Any, value: Any) -> Any:
        """What the formula sees of an argument."""
        if isinstance(kind, types.Literal):
            return kind.literal_value
        if isinstance(kind, types.NoneType):
            return None
        if isinstance(kind, Pointer):
            return _Pointed(self, kind, value)
        if isinstance(kind, types.BaseTuple):
            parts = [
                self.argument(
                    part, None if self.builder is None else self.builder.extract_value(value, k)
                )
                for k, part in enumerate(kind)
            ]
            named = isinstance(kind, types.BaseNamedTuple)
            return kind.instance_class(*parts) if named else tuple(parts)
        if isinstance(kind, types.Array):
            pointer, strides = None, [None] * kind.ndim
            if self.builder is not None:
                array = make_array(kind)(self.context, self.builder, value)
                pointer = self.builder.bitcast(array.data, cgutils.voidptr_t)
                strides = list(cgutils.unpack_tuple(self.builder, array.strides))
                if kind.layout == "C":  # known, so that LLVM need not ask
                    size = self.context.get_abi_sizeof(self.context.get_data_type(kind.dtype))
                    strides[-1] = ir.Constant(cgutils.intp_t, size)
            return _Row(self, kind, value, pointer, strides)
        return _Number(self, kind, value)

    def of_kind(self, number: Any, kind: Any) -> Any:
        """The LLVM value of a number as this type."""
        if not isinstance(number, _Number):
            return self.context.get_constant(kind, number)
        if number.kind == kind:
            return number.value
        convert = self.builder.fpext if number.kind == types.float32 else self.builder.sitofp
        return convert(number.value, self.context.get_value_type(kind))

    def binary(self, name: str, left: Any, right: Any) -> _Number:
        kinds = [
            one.kind if isinstance(one, _Number) else numba.typeof(one) for one in (left, right)
        ]
        whole = name != "div" and all(
            isinstance(types.unliteral(kind), types.Integer) for kind in kinds
        )
        kind = types.intp if whole else types.float64
        value = None
        if self.builder is not None:
            operation = getattr(self.builder, name if whole else "f" + name)
            value = operation(self.of_kind(left, kind), self.of_kind(right, kind))
        return _Number(self, kind, value)

    def unary(self, name: str, number: _Number) -> _Number:
        value = None
        if self.builder is not None and name == "neg":
            value = self.builder.fneg(number.value)
        elif self.builder is not None:
            function = self.builder.module.declare_intrinsic("llvm." + name, [number.value.type])
            value = self.builder.call(function, [number.value])
        return _Number(self, number.kind, value)

    def element(self, row: _Row, at: Any) -> Any:
        if self.builder is None:
            return None
        step = self.builder.mul(self.of_kind(at, types.intp), row.strides[0])
        return self.builder.gep(row.pointer, [step], inbounds=True)

    def read(self, pointer: Any, kind: Any) -> Any:
        place = self.builder.bitcast(pointer, self.context.get_data_type(kind).as_pointer())
        return self.builder.load(place)

    def result(self, value: Any) -> tuple[Any, Any]:
        """Type and LLVM value of what the formula returned."""
        if value is None:
            return types.none, None if self.builder is None else self.context.get_dummy_value()
        if isinstance(value, tuple):
            parts = [self.result(part) for part in value]
            named = type(value) if hasattr(value, "_fields") else None
            kind = types.BaseTuple.from_types([kind for kind, _ in parts], named)
            if self.builder is None:
                return kind, None
            return kind, self.context.make_tuple(self.builder, kind, [part for _, part in parts])
        if isinstance(value, _Number | _Row | _Pointed):
            if self.builder is not None and isinstance(value, _Row):
                self.context.nrt.incref(self.builder, value.kind, value.value)
            return value.kind, value.value
        kind = numba.typeof(value)
        return kind, None if self.builder is None else self.context.get_constant(kind, value)


class _Maths:
    """The functions of `math` for numbers that are being traced, as numba compiles them."""

    def __getattr__(self, name: str) -> Any:
        function = getattr(math, name)
        return partial(self._call, function) if callable(function) else function

    def _call(self, function: Callable[..., float], *arguments: Any) -> Any:
        traces = [one.trace for one in arguments if isinstance(one, _Number)]
        if not traces:
            return function(*arguments)
        trace, value = traces[0], None
        if trace.builder is not None:
            kinds = signature(types.float64, *(types.float64,) * len(arguments))
            law = trace.context.get_function(function, kinds)
            value = law(trace.builder, [trace.of_kind(one, types.float64) for one in arguments])
        return _Number(trace, types.float64, value)


_FORMULAS: set[Callable[..., Any]] = set()


@cache
def _traced(law: Callable[..., Any]) -> Callable[..., Any]:
    """The formula with functions for numbers that are being traced in the place of those of `math`."""
    scope = dict(law.__globals__)
    scope["math"] = _Maths()
    for name in law.__code__.co_names:
        called = scope.get(name)
        if isinstance(called, FunctionType) and called in _FORMULAS:
            scope[name] = _traced(called)
    return FunctionType(law.__code__, scope, law.__name__, law.__defaults__, law.__closure__)


def formula(law: Callable[..., Any]) -> None:
    """Have kernels contain the operations that one run of a law makes."""
    _FORMULAS.add(law)

    class InPlace(AbstractTemplate):
        key = law
        prefer_literal = True

        def generic(self, args: Any, kws: Any) -> Any:
            trace = _Trace(None, None)
            run = _traced(law)
            kind, _ = trace.result(run(*(trace.argument(one, None) for one in args)))
            return signature(kind, *args)

    @lower_builtin(law, types.VarArg(types.Any))
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        trace = _Trace(context, builder)
        given = [trace.argument(kind, value) for kind, value in zip(sig.args, args, strict=True)]
        return trace.result(_traced(law)(*given))[1]

    vars(law)["_numba_type_"] = types.Function(InPlace)


# From Python ---------------------------------------------------------------------------------------------------------


def _write(block: Any, at: int, kind: Any, value: Any, keep: list[Any]) -> int:
    """Write a value into words (n,) from `at` on; returns where the next one begins."""
    if isinstance(kind, types.BaseTuple):
        for part, inner in zip(kind, value, strict=True):
            at = _write(block, at, part, inner, keep)
        return at
    if isinstance(kind, types.NoneType):
        return at
    if isinstance(kind, types.Array):
        keep.append(value)
        block[at : at + 1 + 2 * kind.ndim] = (value.ctypes.data, *value.shape, *value.strides)
        return at + 1 + 2 * int(kind.ndim)
    if isinstance(kind, Records):
        keep.append(value)
        block[at] = value.address
    elif isinstance(kind, types.Float):
        block[at : at + 1].view(np.float64)[0] = value
    else:
        block[at] = value
    return at + 1


def _read(block: Any, at: int, kind: Any, keep: Iterator[Any]) -> tuple[Any, int]:
    """The value in words (n,) from `at` on, and where the next one begins."""
    if isinstance(kind, types.BaseTuple):
        values = []
        for part in kind:
            value, at = _read(block, at, part, keep)
            values.append(value)
        if isinstance(kind, types.BaseNamedTuple):
            return kind.instance_class(*values), at
        return tuple(values), at
    if isinstance(kind, types.NoneType):
        return None, at
    if isinstance(kind, types.Array | Records):
        return next(keep), at + words(kind)
    if isinstance(kind, types.Float):
        return float(block[at : at + 1].view(np.float64)[0]), at + 1
    number = int(block[at])
    return bool(number) if isinstance(kind, types.Boolean) else number, at + 1


class RecordList:
    """Several NamedTuples of one type, which kernels read and write in place; in Python a list of them.

    A record that is written keeps its arrays and takes the numbers.
    """

    def __init__(self, items: Sequence[Any]) -> None:
        self.target = numba.typeof(items[0])
        self.kind = Records(self.target)
        self._block = np.zeros((len(items), words(self.target)), dtype=np.int64)
        self._arrays: list[list[Any]] = []
        for row, item in zip(self._block, items, strict=True):
            self._arrays.append([])
            _write(row, 0, self.target, item, self._arrays[-1])
        self.address = self._block.ctypes.data

    def __len__(self) -> int:
        return len(self._block)

    def __getitem__(self, row: int) -> Any:
        if not 0 <= row < len(self):
            raise IndexError(row)
        return _read(self._block[row], 0, self.target, iter(self._arrays[row]))[0]

    def __setitem__(self, row: int, item: Any) -> None:
        there, arrays = self._arrays[row], list[Any]()
        _write(np.empty(words(self.target), dtype=np.int64), 0, self.target, item, arrays)
        for array, new in zip(there, arrays, strict=True):
            if array.shape != new.shape:
                raise ValueError(f"array of shape {new.shape}: expected {array.shape}")
            array[...] = new
        before = iter(there)
        _write(self._block[row], 0, self.target, _with_arrays(item, self.target, before), [])


def _with_arrays(value: Any, kind: Any, arrays: Iterator[Any]) -> Any:
    """The value with other arrays."""
    if isinstance(kind, types.BaseTuple):
        parts = [_with_arrays(one, part, arrays) for one, part in zip(value, kind, strict=True)]
        return tuple(parts)
    return next(arrays) if isinstance(kind, types.Array) else value


class Referred:
    """A NamedTuple that Python hands to kernels as one pointer; its fields are read as of the tuple."""

    def __init__(self, value: Any) -> None:
        kind, self.value = numba.typeof(value), value
        self.kind, self._arrays = Pointer(kind), list[Any]()
        self._block = np.zeros(max(words(kind), 1), dtype=np.int64)
        _write(self._block, 0, kind, value, self._arrays)
        self.address = self._block.ctypes.data

    def __getattr__(self, name: str) -> Any:
        return getattr(self.value, name)


@typeof_impl.register(RecordList)
@typeof_impl.register(Referred)
def _typeof(value: Any, _: Any) -> Any:
    return value.kind
