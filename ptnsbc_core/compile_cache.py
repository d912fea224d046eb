"""The compile cache: the machine code of the kernels on disk, one file for each signature that Python calls.

Promise: whatever is in the folder, or cannot be, no process ends for it. It costs one line on stderr and the time to
compile. numba's own cache cannot keep that: it trusts its files, and damaged machine code ends the process by an abort
inside LLVM that nothing can catch. Here every file carries a checksum, and the signature that it was compiled for.

The folder of a cache is named after a digest of all sources that a kernel may contain: an edited law never runs in its
old form.
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
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

_SOURCES = ("ptnsbc_core", "ptnsbc_sim")
_MARK = b"ptnsbc_core.kernel"  # in a source with kernels
_KEPT_CACHES = 8  # some 3 MB each; several checkouts fly in turn
_FOLDER_NAME = re.compile(r"[0-9a-f]{16}")
_HEADER = b"ptnsbc-kernel-2\n"
_AT_EVERY_START = "the laws are compiled at every start"


def kernel_sources() -> dict[str, Path]:
    """The sources that a kernel may contain: all of ptnsbc_core, and of ptnsbc_sim the modules that have kernels.

    The constants that a kernel of ptnsbc_sim uses stand in one of these; tests/core/test_compile_cache.py checks it.
    A colcon workspace installs each package below a prefix of its own.
    """
    sources = {}
    for package in _SOURCES:
        spec = importlib.util.find_spec(package)
        if spec is None or spec.origin is None:
            continue
        folder = Path(spec.origin).resolve().parent
        for path in sorted(folder.rglob("*.py")):
            if package == "ptnsbc_core" or _MARK in path.read_bytes():
                sources[Path(package, path.relative_to(folder)).as_posix()] = path
    return sources


@cache
def source_digest() -> str:
    """Digest of `kernel_sources`, the same wherever they are installed."""
    digest = hashlib.sha256()
    for name, path in kernel_sources().items():
        source = path.read_bytes()
        digest.update(f"{name} {len(source)}\n".encode() + source)
    return digest.hexdigest()[:16]


def cache_root() -> Path:
    """Folder of all caches: $PTNSBC_CACHE_DIR, or `ptnsbc` in the user's folder for caches."""
    if folder := os.environ.get("PTNSBC_CACHE_DIR"):
        return Path(folder)
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "ptnsbc"


def prune(root: Path, keep: Path) -> None:
    """Remove all caches but those used last: every edit of a law makes a new one."""
    with suppress(OSError):
        caches = [path for path in root.iterdir() if _FOLDER_NAME.fullmatch(path.name)]
        caches.sort(key=lambda path: (path == keep, path.stat().st_mtime), reverse=True)
        for path in caches[_KEPT_CACHES:]:
            shutil.rmtree(path, ignore_errors=True)


class CacheFolder:
    """The files of one cache. Only files of the user who runs the process are read: they contain code."""

    def __init__(self, root: Path, digest: str) -> None:
        self.path = root / digest
        self._reported = False
        with suppress(OSError):  # `prune` keeps what was used last, also by other checkouts
            os.utime(self.path)

    def report(self, fault: str, consequence: str = _AT_EVERY_START) -> None:
        """Say the first fault in one line on stderr."""
        if not self._reported:
            self._reported = True
            with suppress(OSError, ValueError):  # stderr may be closed
                print(f"ptnsbc: compile cache {self.path}: {fault}: {consequence}", file=sys.stderr)

    def report_damage(self, name: str) -> None:
        """Say that a file cannot be used."""
        self.report(f"{name} is damaged", "damaged files are compiled again")

    def _is_ours(self, path: Path, descriptor: int | None = None) -> bool:
        """True if the user who runs the process owns a folder, or a file that has been opened."""
        owner = os.stat(path if descriptor is None else descriptor).st_uid
        if owner != os.geteuid():
            self.report(
                f"user {owner} owns {path}, not user {os.geteuid()}: it is not used",
                f"{_AT_EVERY_START}; set PTNSBC_CACHE_DIR to a folder of your own",
            )
        return owner == os.geteuid()

    def read(self, name: str) -> bytes | None:
        """The content that `write` has stored, or None."""
        path = self.path / name
        try:
            with path.open("rb") as file:
                folders = self._is_ours(self.path.parent) and self._is_ours(self.path)
                data = file.read() if folders and self._is_ours(path, file.fileno()) else None
        except OSError as error:
            if not isinstance(error, FileNotFoundError):
                self.report(f"cannot be read ({error.strerror})")
            return None
        if data is None:
            return None
        content = data[len(_sealed(b"")) :]
        if data != _sealed(content):
            self.report_damage(name)
            return None
        return content

    def write(self, name: str, content: bytes) -> None:
        """Store a file in one step, so that other processes never see a part of it."""
        try:
            if not all(map(self._is_ours, filter(Path.exists, (self.path.parent, self.path)))):
                return
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
            self.report(f"cannot be written ({error.strerror})")


