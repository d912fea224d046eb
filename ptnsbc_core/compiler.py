"""Compilation of the kernels by numba: in two steps, and with pointers in the place of wide tuples.

Promise: the first flight of a fresh installation compiles in some 20 s of a processor, by numba's own way in 70 to 100.
numba optimises and emits every function on its own and again as a part of others, and passes a NamedTuple field by
field: the constants of a UAV were 149 arguments of each law.

- A kernel that a kernel calls is a *part*: its LLVM code is linked into the kernel that Python calls, which alone is
  optimised, emitted and kept on disk. There a part is internal: it goes inline where it is called once.
- A `Pointer` points to a NamedTuple in memory. A field is read where it is used.
- A *formula* is a Python function without branches. The compiler calls it with placeholders for numbers; each operation
  on a placeholder writes its LLVM instruction into the kernel.

No operation on floats moves or changes, so the bits of a flight are those of every other way to compile it.
"""

from __future__ import annotations

import gc
import math
import operator
import os
import threading
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, partial
from types import FunctionType
from typing import Any

# numba colours messages that nobody sees
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")

import llvmlite.ir as ir
import numba
from llvmlite.binding import Linkage, parse_assembly
from numba import _dynfunc, types
from numba.core import cgutils, event
from numba.core.callconv import create_error_model
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.sigutils import normalize_signature
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
from numba.np.arrayobj import make_array

from ptnsbc_core.compile_cache import CacheFolder, KernelCache, LawFiles, kernel_folder
from ptnsbc_core.machine_code import (
    SUPPORTED,
    Loaded,
    RecordList,
    Referred,
    in_memory,
    kind_of,
    linked,
    store,
)

FOLDER = kernel_folder()


class _Library(JITCodeLibrary):
    """The code of a kernel, whose functions are not optimised on their own."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout


class _Part(_Library):
    """The code of a kernel that only kernels call: neither optimised nor emitted."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        self._finalized = True


class _Whole(_Library):
    """The code of a kernel that Python calls, with all of its parts; optimised once, as a whole."""

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr and function.name.startswith("_ZN"):
                # a weak function of its name in another module would be linked to this one
                function.linkage, function.name = Linkage.internal, "part"
        loops = {"loop_vectorize": False, "slp_vectorize": True}  # laws: small vectors, short loops
        passes, builder = self._codegen._module_pass_manager(**loops)
        with self._recorded_timings.record("Module passes", builder):
            passes.run(self._final_module, builder)

    def add_linking_library(self, library: Any) -> None:
        if library not in self._linking_libraries:
            super().add_linking_library(library)
            if isinstance(library, _Part):
                for part in library._linking_libraries:
                    self.add_linking_library(part)


_ALLOCATOR = """
declare noalias ptr @aligned_alloc(i64, i64)
declare void @free(ptr)

define linkonce_odr noalias ptr @NRT_MemInfo_alloc_aligned(i64 %size, i32 %align) {
  %all = add i64 %size, 64
  %block = call ptr @aligned_alloc(i64 64, i64 %all)
  %none = icmp eq ptr %block, null
  br i1 %none, label %end, label %fill
fill:
  %data = getelementptr i8, ptr %block, i64 64
  %field = getelementptr i8, ptr %block, i64 24
  store i64 1, ptr %block
  store ptr %data, ptr %field
  br label %end
end:
  ret ptr %block
}

define linkonce_odr ptr @NRT_MemInfo_data_fast(ptr %block) {
  %field = getelementptr i8, ptr %block, i64 24
  %data = load ptr, ptr %field
  ret ptr %data
}

define linkonce_odr void @NRT_MemInfo_call_dtor(ptr %block) {
  call void @free(ptr %block)
  ret void
}
"""
# The arrays that no kernel gives away, without numba's library, whose code reads their place from byte 24.


