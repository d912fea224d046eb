"""Python files of the user: executed once as a module of their own, with errors that name their file and line."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import traceback
from pathlib import Path
from types import FunctionType
from typing import Any

from ptnsbc_core.errors import PtnsbcError


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
