"""The server of the live view, on a port of 127.0.0.1: the page with its socket.

Page and socket share a port. Both want the token of the printed address.
The page has the parts of the report's page; what it shows comes over its socket: the stage, the flight so far, and
every frame.
"""

from __future__ import annotations

import hmac
import json
import math
import queue
import resource
import secrets
import socket
import threading
import time
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from string import Template
from typing import Any
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools.report.page import asset, plotly

MOST_ROWS = 4000
"""Rows that are kept for a page that joins later: when there are more, every other one is dropped."""
_SPACING_S = 0.1

_SCRIPTS = ("data.js", "clock.js", "camera.js", "scene.js", "charts.js", "main.js")
HOST = "127.0.0.1"
STOPS = {"stop": ("stop",), "motors": ("stop", "--kill")}
ORDERS = ("hold", "land", *STOPS)
"""The orders that a page may give; each is confirmed there. Those of STOPS are commands of ptnsbc."""
_MOST_PAGES = 16
_MOST_CONNECTIONS = 64  # with those that have shown no token yet
_DESCRIPTORS = 4  # that a connection of websockets takes
_LARGEST_ORDER = 1024  # bytes
_LOOK_S = 0.2
_LOADING_S = 3.0  # from a page to its socket
_LAST_S, _SETTLE_S = 5.0, 0.05  # for what pages have not got yet
_SECURITY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src ws://{host}"
)
_HEADERS = {
    "Content-Type": "text/html; charset=utf-8",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Connection": "close",
}


class Feed:
    """Written by one thread, read by one thread for each page."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._stage: dict[str, Any] = {}
        self._versions = 0  # of the stage
        self._rows: list[list[Any]] = []
        self._spacing_s = _SPACING_S
        self._frame = ""
        self._number = 0  # of frames and answers
        self._answers: list[tuple[int, str]] = []
        self._ended_at: int | None = None  # the number before the end of the flight

    def set_stage(self, stage: dict[str, Any]) -> None:
        """Begin anew with another stage; what was flown so far stays."""
        with self._changed:
            self._stage = stage
            self._versions += 1
            self._changed.notify_all()

    def add(self, frame: dict[str, Any]) -> None:
        """The newest picture of the flight (`FlightState.frame`)."""
        with self._changed:
            self._frame = _text({"kind": "frame", **frame})
            self._number += 1
            self._keep(frame)
            self._changed.notify_all()

    def tell(self, kind: str, **keys: Any) -> None:
        """A message for all pages that are open: what has become of an order, or of the flight."""
        with self._changed:
            if kind == "end":  # a page that comes later gets it too
                self._ended_at = self._number
            self._number += 1
            answer = self._number, _text({"kind": kind, **keys})
            self._answers = [*self._answers[-20:], answer]
            self._changed.notify_all()

    def begin(self) -> tuple[int, int, str]:
        """Number and version of now, and the message with which a page begins: the stage and the flight so far."""
        with self._changed:
            message = {"kind": "stage", "stage": self._stage, "rows": self._rows}
            number = self._number if self._ended_at is None else self._ended_at
            return number, self._versions, _text(message)

    def after(self, number: int, version: int, patience_s: float) -> tuple[int, list[str]] | None:
        """The messages after `number`, waiting so long for one; None when the page is to begin anew."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._number != number or self._versions != version, patience_s
            )
            if self._versions != version:
                return None
            news = [text for at, text in self._answers if at > number]
            if self._number != number and self._frame:
                news.append(self._frame)
            return self._number, news

    def _keep(self, frame: dict[str, Any]) -> None:
        """A row for pages that join later: time, poses and errors of all UAVs, as long as all are known."""
        t, uavs = frame["t"], frame["uavs"]
        if t is None or any(uav["pose"] is None for uav in uavs):
            return
        if self._rows and t - self._rows[-1][0] < self._spacing_s:
            return
        self._rows.append([t, [uav["pose"] for uav in uavs], [uav["error"] for uav in uavs]])
        if len(self._rows) > MOST_ROWS:
            self._rows = self._rows[::2]
            self._spacing_s *= 2.0


def _text(message: dict[str, Any]) -> str:
    return json.dumps(message, allow_nan=False, separators=(",", ":"))


@cache
def live_page() -> str:
    """The whole page; what it shows comes over its socket."""
    own = files(__package__).joinpath("assets")
    scripts = [*map(asset, _SCRIPTS), own.joinpath("live.js").read_text("utf-8")]
    return Template(own.joinpath("live.html").read_text("utf-8")).substitute(
        view=asset("view.html"),
        style=asset("style.css") + own.joinpath("live.css").read_text("utf-8"),
        script="\n".join(scripts),
        plotly=plotly(),
    )


