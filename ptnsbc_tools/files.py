"""Files that are complete whenever they exist."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ptnsbc_core.errors import PtnsbcError


class OutputFileError(PtnsbcError):
    """A file that cannot be written."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path in the same folder; what is written there replaces `path` at the end of the block.

    Raises:
        OutputFileError: the block or the renaming raised OSError.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise OutputFileError(f"{path}: cannot be written: {error.strerror}") from error
