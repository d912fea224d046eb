"""`ptnsbc tune`: identify one vehicle in a hover test, and write the settings that fit it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console, options, ros
from ptnsbc_tools.options import AllowArmingOption, SetOption

if TYPE_CHECKING:
    from ptnsbc_nodes.bridge.identification import Identified, Settings
    from ptnsbc_sim.scenario import Scenario


class TuneFileError(PtnsbcError):
    """A file of settings that cannot be written as requested."""


def tune(
    uav: Annotated[int, typer.Option("--uav", metavar="N", help="Id of the UAV in the scenario.")],
    scenario: Annotated[
        str,
        typer.Argument(metavar="[SCENARIO]", help="Scenario of the fleet that the vehicle is for."),
    ] = "experiment_4",
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect", metavar="LINK", help="Link to the vehicle. Default: as in the scenario."
        ),
    ] = None,
    signing_key: Annotated[
        Path | None,
        typer.Option(
            "--signing-key", metavar="FILE", help="Key for signing. Default: as in the scenario."
        ),
    ] = None,
    allow_arming: AllowArmingOption = False,
    box: Annotated[
        float,
        typer.Option("--box", metavar="M", help="Side of the box that the vehicle may use."),
    ] = 3.0,
    alike: Annotated[
        bool,
        typer.Option("--alike", help="Write the result for all vehicles with the same autopilot."),
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Scenario file to write, which extends SCENARIO."
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing file.")
    ] = False,
    json: options.JsonOption = False,
    domain: options.DomainOption = None,
    settings: SetOption = None,
) -> None:
    """Identify how one vehicle follows velocities in a hover test, and print the settings that fit it.

    The vehicle takes off, flies sinusoids within a box over about a minute, and lands. It lands at once
    outside of its box, at the fence, and at Ctrl-C; a pilot who takes over keeps it.
    """
    with ros.required("install the extras [ros,mavlink] or source ROS 2"):
        from ptnsbc_nodes.bridge.hover_test import fly_hover_test
        from ptnsbc_nodes.bridge.identification import settings as fitting
    ros.select_network(None, domain)
    if output is not None and output.exists() and not overwrite:
        raise TuneFileError(f"{output}: exists: choose another name, or --overwrite")
    given = options.overrides(settings=settings)
    if connect is not None:
        given[f"mavlink.vehicles.{uav}.connect"] = connect
    chosen = options.scenario_with(scenario, given).bridged()
    found = fly_hover_test(
        chosen, uav, signing_key, console.say, allow_arming=allow_arming, box_m=box
    )
    fits = fitting(chosen, found)
    for line in _lines(chosen, found, fits):
        console.say(line)
    uavs = _alike(chosen, uav) if alike else (uav,)
    keys = _keys(chosen, found, fits, uavs)
    if output is not None:
        _write(output, scenario, keys, found)
        console.say(f"next: ptnsbc fleet {output} --backend mavlink --allow-arming")
    if json:
        points = [{"hertz": p.hertz, "gain": p.gain, "lag_s": p.lag_s} for p in found.points]
        console.print_json({"points": points, "settings": fits._asdict(), "keys": keys})


def _lines(scenario: Scenario, found: Identified, fits: Settings) -> Iterator[str]:
    """The result in words."""
    for point in found.points:
        model = found.expected(point.hertz)
        yield (
            f"{point.hertz:g} Hz: gain {point.gain:.2f}, lag {point.lag_s:.2f} s "
            f"(model {model.gain:.2f}, {model.lag_s:.2f} s)"
        )
    response, own = found.response, scenario.gains.formation
    yield (
        f"velocity loop {response.gain:.2f} 1/s, lag of the tilt {response.tilt_lag_s:.2f} s, "
        f"drag {found.drag_1_s:.2f} 1/s, link {1e3 * found.delay_s:.0f} ms"
    )
    yield (
        f"gains.formation.kappa_1_s: {fits.kappa_1_s:.2g} instead of {own.kappa_1_s:g}, "
        f"up to {fits.largest_kappa_1_s:.1f} fits"
    )
    yield f"gains.formation.residual: {fits.residual:.2g} instead of {own.residual:g}"
    yield f"gains.filter.bandwidth_1_s: {fits.filter_1_s:g} instead of {scenario.gains.filter.bandwidth_1_s:g}"
    yield (
        f"gains.formation.deadline_s: {fits.deadline_s:g} instead of {own.deadline_s:g}, "
        f"from {fits.shortest_deadline_s:g} s on fits"
    )


def _alike(scenario: Scenario, uav: int) -> tuple[int, ...]:
    kind = scenario.vehicle_link(uav).autopilot
    return tuple(i for i in scenario.uav_ids if scenario.vehicle_link(i).autopilot == kind)


def _keys(
    scenario: Scenario, found: Identified, fits: Settings, uavs: tuple[int, ...]
) -> dict[str, Any]:
    """The `mavlink` block that makes the scenario fit."""
    response = found.response
    own = {
        "velocity_loop_1_s": round(response.gain, 3),
        "tilt_lag_s": round(response.tilt_lag_s, 3),
    }
    overrides = {
        "gains.formation.kappa_1_s": round(fits.kappa_1_s, 2),
        "gains.formation.residual": float(f"{fits.residual:.2g}"),
        "gains.formation.deadline_s": fits.deadline_s,
        "gains.filter.bandwidth_1_s": fits.filter_1_s,
    }
    return {
        "overrides": {**scenario.mavlink.overrides, **overrides},
        "vehicles": {uav: dict(own) for uav in uavs},
    }


def _write(path: Path, base: str, keys: dict[str, Any], found: Identified) -> None:
    """A scenario file that extends the one that was given."""
    from ptnsbc_sim.scenario.reading.reader import dump, find
    from ptnsbc_tools.files import replacing

    source = find(base)
    if source.resolve() == path.resolve():
        raise TuneFileError(f"{path}: is the scenario itself: expected another file")
    named = (
        base
        if os.sep not in base and not Path(base).suffix
        else os.path.relpath(source, path.parent)
    )
    measured = "".join(
        f"# {point.hertz:g} Hz: gain {point.gain:.2f}, lag {point.lag_s:.2f} s\n"
        for point in found.points
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        text = f"# By ptnsbc tune: how the vehicle follows a velocity.\n{measured}"
        part.write_text(text + dump({"extends": named, "mavlink": keys}), encoding="utf-8")
