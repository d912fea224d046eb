"""Python files of the user: executed once as a module of their own, with errors that name their file and line."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import math
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FunctionType
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.kernel import COMPILED

_LONGEST = 300
_LONGEST_VALUE = 120


class UserFileError(PtnsbcError):
    """A file of the user that cannot be executed, or a function in it that failed."""


def executed(file: Path, what: str) -> dict[str, Any]:
    """The names of a file that has been executed as a module of its own.

    Args:
        file: its whole path.
        what: what it holds, for messages: "a law".

    Raises:
        UserFileError: there is no such file, or it raises an error.
    """
    try:
        text = file.read_bytes()
    except OSError as error:
        raise UserFileError(
            f"{file}: {error.strerror}: expected the Python file of {what}"
        ) from None
    module_name = f"ptnsbc_user_{hashlib.sha256(str(file).encode() + text).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    if spec is None or spec.loader is None:
        raise UserFileError(f"{file}: expected the Python file of {what}, whose name ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # where a compiled function looks for its names
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise UserFileError(f"{file}:{error.lineno}: {error.msg}") from None
    except Exception as error:
        lines = [
            f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(file)
        ]
        place = f"{file}:{lines[-1]}" if lines else str(file)
        raise UserFileError(f"{place}: {type(error).__name__}: {error}") from error
    return vars(module)


def place_of(function: FunctionType, error: BaseException | None = None) -> str:
    """File, line and name: the line of the function's file that raised the error, else that of the function."""
    file, line = function.__code__.co_filename, function.__code__.co_firstlineno
    for frame in traceback.extract_tb(error.__traceback__) if error else ():
        if frame.filename == file and frame.lineno:
            line = frame.lineno
    return f"{file}:{line}: {function.__name__}"


def shown(found: object) -> str:
    """The result of a function, in one line of a message."""
    return " ".join(repr(found).split())[:_LONGEST_VALUE]


@dataclass(frozen=True)
class UserFunction:
    """A function from a file of the user."""

    file: Path
    name: str
    function: FunctionType
    call: Callable[..., Any]  # compiled where it can be

    def __call__(self, *inputs: Any) -> Any:
        """The result of the function.

        Raises:
            UserFileError: it raised an error.
        """
        try:
            return self.call(*inputs)
        except Exception as error:
            seen = self._interpreted(inputs) or error
            raise UserFileError(
                f"{place_of(self.function, seen)}: {type(error).__name__}: {error}"
            ) from error

    def numbers(self, found: Any, count: int, expected: str, at: str = "") -> tuple[float, ...]:
        """The result of the function, as so many finite numbers.

        Args:
            found: what it returned.
            count: how many numbers there must be.
            expected: the word for them, for messages: "a velocity of three numbers [m/s, ENU]".
            at: the instant, for messages.

        Raises:
            UserFileError: it is something else.
        """
        try:
            numbers = tuple(float(number) for number in found)
        except (TypeError, ValueError):
            numbers = ()
        if len(numbers) != count:
            raise UserFileError(
                f"{place_of(self.function)}: returned {shown(found)}: expected {expected}"
            )
        if not all(map(math.isfinite, numbers)):
            values = ", ".join(f"{number:g}" for number in numbers)
            raise UserFileError(
                f"{place_of(self.function)}: returned ({values}){at}: expected finite numbers"
            )
        return numbers

    def _interpreted(self, inputs: tuple[Any, ...]) -> Exception | None:
        """The error that the function raises when it is interpreted: a compiled one does not know its line."""
        try:
            self.function(*inputs)
        except Exception as error:
            return error
        return None


def user_function(named: str, what: str, example: tuple[Any, ...]) -> UserFunction:
    """The function that FILE.py:NAME names, compiled where numba can; loading it executes its file.

    Args:
        named: the file by its whole path, or relative to the current folder.
        what: what the function is, for messages: "law".
        example: inputs with the types of all inputs.

    Raises:
        UserFileError: there is no such file or function, or the file raises an error.
    """
    path, _, name = named.rpartition(":")
    file = Path(path).expanduser().absolute()
    function = executed(file, f"a {what}").get(name)
    if not isinstance(function, FunctionType):
        found = "no such name" if function is None else type(function).__name__
        raise UserFileError(
            f"{file}: {name}: {found}: expected a function of the inputs of a {what}"
        )
    try:
        inspect.signature(function).bind(*example)
    except TypeError as error:
        raise UserFileError(
            f"{place_of(function)}: {error}: expected a function of the inputs of a {what}"
        ) from None
    return UserFunction(file, name, function, _compiled(function, file, what, example))


def _compiled(
    function: FunctionType, file: Path, what: str, example: tuple[Any, ...]
) -> Callable[..., Any]:
    """The function compiled and kept on disk; as it is where numba cannot compile it, with a word."""
    if not COMPILED:
        return function
    import numba

    from ptnsbc_core.compile_cache import CacheFolder, KernelCache, cache_root, source_digest

    law = numba.njit(function)
    if not any(hasattr(value, "py_func") for value in function.__globals__.values()):
        # A function that calls compiled functions of other files is compiled anew: their changes would not be seen.
        digest = hashlib.sha256(source_digest().encode() + file.read_bytes()).hexdigest()[:16]
        law._cache = KernelCache(function, CacheFolder(cache_root() / "laws", digest))
    try:
        law.compile(tuple(numba.typeof(one) for one in example))
    except Exception as error:  # not all of numba's errors are NumbaErrors: `global`, *inputs
        line = " ".join(str(error).split()) or type(error).__name__
        print(
            f"{what} {file}:{function.__code__.co_firstlineno}: {function.__name__} is interpreted, "
            f"numba cannot compile it: {line[:_LONGEST]}",
            file=sys.stderr,
            flush=True,
        )
        return function
    return law
