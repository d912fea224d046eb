"""Bags: the functions behind `ptnsbc bag trim` and `repair`, and `ptnsbc bag replay --rerun`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ptnsbc_io.bag import repair as repairs
from ptnsbc_sim.plugins.loader import PluginError
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import console
from ptnsbc_tools.limits import refuse_outside
from ptnsbc_tools.reading.bag_reader import scenario_of
from ptnsbc_tools.reading.opener import open_bag
from ptnsbc_tools.replay import rerun as runs
from ptnsbc_tools.replay.rerun import Rerun

_MOST_JOBS = 4


def trim(
    bag: str | Path,
    output: str | Path,
    begin_s: float = 0.0,
    end_s: float | None = None,
    *,
    overwrite: bool = False,
    progress: bool | None = None,
) -> int:
    """Write a span of a bag into a new one, as `ptnsbc bag trim`; times and bytes of the messages stay.

    Args:
        bag: folder of the bag, or its .mcap file.
        output: folder of the new bag.
        begin_s: keep messages from here on [s], after the first one.
        end_s: keep messages up to here [s]; None: all.
        overwrite: replace an existing bag.

    Returns:
        The number of messages in the span.

    Raises:
        BagError: no bag, no message in this span, or an existing bag at `output`.
        LimitError: a time that no bag reaches.
    """
    refuse_outside("begin_s", begin_s)
    refuse_outside("end_s", end_s)
    with console.progress("trimming", progress) as advance:
        return repairs.trim(
            Path(bag), Path(output), begin_s, end_s, overwrite=overwrite, advance=advance
        )


def repair(
    bag: str | Path,
    output: str | Path | None = None,
    *,
    discard: bool = False,
    progress: bool | None = None,
) -> repairs.Repaired:
    """Restore the index and metadata.yaml of a cut or damaged bag, as `ptnsbc bag repair`.

    A killed recording DIR.part becomes DIR. A damaged bag DIR is replaced and kept as DIR.original.

    Args:
        bag: folder of the bag, the .part of a killed recording, or an .mcap file.
        output: folder of the repaired bag; by default as said above.
        discard: remove the damaged bag after the repair.

    Raises:
        BagError: no bag, or nothing in it can be read.
    """
    with console.progress("repairing", progress) as advance:
        target = None if output is None else Path(output)
        return repairs.repair(Path(bag), target, discard=discard, advance=advance)


def rerun(
    bag: str | Path,
    *,
    scenario: str | Path | None = None,
    law: str | None = None,
    plugins: Sequence[str] = (),
    progress: bool | None = None,
) -> Rerun:
    """Run the recorded inputs of a flight through the controllers again, as `ptnsbc bag replay --rerun`.

    Args:
        bag: folder of a bag of ours, or its .mcap file.
        scenario: scenario file to use instead of the attached one.
        law: FILE.py:NAME to execute, of a bag whose scenario names a law.
        plugins: FILE.py:NAME to execute, of a bag whose scenario names a task or a controller.

    Returns:
        What was compared, byte for byte; `verdict` is the word, `first` the first difference.

    Raises:
        PluginError: the scenario names a plug-in, and none is given.
        BagError: no bag, or none that can be run again.
    """
    path = Path(bag)
    found = open_bag(path)
    flown = scenario_of(found, None if scenario is None else Path(scenario))
    flown = _trusted(path, flown, law, plugins)
    with console.compiling():
        from ptnsbc_nodes.runtime.warmup import load_fleet

        load_fleet(flown)
    jobs = min(os.cpu_count() or 1, _MOST_JOBS)
    return runs.rerun(found, flown, progress, jobs)


def _trusted(path: Path, flown: Scenario, law: str | None, plugins: Sequence[str]) -> Scenario:
    """The scenario of a bag with the files of its plug-ins; PluginError when one that it names is not given."""
    changes = {} if law is None else {"law": law}
    given = {plugin.rpartition(":")[2]: plugin for plugin in plugins}
    for kind, option, named in (
        ("law", "--law", flown.law),
        ("task", "--plugin", flown.plugins.task),
        ("controller", "--plugin", flown.plugins.controller),
    ):
        if named is None or Path(named).is_absolute() or kind in changes:
            continue
        name = named.rpartition(":")[2]
        if kind == "law" or name not in given:
            raise PluginError(
                f"{path}: flown with the {kind} {named}, which a bag does not carry: give it with {option} "
                f"FILE.py:{name}"
            )
        changes[f"plugins.{kind}"] = given[name]
    return flown.with_(changes) if changes else flown
