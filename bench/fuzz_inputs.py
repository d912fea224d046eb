"""Inputs of `bench.fuzz`: bags, scenarios, files, messages and packets, how each is changed and what reads it."""

from __future__ import annotations

import json
import random
import re
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from itertools import islice
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from mcap.writer import CompressionType

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io import wire
from ptnsbc_io.bag import BagMessage, BagWriter, declare, read_bag
from ptnsbc_io.bag.reader import find_problems
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.mavlink.transport import Packet, Transport
from ptnsbc_io.wire import decode_diagnostics
from ptnsbc_sim.occupancy import map_text
from ptnsbc_sim.scenario import agent_config, load_scenario, scenario_from_text
from ptnsbc_sim.scenario.mission.trajectories import extremes
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_tools.check import check
from ptnsbc_tools.library.bags import repair
from ptnsbc_tools.reading.bag_reader import read_recording, read_status

ROOT = Path(__file__).resolve().parents[1]
_SAMPLE_NS = 60_000_000  # of the sample flight: six ticks of five UAVs
_CUT = 60  # at most so many bytes are moved, repeated or left out at once
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORDS = (
    b"0", b"-1", b"1e300", b"-1e300", b"1e-300", b"inf", b".nan", b".inf", b"null", b"[]", b"{}", b"true",
    b"18446744073709551616", b"9" * 5000, b"[[[[1]]]]", b'"\x1b[2J"', b"&a [*a]", b"!!python/object:os.system x",
    b"extends: /etc/passwd", b"name: x", b"1 furlong", "λ".encode(),
)  # fmt: skip
_INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFFFFFF, 0xFFFFFFFF, 2**63 - 1, 2**63, 2**64 - 1)


def mutated(data: bytes, chance: random.Random) -> bytes:
    """A few random changes to some bytes."""
    buffer = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 4, 16))):
        at = chance.randrange(len(buffer) + 1)
        length = chance.randrange(1, _CUT)
        match chance.randrange(7):
            case 0 if at < len(buffer):
                buffer[at] ^= 1 << chance.randrange(8)
            case 1:
                size = chance.choice((1, 2, 4, 8))
                number = chance.choice(_INTEGERS) % 2 ** (8 * size)
                buffer[at : at + size] = number.to_bytes(size, "little")
            case 2:
                del buffer[at : at + length]
            case 3:
                buffer[at:at] = buffer[at : at + length]
            case 4:
                other = chance.randrange(len(buffer) + 1)
                buffer[at : at + length] = buffer[other : other + length]
            case 5:
                buffer[at:at] = chance.choice((bytes(length), chance.randbytes(length)))
            case 6 if chance.random() < 0.3:
                del buffer[at:]
    return bytes(buffer)


def mutated_text(data: bytes, chance: random.Random) -> bytes:
    """A few changes to numbers, words and lines; now and then to bytes."""
    if chance.random() < 0.2:
        return mutated(data, chance)
    for _ in range(chance.choice((1, 1, 2, 4))):
        found = list(_NUMBER.finditer(data))
        lines = data.split(b"\n")
        at = chance.randrange(len(lines))
        match chance.randrange(5):
            case 0 | 1 if found:
                start, end = chance.choice(found).span()
                data = data[:start] + chance.choice(_WORDS) + data[end:]
            case 2:
                data = b"\n".join([*lines[:at], *lines[at + 1 :]])
            case 3:
                lines.insert(at, chance.choice((*lines, *_WORDS)))
                data = b"\n".join(lines)
            case 4:
                key, colon, _ = lines[at].partition(b":")
                lines[at] = key + colon + b" " + chance.choice(_WORDS)
                data = b"\n".join(lines)
    return data


