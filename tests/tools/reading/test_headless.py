"""Every bag we write, by readers that are not ours: the mcap library and rosbags."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import pytest

from ptnsbc_io.bag import BagWriter, declare, read_bag
from ptnsbc_io.bag.reader import find_problems
from ptnsbc_io.wire import decode_integers
from ptnsbc_nodes.uav.step_log import tick_note
from ptnsbc_tools.library.bags import repair

sys.path.insert(0, str(Path(__file__).parents[2]))
import doctor


def split(source: Path, path: Path) -> Path:
    bag = read_bag(source)
    infos = [declare(topic.name, topic.type) for topic in bag.topics.values()]
    attachments = {name: bag.attachment(name) for name in bag.attachments}
    with BagWriter(path, infos, attachments=attachments) as writer:
        split_ns = 0
        for message in bag.messages():
            if message.stamp_ns >= split_ns:
                writer.split()
                split_ns = message.stamp_ns + 400_000_000
            writer.write(*message)
    return path


def cut_and_repaired(source: Path, path: Path) -> Path:
    path.mkdir()
    content = next(source.glob("*.mcap")).read_bytes()
    (path / "x_0.mcap").write_bytes(content[: len(content) * 2 // 3])
    return repair(path).bag


@pytest.fixture(params=["headless", "realtime", "split", "repaired"])
def bag(request, tmp_path) -> Path:
    if request.param == "split":
        return split(request.getfixturevalue("headless"), tmp_path / "split")
    if request.param == "repaired":
        return cut_and_repaired(request.getfixturevalue("realtime"), tmp_path / "repaired")
    return request.getfixturevalue(request.param)


def test_it_is_sound(bag):
    examined: Counter[str] = Counter()
    for file in sorted(bag.glob("*.mcap")):
        examined += doctor.examine(file)
    counts = doctor.read_by_another(bag)
    ours = Counter({t.name: t.messages for t in read_bag(bag).topics.values() if t.messages})
    assert counts == examined == ours
    assert find_problems(read_bag(bag)) == []


def test_what_was_published_is_there(realtime, scenario):
    """Publishers count their steps: no number is missing, and each has its outputs."""
    bag = read_bag(realtime)
    for uav in scenario.uav_ids:
        rows = [decode_integers(m.data) for m in bag.messages([f"/uav{uav}/tick"])]
        numbers = [tick_note(row.label, row.values.tolist()).sequence for row in rows]
        begun = numbers.index(0, 1) if uav == 2 else 0  # it began anew
        assert numbers[begun:] == list(range(len(numbers) - begun))
        for name in ("formation_state", "leader_estimate", "setpoint/velocity", "setpoint/wrench"):
            assert bag.topics[f"/uav{uav}/{name}"].messages == len(numbers)
