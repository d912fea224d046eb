"""The page of the live view and its socket: what a page is sent, who may open it, and which orders it may give."""

from __future__ import annotations

import errno
import http.client
import json
import os
import resource
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.sync.server import Server

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools.live.server import (
    HOST,
    MOST_ROWS,
    Feed,
    LiveServer,
    order_in,
)


def frame(t: float | None, error: float | None = 0.5) -> dict[str, Any]:
    return {"t": t, "uavs": [{"pose": [0.0] * 7, "error": error}]}


def test_a_page_begins_with_the_flight_so_far() -> None:
    feed = Feed()
    feed.set_stage({"name": "a"})
    for tick in range(10):
        feed.add(frame(tick / 4))
    number, version, text = feed.begin()
    message = json.loads(text)
    assert message["stage"] == {"name": "a"} and len(message["rows"]) == 10
    assert feed.after(number, version, 0.0) == (number, [])
    feed.add(frame(9.0))
    found = feed.after(number, version, 0.0)
    assert found is not None and [json.loads(one)["t"] for one in found[1]] == [9.0]


def test_frames_that_lack_a_uav_or_come_too_fast_are_no_rows() -> None:
    feed = Feed()
    for t in (None, 0.0, 0.01, 0.02, 0.2):
        feed.add(frame(t))
    feed.add({"t": 1.0, "uavs": [{"pose": None, "error": None}]})
    assert [row[0] for row in json.loads(feed.begin()[2])["rows"]] == [0.0, 0.2]


def test_a_long_flight_is_thinned() -> None:
    feed = Feed()
    for tick in range(2 * MOST_ROWS):
        feed.add(frame(tick * 0.125))
    times = [row[0] for row in json.loads(feed.begin()[2])["rows"]]
    assert len(times) <= MOST_ROWS
    assert times[0] == 0.0 and times[-1] > 0.99 * 2 * MOST_ROWS * 0.125


def test_a_new_stage_makes_pages_begin_anew_and_answers_are_passed_on() -> None:
    feed = Feed()
    number, version, _ = feed.begin()
    feed.tell("said", text="hold: announced")
    found = feed.after(number, version, 0.0)
    assert found is not None and json.loads(found[1][0])["text"] == "hold: announced"
    feed.set_stage({"name": "b"})
    assert feed.after(found[0], version, 0.0) is None


def test_whoever_waits_is_woken() -> None:
    feed = Feed()
    number, version, _ = feed.begin()
    adder = threading.Timer(0.01, feed.add, [frame(1.0)])
    adder.start()
    found = feed.after(number, version, 30.0)
    adder.join()
    assert found is not None and len(found[1]) == 1


@pytest.fixture
def server() -> Iterator[LiveServer]:
    feed = Feed()
    feed.set_stage({"name": "a"})
    with LiveServer(feed, lambda: "<p>page</p>") as one:
        yield one


def get(server: LiveServer, path: str, **headers: str) -> tuple[int, str, str]:
    connection = http.client.HTTPConnection(HOST, server.port, timeout=30)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    found = answer.status, answer.read().decode(), answer.getheader("Content-Security-Policy") or ""
    connection.close()
    return found


def test_the_page_needs_the_token(server: LiveServer) -> None:
    status, body, security = get(server, f"/?token={server.token}")
    assert (status, body) == (200, "<p>page</p>")
    assert "default-src 'none'" in security and f"connect-src ws://{HOST}:{server.port}" in security
    for path in ("/", "/?token=", "/?token=x", f"/?token={server.token}x", "/socket"):
        assert get(server, path)[0] == 403, path
    assert get(server, f"/other?token={server.token}")[0] == 404


def test_another_name_or_origin_is_refused(server: LiveServer) -> None:
    path = f"/?token={server.token}"
    assert get(server, path, Host="example.org")[0] == 403
    assert get(server, path, Origin="http://example.org")[0] == 403


def test_two_host_headers_are_answered_by_400(
    server: LiveServer, caplog: pytest.LogCaptureFixture
) -> None:
    with socket.create_connection((HOST, server.port), timeout=30) as visitor:
        visitor.sendall(b"GET /?token=x HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: localhost\r\n\r\n")
        assert visitor.recv(100).startswith(b"HTTP/1.1 400 ")
    assert not caplog.records


