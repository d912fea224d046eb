"""The process of a hover test: it opens the link, flies, and lets the operator land or stop the vehicle.

`ptnsbc stop` reaches it as it reaches a bridge of this host, and knows how to reach the vehicle past it.
"""

from __future__ import annotations

import os
import time
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

from ptnsbc_io.key_file import read_key
from ptnsbc_io.mavlink.link import MavlinkLink, Signer
from ptnsbc_io.mavlink.transport import connect
from ptnsbc_nodes.bridge.bridge import WANTED_MESSAGES
from ptnsbc_nodes.bridge.ports import Clocks, Log
from ptnsbc_nodes.bridge.status import vehicle_record
from ptnsbc_nodes.bridge.tuning.excitation import TuneError
from ptnsbc_nodes.bridge.tuning.hover_test import HoverTest
from ptnsbc_nodes.bridge.tuning.settings import Identified
from ptnsbc_nodes.emergency.orders import Order, OrderPort, latched, runtime_folder
from ptnsbc_nodes.emergency.records import VehicleRecord, write_record
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_sim.scenario import Scenario

_WAIT_S, _RECORD_S = 0.005, 1.0


def fly_hover_test(
    scenario: Scenario, uav: int, key: Path | None, log: Log, *, allow_arming: bool, box_m: float
) -> Identified:
    """Fly one vehicle and identify it; the first signal lands it, the second one ends this at once.

    Args:
        scenario: the fleet of the vehicle, overrides applied.
        uav: id of its UAV.
        key: key file for signing, instead of the scenario's.
        log: takes lines for the operator.
        allow_arming: whether it may arm; otherwise a pilot arms.
        box_m: side of the box that the vehicle must not leave [m].

    Raises:
        TuneError: no result, with the reason.
    """
    folder = runtime_folder(environment.named_domain())
    if (held := latched(folder)).what:
        raise TuneError(
            f"the operator's order {held.text!r} still holds: expected none; ptnsbc stop --clear releases it"
        )
    settings = scenario.vehicle_link(uav)
    path = str(key or settings.signing_key or "")
    signer = Signer(read_key(Path(path))) if path else None
    record = VehicleRecord(
        name=f"bridge{uav}",
        pid=os.getpid(),
        sysid=settings.sysid,
        autopilot=settings.autopilot,
        connect=settings.connect,
        signing_key=str(Path(path).resolve()) if path else "",
    )
    clocks = Clocks(time.monotonic, time.time_ns)
    link = MavlinkLink(connect(settings.connect), settings.sysid, WANTED_MESSAGES, signer)
    with closing(link):
        test = HoverTest(scenario, uav, link, clocks, log, allow_arming=allow_arming, box_m=box_m)
        environment.prefer_punctuality()
        _serve(test, folder, record)
    return test.identified()


def _serve(test: HoverTest, folder: Path, record: VehicleRecord) -> None:
    """Serve the test until it is over."""

    def present() -> VehicleRecord:
        return vehicle_record(record.name, test.bridge, record)

    def take(order: Order) -> None:
        test.inputs.take(order)

    port = OrderPort(folder, record.name, take, lambda: present().encode())
    due_s = 0.0
    try:
        with StopRequest() as request:
            while not test.over:
                test.bridge.link.wait(_WAIT_S)
                test.serve()
                if request.count > 1:
                    raise KeyboardInterrupt
                if request.came:
                    test.land()
                if time.monotonic() >= due_s:
                    due_s = time.monotonic() + _RECORD_S
                    with suppress(OSError):
                        write_record(folder, present())
        test.bridge.leave()
    finally:
        port.close()
        with suppress(OSError):
            write_record(folder, replace(present(), ended=True))
