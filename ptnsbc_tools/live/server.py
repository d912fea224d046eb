"""The page and its socket, on one port of 127.0.0.1. Both want the token of the address that was printed."""

from __future__ import annotations

import hmac
import json
import queue
import secrets
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any
from urllib.parse import parse_qs, urlsplit

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools.live.feed import Feed

HOST = "127.0.0.1"
ORDERS = ("hold", "land", "stop")
"""The orders that a page may give; each is confirmed there."""
_MOST_PAGES = 16
_LARGEST_ORDER = 1024  # bytes
_LOOK_S = 0.2
_SECURITY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src ws://{host}"
)


class LiveServerError(PtnsbcError):
    """The page cannot be served."""


class LiveServer:
    """Serves one page and feeds it; use it as a context manager.

    Args:
        feed: what is shown.
        page: makes the HTML.
        port: 0 for a free one.
    """

    def __init__(self, feed: Feed, page: Callable[[], str], port: int = 0) -> None:
        self.orders: queue.SimpleQueue[str] = queue.SimpleQueue()
        """The orders of people at the pages, in their order."""
        self.token = secrets.token_urlsafe(18)
        self._feed, self._page = feed, page
        self._pages = threading.BoundedSemaphore(_MOST_PAGES)
        self._ended = threading.Event()
        try:
            self._server = serve(
                self._serve,
                HOST,
                port,
                process_request=self._answer,
                max_size=_LARGEST_ORDER,
                server_header=None,
            )
        except OSError as error:
            raise LiveServerError(
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

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._server.shutdown()
        self._thread.join()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page, or a refusal; None lets a socket open."""
        try:
            address = urlsplit(request.path)
            token = parse_qs(address.query).get("token", [""])[0]
            host = request.headers.get("Host", "")
            origin = request.headers.get("Origin")
        except ValueError:  # two Host headers, or no address
            return connection.respond(400, "not understood\n")
        hosts = (f"{HOST}:{self.port}", f"localhost:{self.port}")
        # Another name that leads here belongs to a page of the internet.
        if host not in hosts or origin not in (None, *(f"http://{one}" for one in hosts)):
            return connection.respond(403, "expected the address that ptnsbc view printed\n")
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return connection.respond(403, "expected the token of the printed address\n")
        if address.path == "/socket" and "Upgrade" in request.headers:
            return None
        if address.path != "/":
            return connection.respond(404, "expected /\n")
        return _page_response(self._page(), _SECURITY.format(host=host))

    def _serve(self, connection: ServerConnection) -> None:
        if not self._pages.acquire(blocking=False):
            connection.close(1013, f"more than {_MOST_PAGES} pages")
            return
        try:
            with suppress(ConnectionClosed):
                self._talk(connection)
        finally:
            self._pages.release()

    def _talk(self, connection: ServerConnection) -> None:
        number, version, text = self._feed.begin()
        connection.send(text)
        while not self._ended.is_set():
            self._take_orders(connection)
            news = self._feed.after(number, version, _LOOK_S)
            if news is None:
                number, version, text = self._feed.begin()
                connection.send(text)
                continue
            number, messages = news
            for message in messages:
                connection.send(message)

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
    permitted = hmac.compare_digest(found["token"].encode(), token.encode())
    return str(found["order"]) if known and permitted else None


def _page_response(text: str, security: str) -> Response:
    body = text.encode()
    headers = Headers(
        {
            "Content-Type": "text/html; charset=utf-8",
            "Content-Length": str(len(body)),
            "Content-Security-Policy": security,
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Connection": "close",
        }
    )
    return Response(200, "OK", headers, body)
