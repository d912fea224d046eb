"""The look of every figure: colours for all common kinds of colour blindness, and dashes."""

from __future__ import annotations

from typing import NamedTuple

# Okabe and Ito. On a dark page black and the darkest blue would vanish.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000", "#F0E442")
DARK_COLOURS = (
    "#4DA6E0", "#E69F00", "#2BBF95", "#F07B2E", "#DD93BB", "#8CD0F5", "#E8E8E8", "#F0E442"
)  # fmt: skip
DASHES = ("-", "--", "-.", ":")
OBSTACLE = "#7F7F7F"
GOOD = "#009E73"

WIDTH_IN = 9.0
HEIGHT_IN = 4.2
DPI = 110


class Look(NamedTuple):
    """How one curve is drawn."""

    colour: int  # index into COLOURS
    dash: int  # index into DASHES


def look(index: int) -> Look:
    """Colour and dash of UAV number `index`: beyond eight colours the dashes tell them apart."""
    return Look(index % len(COLOURS), (index // len(COLOURS)) % len(DASHES))
