"""The fleet's seal: what it lets through, and what it does not."""

import os
import stat

import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import decode_leg
from ptnsbc_nodes.comm.seal import (
    KEY_FILE,
    SEAL_BYTES,
    Seal,
    SealError,
    key_file,
    new_key,
    operators_seal,
    required_seal,
)

KEY = bytes(range(32))
LEG = wire.HeaderTemplate("landing").encode(7)  # 28 bytes: no zeros are added


class Clock:
    def __init__(self):
        self.now_ns = 10**18

    def __call__(self):
        return self.now_ns


@pytest.fixture
def clock():
    return Clock()


def test_what_is_closed_opens_and_is_the_same(clock):
    seal = Seal(KEY, now_ns=clock)
    for topic in (topics.odom(1), topics.EPOCH, topics.LOST):
        for more in range(4):
            sealed = seal.closer(topic)(LEG + bytes(more))
            assert len(sealed) % 4 == 0  # DDS fills up a message between processes
            assert len(LEG) + more + SEAL_BYTES <= len(sealed) < len(LEG) + more + SEAL_BYTES + 4
            assert seal.opener(topic)(sealed).rstrip(b"\0") == LEG.rstrip(b"\0")


def test_a_reader_without_the_key_reads_the_message_all_the_same(clock):
    leg = wire.HeaderTemplate("land").encode(7)
    assert decode_leg(Seal(KEY, now_ns=clock).closer(topics.EPOCH)(leg)) == (7, "land")


def test_no_byte_may_be_changed_added_or_cut(clock):
    seal = Seal(KEY, now_ns=clock)
    sealed, opener = seal.closer(topics.EPOCH)(LEG), seal.opener(topics.EPOCH)
    for at in range(len(sealed)):
        broken = bytearray(sealed)
        broken[at] ^= 1
        for forged in (bytes(broken), sealed[:at], sealed + b"\0"):
            with pytest.raises(SealError, match="not sealed with the key"):
                opener(forged)


def test_another_key_or_topic_does_not_open_it(clock):
    sealed = Seal(KEY, now_ns=clock).closer(topics.odom(1))(LEG)
    for seal, topic in ((Seal(bytes(32), now_ns=clock), 1), (Seal(KEY, now_ns=clock), 2)):
        with pytest.raises(SealError):
            seal.opener(topics.odom(topic))(sealed)


@pytest.mark.parametrize(("later_s", "opens"), [(9.9, True), (10.1, False), (-10.1, False)])
def test_a_message_is_not_sent_again_later(clock, later_s, opens):
    seal = Seal(KEY, now_ns=clock)
    sealed = seal.closer(topics.EMERGENCY)(LEG)
    clock.now_ns += round(later_s * 1e9)
    if opens:
        assert seal.opener(topics.EMERGENCY)(sealed) == LEG
    else:
        with pytest.raises(SealError, match="expected 10 s at most"):
            seal.opener(topics.EMERGENCY)(sealed)


def test_who_joins_late_reads_latched_messages_of_this_hour(clock):
    seal = Seal(KEY, now_ns=clock)
    sealed = seal.closer(topics.EPOCH)(LEG)
    clock.now_ns += 3599 * 10**9
    assert seal.opener(topics.EPOCH)(sealed) == LEG
    clock.now_ns += 2 * 10**9
    with pytest.raises(SealError):
        seal.opener(topics.EPOCH)(sealed)


def test_a_leg_is_taken_once_and_not_after_a_newer_one(clock):
    """A leg that was sent again four times was four times in the bag."""
    seal = Seal(KEY, now_ns=clock)
    close, opener = seal.closer(topics.EPOCH), seal.opener(topics.EPOCH, lockstep=True)
    first = close(LEG)
    clock.now_ns += 10**9
    second = close(LEG)
    opener(second)
    for again in (first, second):
        with pytest.raises(SealError, match="not newer than the one before"):
            opener(again)


def test_in_lockstep_a_state_may_wait(clock):
    seal = Seal(KEY, now_ns=clock)
    sealed = seal.closer(topics.odom(1))(LEG)
    clock.now_ns += 3600 * 10**9
    assert seal.opener(topics.odom(1), lockstep=True)(sealed) == LEG


def test_an_operators_program_takes_both(clock):
    seal = Seal(KEY, required=False, now_ns=clock)
    opener = seal.opener(topics.DIAGNOSTICS)
    assert opener(LEG) == LEG
    assert opener(seal.closer(topics.DIAGNOSTICS)(LEG)) == LEG


def test_a_new_key_is_for_its_owner_and_is_never_overwritten(tmp_path, monkeypatch):
    path = tmp_path / "settings" / "fleet.key"
    monkeypatch.setenv(KEY_FILE, str(path))
    assert key_file() == path
    assert operators_seal() is None
    with pytest.raises(SealError, match="expected the key of the fleet: ptnsbc network key"):
        required_seal()
    new_key(path)
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
    sealed = required_seal().closer(topics.EPOCH)(LEG)
    assert required_seal().opener(topics.EPOCH)(sealed) == LEG
    with pytest.raises(SealError, match="a key is never overwritten"):
        new_key(path)
    path.chmod(0o644)
    with pytest.raises(PtnsbcError, match="chmod 600"):
        required_seal()
