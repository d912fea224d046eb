"""The loader of plug-ins: a Python file is executed once, its function is compiled where numba can compile it.

Only files that a scenario or the user names are executed, never what a bag names. A command says which, before they
run, or refuses to run any. Every error names the file of the user and the line in it. A function that cannot be
compiled is interpreted, which is said in one line.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import linecache
import math
import os
import re
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.kernel import COMPILED, compiler
from ptnsbc_sim.plugins import NAMED, REFUSED, USER_CODE
from ptnsbc_sim.plugins.hooks import HOOKS, Hook

_LONGEST_VALUE = 120
_MOST_KEPT = 1000  # numbers of the memory of a law
_named: set[Path] = set()


class PluginError(PtnsbcError):
    """A plug-in that cannot be loaded, or that failed."""


def named_in(file: Path, name: str, what: str, kind: type = FunctionType) -> Any:
    """A function, or a class (`type`), of a file, which is executed as a module of its own.

    Args:
        file: its whole path.
        name: of the function.
        what: what it is, for messages: "a law".

    Raises:
        PluginError: there is no such file or name, the file raises an error, or no code may run.
    """
    if os.environ.get(USER_CODE) == REFUSED:
        raise PluginError(f"{file}: the code of {what}, which this command does not run")
    if os.environ.get(USER_CODE) == NAMED and file not in _named:
        _named.add(file)
        print(f"runs the code of {file}", file=sys.stderr, flush=True)
    try:
        text = file.read_bytes()
    except OSError as error:
        raise PluginError(f"{file}: {error.strerror}: expected the Python file of {what}") from None
    module_name = f"ptnsbc_user_{hashlib.sha256(str(file).encode() + text).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    if spec is None or spec.loader is None:
        raise PluginError(f"{file}: expected the Python file of {what}, whose name ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # where a compiled function looks for its names
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise PluginError(f"{file}:{error.lineno}: {error.msg}") from None
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == str(file)]
        place = f"{file}:{lines[-1]}" if lines else str(file)
        raise PluginError(f"{place}: {type(error).__name__}: {error}") from error
    function = vars(module).get(name)
    if not isinstance(function, kind):
        found = "no such name" if function is None else type(function).__name__
        expected = "a function" if kind is FunctionType else "a class"
        raise PluginError(f"{file}: {name}: {found}: expected {expected}, {what}")
    return function


def place_of(function: FunctionType, error: BaseException | None = None) -> str:
    """File, line and name: the line of the function's file that raised the error, else that of the function."""
    file, line = function.__code__.co_filename, function.__code__.co_firstlineno
    for frame in traceback.extract_tb(error.__traceback__) if error else ():
        if frame.filename == file and frame.lineno:
            line = frame.lineno
    return f"{file}:{line}: {function.__name__}"


@dataclass(frozen=True)
class Plugin:
    """A function of the user in its hook."""

    hook: Hook
    function: FunctionType
    call: Callable[..., Any]  # compiled where it can be
    memory: tuple[float, ...] = ()  # first value of what a law keeps, by its attribute `memory`
    address: int = 0  # of the compiled law, which takes its inputs and a row for its numbers

    def result(self, *inputs: Any) -> Any:
        """Result of the function.

        Raises:
            PluginError: it raised an error.
        """
        try:
            return self.call(*inputs)
        except Exception as error:
            seen: Exception = error
            try:
                given = self.function(*inputs)  # a compiled one does not know the line of its error
                if self.address and isinstance(error, ValueError):
                    return given  # of another size
            except Exception as interpreted:
                seen = interpreted
            near = ""
            if isinstance(seen, AttributeError):
                fields = getattr(seen.obj, "_fields", ())
                for name in get_close_matches(seen.name, fields, 1, 0.5):
                    near = f": did you mean {name}?"
            raise PluginError(
                f"{place_of(self.function, seen)}: {type(error).__name__}: {error}{near}"
            ) from error

    def numbers(self, *inputs: Any, at: str) -> tuple[float, ...]:
        """The numbers that the function gives, of a law with its memory; `at` is the instant, for messages.

        Raises:
            PluginError: it raised an error, or gave something else than `hook.size` finite numbers and its memory.
        """
        result, kept = self.result(*inputs), len(self.memory)
        sizes = [self.hook.size, kept] if kept else [self.hook.size]
        try:
            parts = [[float(number) for number in part] for part in (result if kept else [result])]
        except (TypeError, ValueError):
            parts = []
        if [len(part) for part in parts] != sizes:
            beside = f", and beside it its memory of {kept} numbers" if kept else ""
            raise self.refusal(result, f"expected {self.hook.gives}{beside}")
        numbers = tuple(number for part in parts for number in part)
        if not all(map(math.isfinite, numbers)):
            values = ", ".join(f"{number:g}" for number in numbers)
            raise PluginError(
                f"{place_of(self.function)}: returned ({values}) at {at}: expected finite numbers"
            ) from ArithmeticError()
        return numbers

    def refusal(self, result: object, expected: str) -> PluginError:
        """The error about a result that does not fit the hook."""
        shown = " ".join(repr(result).split())[:_LONGEST_VALUE]
        return PluginError(f"{place_of(self.function)}: returned {shown}: {expected}")


