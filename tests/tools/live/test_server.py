"""The server of the live view: who gets in, and what is taken from a page."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Iterator

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from ptnsbc_tools.live.feed import Feed
from ptnsbc_tools.live.server import HOST, LiveServer, LiveServerError, order_in


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
    with pytest.raises(LiveServerError, match=f"--port {server.port}: .*: expected a free port"):
        LiveServer(Feed(), str, server.port)
