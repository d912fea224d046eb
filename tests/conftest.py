"""The order of the tests, for several workers: about 2000 tests, of which thirty take most of the time."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

HERE = Path(__file__).parent
# Folders and files below tests/ that run, or read bags, without a compiled law.
WITHOUT_LAWS = ("nodes/bag/", "docs/", "nodes/mavlink/", "test_")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long tests before short ones: no worker is left with one when the others have run out of work.

    Before them, on an empty cache one worker compiles the laws with the first test; what needs none keeps the
    others busy meanwhile, which would compile the same. Everything else stays in the order of the files.
    """
    items.sort(key=_turn)
    for item in items:
        if "alone" in item.keywords and not _place(item).startswith("nodes/"):
            raise pytest.UsageError(f"{item.nodeid}: make test flies `alone` of tests/nodes only")


def _place(item: pytest.Item) -> str:
    return os.path.relpath(item.path, HERE)


def _turn(item: pytest.Item) -> int:
    if "compiles" in item.keywords:
        return 0
    if _place(item).startswith(WITHOUT_LAWS):
        return 1
    return 2 if "slow" in item.keywords else 3
