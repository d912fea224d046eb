"""Logs of stand-ins fetched over real UDP; their time is handed in, so nobody waits for it."""

import socket
from itertools import chain, count, repeat
from types import SimpleNamespace

import pytest

from ptnsbc_autopilot.flight_logs import log_bytes
from ptnsbc_autopilot.launch import Fleet, Network, Options, stations
from ptnsbc_io.mavlink import log_download
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.mavlink.log_download import WANTED, LogDownload
from ptnsbc_io.mavlink.transport import Transport, connect

STEP_S = 0.004
KINDS = ("px4", "arducopter")


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        return made.getsockname()[1]


class Lossy(Transport):
    """A way on which every so manieth packet of either side gets lost."""

    def __init__(self, way, each):
        self._way, self._each, self._sent, self._came = way, each, count(), count()

    def fileno(self):
        return self._way.fileno()

    def receive(self):
        packet = self._way.receive()
        lost = packet is not None and next(self._came) % self._each == 0
        return self.receive() if lost else packet

    def send(self, data, address):
        return next(self._sent) % self._each == 0 or self._way.send(data, address)

    def close(self):
        self._way.close()


class Flown:
    """A stand-in that has flown, and the download of its log."""

    def __init__(self, kind, path, flights=2, patience_s=20.0, lost=10**9):
        port = free_port()
        network = Network(connect=f"udpin:127.0.0.1:{port}", gcs=None)
        options = Options(kind=kind, fleet=Fleet(count=1), network=network, boot_time=0.0)
        (self.station,) = stations(options, 0.0, lambda _line: None)
        self.t, self.vehicle = 0.0, self.station.vehicle
        self.vehicle.flown = flights
        for end in self.station.sockets:
            end.open()
        link = MavlinkLink(Lossy(connect(f"udpout:127.0.0.1:{port}"), lost), 1, WANTED)
        self.download = LogDownload(link, 1, path, patience_s)

    def run(self, over=lambda: False):
        while not (self.download.over or over()):
            self.download.step()
            self.t += STEP_S
            self.station.exchange(self.t)
        return self.download.problem

    def close(self):
        self.download.close()
        for end in self.station.sockets:
            end.socket.close()


@pytest.fixture
def flown(tmp_path, monkeypatch):
    made = []
    clock = SimpleNamespace(monotonic=lambda: made[-1].t if made else 0.0)
    monkeypatch.setattr(log_download, "time", clock)

    def make(kind="px4", **options):
        made.append(Flown(kind, tmp_path / "uav1.log", **options))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("window", [10 * 90, 512 * 90])
def test_the_newest_log_comes_whole_though_every_fifth_packet_is_lost(
    flown, monkeypatch, tmp_path, kind, window
):
    monkeypatch.setattr(log_download, "_WINDOW", window)
    one = flown(kind, lost=5)
    assert one.run() == ""
    assert (tmp_path / "uav1.log").read_bytes() == log_bytes(1, 2)
    assert one.download.done == one.download.size == len(log_bytes(1, 2))
    assert [path.name for path in tmp_path.iterdir()] == ["uav1.log"]


def test_a_log_that_ends_before_its_listed_size_is_taken_to_its_end(flown, monkeypatch, tmp_path):
    whole = log_bytes(1, 1)
    cut = whole[:700]
    told = chain([whole], repeat(cut))
    monkeypatch.setattr("ptnsbc_autopilot.flight_logs.log_bytes", lambda *_: next(told))
    assert flown(flights=1).run() == ""
    assert (tmp_path / "uav1.log").read_bytes() == cut


@pytest.mark.parametrize("kind", KINDS)
def test_an_armed_vehicle_is_refused(flown, tmp_path, kind):
    one = flown(kind)
    one.vehicle.arm(0.0)
    assert "armed: expected a vehicle on the ground" in one.run()
    assert not list(tmp_path.iterdir())


def test_arming_ends_the_download_and_leaves_no_half_file(flown, monkeypatch, tmp_path):
    monkeypatch.setattr(log_download, "_WINDOW", 10 * 90)
    one = flown()
    one.run(lambda: one.download.done)
    assert list(tmp_path.iterdir())  # beside its name
    one.vehicle.arm(one.t)
    assert "armed" in one.run()
    assert not list(tmp_path.iterdir())


def test_an_interrupted_download_leaves_no_half_file(flown, tmp_path):
    one = flown()
    one.run(lambda: one.download.done)
    one.download.close()
    assert not list(tmp_path.iterdir())


def test_a_vehicle_without_a_log(flown, tmp_path):
    assert "no log" in flown(flights=0).run()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("kind", "silence", "words"),
    [
        ("px4", "mute", "no sign of life for 2 s: expected a vehicle that is switched on"),
        ("stm32", "", "no list of logs for 2 s"),
    ],
)
def test_an_autopilot_that_does_not_answer_is_given_up(flown, kind, silence, words):
    one = flown(kind, patience_s=2.0)
    one.vehicle.faults.mute = bool(silence)
    assert words in one.run()
