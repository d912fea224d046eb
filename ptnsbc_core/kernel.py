"""One source for every law: compiled by numba where present, plain Python elsewhere.

`PTNSBC_JIT=0` selects the interpreted form. numba is imported when Python calls the first kernel: a program that flies
nothing starts without it. `compiler` says how kernels are compiled, `compile_cache` how their code is kept on disk.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, MutableSequence, Sequence
from functools import cached_property, update_wrapper
from types import ModuleType
from typing import Any, Generic, ParamSpec, TypeVar, cast

from ptnsbc_core.machine_code import Entry, Loaded, RecordList, Referred, kind_of, load

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

COMPILED: bool = (
    os.environ.get("PTNSBC_JIT", "1") != "0" and importlib.util.find_spec("numba") is not None
)
"""True if kernels run compiled in this process."""

_parts: list[tuple[str, Callable[..., Any]]] = []
"""Laws that numba has to know before it compiles a kernel that calls them, and how."""

LAWS: list[Callable[..., Any]] = []
"""Laws of the loaded modules that numba compiles as functions: a flight uses nearly all of them."""


def compiler() -> ModuleType:
    """The module `compiler`, which knows all laws that are imported."""
    from ptnsbc_core import compiler

    while _parts:
        how, law = _parts.pop()
        getattr(compiler, how)(law)
    return compiler


class Kernel(Generic[P, R]):
    """A law that Python calls compiled."""

    def __init__(self, law: Callable[P, R]) -> None:
        update_wrapper(self, law)
        self.py_func = law
        self._loaded: dict[Any, Loaded] = {}

    def loaded(self, arguments: tuple[Any, ...]) -> Loaded:
        """The law in memory for arguments of these types: from the cache without numba, or compiled."""
        kinds = kind_of(arguments)
        if kinds not in self._loaded:
            found = load(self.py_func, kinds) or compiler().loaded(self.py_func, arguments)
            self._loaded[kinds] = found
        return self._loaded[kinds]

    @cached_property
    def dispatcher(self) -> Any:
        """The law as numba knows it; it compiles for new types of arguments."""
        return compiler().compiled(self.py_func)

    @property
    def _numba_type_(self) -> Any:  # what numba sees of the law in another kernel
        return self.dispatcher._numba_type_

    def __call__(self, *arguments: P.args, **named: P.kwargs) -> R:
        """The law at these arguments."""
        return cast(R, self.dispatcher(*arguments, **named))


def kernel(law: Callable[P, R]) -> Callable[P, R]:
    """Mark a law as a kernel: scalars, tuples, float64 arrays and NamedTuples in and out, no I/O, no globals."""
    LAWS.append(law)
    return Kernel(law) if COMPILED else law


def inline_kernel(law: Callable[P, R]) -> Callable[P, R]:
    """Mark a law that kernels contain wherever they call it. Python calls the law itself, which nothing compiles."""
    LAWS.append(law)
    _parts.append(("inline", law))
    return law


def formula(law: Callable[P, R]) -> Callable[P, R]:
    """Mark a law of arithmetic, without branches and functions: a kernel contains its operations in place.

    To call it costs a kernel nothing: the vector operations of the laws are not functions that numba has to compile.
    """
    _parts.append(("formula", law))
    return law


def prepared(law: Callable[P, R], *arguments: Any) -> Callable[P, R]:
    """The kernel `law` for arguments of these types, which no call checks: that can take longer than a step."""
    if not isinstance(law, Kernel):
        return law
    return cast(Callable[P, R], Entry(law.loaded(arguments), arguments))


def by_reference(value: T) -> T:
    """In kernels: a NamedTuple as a pointer, so that a wide one is passed as one word.

    Its arrays have no count of references: the caller holds them for as long as the pointer is used.
    """
    return value


_parts.append(("reference", by_reference))


def fails(address: int, inputs: tuple[Any, ...], row: Any) -> bool:
    """In kernels: call the law at a `compiler.address_of` with these arguments; True if it raised an error.

    Kernels alone have it: without numba no law has an address, and the loop in Python calls laws by their names.
    """
    raise NotImplementedError(f"{address:#x}: no kernel calls it")


_parts.append(("at_address", fails))


def referred(value: T) -> T:
    """In Python: a NamedTuple as kernels take it by one pointer; it reads as the NamedTuple. None stays None."""
    return cast(T, Referred([value])) if COMPILED and value is not None else value


def kernel_list(items: Sequence[T]) -> MutableSequence[T]:
    """NamedTuples of one type, at least one, which kernels read and write in place: for them it is one pointer.

    A NamedTuple that is written has its arrays copied into those that are there.
    """
    if not COMPILED:
        return list(items)
    return cast(MutableSequence[T], RecordList(items))
