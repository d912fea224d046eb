"""The server of --foxglove, with a client of its protocol."""

from __future__ import annotations

import json
import socket

import pytest

pytest.importorskip("foxglove", reason="needs foxglove-sdk (extra [foxglove])")

from websockets.sync.client import connect

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.live.foxglove import FoxgloveSink
from ptnsbc_tools.live.server import LiveServerError

SCENARIO = load_scenario("paper_5")
POSE = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]


def test_a_client_is_offered_the_scene_the_frames_and_the_numbers() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    uavs = [{"id": 1, "pose": POSE}, {"id": 2, "pose": None}]
    with (
        FoxgloveSink(SCENARIO, port) as sink,
        connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"]) as client,  # type: ignore[list-item]
    ):
        topics: set[str] = set()
        while len(topics) < 3:
            message = client.recv(timeout=30)
            if isinstance(message, str) and json.loads(message)["op"] == "advertise":
                topics |= {one["topic"] for one in json.loads(message)["channels"]}
        assert topics == {"/scene", "/tf", "/formation/live"}
        sink({"uavs": uavs})


def test_a_port_that_is_taken_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(LiveServerError, match=f"--foxglove {port}"):
            FoxgloveSink(SCENARIO, port)
