"""Links over real UDP sockets and a real pseudo-terminal: who gets through, and what is counted."""

import os
import pty
import random
import socket
import tracemalloc
import tty

import pytest

pytest.importorskip("pymavlink")

import mavlink_wires as wires
from mavlink_wires import Far, arrived, heartbeat, settled

from ptnsbc_io.mavlink import transport
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import BrokenFrame, Framer, MavlinkLink, Signer
from ptnsbc_io.mavlink.transport import ConnectError, connect

KEY, OTHER_KEY = bytes(range(32)), bytes(range(1, 33))
WANTED = frozenset({mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED})


@pytest.fixture
def make():
    """`make(key)`: a listening link, and a vehicle that speaks to it."""
    open_things = []

    def factory(key=None, far_key=None, sysid=1, compid=1):
        link = MavlinkLink(
            connect(f"udpin:127.0.0.1:{free_port()}"), 1, WANTED, key and Signer(key)
        )
        port = link._transport._port.getsockname()[1]
        far = Far(port, sysid, compid, far_key)
        open_things.extend((link, far))
        return link, far

    yield factory
    for thing in open_things:
        thing.close()


def free_port():
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def dropped(link):
    return {reason: count for reason, count in link.counts.items() if count}


def test_a_heartbeat_gets_through_and_is_answered(make):
    link, far = make()
    far.send(heartbeat(custom_mode=7))
    (message,) = arrived(link)
    assert (message.get_type(), message.custom_mode) == ("HEARTBEAT", 7)
    link.send(heartbeat(type=mavlink.MAV_TYPE_ONBOARD_CONTROLLER))
    answer = far.receive()
    assert (answer.get_srcSystem(), answer.get_srcComponent()) == (1, 191)
    assert answer.get_msgbuf()[0] == 0xFD
    assert dropped(link) == {}


def test_other_systems_and_components_are_dropped(make):
    link, far = make(sysid=2)
    far.send(heartbeat())
    assert settled(link) == []
    far.codec = wires.codec(1, 100)
    far.send(heartbeat())
    assert settled(link) == []
    assert dropped(link) == {"other_sysid": 1, "other_component": 1}
    assert link.peer is None  # nobody has a say before the vehicle itself has spoken


def test_unsigned_wrong_signed_and_replayed_packets_are_dropped(make):
    link, far = make(key=KEY, far_key=KEY)
    first = far.send(heartbeat(custom_mode=1))
    assert len(settled(link)) == 1
    stranger = Far(far.to[1], key=OTHER_KEY)
    stranger.send(heartbeat())
    plain = Far(far.to[1])
    plain.send(heartbeat())
    far.raw(first)
    assert settled(link) == []
    assert dropped(link) == {"wrong_signed": 1, "unsigned": 1, "replayed": 1}
    far.send(heartbeat(custom_mode=2))  # and the true one is still heard
    assert [m.custom_mode for m in settled(link)] == [2]
    assert link.peer[1] == far.port
    stranger.close()
    plain.close()


def test_a_forged_timestamp_does_not_lock_the_vehicle_out(make):
    link, far = make(key=KEY, far_key=KEY)
    far.send(heartbeat())
    assert len(settled(link)) == 1
    forged = bytearray(far.pack(heartbeat()))
    forged[-12:-6] = b"\xff" * 6  # from the end of time, signature wrong
    far.raw(bytes(forged))
    far.send(heartbeat())
    assert len(settled(link)) == 1
    assert dropped(link) == {"wrong_signed": 1}


def test_an_old_recording_is_not_the_start_of_a_stream(make):
    link, far = make(key=KEY, far_key=KEY)
    far.signer = Signer(KEY, timestamp=1000)
    far.signer.prepare = lambda codec: _arm_at(codec, KEY, 1000)
    far.send(heartbeat())
    assert settled(link) == []
    assert dropped(link) == {"replayed": 1}


def _arm_at(codec, key, stamp):
    codec.signing.secret_key, codec.signing.timestamp = key, stamp
    codec.signing.sign_outgoing = True


