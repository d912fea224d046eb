"""The pages stay short: words by hand have a limit, and each page is read in five minutes or is a reference."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
LARGEST_SUM = 45_000
LARGEST_PAGE = 2000

# Nobody reads these from top to bottom: they are made from the code, or of the numbers of flights.
REFERENCES = ("docs/cli.md", "docs/scenarios.md", "docs/tables.md")
# Look-up tables by hand, which count, but not as a page that is read.
LOOKED_UP = ("docs/equations.md", "docs/autopilot.md")


def words(text: str) -> int:
    """Words of a page that a person has written: those outside of its made regions."""
    by_hand = re.sub(r"<!-- made: .*?<!-- /made -->", "", text, flags=re.DOTALL)
    return len(by_hand.split())


def pages() -> dict[str, int]:
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout.split()  # fmt: skip
    return {
        name: words((ROOT / name).read_text("utf-8"))
        for name in listed
        if name not in REFERENCES and (ROOT / name).is_file()
    }


def test_the_pages_have_a_limit_together():
    counts = pages()
    assert sum(counts.values()) <= LARGEST_SUM, sorted(counts.items(), key=lambda item: -item[1])


def test_a_page_is_read_in_five_minutes_or_looked_up():
    long = {
        name: count
        for name, count in pages().items()
        if count > LARGEST_PAGE and name not in LOOKED_UP
    }
    assert long == {}


def test_made_words_do_not_count():
    assert words("one two\n<!-- made: it -->\n\n| three |\n\n<!-- /made -->\nfour") == 3