class Bags:
    """Bags of some ticks of the sample flight, changed as files, or in the messages and the scenario in them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        sample = read_bag(ROOT / "bags" / "sample")
        self._scenario = sample.attachment("scenario.yaml")
        self._topics = [declare(one.name, one.type) for one in sample.topics.values()]
        self._messages = [one for one in sample.messages() if one.stamp_ns <= _SAMPLE_NS]
        self.sound = [self._written(self._messages, one) for one in CompressionType]

    def make(self, chance: random.Random) -> bytes:
        """A mutation."""
        if chance.random() < 0.5:
            return mutated(chance.choice(self.sound), chance)
        changed = [
            one._replace(data=mutated(one.data, chance)) if chance.random() < 0.05 else one
            for one in self._messages
        ]
        scenario = mutated_text(self._scenario, chance) if chance.random() < 0.3 else None
        return self._written(changed, CompressionType.NONE, scenario)

    def _written(
        self,
        messages: Sequence[BagMessage],
        compression: CompressionType,
        scenario: bytes | None = None,
    ) -> bytes:
        goal = self._folder / "made"
        attached = {"scenario.yaml": scenario or self._scenario}
        with BagWriter(
            goal, self._topics, attachments=attached, compression=compression, overwrite=True
        ) as writer:
            for one in messages:
                writer.write(one.topic, one.stamp_ns, one.data)
        return (goal / "made_0.mcap").read_bytes()

    def run(self, data: bytes) -> None:
        """Read, judge, check and repair."""
        path = self._folder / "bag.mcap"
        path.write_bytes(data)
        for salvage in (False, True):
            with suppress(PtnsbcError):
                bag = read_bag(path, salvage=salvage)
                for _ in bag.messages():
                    pass
                find_problems(bag)
        with suppress(PtnsbcError):
            verdict_on(read_recording(path)).as_json()
        with suppress(PtnsbcError):
            read_status(path)
        try:
            with suppress(PtnsbcError):
                repair(path, self._folder / "repaired")
        finally:
            shutil.rmtree(self._folder / "repaired", ignore_errors=True)


class Scenarios:
    """Shipped scenarios, changed as texts."""

    def __init__(self, _folder: Path) -> None:
        self.sound = [path.read_bytes() for path in sorted((ROOT / "scenarios").glob("*.yaml"))]

    def make(self, chance: random.Random) -> bytes:
        """A mutation."""
        return mutated_text(chance.choice(self.sound), chance)

    def run(self, data: bytes) -> None:
        """Load and check."""
        with suppress(PtnsbcError):
            scenario = scenario_from_text(data.decode(errors="replace"), folder=ROOT / "scenarios")
            check(scenario)
            for uav in scenario.uav_ids:
                agent_config(scenario, uav)


_PATH = "0,0,0,8,0\n1,1,0,8,0.1\n2,2,1,8,0.2\n"
_SETPOINTS = "0.5,0,0,8,0,0,0,0\n1.5,1,0,8,1,0,0,0.1\n3,2,1,8,0,0,0,0.2\n"
_STREAM = {
    "kind": "stream", "position_m": [0, 0, 8], "low_m": [-9, -9, 2], "high_m": [9, 9, 9],
    "speed_m_s": 2, "acceleration_m_s2": 2,
}  # fmt: skip
_POINTS = "0,0,8\n1,0,8\n1,2,9\n"
_POLYNOMIAL = ",".join(["2", *["0.5", "1", "-0.25", *"00000"] * 4])
_HOME = [47.4, 8.5, 488]
_ITEMS = [
    {"command": 16, "frame": 3, "params": [0, 0, 0, None, 47.4 + step, 8.5, 9]}
    for step in (0, 1e-4)
]
_PLAN = {"hoverSpeed": 5, "plannedHomePosition": _HOME, "items": _ITEMS}
_CURVES = [[0, [0, 0, 8], []], [2, [4, 0, 8], [[0, 2, 8], [4, 2, 8]]], [3, [5, 0, 8], []]]


class Files:
    """Paths, shapes and maps, in the forms that a scenario may name."""

    _keys: tuple[tuple[str, dict[str, object]], ...] = (
        ("leader.trajectory", {"kind": "file"}),
        ("leader.trajectory", {"kind": "file", "speed_m_s": 1}),
        ("leader.trajectory", {"kind": "file", "rate_hz": 5}),
        ("leader.trajectory", _STREAM),
        ("formation.shape", {"kind": "file"}),
    )

    def __init__(self, folder: Path) -> None:
        self._path = folder / "file"
        poses = "# timestamp tx ty tz qx qy qz qw\n7 0 0 8 0 0 0 1\n8 1 0 8 0 0 1 0\n"
        texts = (
            _PATH,
            _SETPOINTS,
            "t_ms;x;y;z\n0;0;0;8\n9000;1,5;0;8\n",
            _POINTS,
            poses,
            _POLYNOMIAL,
        )
        plan = json.dumps({"fileType": "Plan", "mission": _PLAN})
        self.sound = [text.encode() for text in (*texts, plan)] + [
            _archive({"swarm": {"drones": [{"settings": {"trajectory": {"points": _CURVES}}}]}}),
            _saved(lambda stream: np.save(stream, np.eye(3))),
            (ROOT / "scenarios" / "yard.pcd").read_bytes()[:2000],
            b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 3\nDATA binary_compressed\n"
            b"\0\0\0\0\x24\0\0\0\3\0\0\x80\x3f\xe0\x17\3",
            *_las(),
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
            b"property float z\nend_header\n1 2 3\n",
        ]

    def make(self, chance: random.Random) -> bytes:
        """A mutation."""
        data = chance.choice(self.sound)
        return mutated(data, chance) if b"\0" in data else mutated_text(data, chance)

    def run(self, data: bytes) -> None:
        """Read as each of them."""
        self._path.write_bytes(data)
        for key, block in self._keys:
            with suppress(PtnsbcError):
                given = {key: {**block, "file": str(self._path)}}
                extremes(load_scenario("paper_5_free", given).leader.trajectory, 60.0)
        by_laspy = (".las",) if b"LASF" in data[:9] else ()  # a process for each
        for suffix in (".pcd", ".ply", ".csv", ".npy", *by_laspy):
            with suppress(PtnsbcError):
                map_text(suffix, data, 1.0)


def _saved(write: Callable[[BytesIO], object]) -> bytes:
    stream = BytesIO()
    write(stream)
    return stream.getvalue()


def _las() -> list[bytes]:
    """Maps as LAS and LAZ, where the library that reads them is installed."""
    if find_spec("laspy") is None:
        return []
    cloud = import_module("laspy").create(point_format=0, file_version="1.2")
    cloud.x = cloud.y = cloud.z = np.array([1.0, 2.0, 9.0])
    return [_saved(partial(cloud.write, do_compress=packed)) for packed in (False, True)]


def _archive(show: object) -> bytes:
    def write(stream: BytesIO) -> None:
        with ZipFile(stream, "w", ZIP_DEFLATED) as folder:
            folder.writestr("show.json", json.dumps(show))

    return _saved(write)


class Wire:
    """Serialised messages of the sample flight, through every decoder."""

    _decoders: tuple[Callable[[bytes], object], ...] = (
        wire.decode_odometry, wire.decode_velocity, wire.decode_wrench, wire.decode_header,
        wire.decode_near, wire.decode_integers, wire.decode_floats, wire.peek_stamp, wire.peek_sequence_stamp,
        decode_diagnostics,
    )  # fmt: skip

    def __init__(self, _folder: Path) -> None:
        sample = read_bag(ROOT / "bags" / "sample").messages()
        self.sound = list({one.topic: one.data for one in islice(sample, 2000)}.values())

    def make(self, chance: random.Random) -> bytes:
        """A mutation."""
        return mutated(chance.choice(self.sound), chance)

    def run(self, data: bytes) -> None:
        """Decode as every kind of message."""
        for decode in self._decoders:
            with suppress(PtnsbcError):
                decode(data)


class _Wires(Transport):
    """A transport that delivers what it is given."""

    def __init__(self, data: bytes, stream: bool) -> None:
        self.stream = stream
        self._left = [Packet(data, ("127.0.0.1", 1))]

    def receive(self) -> Packet | None:
        return self._left.pop() if self._left else None

    def send(self, data: bytes, address: object) -> bool:
        return bool(data and address)


class Packets:
    """MAVLink packets of every kind that the dialect has."""

    _wanted = frozenset(mavlink.mavlink_map)

    def __init__(self, _folder: Path) -> None:
        self._kinds = sorted(mavlink.mavlink_map)
        self.sound = [b""]

    def make(self, chance: random.Random) -> bytes:
        """Packets with right checksums, half of them mutated."""
        packets = b"".join(self._packet(chance) for _ in range(chance.choice((1, 1, 3))))
        return mutated(packets, chance) if chance.random() < 0.5 else packets

    def _packet(self, chance: random.Random) -> bytes:
        """A packet with a right checksum and random content, cut or too long at times."""
        number = chance.choice(self._kinds)
        kind = mavlink.mavlink_map[number]
        size = kind.unpacker.size + chance.choice((0, 0, -1, 5))
        payload = chance.randbytes(min(255, max(0, size)))
        head = bytes((0xFD, len(payload), 0, 0, chance.randrange(256), 1, 1))
        head += number.to_bytes(3, "little")
        crc = mavlink.x25crc(head[1:] + payload + bytes([kind.crc_extra])).crc
        return head + payload + crc.to_bytes(2, "little")

    def run(self, data: bytes) -> None:
        """Through a link of datagrams, and through one of a serial line."""
        for stream in (False, True):
            link = MavlinkLink(_Wires(data, stream), 1, self._wanted)
            for message in link.poll(0.0):
                message.to_dict()


Fuzzer = Bags | Scenarios | Files | Wire | Packets
FUZZERS: dict[str, Callable[[Path], Fuzzer]] = {
    "bags": Bags,
    "scenarios": Scenarios,
    "files": Files,
    "wire": Wire,
    "mavlink": Packets,
}
