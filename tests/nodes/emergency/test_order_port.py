"""The socket for orders, with real sockets."""

import select

import pytest

from ptnsbc_nodes.emergency.order_port import OrderClient, OrderPort, socket_path
from ptnsbc_nodes.emergency.orders import Order, RuntimeFolderError

PATIENCE_S = 30.0


@pytest.fixture
def port(tmp_path):
    taken = []
    port = OrderPort(tmp_path, "bridge3", taken.append, lambda: b"state")
    port.taken = taken
    yield port
    port.close()


@pytest.fixture
def client(tmp_path):
    client = OrderClient(tmp_path)
    yield client
    client.close()


def answer(client):
    assert select.select([client], [], [], PATIENCE_S)[0]
    return client.answers()


def test_an_order_is_taken_and_answered(port, client):
    assert client.send("bridge3", Order("kill", pilots_too=True))
    assert answer(client) == [b"state"]
    assert port.taken == [Order("kill", pilots_too=True)]


def test_a_question_is_answered_and_orders_nothing(port, client):
    assert client.send("bridge3", Order())
    assert answer(client) == [b"state"]
    assert port.taken == []


def test_bytes_that_are_no_order_change_nothing(port, client, tmp_path):
    for data in (b"\xff\x00", b"kill everything", b"x" * 9000):
        client._socket.sendto(data, str(socket_path(tmp_path, "bridge3")))
    assert client.send("bridge3", Order("land"))
    assert answer(client) == [b"state"]
    assert port.taken == [Order("land")]
    assert port.broken == 3


def test_nobody_listens(client):
    assert not client.send("bridge9", Order("kill"))


def test_a_socket_of_a_killed_bridge_is_replaced(port, client, tmp_path):
    taken = []
    second = OrderPort(tmp_path, "bridge3", taken.append, lambda: b"second")
    port.close()  # the first one does not remove what is no longer its own
    assert client.send("bridge3", Order("kill"))
    assert answer(client) == [b"second"]
    assert taken == [Order("kill")]
    second.close()
    assert not socket_path(tmp_path, "bridge3").exists()


def test_no_place_for_a_socket(tmp_path):
    with pytest.raises(RuntimeFolderError, match="expected a place for a socket"):
        OrderPort(tmp_path / "missing", "bridge3", print, lambda: b"")
