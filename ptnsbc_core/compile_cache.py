"""The compile cache: the machine code of every kernel on disk, one file for each signature.

numba's own cache trusts its files. A damaged one ends the process: with a traceback from its index, or by an abort
inside LLVM that nothing can catch. Here every file carries a checksum and the signature that it was compiled for.
A file that does not match is ignored and written anew. A fault of the cache costs one line on stderr and the time
to compile; it never ends a process.

The folder of a cache is named after a digest of all sources below which there are kernels, because a kernel
contains the kernels and the constants of other modules that it uses.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import pickle
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba.core.compiler import CompileResult
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

_SOURCES = ("ptnsbc_core", "ptnsbc_sim", "ptnsbc_autopilot", "paper")
_KEPT_CACHES = 8  # some 11 MB each; several checkouts fly in turn
_FOLDER_NAME = re.compile(r"[0-9a-f]{16}")
_HEADER = b"ptnsbc-kernel-1\n"
_CHECKSUM_SIZE = hashlib.sha256().digest_size
_AT_EVERY_START = "the laws are compiled at every start"


def _folders() -> dict[str, Path]:
    """Folders of the packages with kernels: a colcon workspace installs each below a prefix of its own."""
    specs = ((name, importlib.util.find_spec(name)) for name in _SOURCES)
    return {
        name: Path(spec.origin).resolve().parent for name, spec in specs if spec and spec.origin
    }


def source_digest() -> str:
    """Digest of the sources that a kernel may contain, the same wherever they are installed."""
    digest = hashlib.sha256()
    for package, folder in _folders().items():
        for path in sorted(folder.rglob("*.py")):
            source = path.read_bytes()
            if package != "ptnsbc_core" and b"ptnsbc_core.kernel" not in source:
                continue  # no kernel is in it
            name = Path(package, path.relative_to(folder)).as_posix()
            digest.update(f"{name} {len(source)}\n".encode())
            digest.update(source)
    return digest.hexdigest()[:16]


def cache_root() -> Path:
    """Folder of all caches: $PTNSBC_CACHE_DIR, or `ptnsbc` in the user's folder for caches."""
    if given := os.environ.get("PTNSBC_CACHE_DIR"):
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "ptnsbc"


def prune(root: Path, keep: Path) -> None:
    """Remove all caches but those used last: every edit of a law makes a new one."""
    try:
        stale = sorted(
            (path for path in root.iterdir() if _FOLDER_NAME.fullmatch(path.name) and path != keep),
            key=lambda path: path.stat().st_mtime,
            reverse=True,
        )[_KEPT_CACHES - 1 :]
    except OSError:
        return
    for path in stale:
        shutil.rmtree(path, ignore_errors=True)


