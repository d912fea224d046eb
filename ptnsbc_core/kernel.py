"""One source for every law: compiled by numba where present, plain Python elsewhere.

`PTNSBC_JIT=0` selects the interpreted form. The compiled form is cached under a folder named after a
digest of all kernel sources: numba itself only notices a change in the file of the outermost function, so
an edited inner law would otherwise keep running in its old form.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, MutableSequence, Sequence
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_ROOT = Path(__file__).resolve().parent.parent
_SOURCES = ("ptnsbc_core", "ptnsbc_sim")
_KEPT_CACHES = 3


def _source_digest() -> str:
    digest = hashlib.sha256()
    for package in _SOURCES:
        for path in sorted((_ROOT / package).rglob("*.py")):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_root() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(os.environ.get("PTNSBC_CACHE_DIR") or Path(base) / "ptnsbc")


def _prune(root: Path, keep: Path) -> None:
    """Drop the oldest caches: each edit of a law makes a new one."""
    try:
        stale = sorted(
            (path for path in root.iterdir() if path.is_dir() and path != keep),
            key=lambda path: path.stat().st_mtime,
            reverse=True,
        )[_KEPT_CACHES - 1 :]
    except OSError:
        return
    for path in stale:
        shutil.rmtree(path, ignore_errors=True)


def _compiler() -> tuple[Any, Any] | None:
    if os.environ.get("PTNSBC_JIT", "1") == "0":
        return None
    try:
        import numba
    except ImportError:
        return None
    root = _cache_root()
    cache = root / _source_digest()
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError:
        cached = False  # a read-only home still flies, it compiles at every start
    else:
        cached = True
        _prune(root, cache)
        numba.config.CACHE_DIR = str(cache)
    whole = numba.njit(cache=cached, error_model="numpy")
    within = numba.njit(cache=cached, error_model="numpy", forceinline=True)
    return whole, within


_COMPILE = _compiler()
COMPILED: bool = _COMPILE is not None
"""Whether kernels run compiled in this process."""


def kernel(law: Callable[P, R]) -> Callable[P, R]:
    """Mark a law as a kernel: scalars, tuples, float64 arrays and NamedTuples in and out, no I/O, no globals."""
    return law if _COMPILE is None else _COMPILE[0](law)


def inline_kernel(law: Callable[P, R]) -> Callable[P, R]:
    """A short kernel that becomes part of its caller.

    Between two compiled functions every array travels as seven words and a reference count; within one the
    compiler drops most of both. Long kernels stay apart, or each caller would compile them again.
    """
    return law if _COMPILE is None else _COMPILE[1](law)


def _list_type() -> Any:
    if not COMPILED:
        return list
    from numba.typed import List

    return List


KernelList: Any = _list_type()
"""A list that kernels make, read and write in place; call it inside kernels only.

Handing a NamedTuple of arrays to a compiled kernel unpacks every field at every call, which costs more than
the laws; a list is handed over as one pointer, and its length is no part of the compiled type.
"""


@kernel
def _listed(item: Any) -> Any:
    out = KernelList()
    out.append(item)
    return out


@kernel
def _append(items: Any, item: Any) -> None:
    items.append(item)


def kernel_list(items: Sequence[T]) -> MutableSequence[T]:
    """A KernelList of at least one item.

    Filled by kernels: the methods of numba's list called from Python are compiled anew in every process.
    """
    out: MutableSequence[T] = _listed(items[0])
    for item in items[1:]:
        _append(out, item)
    return out