class _Listener(socket.socket):
    """A listening socket with `_MOST_CONNECTIONS` at a time; whoever comes then is sent away.

    All together take at most a quarter of the descriptors of this process: the flight needs the others.
    """

    def __init__(self, port: int) -> None:
        super().__init__(socket.AF_INET, socket.SOCK_STREAM)
        self._taken: list[socket.socket] = []
        self.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.bind((HOST, port))
        self.listen()
        self.settimeout(_LOOK_S)  # of `accept`: it sees that the socket is closed

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection for which there is room and a descriptor; OSError once the socket is closed."""
        while True:
            try:
                connection, address = super().accept()
            except OSError:
                if self.fileno() == -1:
                    raise
                time.sleep(_SETTLE_S)  # no event says that a descriptor is free again
                continue
            self._taken = [each for each in self._taken if each.fileno() != -1]
            spare = resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 4
            if len(self._taken) < min(_MOST_CONNECTIONS, spare // _DESCRIPTORS):
                self._taken.append(connection)
                return connection, address
            connection.close()


class LiveServer:
    """Serves the page that `page` makes, and feeds it; use it as a context manager. Port 0: a free one."""

    def __init__(self, feed: Feed, page: Callable[[], str], port: int = 0) -> None:
        self.orders: queue.SimpleQueue[str] = queue.SimpleQueue()
        """The orders of people at the pages, in their order."""
        self.token = secrets.token_urlsafe(18)
        self._feed, self._page = feed, page
        self._pages = threading.BoundedSemaphore(_MOST_PAGES)
        self._loading_s = -math.inf  # until when a page that was asked for may open its socket
        self._ended = threading.Event()
        try:
            self._server = serve(
                self._serve,
                sock=_Listener(port),
                open_timeout=_LOADING_S,
                process_request=self._answer,
                max_size=_LARGEST_ORDER,
                server_header=None,
            )
        except OSError as error:
            raise PtnsbcError(
                f"--port {port}: {error.strerror or error}: expected a free port, or 0 for any"
            ) from None
        self.port = int(self._server.socket.getsockname()[1])
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    @property
    def address(self) -> str:
        """The address that a browser of this host opens."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def __enter__(self) -> LiveServer:
        self._thread.start()
        return self

    @property
    def looked_at(self) -> bool:
        """True while a page is open, or is being opened."""
        return bool(self._server.connections) or time.monotonic() < self._loading_s

    def __exit__(self, *_: object) -> None:
        """End once every page has got what there is."""
        limit_s = time.monotonic() + _LAST_S
        while not self._server.connections and self.looked_at:
            time.sleep(_SETTLE_S)  # no event says that a page has come, or has left
        self._ended.set()
        while self._server.connections and time.monotonic() < limit_s:
            time.sleep(_SETTLE_S)
        # It waits for every connection: one that does not let go keeps no flight from ending.
        ending = threading.Thread(target=self._server.shutdown, daemon=True)
        ending.start()
        ending.join(_LAST_S)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, or a refusal; None lets a socket open."""
        try:
            address = urlsplit(request.path)
            token = parse_qs(address.query).get("token", [""])[0].encode()
            host = request.headers.get("Host", "")
            origin = request.headers.get("Origin")
        except (ValueError, LookupError):  # no address, a token that is no text, two Host headers
            return connection.respond(400, "not understood\n")
        hosts = (f"{HOST}:{self.port}", f"localhost:{self.port}")
        # Another name that leads here belongs to a page of the internet.
        if host not in hosts or origin not in (None, *(f"http://{one}" for one in hosts)):
            return connection.respond(403, "expected the address that ptnsbc view printed\n")
        if not hmac.compare_digest(token, self.token.encode()):
            return connection.respond(403, "expected the token of the printed address\n")
        if address.path == "/socket" and "Upgrade" in request.headers:
            return None
        if address.path != "/":
            return connection.respond(404, "expected /\n")
        self._loading_s = time.monotonic() + _LOADING_S
        body = self._page().encode()
        about = {
            "Content-Length": str(len(body)),
            "Content-Security-Policy": _SECURITY.format(host=host),
        }
        return Response(200, "OK", Headers(_HEADERS | about), body)

    def _serve(self, connection: ServerConnection) -> None:
        if not self._pages.acquire(blocking=False):
            connection.close(1013, f"more than {_MOST_PAGES} pages")
            return
        self._loading_s = -math.inf
        try:
            news, last = None, False
            while True:
                if news is None:
                    number, version, text = self._feed.begin()
                    messages = [text]
                else:
                    number, messages = news
                for message in messages:
                    connection.send(message)
                self._take_orders(connection)
                if last:
                    break
                last = self._ended.is_set()  # before the last look: it misses nothing
                news = self._feed.after(number, version, _LOOK_S)
        except ConnectionClosed:
            pass
        finally:
            self._pages.release()

    def _take_orders(self, connection: ServerConnection) -> None:
        while True:
            try:
                data = connection.recv(timeout=0)
            except TimeoutError:
                return
            order = order_in(data, self.token)
            if order is None:
                connection.send(json.dumps({"kind": "said", "text": "the order is not understood"}))
            else:
                self.orders.put(order)


def order_in(data: str | bytes, token: str) -> str | None:
    """The order in a message of a page; None for any other, and for one without the token."""
    try:
        found: Any = json.loads(data)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict) or not isinstance(found.get("token"), str):
        return None
    known = found.get("order") in ORDERS
    shown = found["token"].encode(errors="replace")  # JSON may name half of a character
    permitted = hmac.compare_digest(shown, token.encode())
    return str(found["order"]) if known and permitted else None