class CacheFolder:
    """The files of one cache. Only files of the user who runs the process are read: they contain code."""

    def __init__(self, root: Path, digest: str) -> None:
        self.path = root / digest
        self._reported = False
        self._marked = False

    def report(self, fault: str, consequence: str) -> None:
        """Say the first fault in one line on stderr."""
        if not self._reported:
            self._reported = True
            with suppress(OSError, ValueError):  # stderr may be closed
                print(f"ptnsbc: compile cache {self.path}: {fault}: {consequence}", file=sys.stderr)

    @cached_property
    def _refused(self) -> bool:
        """True if another user owns the folder, or the folder of all caches."""
        for folder in (self.path.parent, self.path):
            try:
                owner = folder.stat().st_uid
            except OSError:  # reading or writing says why
                return False
            if owner != os.geteuid():
                fault = f"user {owner} owns {folder}, not user {os.geteuid()}: it is not used"
                self.report(
                    fault, f"{_AT_EVERY_START}; set PTNSBC_CACHE_DIR to a folder of your own"
                )
                return True
        return False

    def read(self, name: str) -> bytes | None:
        """The content that `write` has stored, or None."""
        if self._refused:
            return None
        try:
            with (self.path / name).open("rb") as file:
                owner = os.fstat(file.fileno()).st_uid
                data = file.read()
        except FileNotFoundError:
            return None
        except OSError as error:
            self.report(f"cannot be read ({error.strerror})", _AT_EVERY_START)
            return None
        content = data[len(_HEADER) + _CHECKSUM_SIZE :]
        if owner != os.geteuid():
            self.report(f"{name} belongs to user {owner}", "it is not used")
        elif data != _sealed(content):
            self.report_damage(name)
        else:
            self._mark_used()
            return content
        return None

    def _mark_used(self) -> None:
        """Date the folder, once for each process: `prune` keeps what was used last, also by other checkouts."""
        if not self._marked:
            self._marked = True
            with suppress(OSError):  # a cache that may only be read
                os.utime(self.path)

    def report_damage(self, name: str) -> None:
        """Say that a file cannot be used."""
        self.report(f"{name} is damaged", "damaged files are compiled again")

    def write(self, name: str, content: bytes) -> None:
        """Store a file in one step, so that other processes never see a part of it."""
        if self._refused:
            return
        try:
            if not self.path.is_dir():
                self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
                prune(self.path.parent, self.path)
            descriptor, temporary = tempfile.mkstemp(dir=self.path)
            try:
                with open(descriptor, "wb") as file:
                    file.write(_sealed(content))
                os.replace(temporary, self.path / name)
            except BaseException:
                os.unlink(temporary)
                raise
        except OSError as error:
            self.report(f"cannot be written ({error.strerror})", _AT_EVERY_START)


def _sealed(content: bytes) -> bytes:
    return _HEADER + hashlib.sha256(content).digest() + content


class KernelCache:
    """The cache of one kernel, in the form that numba's dispatchers call."""

    def __init__(self, law: Callable[..., Any], folder: CacheFolder) -> None:
        self._folder = folder
        self.cache_path = str(folder.path)
        self._name = f"{law.__module__}.{law.__qualname__}"
        code = law.__code__
        self._ours = law.__module__.split(".")[0] in _SOURCES
        self._kernel: tuple[object, ...] = (
            (numba.__version__, llvmlite.__version__, sys.implementation.cache_tag),
            (self._name, code.co_firstlineno, hashlib.sha256(code.co_code).hexdigest()),
            None if self._ours else _content(code.co_filename),
        )

    def _key(self, signature: Any, codegen: Any) -> tuple[object, ...]:
        return (*self._kernel, signature, codegen.magic_tuple())

    def _file(self, key: tuple[object, ...]) -> str:
        name = re.sub(r"[^\w.]", "_", self._name)
        return f"{name}-{hashlib.sha256(str(key).encode()).hexdigest()[:32]}.kernel"

    def load_overload(self, signature: Any, context: Any) -> CompileResult | None:
        """The compiled kernel of this signature, or None."""
        # The registries of numba tell it how to compile, and take half a second of a processor. They also define the
        # symbols of hashes, which a kernel of somebody else may need; LLVM would end the process without them.
        if self._ours:
            rtsys.initialize(context)
        else:
            context.refresh()
        key = self._key(signature, context.codegen())
        content = self._folder.read(self._file(key))
        if content is None:
            return None
        try:
            stored_key, parts = pickle.loads(content)
            return CompileResult._rebuild(context, *parts) if stored_key == key else None
        except Exception:  # whatever the file contains, the kernel can be compiled
            self._folder.report_damage(self._file(key))
            return None

    def save_overload(self, signature: Any, result: CompileResult) -> None:
        """Store a compiled kernel; one that contains addresses of this process cannot be stored."""
        if result.lifted or result.library.has_dynamic_globals:
            return
        key = self._key(signature, result.codegen)
        self._folder.write(self._file(key), dumps((key, result._reduce())))

    def flush(self) -> None:
        """`recompile` of a dispatcher calls this; what it compiles replaces the stored files."""


def _content(source: str) -> str | None:
    """Digest of a source file that is in none of the packages of `source_digest`."""
    try:
        return hashlib.sha256(Path(source).read_bytes()).hexdigest()
    except OSError:
        return None