@lru_cache(maxsize=64)
def load_plugin(name: str, named: str) -> Plugin:
    """Load the plug-in of a hook, which executes its file.

    Args:
        name: of the hook, see `HOOKS`.
        named: FILE.py:NAME with the whole path of the file, as scenarios that were read have it.

    Raises:
        PluginError: the path is not whole, as in a scenario from a bag; there is no such file or function; the file
            raises an error; or the function does not take the inputs of the hook.
    """
    hook = HOOKS[name]
    path, _, wanted = named.rpartition(":")
    file = Path(path).expanduser()
    if not file.is_absolute():
        raise PluginError(
            f"{name}: {named}: a bag names a {name} and does not carry it: expected a scenario whose {name} "
            "you give"
        )
    function = named_in(file, wanted, f"a {name}")
    try:
        inspect.signature(function).bind(*hook.example)
    except TypeError as error:
        expected = f"expected a function of the inputs of a {name}"
        raise PluginError(f"{place_of(function)}: {error}: {expected}") from None
    memory = _memory_of(function) if name == "law" else ()
    if memory:
        hook = hook._replace(example=(hook.example[0]._replace(memory=np.array(memory)),))
    plugin = Plugin(hook, function, function, memory)
    return _compiled(plugin, file) if COMPILED else plugin


def _memory_of(function: FunctionType) -> tuple[float, ...]:
    """The first memory of a law; none where it names none."""
    named = getattr(function, "memory", ())
    with suppress(TypeError, ValueError):
        memory = tuple(map(float, named))
        if len(memory) <= _MOST_KEPT and all(map(math.isfinite, memory)):
            return memory
    expected = f"expected at most {_MOST_KEPT} finite numbers"
    raise PluginError(f"{place_of(function)}: memory = {named!r}: {expected}")


def _compiled(plugin: Plugin, file: Path) -> Plugin:
    """The plug-in compiled and kept on disk; as it is where numba cannot compile it, with a word."""
    from ptnsbc_core.compile_cache import CacheFolder, cache_root, source_digest

    folder, function, compile_for = None, plugin.function, compiler()
    others = list(function.__globals__.values())
    if not any(hasattr(other, "py_func") for other in others):
        # A function that calls compiled functions of other files is compiled anew: their changes would not be seen.
        digest = hashlib.sha256(source_digest().encode() + file.read_bytes()).hexdigest()[:16]
        folder = CacheFolder(cache_root() / "laws", digest)
    for other in others:
        if isinstance(other, FunctionType) and other.__module__ == function.__module__:
            compile_for.part(other, error_model="python")
    try:
        if plugin.hook.name == "law":
            return _law_for_kernels(plugin, folder)
        compiled = compile_for.compiled(function, folder, error_model="python")
        compile_for.address_of(compiled, *plugin.hook.example)
        return replace(plugin, call=compiled)
    except Exception as error:  # not all of numba's errors are NumbaErrors: `global`, *inputs
        began = time.perf_counter()
        try:
            plugin.numbers(*plugin.hook.example, at="") if plugin.hook.size else plugin.result(
                *plugin.hook.example
            )
        except PluginError as refused:
            if not isinstance(refused.__cause__, ArithmeticError):
                return plugin  # it does not run either: its first call says why, with the line
        print(
            f"{plugin.hook.name} {_why_not(function, str(error))}: {function.__name__} is interpreted, "
            f"{1e6 * (time.perf_counter() - began):.0f} us a call",
            file=sys.stderr,
            flush=True,
        )
        return plugin


_REASONS = {
    r"unexpected keyword argument '(\w+)'": "numba has no {} here",
    r"(?:Untyped global name|Unknown attribute) '(\w+)'": "numba does not know {}",
    r"Cannot unify .* for '([a-z]\w*)": "{} is of two types",
}
"""Errors of numba, and what they mean for a user."""


def _why_not(function: FunctionType, error: str) -> str:
    """File and line that numba cannot compile, with the reason and the text of the line."""
    code, said = function.__code__, re.sub(r"\x1b\[[0-9;]*m", "", error)
    at = re.search(rf"{re.escape(Path(code.co_filename).name)}(?:\", line | \()(\d+)", said)
    line = int(at[1]) if at else code.co_firstlineno
    found = ((words, re.search(kind, said)) for kind, words in _REASONS.items())
    known = (words.format(match[1]) for words, match in found if match)
    reason, text = next(known, "numba cannot compile it"), linecache.getline(code.co_filename, line)
    return f"{code.co_filename}:{line}: {reason}: {text.strip()}"


def _law_for_kernels(plugin: Plugin, folder: Any) -> Plugin:
    """A law that a kernel calls by its address, and Python by the same code."""
    function, kept = plugin.function, len(plugin.memory)

    def without_memory(inputs: Any) -> Any:
        return function(inputs), inputs.memory

    law = function if kept else without_memory
    compiler().part(law, error_model="python")

    def writes(inputs: Any, row: Any) -> None:
        v, memory = law(inputs)
        if len(v) != 3 or len(memory) != kept:
            raise ValueError
        row[0], row[1], row[2] = v[0], v[1], v[2]
        for k in range(kept):
            row[3 + k] = memory[k]

    writes.__module__, writes.__qualname__ = function.__module__, function.__qualname__
    compiled = compiler().compiled(writes, folder, error_model="python")
    row = np.empty(plugin.hook.size + kept)
    address = compiler().address_of(compiled, *plugin.hook.example, row)

    def call(inputs: Any) -> Any:
        given = np.empty_like(row)
        compiled(inputs, given)
        return (given[:-kept], given[-kept:]) if kept else given

    return replace(plugin, call=call, address=address)
