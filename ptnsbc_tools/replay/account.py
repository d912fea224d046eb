"""What a re-run found out, for people and as JSON."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from rich.table import Table

from ptnsbc_tools.replay.rerun import EQUAL, Rerun
from ptnsbc_tools.replay.uav_replay import Account


def as_json(done: Rerun, seconds: float) -> dict[str, Any]:
    """Plain types only; `seconds` is what the re-run took."""
    first = done.first
    return {
        "verdict": done.verdict,
        "mode": "real time" if done.realtime else "lock-step",
        "first_difference": None if first is None else first.as_json(),
        "steps": sum(one.steps for one in done.accounts.values()),
        "compared": sum(one.compared for one in done.accounts.values()),
        "flown_s": done.flown_s,
        "took_s": seconds,
        "times_real_time": done.flown_s / seconds,
        "uavs": [_of_uav(uav, account) for uav, account in done.accounts.items()],
    }


def table(done: Rerun) -> Table:
    """One row per UAV."""
    found = Table(title="re-run")
    for name in ("UAV", "steps", "compared", "before the first leg", "not re-run", "not recorded"):
        found.add_column(name, justify="right")
    found.add_column("result")
    for uav, one in done.accounts.items():
        left_out = sum(gap.steps for gap in one.gaps)
        figures = (one.steps, one.compared, one.waiting, left_out, one.unrecorded)
        found.add_row(str(uav), *map(str, figures), _result(one))
    return found


def lines(done: Rerun, seconds: float) -> Iterator[str]:
    """What is to be said beside the table, the verdict last."""
    for uav, one in done.accounts.items():
        for gap in one.gaps:
            span = f"t = {gap.first_s:.3f} s to {gap.last_s:.3f} s"
            yield f"uav{uav}: void from {span}, {gap.steps} steps: {gap.reason}"
        if one.unrecorded:
            yield f"uav{uav}: {one.unrecorded} of its outputs are not in the recording"
        if one.silent:
            yield f"uav{uav}: nothing of it is recorded for the last {one.silent} steps"
    steps = sum(one.steps for one in done.accounts.values())
    speed = f"{done.flown_s:.1f} s of flight in {seconds:.1f} s"
    if done.first is not None:
        yield f"different: {done.first}"
    elif done.verdict == EQUAL:
        outputs = sum(one.compared for one in done.accounts.values())
        yield f"equal: {steps} steps, {outputs} outputs, byte for byte; {speed}"
    else:
        yield f"void: what could be re-run is equal ({steps} steps), but not all could; {speed}"


def _result(account: Account) -> str:
    if account.difference is not None:
        return f"different from tick {account.difference.tick}"
    return "void" if account.gaps or account.unrecorded or not account.compared else "equal"


def _of_uav(uav: int, account: Account) -> dict[str, Any]:
    plain = dataclasses.asdict(account)
    plain["gaps"] = [gap._asdict() for gap in account.gaps]
    return {"uav": uav, **plain}
