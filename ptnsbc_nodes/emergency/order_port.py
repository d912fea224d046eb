"""The socket on which a bridge takes orders from processes of this host: no discovery, no middleware, no leader.

A datagram holds an order as text, or nothing for a question. Each is answered with the vehicle's record. The thread of
the port stores the order for the thread of the bridge, and works also while the executor of the node is busy.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from ptnsbc_nodes.emergency.orders import Order, RuntimeFolderError, parse_order

_LARGEST = 256  # [bytes]; no order is longer
_LOOK_S = 0.5


def socket_path(folder: Path, name: str) -> Path:
    """The socket of a bridge."""
    return folder / f"{name}.sock"


class OrderPort:
    """The bridge's end: a thread that takes orders and answers each."""

    def __init__(
        self, folder: Path, name: str, take: Callable[[Order], None], state: Callable[[], bytes]
    ) -> None:
        """Open the socket.

        Args:
            folder: the runtime folder of the domain.
            name: of the bridge.
            take: stores an order; called in the thread of the port.
            state: the answer, a record as bytes.

        Raises:
            RuntimeFolderError: the socket cannot be opened.
        """
        self._path = socket_path(folder, name)
        self._take, self._state = take, state
        self._open = True
        self.broken = 0
        """Datagrams that were no order."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._path.unlink(missing_ok=True)  # of a bridge of this name that was killed
            self._socket.bind(str(self._path))
        except OSError as error:
            self._socket.close()
            raise RuntimeFolderError(
                f"{self._path}: {error.strerror or error}: expected a place for a socket; set XDG_RUNTIME_DIR"
            ) from None
        self._socket.settimeout(_LOOK_S)
        self._inode = os.stat(self._path).st_ino
        self._thread = threading.Thread(target=self._serve, name=f"{name} orders", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the socket, and remove it unless a bridge of the same name has replaced it."""
        self._open = False
        self._thread.join(timeout=2 * _LOOK_S)
        self._socket.close()
        with suppress(OSError):
            if os.stat(self._path).st_ino == self._inode:
                self._path.unlink()

    def _serve(self) -> None:
        while self._open:
            try:
                data, sender = self._socket.recvfrom(_LARGEST)
            except TimeoutError:
                continue
            except OSError:
                return
            order = parse_order(data.decode(errors="replace")) if data.strip() else None
            if order is not None:
                self._take(order)
            elif data.strip():
                self.broken += 1
                continue
            if sender:
                with suppress(OSError):  # who asked may be gone
                    self._socket.sendto(self._state(), socket.MSG_DONTWAIT, sender)


class OrderClient:
    """The operator's end: sends to many bridges and takes their answers, without waiting."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind("")  # Linux gives it an abstract name

    def fileno(self) -> int:
        """For select()."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def send(self, name: str, order: Order) -> bool:
        """Send an order, or a question when it is empty; False when no bridge listens or its queue is full."""
        try:
            self._socket.sendto(order.text.encode() or b"\n", str(socket_path(self._folder, name)))
        except OSError:
            return False
        return True

    def answers(self) -> list[bytes]:
        """The orders that have arrived."""
        found = []
        with suppress(OSError):
            while True:
                found.append(self._socket.recv(1 << 16))
        return found
