"""The folder of a bag: made beside its name, renamed when it is complete."""

from __future__ import annotations

import shutil
from pathlib import Path

from ptnsbc_io.bag.errors import BagError


def make_part(directory: Path, part: Path, *, overwrite: bool) -> None:
    """Create `part`; BagError when it or `directory` is in the way."""
    way_out = "choose another name or pass --overwrite"
    if directory.exists() and not overwrite:
        raise BagError(f"{directory} exists: {way_out}")
    if part.exists():
        if not overwrite:
            raise BagError(
                f"{part} exists, a recording that was killed or still runs: "
                f"rescue it with ptnsbc bag repair, {way_out}"
            )
        shutil.rmtree(part)
    try:
        part.mkdir(parents=True)
    except OSError as error:
        raise BagError(f"{part}: cannot be created: {error.strerror}") from error


def put_in_place(directory: Path, part: Path, *, overwrite: bool) -> None:
    """Give `part` its name; with `overwrite` what is there goes only then."""
    old = directory.with_name(directory.name + ".old")
    try:
        if overwrite and directory.exists():
            # Moved away first: at no time is there neither the old bag nor the new one.
            directory.rename(old)
        part.rename(directory)
    except OSError as error:
        raise BagError(
            f"{directory} appeared while the bag was written ({error.strerror}): "
            f"the bag is complete in {part}"
        ) from error
    shutil.rmtree(old, ignore_errors=True)