class _Flat(_Whole):
    """The code of a kernel that needs the C library alone."""

    def _optimize_final_module(self) -> None:
        self._final_module.link_in(parse_assembly(_ALLOCATOR))
        super()._optimize_final_module()


def _pipeline(library: type[JITCodeLibrary]) -> type[CompilerBase]:
    """numba's pipeline, into a library of ours."""

    class Pipeline(CompilerBase):
        def define_pipelines(self) -> list[Any]:
            state = self.state
            state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
            state.library.enable_object_caching()
            state.flags.no_compile = library is _Part
            return [DefaultPassBuilder.define_nopython_pipeline(state)]

    return Pipeline


class _WholeKernel(CPUDispatcher):
    """A law as Python calls it; kernels see its part."""

    def __init__(
        self, law: Callable[..., Any], error_model: str, library: type[JITCodeLibrary] = _Whole
    ) -> None:
        options = {"nopython": True, "error_model": error_model, "no_cfunc_wrapper": True}
        options["no_cpython_wrapper"] = library is _Flat
        super().__init__(law, targetoptions=options, pipeline_class=_pipeline(library))
        self._part = _PartOfKernel(law, inline=False, error_model=error_model)

    @property
    def _numba_type_(self) -> types.Dispatcher:
        return types.Dispatcher(self._part)

    def compile(self, sig: Any) -> Any:
        """As numba's, beside the main thread, which hears Ctrl-C: LLVM does not return for seconds."""
        if threading.current_thread() is not threading.main_thread():
            return self._compile_here(sig)
        compiler = ThreadPoolExecutor(1, "compiler")
        try:
            return compiler.submit(self._compile_here, sig).result()
        finally:
            compiler.shutdown(wait=False)

    def _compile_here(self, sig: Any) -> Any:
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

    pipeline = _pipeline(_Part)

    def __init__(self, law: Callable[..., Any], *, inline: bool, error_model: str) -> None:
        options = {"nopython": True, "error_model": error_model, "forceinline": inline}
        wrappers = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(law, targetoptions={**options, **wrappers}, pipeline_class=self.pipeline)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """As numba's, once for a type: a literal is no type of its own."""
        named = {name: types.unliteral(kind) for name, kind in kws.items()}
        return super().get_call_template(tuple(map(types.unliteral, args)), named)

    def compile(self, sig: Any) -> Any:
        """As numba's, without its clocks: every call of LLVM would tell those of all functions around it."""
        kinds, result = normalize_signature(sig)
        if kinds not in self.overloads:
            details = {"dispatcher": self, "args": kinds, "return_type": result}
            told = event.trigger_event("numba:compile", details)
            with global_compiler_lock, self._compiling_counter, told:
                part = self._compiler.compile(kinds, result)
                code, of = part.fndesc, (part.library,)
                # numba finds a part by a function, which nobody calls
                name = _dynfunc.make_function(
                    code.lookup_module(), code.qualname, "", 0, part.environment, of
                )
                self.targetctx.insert_user_function(name, code, [part.library])
                self.add_overload(part._replace(entry_point=name))
        return self.overloads[kinds].entry_point


def compiled(
    law: Callable[..., Any],
    folder: CacheFolder | None = FOLDER,
    error_model: str = "numpy",
) -> CPUDispatcher:
    """A law for Python; its machine code is kept in `folder`, where there is one."""
    whole = _WholeKernel(law, error_model)
    if folder is not None:
        whole._cache = KernelCache(law, folder)
    return whole


def address_of(law: CPUDispatcher, *arguments: Any) -> int:
    """The address of a law, compiled for arguments of these types, as long as `law` is kept."""
    kinds = tuple(map(numba.typeof, arguments))
    law.compile(kinds)
    found = law.overloads[kinds]
    return int(found.library.get_pointer_to_function(found.fndesc.llvm_func_name))