def _sealed(content: bytes) -> bytes:
    return _HEADER + hashlib.sha256(content).digest() + content


@cache
def kernel_folder() -> CacheFolder:
    """The cache of these sources."""
    return CacheFolder(cache_root(), source_digest())


class LawFiles:
    """The files of one law in a cache."""

    def __init__(self, law: Callable[..., Any], folder: CacheFolder, ending: str) -> None:
        self._folder, self._ending, code, source = folder, ending, law.__code__, None
        self._name = re.sub(r"[^\w.]", "_", f"{law.__module__}.{law.__qualname__}")
        self.ours = law.__module__.split(".")[0] in _SOURCES
        if not self.ours:  # in none of the sources of the digest
            with suppress(OSError):
                source = hashlib.sha256(Path(code.co_filename).read_bytes()).hexdigest()
        self._law: tuple[object, ...] = (
            (version("numba"), version("llvmlite"), sys.implementation.cache_tag),
            (self._name, code.co_firstlineno, hashlib.sha256(code.co_code).hexdigest()),
            source,
        )

    def _file(self, key: tuple[object, ...]) -> str:
        return f"{self._name}-{hashlib.sha256(str(key).encode()).hexdigest()[:32]}.{self._ending}"

    def load(self, form: tuple[object, ...], made: Callable[[Any], T]) -> T | None:
        """Result of `made` on the parts of the law in this form; None without a file."""
        key = (*self._law, *form)
        content = self._folder.read(self._file(key))
        if content is None:
            return None
        try:
            stored_key, parts = pickle.loads(content)
            return made(parts) if stored_key == key else None
        except Exception:  # whatever the file contains, the kernel can be compiled
            self._folder.report_damage(self._file(key))
            return None

    def save(self, form: tuple[object, ...], parts: Any, dumps: Any = pickle.dumps) -> None:
        """Store the parts of the law in this form."""
        key = (*self._law, *form)
        self._folder.write(self._file(key), dumps((key, parts)))


class KernelCache:
    """The cache of one kernel, in the form that numba's dispatchers call."""

    def __init__(self, law: Callable[..., Any], folder: CacheFolder) -> None:
        self.cache_path = str(folder.path)
        self._files = LawFiles(law, folder, "kernel")

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The compiled kernel of this signature, or None."""
        from numba.core.compiler import CompileResult
        from numba.core.runtime import rtsys

        # The registries of numba tell it how to compile, and take half a second of a processor. They also define the
        # symbols of hashes, which a kernel of somebody else may need; LLVM would end the process without them.
        if self._files.ours:
            rtsys.initialize(context)
        else:
            context.refresh()
        form = (signature, context.codegen().magic_tuple())
        return self._files.load(form, lambda parts: CompileResult._rebuild(context, *parts))

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store a compiled kernel; one that contains addresses of this process cannot be stored."""
        from numba.core.serialize import dumps

        if not (result.lifted or result.library.has_dynamic_globals):
            form = (signature, result.codegen.magic_tuple())
            self._files.save(form, result._reduce(), dumps)

    def flush(self) -> None:
        """`recompile` of a dispatcher calls this; what it compiles replaces the stored files."""
