"""The folder of results: made beside its place and renamed, so what is there is whole."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ptnsbc_tools.reproduce.experiment_result import ReproduceError

RESULTS = "results.json"


def refuse(folder: Path, names: Sequence[str]) -> None:
    """An error when `folder` holds what this run would destroy.

    Args:
        folder: where results are to go.
        names: the experiments of this run.
    """
    if folder.exists() and not folder.is_dir():
        raise ReproduceError(f"-o {folder}: is a file: expected a folder, or a name not in use")
    if not folder.exists() or not any(folder.iterdir()):
        return
    lost = [name for name in _parts(folder) if name not in names]
    if lost:
        raise ReproduceError(
            f"-o {folder}: holds results of {', '.join(lost)}, which this run would not replace: "
            "choose another folder, or leave out --only"
        )


def _parts(folder: Path) -> list[str]:
    """Names of the experiments whose results are in a folder."""
    try:
        found = json.loads((folder / RESULTS).read_text(encoding="utf-8"))
        return [str(part["name"]) for part in found["parts"]]
    except (OSError, ValueError, KeyError, TypeError):
        raise ReproduceError(
            f"-o {folder}: holds other things than results: expected an empty or new folder, or "
            "one that an earlier run has made"
        ) from None


@contextmanager
def beside(folder: Path) -> Iterator[Path]:
    """A folder to work in that takes the place of `folder` when the block ends well, or is gone."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise ReproduceError(f"-o {folder}: {error.strerror}: expected a place to write") from None
    try:
        made.chmod(0o777 & ~_umask())  # mkdtemp makes it for its owner alone
        yield made
        _replace(folder, made)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _replace(folder: Path, made: Path) -> None:
    """Put `made` in the place of `folder`; what was there is dropped last."""
    if not folder.exists():
        made.replace(folder)
        return
    old = made.with_name(f"{made.name}.old")
    folder.replace(old)
    made.replace(folder)
    shutil.rmtree(old, ignore_errors=True)