def loaded(law: Callable[..., Any], arguments: tuple[Any, ...]) -> Loaded:
    """The kernel of a law for arguments of these types; the next process finds it by `machine_code.load`."""
    flat = SUPPORTED and LawFiles(law, kernel_folder(), "").ours
    kernel = _WholeKernel(law, "numpy", _Flat) if flat else compiled(law)
    address = address_of(kernel, *arguments)
    found = kernel.overloads[tuple(map(numba.typeof, arguments))]
    if flat and not found.library.has_dynamic_globals:
        code = linked(found.library._get_compiled_object(), found.fndesc.llvm_func_name)
        store(law, kind_of(arguments), code)
        with suppress(OSError):  # a system that executes nothing from memory
            return in_memory(code)
    return Loaded(address, kernel)


def at_address(law: Callable[..., Any]) -> None:
    """Have kernels take a call of `law` for a call of the function at the address that comes first."""

    class AtAddress(AbstractTemplate):
        key = law

        def generic(self, args: Any, kws: Any) -> Any:
            return signature(types.boolean, *args)

    @lower_builtin(law, types.Integer, types.Any, types.Any)
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kinds, convention = sig.args[1:], context.call_conv
        kind = convention.get_function_type(types.none, kinds)
        function = builder.inttoptr(args[0], kind.as_pointer())
        status, _ = convention.call_function(builder, function, types.none, kinds, args[1:])
        return status.is_error

    vars(law)["_numba_type_"] = types.Function(AtAddress)


def inline(law: FunctionType) -> None:
    """Have kernels contain a law wherever they call it."""
    part(law, inline=True)


def part(law: FunctionType, *, inline: bool = False, error_model: str = "numpy") -> None:
    """Have kernels know a law, which Python calls as it is."""
    of = _PartOfKernel(law, inline=inline, error_model=error_model)
    # the type alone does not keep the part
    vars(law).update(_part=of, _numba_type_=types.Dispatcher(of))


# Pointers ------------------------------------------------------------------------------------------------------------

_BY_VALUE = 160
"""A field of more bytes than this is read as a pointer too."""


class _Target(types.Type):
    """Type of a pointer to a struct in the layout of C. Its owner keeps the arrays alive: it holds no reference."""

    def __init__(self, target: Any) -> None:
        self.target = target
        digest = zlib.crc32(str(target).encode())
        super().__init__(f"{type(self).__name__}({target.instance_class.__name__}, {digest:08x})")


class Pointer(_Target):
    """Type of a pointer to a NamedTuple."""


class Records(_Target):
    """Type of a pointer to several NamedTuples, one after the other."""


@register_model(Pointer)
@register_model(Records)
class _PointerModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, cgutils.voidptr_t)


def _size(kind: Any) -> int:
    """Bytes of a value in memory."""
    context = cpu_target.target_context
    return int(context.get_abi_sizeof(context.get_data_type(kind)))


@cache
def _field(target: Any, name: str) -> tuple[int, Any]:
    """Index and type of a field as kernels read it."""
    at = target.fields.index(name)
    kind = list(target)[at]
    wide = isinstance(kind, types.BaseNamedTuple) and _size(kind) > _BY_VALUE
    return at, Pointer(kind) if wide else kind


def _typed(context: Any, builder: Any, pointer: Any, kind: Any) -> Any:
    return builder.bitcast(pointer, context.get_data_type(kind).as_pointer())


def _store(context: Any, builder: Any, place: Any, kind: Any, value: Any, copy: bool) -> None:
    """Write a value; of an array its address, or with `copy` its numbers into the array that is there."""
    if isinstance(kind, types.BaseTuple):
        for k, part in enumerate(kind):
            inner = cgutils.gep_inbounds(builder, place, 0, k)
            _store(context, builder, inner, part, builder.extract_value(value, k), copy)
        return
    if copy and isinstance(kind, types.Array):
        array = make_array(kind)(context, builder, value)
        there = make_array(kind)(context, builder, builder.load(place)).data
        with builder.if_then(builder.icmp_unsigned("!=", there, array.data)):
            size = builder.mul(array.nitems, array.itemsize)
            cgutils.raw_memmove(builder, there, array.data, size, 1)
        return
    context.pack_value(builder, kind, value, place)