def test_a_signed_link_signs_and_an_unsigned_vehicle_learns_where_to_answer(make):
    link, far = make(key=KEY)
    far.send(heartbeat())
    assert settled(link) == []
    link.send(heartbeat())
    answer = far.receive()
    assert answer.get_msgbuf()[2] == 1
    checker = Signer(KEY)
    frame = next(Framer(stream=False).feed(bytes(answer.get_msgbuf())))
    assert checker.has_valid_signature(frame)


def test_our_own_timestamps_only_rise():
    codec, signer = wires.codec(), Signer(KEY)
    stamps = []
    for _ in range(50):
        signer.prepare(codec)
        data = heartbeat().pack(codec)
        stamps.append(int.from_bytes(data[-12:-6], "little"))
    assert sorted(set(stamps)) == stamps


def test_malformed_and_truncated_packets_are_counted(make):
    link, far = make()
    whole = far.pack(heartbeat())
    wrong = bytearray(whole)
    wrong[12] ^= 0xFF
    far.raw(bytes(wrong))
    far.raw(whole[:-5])
    far.raw(b"hello, vehicle")
    far.raw(bytes([0xFD]))
    assert settled(link) == []
    assert dropped(link) == {"malformed": 2, "truncated": 2}


def test_frames_after_noise_in_one_datagram(make):
    link, far = make()
    far.raw(
        b"\x00\x01noise" + far.pack(heartbeat(custom_mode=1)) + far.pack(heartbeat(custom_mode=2))
    )
    assert [m.custom_mode for m in settled(link)] == [1, 2]
    assert dropped(link) == {"malformed": 1}


def test_mavlink_1_is_understood_because_px4_begins_with_it(make):
    link, far = make()
    far.raw(heartbeat(custom_mode=3).pack(far.codec, force_mavlink1=True))
    assert [m.custom_mode for m in settled(link)] == [3]


def test_a_second_vehicle_with_the_same_id_is_noticed_and_not_believed(make):
    link, far = make()
    far.send(heartbeat(custom_mode=1))
    assert len(settled(link, now_s=10.0)) == 1
    twin = Far(far.to[1])
    twin.send(heartbeat(custom_mode=2))
    assert settled(link, now_s=10.5) == []
    assert link.duplicate_sysid_s == 10.5
    assert dropped(link) == {"other_address": 1}
    # a vehicle that went silent may come back from elsewhere: a rebooted radio, a new port
    twin.send(heartbeat(custom_mode=2))
    assert [m.custom_mode for m in settled(link, now_s=14.0)] == [2]
    twin.close()


def test_messages_nobody_wants_are_not_decoded(make):
    link, far = make()
    far.send(mavlink.MAVLink_system_time_message(1, 2))
    assert settled(link) == []
    assert link.received == 1
    assert dropped(link) == {}


def test_udpout_speaks_first(make):
    far = Far()
    link = MavlinkLink(connect(f"udpout:127.0.0.1:{far.port}"), 1, WANTED)
    link.send(heartbeat())
    assert far.receive() is not None
    far.send(heartbeat(custom_mode=4))
    assert [m.custom_mode for m in settled(link)] == [4]
    link.close()
    far.close()


def serve(port=0):
    server = socket.create_server(("127.0.0.1", port))
    server.settimeout(5.0)
    return server


def test_a_tcp_link_comes_back_with_its_server(monkeypatch):
    """A router that starts after the bridge, or again in flight."""
    monkeypatch.setattr(transport, "_AGAIN_S", 0.0)
    port, codec = free_port(), wires.codec()
    link = MavlinkLink(connect(f"tcp:127.0.0.1:{port}"), 1, WANTED)
    for mode in (3, 4):
        assert settled(link) == []
        assert not link.send(heartbeat())
        with serve(port) as server:
            assert not list(link.poll(0.0))  # it calls
            with server.accept()[0] as vehicle:
                stream = b"\xfd\x40" + heartbeat(custom_mode=mode).pack(codec)
                for at in range(0, len(stream), 7):
                    vehicle.sendall(stream[at : at + 7])
                vehicle.sendall(b"\x00" * 90)
                assert [m.custom_mode for m in arrived(link, 1)] == [mode]
                assert link.send(heartbeat(custom_mode=5))
                assert next(Framer(stream=True).feed(vehicle.recv(1000))).message_id == 0
        assert settled(link) == []  # it has ended
    link.close()


