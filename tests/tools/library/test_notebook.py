"""How results look in a notebook: the tables of the command line as HTML."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import pytest

from ptnsbc_sim.verdict import Recording
from ptnsbc_tools.library import notebook
from ptnsbc_tools.library.flight import Flight
from ptnsbc_tools.library.flying import check, load

Fly = Callable[..., Recording]


def test_every_type_that_is_shown_exists() -> None:
    for module, name in notebook.SHOWN:
        assert isinstance(getattr(import_module(module), name), type)


def test_a_flight_and_its_verdict_are_tables(fly: Fly) -> None:
    flight = Flight(fly({4: lambda t: 0.2 + 0 * t}, seconds=7.0))
    assert "Verdict:" in notebook.html(flight) and "<pre" in notebook.html(flight)
    assert "Separation" in notebook.html(flight.verdict)


def test_a_flight_without_a_verdict_says_why(fly: Fly) -> None:
    recording = fly(seconds=7.0)
    del recording.odometry[3]
    assert "no verdict: no message on /uav3/odom" in notebook.html(Flight(recording))


def test_text_from_outside_is_no_markup() -> None:
    scenario = load("paper_5").with_(description="<script>alert(1)</script>")
    shown = notebook.html(scenario)
    assert "<script>" not in shown and "&lt;script&gt;" in shown
    assert ": by closed forms" in notebook.html(check(scenario, dry_runs=0))


def test_the_types_are_registered_once_there_is_a_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[tuple[str, str], Any] = {}
    formatter = SimpleNamespace(for_type_by_name=lambda m, n, f: seen.update({(m, n): f}))
    shell = SimpleNamespace(display_formatter=SimpleNamespace(formatters={"text/html": formatter}))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: None))
    notebook.register()
    assert seen == {}
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    notebook.register()
    assert seen == dict.fromkeys(notebook.SHOWN, notebook.html)