def _load(context: Any, builder: Any, kind: Any, place: Any) -> Any:
    """Read a value. Its arrays have no count of references: told so, the compiler leaves out the calls that count."""
    if isinstance(kind, types.BaseTuple):
        places = (cgutils.gep_inbounds(builder, place, 0, k) for k in range(len(kind)))
        parts = [_load(context, builder, *part) for part in zip(kind, places, strict=True)]
        return context.make_tuple(builder, kind, parts)
    value = context.unpack_value(builder, kind, place)
    if not isinstance(kind, types.Array):
        return value
    array = make_array(kind)(context, builder, value)
    array.meminfo = cgutils.get_null_value(array.meminfo.type)
    return array._getvalue()


@infer_getattr
class _Fields(AttributeTemplate):
    key = Pointer

    def generic_resolve(self, kind: Any, name: str) -> Any:
        return _field(kind.target, name)[1] if name in kind.target.fields else None


@lower_getattr_generic(Pointer)
def _get_field(context: Any, builder: Any, kind: Any, value: Any, name: str) -> Any:
    at, part = _field(kind.target, name)
    place = cgutils.gep_inbounds(builder, _typed(context, builder, value, kind.target), 0, at)
    if isinstance(part, Pointer):
        return builder.bitcast(place, cgutils.voidptr_t)
    return _load(context, builder, part, place)


