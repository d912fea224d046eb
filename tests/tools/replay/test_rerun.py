"""A re-run finds everything equal, or says what is not: where, from when, and by how much."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

import pytest

from ptnsbc_io.bag import BagError, BagMessage, declare, read_bag
from ptnsbc_io.bag.reader import find_problems
from ptnsbc_io.wire import HeaderTemplate, decode_integers, peek_stamp
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import Decision, encode_slots
from ptnsbc_nodes.uav.step_log import tick_note
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.reading.bag_reader import read_recording
from ptnsbc_tools.replay.rerun import ReplayState, rerun

PERIOD_NS = 10_000_000
NUMBERS_AT = 80  # in every message of ours with a header: behind the frames, before the end


@pytest.fixture
def again(scenario):
    return lambda path: rerun(read_bag(path), scenario)


def flip(topic: str, stamp_ns: int, at: int = NUMBERS_AT):
    """Flip one bit of the message on `topic` with this stamp."""

    def change(message: BagMessage) -> Iterable[BagMessage]:
        data = bytearray(message.data)
        if message.topic == topic and peek_stamp(message.data) == stamp_ns:
            data[at] ^= 1
        yield message._replace(data=bytes(data))

    return change


def drop(*wanted: tuple[str, int]):
    """Leave out the messages of these topics and stamps."""

    def change(message: BagMessage) -> Iterable[BagMessage]:
        if (
            message.topic.endswith(("/tick", "/snapshot"))
            or (message.topic, peek_stamp(message.data)) not in wanted
        ):
            yield message

    return change


def notes(path: Path, uav: int) -> list:
    rows = (decode_integers(m.data) for m in read_bag(path).messages([f"/uav{uav}/tick"]))
    return [tick_note(row.label, row.values.tolist()) for row in rows]


@pytest.mark.parametrize("kind", ["headless", "realtime"])
def test_equal(again, request, scenario, kind):
    done = again(request.getfixturevalue(kind))
    assert (done.verdict, done.realtime) == ("equal", kind == "realtime")
    for account in done.accounts.values():
        assert account.steps >= scenario.timing.ticks
        assert account.compared > 4 * account.steps, "and counters or snapshots"
        assert (account.silent, account.unrecorded, account.gaps) == (0, 0, [])


def test_equal_where_links_lose_and_positions_are_noisy(tmp_path):
    """What is lost follows from seed, edge and tick; odometry is recorded as the UAV saw it."""
    from ptnsbc_sim.swarm import fly
    from ptnsbc_tools.reading.headless import write_flight

    changes = {"timing.duration_s": 1.0, "communication.loss": 0.3, "communication.delay_s": 0.06}
    flown = load_scenario("experiment_4", changes)
    assert flown.imperfect
    done = rerun(read_bag(write_flight(fly(flown), tmp_path / "lossy")), flown)
    assert done.verdict == "equal", done.first
    assert all(account.steps == flown.timing.ticks for account in done.accounts.values())
    for another in ({"seed": 12345}, {"communication.delay_s": 0.07}):
        other = load_scenario("experiment_4", changes | another)
        assert rerun(read_bag(tmp_path / "lossy"), other).verdict == "different"


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """A flight whose UAVs take slots of others, and its bag."""
    from ptnsbc_sim.swarm import fly
    from ptnsbc_tools.reading.headless import write_flight

    base = load_scenario("paper_5")
    places = [base.uav(uav).position.tolist() for uav in (4, 1, 5, 2, 3)]
    starts = [{"id": row + 1, "position_m": place} for row, place in enumerate(places)]
    changes = {"timing.duration_s": 1.0, "formation.assignment": "optimal", "uavs": starts}
    flight = fly(load_scenario("paper_5", changes))
    assert flight.slots == {1: 4, 2: 1, 3: 5, 4: 2, 5: 3}
    return flight.scenario, write_flight(flight, tmp_path_factory.mktemp("slots") / "flight")


def test_equal_where_uavs_take_the_slots_of_others(taken):
    scenario, path = taken
    done = rerun(read_bag(path), scenario, jobs=2)
    assert done.verdict == "equal", done.first
    assert all(account.steps == scenario.timing.ticks for account in done.accounts.values())


def test_another_decision_gives_another_flight(taken, rewritten):
    scenario, path = taken
    other = encode_slots(Decision(0, {uav: uav for uav in scenario.uav_ids}))
    slots = "/formation/slots"
    changed = rewritten(path, lambda m: [m._replace(data=other) if m.topic == slots else m])
    assert rerun(read_bag(changed), scenario).verdict == "different"


@pytest.mark.parametrize("data", [None, b"", encode_slots(Decision(0, {1: 1, 2: 2}))])
def test_without_a_decision_nothing_can_be_made_again(taken, rewritten, data):
    scenario, path = taken
    slots = "/formation/slots"

    def change(message):
        if message.topic != slots:
            return [message]
        return [] if data is None else [message._replace(data=data)]

    done = rerun(read_bag(rewritten(path, change)), scenario)
    assert done.verdict == "void"
    (gap,) = done.accounts[3].gaps
    assert gap.reason == "/formation/slots stamped 0 is not recorded"


def test_damaged_statuses_are_left_out_and_named(scenario, headless, rewritten):
    """One of them on a topic that everybody may publish on made a bag that no command would read."""
    count = 0

    def change(message):
        nonlocal count
        count += message.topic == "/diagnostics"
        broken = message._replace(data=message.data[:-5])
        return [broken, message] if message.topic == "/diagnostics" and count < 3 else [message]

    path = rewritten(headless, change)
    assert rerun(read_bag(path), scenario).verdict == rerun(read_bag(headless), scenario).verdict
    whole, damaged = read_recording(headless), read_recording(path)
    assert damaged.left_out == ("2 damaged on /diagnostics, left out",)
    assert find_problems(read_bag(path)) == [f"{path.name}_0.mcap: 2 damaged on /diagnostics"]
    assert {uav: track.size for uav, track in damaged.counters.items()} == {
        uav: track.size for uav, track in whole.counters.items()
    }


def test_a_topic_that_nobody_knows_is_passed_over(scenario, headless, rewritten):
    """Bags of earlier versions may hold orders that no fleet takes."""
    fault = HeaderTemplate('{"kind": "loss", "uav": 2, "share": 0.5}').encode(0)

    def change(message):
        also = message.topic == "/formation/epoch"
        return [message, *[message._replace(topic="/formation/fault", data=fault)] * also]

    path = rewritten(headless, change, declare("/formation/fault", "std_msgs/msg/Header"))
    assert read_bag(path).topics["/formation/fault"].messages == 1
    assert rerun(read_bag(path), scenario).verdict == rerun(read_bag(headless), scenario).verdict
    assert read_recording(path).left_out == ()


@pytest.mark.parametrize("kind", ["headless", "realtime"])
def test_shared_out_among_processes(scenario, request, rewritten, kind):
    path = request.getfixturevalue(kind)
    alone, shared = (rerun(read_bag(path), scenario, jobs=jobs) for jobs in (1, 3))
    assert shared == alone
    lost = rewritten(path, lambda m: [] if m.topic == "/uav2/odom" else [m])
    void, again = (rerun(read_bag(lost), scenario, jobs=jobs) for jobs in (1, 9))
    assert void == again
    assert void.verdict == "void"
    broken = rewritten(path, lambda m: [m._replace(data=b"")] if m.topic == "/uav2/odom" else [m])
    with pytest.raises(BagError, match="a message on /uav2/odom"):
        rerun(read_bag(broken), scenario, jobs=2)


@pytest.mark.parametrize("uav", [1, 3, 5])
@pytest.mark.parametrize("tick", [0, 70])
def test_one_bit_of_an_input(again, headless, rewritten, uav, tick):
    stamp = tick * PERIOD_NS
    done = again(rewritten(headless, flip(f"/uav{uav}/odom", stamp)))
    assert done.verdict == "different"
    first = done.first
    assert (first.uav, first.tick, first.stamp_ns) == (uav, tick, stamp)
    assert first.field.startswith("formation_state pose.")
    assert 0 < abs(first.difference) < 1e-6
    assert {u for u, a in done.accounts.items() if a.difference} == {uav}


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("leader_estimate", "leader_estimate pose."),
        ("setpoint/velocity", "setpoint/velocity twist."),
        ("setpoint/wrench", "setpoint/wrench wrench."),
    ],
)
def test_one_bit_of_an_output(again, headless, rewritten, name, field):
    done = again(rewritten(headless, flip(f"/uav4/{name}", 900_000_000, at=64)))
    assert (done.first.uav, done.first.tick) == (4, 90)
    assert done.first.field.startswith(field)


def test_an_input_that_cannot_be_read(again, headless, rewritten):
    def change(message):
        cut = message.topic == "/uav2/odom" and message.stamp_ns == 3 * PERIOD_NS
        yield message._replace(data=message.data[:300]) if cut else message

    done = again(rewritten(headless, change))
    assert (done.first.uav, done.first.tick, done.first.field) == (2, 3, "an input")


def test_a_counter_that_was_told_otherwise(again, headless, rewritten):
    def change(message):
        data = message.data
        if b"uav2: planner" in data and message.stamp_ns == 10**9:
            told = re.compile(rb"(avoidance_active_s\0.{0,8}?)\d\.\d{3}\0", re.DOTALL)
            data, changed = told.subn(rb"\g<1>9.000\0", data, count=1)
            assert changed
        yield message._replace(data=data)

    done = again(rewritten(headless, change))
    assert (done.first.uav, done.first.tick) == (2, 100)
    assert done.first.field == "diagnostics avoidance_active_s"
    assert done.first.recorded == "9.000"
    assert -9.0 <= done.first.difference < -8.0  # in the first second it avoided at times


def test_lockstep_lost_messages(again, headless, rewritten):
    """What a neighbour needed voids the neighbour; what nobody needed is an output less."""
    stamp = 50 * PERIOD_NS
    lost = drop(("/uav2/leader_estimate", stamp), ("/uav5/setpoint/velocity", stamp))
    done = again(rewritten(headless, lost))
    assert done.verdict == "void"
    assert done.first is None
    voided = {uav for uav, account in done.accounts.items() if account.gaps}
    assert voided == {3}
    (gap,) = done.accounts[3].gaps
    assert gap.first_s == pytest.approx(0.51)
    assert gap.steps == 150 - 51
    assert gap.reason == f"/uav2/leader_estimate stamped {stamp} is not recorded"
    assert [done.accounts[uav].unrecorded for uav in (1, 2, 5)] == [0, 1, 1]


def test_a_process_that_ended_is_no_hole(again, headless, rewritten):
    def change(message):
        ended = message.stamp_ns >= 10**9 and message.topic.startswith("/uav5/")
        if not ended or message.topic in ("/uav5/odom", "/uav5/near"):
            yield message

    done = again(rewritten(headless, change))
    # UAV 4 heard it until then, and flew on with what it had: here it did not, so it differs.
    assert done.accounts[5].silent == 50
    assert done.accounts[5].gaps == []
    assert [done.accounts[uav].difference for uav in (1, 2, 3)] == [None] * 3


def test_realtime_lost_input_is_void_until_the_next_snapshot(again, realtime, rewritten):
    flown = notes(realtime, 3)
    chosen = next(n for n in flown if n.sequence > 60)
    used = chosen.used["own"].stamp_ns
    done = again(rewritten(realtime, drop(("/uav3/odom", used))))
    assert (done.verdict, done.first) == ("void", None)
    account = done.accounts[3]
    (gap,) = account.gaps
    assert gap.reason == f"/uav3/odom stamped {used} was used and is not recorded"
    first = next(n.sequence for n in flown if n.used["own"].stamp_ns == used)
    assert gap.steps == 100 - first + 1, "the snapshot after step 100 helps from step 101 on"
    assert account.steps == len(flown) - gap.steps
    assert all(not one.gaps for uav, one in done.accounts.items() if uav != 3)


def test_realtime_one_bit_of_an_input(again, realtime, rewritten):
    """The checksum tells even what the laws do not notice."""
    flown = notes(realtime, 5)
    used = flown[90].used["near"].stamp_ns
    tick = next(n.sequence for n in flown if n.used["near"].stamp_ns == used)
    done = again(rewritten(realtime, flip("/uav5/near", used, at=-20)))
    assert (done.first.uav, done.first.tick) == (5, tick)
    assert done.first.field == f"/uav5/near, an input stamped {used}"


def test_realtime_one_of_two_with_the_same_stamp_is_lost(again, realtime, rewritten):
    """A UAV that ticked twice on one odometry: what is left is no difference of those who used the other."""
    stamps = [note.used["own"].stamp_ns for note in notes(realtime, 2)]
    twice = {stamp for stamp in stamps if stamps.count(stamp) > 1}
    assert twice
    kept: dict[int, bytes] = {}
    lost = []

    def change(message):
        if message.topic == "/uav2/leader_estimate" and peek_stamp(message.data) in twice:
            first = kept.setdefault(peek_stamp(message.data), message.data)
            if first is not message.data:
                lost.append(message.data != first)
                return
        yield message

    done = again(rewritten(realtime, change))
    assert (done.verdict, done.first) == ("void", None)
    assert done.accounts[2].unrecorded == sum(lost) > 0
    assert {uav for uav, account in done.accounts.items() if account.gaps} <= {1, 3}


def test_realtime_recorded_from_the_middle(again, realtime, rewritten):
    flown = notes(realtime, 1)
    start_ns = flown[70].moment.now_ns - 2 * PERIOD_NS
    done = again(rewritten(realtime, lambda m: [m] if m.stamp_ns >= start_ns else []))
    account = done.accounts[1]
    assert (done.verdict, done.first) == ("void", None)
    assert account.gaps[0].reason == "the recording begins after the first step"
    assert account.steps == len(flown) - 101


def test_realtime_lost_note(again, realtime, rewritten):
    count = 0

    def change(message):
        nonlocal count
        count += message.topic == "/uav4/tick"
        if message.topic != "/uav4/tick" or count != 120:
            yield message

    done = again(rewritten(realtime, change))
    (gap,) = done.accounts[4].gaps
    assert gap.reason == "notes on /uav4/tick are not recorded"
    assert gap.steps == 150 - 119 + 1
    assert done.first is None


def test_real_time_without_notes_is_refused(again, realtime, rewritten):
    silent = rewritten(realtime, lambda m: [] if m.topic.endswith("/tick") else [m])
    with pytest.raises(BagError, match=r"expected lock-step, or /uav\d/tick of real time"):
        again(silent)


def run(*words: object) -> tuple[int, str, str]:
    command = [sys.executable, "-m", "ptnsbc_tools.cli", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.slow
def test_command(headless, rewritten):
    code, out, err = run("bag", "replay", headless, "--rerun", "--json")
    assert code == 0, err
    told = json.loads(out)
    assert told["verdict"] == "equal"
    assert told["first_difference"] is None
    assert [one["uav"] for one in told["uavs"]] == [1, 2, 3, 4, 5]
    code, out, err = run("bag", "replay", rewritten(headless, flip("/uav2/odom", 0)), "--rerun")
    assert code == 1, err
    assert "different: tick 0 (t = 0.000 s), uav2, formation_state" in out
    code, out, err = run("bag", "replay", headless / "none", "--rerun")
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.skipif(find_spec("rclpy") is None, reason="needs rclpy")
def test_a_fleet_in_real_time(tmp_path):
    """Processes by the wall clock; whatever the machine does to their timing, it is noted.

    The namespace is in the frames of the messages, and so in the bytes that a re-run compares.
    """
    words = ("fleet", "paper_5", "--real-time", "--duration", "2", "--processes", "2")
    _, _, err = run(*words, "--bag", tmp_path / "bag", "--namespace", "blue", "--json")
    code, out, err = run("bag", "replay", tmp_path / "bag", "--rerun", "--json")
    told = json.loads(out)
    assert told["mode"] == "real time"
    assert told["first_difference"] is None
    assert all(one["steps"] > 50 for one in told["uavs"]), err
    assert code == (told["verdict"] != "equal")
    # A machine under load may lose messages; then it is void and says of what.
    lost = any(one["gaps"] or one["unrecorded"] for one in told["uavs"])
    assert told["verdict"] == ("void" if lost else "equal")


def test_counters_of_steps_that_are_not_made_do_not_pile_up():
    pytest.importorskip("rclpy")
    from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics

    state = ReplayState(load_scenario("paper_5"), [1])
    kept = state.uavs[1].recorded_counters
    for tick in range(0, 5000, 20):
        data = diagnostics(tick, "uav1: planner", DiagnosticLevel.OK, "", {"ticks": str(tick)})
        state.put(BagMessage(topics.DIAGNOSTICS.name, tick, bytes(data)))
        assert tick in kept  # the newest is there for its step
    assert len(kept) < 100
