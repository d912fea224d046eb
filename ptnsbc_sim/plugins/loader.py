"""The loader of plug-ins: a Python file is executed once, its function is compiled where numba can compile it.

Only files that a scenario or the user names are executed, never what a bag names. A command says which, before they
run, or refuses to run any. Every error names the file of the user and the line in it. A function that cannot be
compiled is interpreted, which is said in one line.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import math
import os
import re
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from types import FunctionType
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.kernel import COMPILED, compiler
from ptnsbc_sim.plugins import NAMED, REFUSED, USER_CODE
from ptnsbc_sim.plugins.hooks import HOOKS, Hook

_LONGEST_VALUE = 120
_named: set[Path] = set()


class PluginError(PtnsbcError):
    """A plug-in that cannot be loaded, or that failed."""


def function_in(file: Path, name: str, what: str) -> FunctionType:
    """A function of a file, which is executed as a module of its own.

    Args:
        file: its whole path.
        name: of the function.
        what: what it is, for messages: "a law".

    Raises:
        PluginError: there is no such file or function, the file raises an error, or no code may run.
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
    if not isinstance(function, FunctionType):
        kind = "no such name" if function is None else type(function).__name__
        raise PluginError(f"{file}: {name}: {kind}: expected a function, {what}")
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
                self.function(*inputs)  # a compiled one does not know the line of its error
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
        """The numbers that the function gives; `at` is the instant, for messages.

        Raises:
            PluginError: it raised an error, or gave something else than `hook.size` finite numbers.
        """
        result = self.result(*inputs)
        try:
            numbers = tuple(float(number) for number in result)
        except (TypeError, ValueError):
            numbers = ()
        if len(numbers) != self.hook.size:
            raise self.refusal(result, f"expected {self.hook.gives}")
        if not all(map(math.isfinite, numbers)):
            values = ", ".join(f"{number:g}" for number in numbers)
            raise PluginError(
                f"{place_of(self.function)}: returned ({values}) at {at}: expected finite numbers"
            )
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
    function = function_in(file, wanted, f"a {name}")
    try:
        inspect.signature(function).bind(*hook.example)
    except TypeError as error:
        expected = f"expected a function of the inputs of a {name}"
        raise PluginError(f"{place_of(function)}: {error}: {expected}") from None
    return Plugin(hook, function, _compiled(function, file, hook))


def _compiled(function: FunctionType, file: Path, hook: Hook) -> Callable[..., Any]:
    """The function compiled and kept on disk; as it is where numba cannot compile it, with a word."""
    if not COMPILED:
        return function
    import numba

    from ptnsbc_core.compile_cache import CacheFolder, cache_root, source_digest

    folder = None
    if not any(hasattr(value, "py_func") for value in function.__globals__.values()):
        # A function that calls compiled functions of other files is compiled anew: their changes would not be seen.
        digest = hashlib.sha256(source_digest().encode() + file.read_bytes()).hexdigest()[:16]
        folder = CacheFolder(cache_root() / "laws", digest)
    compiled = compiler().compiled(function, folder, error_model="python")
    try:
        compiled.compile(tuple(numba.typeof(argument) for argument in hook.example))
    except Exception as error:  # not all of numba's errors are NumbaErrors: `global`, *inputs
        try:
            function(*hook.example)
        except (AttributeError, NameError, TypeError):
            return function  # it does not run either: its first call says why, with the line
        lines = re.sub(r"\x1b\[[0-9;]*m", "", str(error)).splitlines() or [type(error).__name__]
        lines = [line for line in lines if line.strip() and not line.startswith("Failed in ")]
        print(
            f"{hook.name} {file}:{function.__code__.co_firstlineno}: {function.__name__} is interpreted, "
            f"numba cannot compile it: {''.join(lines[:1]).strip()[:_LONGEST_VALUE]}",
            file=sys.stderr,
            flush=True,
        )
        return function
    return compiled
