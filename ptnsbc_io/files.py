"""Files that are complete whenever they exist, and files with a secret key."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ptnsbc_core.errors import PtnsbcError

KEY_BYTES = 32
_SHARED_BITS = 0o077


class OutputFileError(PtnsbcError, OSError):
    """A file that cannot be written."""


@contextmanager
def replacing(path: Path, *, folder: bool = False) -> Iterator[Path]:
    """A path beside `path`; what is written there replaces `path` at the end of the block.

    Nobody ever reads half a file, and several processes may write the same one. With `folder` its folder is made.

    Raises:
        OutputFileError: the block or the renaming raised OSError.
    """
    part = path.with_name(f".{path.name}.{threading.get_native_id()}.part")
    try:
        if folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        part.replace(path)
    except OSError as error:
        raise OutputFileError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            part.unlink()


def read_key(path: Path) -> bytes:
    """The secret key (32 bytes) in a file, in binary or as 64 hexadecimal digits.

    Raises:
        PtnsbcError: the file is not readable, has another size, or is readable for others.
    """
    try:
        mode, raw = path.stat().st_mode, path.read_bytes()
    except OSError as error:
        raise PtnsbcError(f"{path}: {error.strerror}: expected a readable key file") from None
    if mode & _SHARED_BITS:
        raise PtnsbcError(
            f"{path}: mode {mode & 0o777:o}: expected a key that others cannot read: chmod 600"
        )
    text = raw.strip()
    if len(text) == 2 * KEY_BYTES:
        with suppress(ValueError):  # UnicodeDecodeError is one too
            raw = bytes.fromhex(text.decode("ascii"))
    if len(raw) != KEY_BYTES:
        raise PtnsbcError(
            f"{path}: {len(raw)} bytes: expected {KEY_BYTES}, or {2 * KEY_BYTES} hexadecimal "
            "digits: head -c 32 /dev/urandom | xxd -p -c 64"
        )
    if not any(raw):
        raise PtnsbcError(f"{path}: zeros only: expected {KEY_BYTES} random bytes")
    return raw
