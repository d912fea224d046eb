"""docs/hardware.md names a test for each failure: each of them exists."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_every_test_that_the_table_names_is_there():
    page = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
    named = re.findall(r"`(test_\w+)…?`", page)
    files = [*Path(__file__).parent.rglob("test_*.py"), *(ROOT / "tests/io/mavlink").glob("*.py")]
    written = "\n".join(path.read_text(encoding="utf-8") for path in files)
    assert len(named) > 15
    assert [name for name in named if f"def {name}" not in written] == []
    paths = re.findall(r"`(tests/[\w/]+\.py)`", page)
    assert [path for path in paths if not (ROOT / path).is_file()] == []