def test_a_serial_line_brings_frames_in_pieces():
    master, slave = pty.openpty()
    tty.setraw(slave)
    link = MavlinkLink(connect(f"serial:{os.ttyname(slave)}:57600"), 1, WANTED)
    codec = wires.codec()
    frames = [heartbeat(custom_mode=n).pack(codec) for n in range(3)]
    # noise that looks like the header of a long frame must not swallow what follows
    stream = b"\xfd\x40\x00" + frames[0] + b"\xff\xfd" + frames[1] + frames[2] + b"\x00" * 90
    for at in range(0, len(stream), 7):
        os.write(master, stream[at : at + 7])
    assert [m.custom_mode for m in arrived(link, 3)] == [0, 1, 2]
    link.send(heartbeat(custom_mode=5))
    data = os.read(master, 1000)
    assert next(Framer(stream=False).feed(data)).message_id == 0
    link.close()
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "udpin:",
        "udpin:14540",
        "tcp:5760",
        "tcp:nowhere.invalid:5760",
        "udpout:127.0.0.1:0",
        "udpin:127.0.0.1:x",
        "serial:",
        "serial:/dev/null:fast",
        "udpin:127.0.0.1:70000",
        "serial:/nowhere/at/all",
    ],
)
def test_what_cannot_be_opened_is_told_in_one_line(text):
    with pytest.raises(ConnectError, match="expected") as failed:
        connect(text)
    assert "\n" not in str(failed.value)


def test_a_port_in_use_is_named(make):
    _link, far = make()
    with pytest.raises(ConnectError, match="free port"):
        connect(f"udpin:127.0.0.1:{far.to[1]}")


class _Loop:
    """A transport that brings what it is given."""

    stream = False

    def __init__(self, packets):
        self.packets = packets

    def receive(self):
        from ptnsbc_io.mavlink.transport import Packet

        return Packet(self.packets.pop(), ("127.0.0.1", 1)) if self.packets else None


def mutated(rng, frames):
    data = bytearray(rng.choice(frames))
    for _ in range(rng.randint(1, 4)):
        data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data[: rng.randint(1, len(data))] if rng.random() < 0.3 else data)


@pytest.mark.parametrize("key", [None, KEY])
def test_fuzzed_packets_neither_pass_nor_crash_nor_pile_up(key):
    """30 000 here; test_doubt.py has those that pass."""
    rng = random.Random(1)
    signer, codec = Signer(KEY), wires.codec()
    frames = []
    for n in range(30):
        if key:
            signer.prepare(codec)
        frames.append(mavlink.MAVLink_local_position_ned_message(n, 1, 2, 3, 0, 0, 0).pack(codec))
        frames.append(heartbeat(custom_mode=n).pack(codec))
    transport = _Loop([])
    link = MavlinkLink(transport, 1, WANTED, Signer(key) if key else None)
    passed = 0
    sizes = []
    tracemalloc.start()
    for _ in range(15):
        for n in range(1000):
            data = mutated(rng, frames) if n % 2 else rng.randbytes(rng.randint(1, 120))
            transport.packets.append(data if data not in frames else b"\0")
        while transport.packets:
            passed += sum(1 for _ in link.poll(0.0))
        sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    # a 16 bit checksum lets one mutation in 65 536 through; a signature none
    assert passed <= (0 if key else 2)
    assert sum(link.counts.values()) >= 14_000
    assert sizes[-1] - sizes[4] < 50_000


def test_framer_keeps_nothing_of_a_datagram():
    framer = Framer(stream=False)
    whole = heartbeat().pack(wires.codec())
    assert list(framer.feed(whole[:10])) == [BrokenFrame(truncated=True)]
    assert next(framer.feed(whole)).data == whole


def test_a_vehicle_without_mavlink_is_not_reached_past_its_bridge():
    with pytest.raises(ConnectError, match=r"ros:uav1: .* is reached by its bridge alone"):
        connect("ros:uav1")
