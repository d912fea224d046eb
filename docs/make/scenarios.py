"""The tables of `docs/scenarios.md`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from docs.make.markdown import table
from docs.make.schema import REQUIRED, Row, rows
from ptnsbc_sim.scenario import gains, model
from ptnsbc_sim.scenario.gains import gain_defaults
from ptnsbc_sim.scenario.mission.fault_rules import FaultBlock

PLANTS = ("quadrotor", "rigid_body_6dof")
_HEADINGS = ("Key", "Type", "Unit", "Default", "Range", "Meaning")
_BLOCKS = {
    "timing": model.Timing,
    "world": model.Surroundings,
    "sensor": model.Sensor,
    "plant": model.Plant,
    "communication": model.Communication,
    "leader": model.Leader,
    "formation": model.Formation,
    "uavs": model.UavBlock,
    "faults": FaultBlock,
    "mavlink": model.Mavlink,
    "ros": model.Ros,
    "plugins": model.Plugins,
}


def regions() -> dict[str, str]:
    """Every made region of the page."""
    top = [row for row in rows(model.ScenarioFile) if "." not in row.key and "[" not in row.key]
    return {
        "top": cells_table(_linked(row) for row in top),
        **{name: cells_table(_own(rows(block))) for name, block in _BLOCKS.items()},
        "gains": cells_table(_gains()),
        "loops": _loops(),
    }


def _own(of: Iterator[Row]) -> Iterator[Row]:
    """Without what stands there already: an obstacle's trajectory below `leader`, a vehicle's keys above `vehicles`."""
    seen: set[tuple[str, str]] = set()
    for row in of:
        own = (row.key.rpartition("vehicles.N.")[2], row.meaning)
        if own not in seen and not row.key.startswith("obstacles[].trajectory."):
            yield row
        seen.add(own)


def cells_table(of: Iterable[Row]) -> str:
    """A table of keys."""
    return table(_HEADINGS, (_cells(row) for row in of))


def _cells(row: Row) -> tuple[str, ...]:
    default = f"**{REQUIRED}**" if row.default == REQUIRED else row.default
    return f"`{row.key}`", row.type, row.unit, default, row.range, row.meaning


def _linked(row: Row) -> Row:
    held = row.key in _BLOCKS or row.key == "gains"
    return row._replace(meaning=f"{row.meaning} [Keys](#{row.key})") if held else row


def _gains() -> Iterator[Row]:
    """The keys of `gains`; those that all loops have in a row each, once."""
    seen: set[str] = set()
    loops = _loop_names()
    for row in rows(gains.Gains):
        block, _, key = row.key.partition(".")
        if not key:
            if row.key == "profile":
                yield row._replace(default=_default("profile"))
            continue
        if block in loops and key in gains.Loop.model_fields:
            if key not in seen:
                seen.add(key)
                default = row.default if key == "time_base" else "below"
                yield row._replace(key=f"LOOP.{key}", default=default)
        else:
            yield row._replace(default=_default(row.key))


def _loop_names() -> list[str]:
    kinds = {name: field.annotation for name, field in gains.Gains.model_fields.items()}
    return [
        name
        for name, kind in kinds.items()
        if isinstance(kind, type) and issubclass(kind, gains.Loop)
    ]


def _loops() -> str:
    keys = [key for key in gains.Loop.model_fields if key != "time_base"]
    cells = ((f"`{loop}`", *(_default(f"{loop}.{key}") for key in keys)) for loop in _loop_names())
    return table(("Loop", *(f"`{key}`" for key in keys)), cells)


def _default(path: str) -> str:
    """The default of a gain: one, or that of each plant."""
    found = [_at(path, plant) for plant in PLANTS]
    return found[0] if len(set(found)) == 1 else " / ".join(found)


def _at(path: str, plant: str) -> str:
    node: object = gain_defaults(plant)
    for key in path.split("."):
        if not isinstance(node, dict) or key not in node:
            return "none" if path.endswith("profile") else f"**{REQUIRED}**"
        node = node[key]
    if isinstance(node, bool):
        return str(node).lower()
    return f"{node:g}" if isinstance(node, int | float) else f"`{node}`"
