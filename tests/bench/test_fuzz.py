"""The fuzzer: its corpus stays harmless, the same seed gives the same inputs, and what fails is kept and said."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from bench import fuzz
from bench.fuzz_inputs import Packets, Scenarios, Wire

NOWHERE = Path()
WIRE = Wire(NOWHERE)
PACKETS = Packets(NOWHERE)
SCENARIOS = Scenarios(NOWHERE)


@pytest.mark.slow
@pytest.mark.parametrize("kind", fuzz.KINDS)
def test_the_corpus_and_some_mutations_do_no_harm(kind: str, monkeypatch, tmp_path) -> None:
    """Without the limits of time and memory: other programs may have the machine."""
    monkeypatch.setattr(fuzz, "_too_much", lambda _cost: "")
    known = list((fuzz.CORPUS / kind).glob("*"))
    monkeypatch.setattr(fuzz, "kept", lambda kind, data: tmp_path / kind)
    result = fuzz.fuzzed(kind, len(known) + 20, seed=0)
    assert result.failures == []
    assert result.inputs == len(known) + 20


@given(st.binary(max_size=300))
def test_bytes_are_a_message_or_an_error_in_words(data: bytes) -> None:
    for head in (b"", b"\0\1\0\0", b"\0\0\0\0"):
        WIRE.run(head + data)


@given(st.binary(max_size=300))
def test_bytes_are_packets_or_dropped(data: bytes) -> None:
    PACKETS.run(data)


@pytest.mark.slow
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.integers() | st.text(), lambda part: (
    st.lists(part, max_size=4) | st.dictionaries(st.text(max_size=8), part, max_size=4)
)))  # fmt: skip
def test_a_tree_is_a_scenario_or_an_error_in_words(tree: object) -> None:
    text = yaml.safe_dump({"name": "x", "uavs": tree, "timing": tree})
    SCENARIOS.run(text.encode())


def test_the_same_seed_gives_the_same_inputs() -> None:
    first, again = ([WIRE.make(random.Random(f"3 {k}")) for k in range(20)] for _ in range(2))
    assert first == again


def test_what_fails_is_kept_and_said(monkeypatch, tmp_path, capsys) -> None:
    monkeypatch.setattr(fuzz, "CORPUS", tmp_path)

    def fails(self: Wire, data: bytes) -> None:
        if data not in self.sound:
            raise KeyError(len(data))

    monkeypatch.setattr(Wire, "run", fails)
    monkeypatch.setattr(fuzz.resource, "setrlimit", lambda *_: None)
    assert fuzz.main(["--wire", "2"]) == 1
    out, err = capsys.readouterr()
    assert out.startswith("wire: 2 inputs, 2 failures")
    assert "KeyError" in err
    assert {path.parent.name for path in tmp_path.rglob("*") if path.is_file()} == {"wire"}


def _commands_that_take(monkeypatch, seconds: list[float], references: list[float]) -> None:
    """Processes of these costs, one after the other: those of a command, and those of the reference."""
    of_command, of_reference = iter(seconds), iter(references)

    def process(call):
        costs = of_reference if call == fuzz._REFERENCE else of_command
        return fuzz.Cost(next(costs), 200.0), 0, ""

    monkeypatch.setattr(fuzz, "_process", process)


@pytest.mark.parametrize(
    ("seconds", "references", "wrong"),
    [
        ([1.9], [], ""),
        ([2.6, 2.5, 2.7, 2.6], [0.7, 0.7, 0.7], ""),  # a host that is slow for all processes
        ([2.6, 1.2, 2.9, 1.3], [0.35, 0.35, 0.35], ""),  # now and then
        ([2.6, 2.5, 2.7, 2.6], [0.35, 0.36, 0.34], "2.6 s"),  # a command that is slow
        ([9.0, 9.0, 9.0, 9.0], [0.7, 0.7, 0.7], "4.5 s"),
    ],
)
def test_a_command_over_the_limit_is_measured_beside_a_reference(
    monkeypatch, seconds, references, wrong
) -> None:
    _commands_that_take(monkeypatch, seconds, references)
    assert fuzz._command("check")[1] == wrong