def test_a_crowd_without_a_token_is_bounded_and_ends(
    server: LiveServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ptnsbc_tools.live.server._MOST_CONNECTIONS", 3)
    crowd = [socket.create_connection((HOST, server.port), timeout=30) for _ in range(9)]
    # those for whom there is no room are sent away at once
    assert [one.recv(1) for one in crowd[3:]] == [b""] * 6
    for one in crowd[:3]:  # what they say is no request: each of them is answered, and leaves
        one.sendall(b"\r\n\r\n")
        while one.recv(1000):
            pass
    for one in crowd:
        one.close()
    # The server lets go of a connection a moment after its last byte.
    end_s = time.monotonic() + 30.0
    while time.monotonic() < end_s:
        with suppress(OSError, http.client.HTTPException):
            assert get(server, f"/?token={server.token}")[0] == 200
            return
    pytest.fail("nobody gets in after the crowd has left")


def test_a_crowd_leaves_the_flight_its_descriptors(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a limit of 256 it took them all, and the launcher of the fleet ended."""
    monkeypatch.setattr(resource, "getrlimit", lambda _: (64, 64))
    monkeypatch.setattr("ptnsbc_tools.live.server._LOADING_S", 60.0)  # none leaves by itself
    with LiveServer(Feed(), lambda: "") as server:
        before = len(os.listdir("/proc/self/fd"))
        crowd = [socket.create_connection((HOST, server.port), timeout=10) for _ in range(12)]
        assert [one.recv(1) for one in crowd[4:]] == [b""] * 8
        assert len(os.listdir("/proc/self/fd")) - before - len(crowd) <= 16
        for one in crowd:
            one.close()


def test_a_connection_that_does_not_let_go_keeps_no_flight_from_ending(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("ptnsbc_tools.live.server._LAST_S", 0.01)
    let_go, shutdown = threading.Event(), Server.shutdown
    monkeypatch.setattr(Server, "shutdown", lambda server: let_go.wait() and shutdown(server))
    with LiveServer(Feed(), lambda: ""):
        pass
    let_go.set()


def test_without_a_descriptor_left_the_page_comes_back(
    server: LiveServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    failures = [OSError(errno.EMFILE, "Too many open files")] * 3
    accept = socket.socket.accept

    def lacking(listener: socket.socket) -> Any:
        if failures:
            raise failures.pop()
        return accept(listener)

    monkeypatch.setattr(socket.socket, "accept", lacking)
    assert get(server, f"/?token={server.token}")[0] == 200
    assert not failures


def test_it_listens_on_this_host_alone(server: LiveServer) -> None:
    assert server.address.startswith(f"http://127.0.0.1:{server.port}/?token=")
    with socket.socket() as other, pytest.raises(OSError):
        other.bind((HOST, server.port))


def test_a_socket_gets_the_stage_and_gives_orders(server: LiveServer) -> None:
    address = f"ws://{HOST}:{server.port}/socket?token="
    with pytest.raises(InvalidStatus):
        connect(f"{address}x")
    with connect(address + server.token) as page:
        assert json.loads(page.recv(timeout=30))["stage"] == {"name": "a"}
        page.send(json.dumps({"order": "land", "token": "x"}))
        assert "not understood" in json.loads(page.recv(timeout=30))["text"]
        page.send(json.dumps({"order": "land", "token": server.token}))
        assert server.orders.get(timeout=30) == "land"


@pytest.mark.parametrize(
    "data",
    [
        "",
        "[]",
        "{",
        b"\xff",
        "[" * 5000,
        '{"order": "kill", "token": "t"}',
        '{"order": "land"}',
        '{"order": ["land"], "token": "t"}',
        '{"order": "land", "token": 3}',
        '{"order": "land", "token": "u"}',
        '{"order": "land", "token": "\\ud800"}',
    ],
)
def test_anything_else_is_no_order(data: str | bytes) -> None:
    assert order_in(data, "t") is None


def test_a_page_that_sends_nonsense_harms_no_other(server: LiveServer) -> None:
    address = f"ws://{HOST}:{server.port}/socket?token={server.token}"
    with connect(address) as bad, connect(address) as good:
        bad.recv(timeout=30)
        good.recv(timeout=30)
        bad.send("x" * 5000)  # above what is taken: the connection is closed
        good.send(json.dumps({"order": "hold", "token": server.token}))
        assert server.orders.get(timeout=30) == "hold"


def test_a_port_that_is_taken_is_named(server: LiveServer) -> None:
    with pytest.raises(PtnsbcError, match=f"--port {server.port}: .*: expected a free port"):
        LiveServer(Feed(), str, server.port)