@infer_global(operator.getitem)
class _GetRecord(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        records, row = args
        if isinstance(records, Records) and isinstance(row, types.Integer):
            return signature(Pointer(records.target), records, types.intp)
        return None


@lower_builtin(operator.getitem, Records, types.Integer)
def _get_record(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    records, row = args
    first = _typed(context, builder, records, sig.args[0].target)
    return builder.bitcast(cgutils.gep_inbounds(builder, first, row), cgutils.voidptr_t)


@infer_global(operator.setitem)
class _SetRecord(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        records, row, value = args
        if not (isinstance(records, Records) and isinstance(row, types.Integer)):
            return None
        fits = _size(value) == _size(records.target)
        return signature(types.none, records, types.intp, value) if fits else None


@lower_builtin(operator.setitem, Records, types.Integer, types.Any)
def _set_record(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    place, kind = _get_record(context, builder, sig, args[:2]), sig.args[2]
    _store(context, builder, _typed(context, builder, place, kind), kind, args[2], copy=True)
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
            named = isinstance(value, types.BaseNamedTuple)
            return signature(Pointer(value) if named else value, value)

    @lower_builtin(law, types.Any)
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        (kind,), (value,) = sig.args, args
        if not isinstance(kind, types.BaseNamedTuple):
            context.nrt.incref(builder, kind, value)
            return value
        place = cgutils.alloca_once(builder, context.get_data_type(kind))
        _store(context, builder, place, kind, value, copy=False)
        return builder.bitcast(place, cgutils.voidptr_t)

    vars(law)["_numba_type_"] = types.Function(ByReference)


_POINTERS: dict[tuple[Any, ...], Any] = {}


@typeof_impl.register(RecordList)
@typeof_impl.register(Referred)
def _typeof(value: Any, _: Any) -> Any:
    kinds, key = vars(value), (type(value), value.kind)
    if "type" not in kinds:  # each call of a kernel asks
        if key not in _POINTERS:
            pointer = Pointer if isinstance(value, Referred) else Records
            _POINTERS[key] = pointer(numba.typeof(value.example))
        kinds["type"] = _POINTERS[key]
    return kinds["type"]


# Formulas ------------------------------------------------------------------------------------------------------------


class _Number:
    """A placeholder for a number: what is done with it becomes LLVM code."""

    __slots__ = ("kind", "trace", "value")

    def __init__(self, trace: _Trace, kind: Any, value: Any) -> None:
        self.trace, self.kind, self.value = trace, kind, value

    def __neg__(self) -> _Number:
        return self.trace.call(operator.neg, self)

    def __abs__(self) -> _Number:
        return self.trace.call(abs, self)

    def __bool__(self) -> bool:
        raise TypeError("a formula has no branches: make it an inline_kernel")


def _add_operator(name: str) -> None:
    function = getattr(operator, name)
    setattr(_Number, f"__{name}__", lambda a, b: a.trace.call(function, a, b))
    setattr(_Number, f"__r{name}__", lambda a, b: a.trace.call(function, b, a))


for _name in ("add", "sub", "mul", "truediv"):
    _add_operator(_name)


class _Row:
    """A placeholder for an array, or for a row of it."""

    __slots__ = ("kind", "pointer", "strides", "trace", "value")

    def __init__(self, trace: _Trace, kind: Any, value: Any, pointer: Any, strides: Any) -> None:
        self.trace, self.kind, self.value = trace, kind, value
        self.pointer, self.strides = pointer, strides

    def _at(self, at: Any) -> Any:
        builder = self.trace.builder
        step = builder.mul(self.trace.number(at, types.intp), self.strides[0])
        return builder.gep(self.pointer, [step], inbounds=True)

    def __getitem__(self, at: Any) -> Any:
        if isinstance(at, tuple):
            return self[at[0]][at[1:]] if len(at) > 1 else self[at[0]]
        if len(self.strides) > 1:
            return _Row(self.trace, self.kind, None, self._at(at), self.strides[1:])
        context, builder, kind = self.trace.context, self.trace.builder, self.kind.dtype
        place = _typed(context, builder, self._at(at), kind)
        return _Number(self.trace, kind, context.unpack_value(builder, kind, place))

    def __setitem__(self, at: Any, number: Any) -> None:
        context, builder, kind = self.trace.context, self.trace.builder, self.kind.dtype
        place = _typed(context, builder, self._at(at), kind)
        context.pack_value(builder, kind, self.trace.number(number, kind), place)


class _Pointed:
    """A placeholder for a pointer."""

    __slots__ = ("kind", "trace", "value")

    def __init__(self, trace: _Trace, kind: Any, value: Any) -> None:
        self.trace, self.kind, self.value = trace, kind, value

    def __getattr__(self, name: str) -> Any:
        value = _get_field(self.trace.context, self.trace.builder, self.kind, self.value, name)
        return self.trace.argument(_field(self.kind.target, name)[1], value)


@cache
def _typed_call(function: Any, *kinds: Any) -> tuple[Any, Any]:
    """A function as numba's types know it, and its signature for these arguments."""
    typing = cpu_target.typing_context
    law = typing.resolve_value_type(function)
    return law, typing.resolve_function_type(law, kinds, {})


class _Trace:
    """One call of a formula with placeholders."""

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
            values = (self.builder.extract_value(value, k) for k in range(len(kind)))
            parts = [self.argument(part, one) for part, one in zip(kind, values, strict=True)]
            named = isinstance(kind, types.BaseNamedTuple)
            return kind.instance_class(*parts) if named else tuple(parts)
        if isinstance(kind, types.Array):
            array = make_array(kind)(self.context, self.builder, value)
            pointer = self.builder.bitcast(array.data, cgutils.voidptr_t)
            strides = list(cgutils.unpack_tuple(self.builder, array.strides))
            if kind.layout == "C":  # known, so that LLVM need not ask
                size = self.context.get_abi_sizeof(self.context.get_data_type(kind.dtype))
                strides[-1] = ir.Constant(cgutils.intp_t, size)
            return _Row(self, kind, value, pointer, strides)
        return _Number(self, kind, value)

    def number(self, number: Any, kind: Any) -> Any:
        """The LLVM value of a number as this type."""
        if isinstance(number, _Number):
            return self.context.cast(self.builder, number.value, number.kind, kind)
        return self.context.get_constant(kind, number)

    def call(self, function: Callable[..., Any], *numbers: Any) -> _Number:
        """The result of an operator or a function of `math`, as numba compiles it."""
        kinds = (one.kind if isinstance(one, _Number) else numba.typeof(one) for one in numbers)
        law, sig = _typed_call(function, *kinds)
        values = [self.number(one, kind) for one, kind in zip(numbers, sig.args, strict=True)]
        value = self.context.get_function(law, sig)(self.builder, values)
        return _Number(self, sig.return_type, value)

    def result(self, value: Any) -> tuple[Any, Any]:
        """Type and LLVM value of what the formula returned."""
        if isinstance(value, tuple):
            parts = [self.result(part) for part in value]
            named = type(value) if hasattr(value, "_fields") else None
            kind = types.BaseTuple.from_types([kind for kind, _ in parts], named)
            return kind, self.context.make_tuple(self.builder, kind, [part for _, part in parts])
        if isinstance(value, _Number | _Row | _Pointed):
            if isinstance(value, _Row):
                self.context.nrt.incref(self.builder, value.kind, value.value)
            return value.kind, value.value
        kind = numba.typeof(value)
        if value is None:
            return kind, self.context.get_dummy_value()
        return kind, self.context.get_constant(kind, value)


class _Maths:
    """The functions of `math` for placeholders."""

    def __getattr__(self, name: str) -> Any:
        function = getattr(math, name)
        return partial(self._call, function) if callable(function) else function

    def _call(self, function: Callable[..., float], *numbers: Any) -> Any:
        for one in numbers:
            if isinstance(one, _Number):
                return one.trace.call(function, *numbers)
        return function(*numbers)


_FORMULAS: set[Callable[..., Any]] = set()


@cache
def _traced(law: Callable[..., Any]) -> Callable[..., Any]:
    """The formula with functions for placeholders in the place of those of `math`."""
    scope = {**law.__globals__, "math": _Maths()}
    for name in law.__code__.co_names:
        called = scope.get(name)
        if isinstance(called, FunctionType) and called in _FORMULAS:
            scope[name] = _traced(called)
    return FunctionType(law.__code__, scope, law.__name__, law.__defaults__, law.__closure__)


def _trace(context: Any, builder: Any, law: Any, kinds: Any, values: Any) -> tuple[Any, Any]:
    """Type and LLVM value of a formula of these arguments; its operations are written by `builder`."""
    trace = _Trace(context, builder)
    placeholders = (trace.argument(*one) for one in zip(kinds, values, strict=True))
    return trace.result(_traced(law)(*placeholders))


@cache
def _result_type(law: Callable[..., Any], kinds: tuple[Any, ...]) -> Any:
    """Type of the result of a formula, by a trace into a module that nobody compiles."""
    kernels = cpu_target.target_context
    model = create_error_model("numpy", kernels)
    context = kernels.subtarget(enable_nrt=True, error_model=model)
    code = context.call_conv.get_function_type(types.none, kinds)
    function = ir.Function(ir.Module(), code, law.__name__)
    builder = ir.IRBuilder(function.append_basic_block())
    numbers = context.call_conv.get_arguments(function)
    values = context.get_arg_packer(kinds).from_arguments(builder, numbers)
    with context.push_code_library(_Part(context.codegen(), law.__name__)):
        return _trace(context, builder, law, kinds, values)[0]


def formula(law: Callable[..., Any]) -> None:
    """Have kernels contain the operations of a law."""
    _FORMULAS.add(law)

    class InPlace(AbstractTemplate):
        key = law
        prefer_literal = True

        def generic(self, args: Any, kws: Any) -> Any:
            return signature(_result_type(law, args), *args)

    @lower_builtin(law, types.VarArg(types.Any))
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _trace(context, builder, law, sig.args, args)[1]

    vars(law)["_numba_type_"] = types.Function(InPlace)
