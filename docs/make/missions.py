"""The tables of `docs/missions.md`."""

from __future__ import annotations

from collections.abc import Iterator

from docs.make.scenarios import cells_table
from docs.make.schema import Row, rows
from ptnsbc_sim.scenario.mission.legs import LegBlock, Mission

_LEGS = "legs[]."


def regions() -> dict[str, str]:
    """Every made region of the page."""
    found = list(rows(Mission))
    return {
        "mission": cells_table(row for row in found if not row.key.startswith(_LEGS)),
        "legs": cells_table(_common(found)),
        "kinds": cells_table(_own(found)),
    }


def _common(found: list[Row]) -> Iterator[Row]:
    """The keys that all kinds of legs have, each once."""
    seen: set[str] = set()
    for row in found:
        key = row.key.removeprefix(_LEGS)
        if key in LegBlock.model_fields and key not in seen:
            seen.add(key)
            yield row._replace(key=key, meaning=row.meaning.split("* ", 1)[-1])


def _own(found: list[Row]) -> Iterator[Row]:
    """The keys of a kind of leg; the keys of a trajectory are those of `leader.trajectory`."""
    for row in found:
        key = row.key.removeprefix(_LEGS)
        if (
            row.key.startswith(_LEGS)
            and key not in LegBlock.model_fields
            and not key.startswith("trajectory.")
        ):
            yield row._replace(key=key)
