"""`ptnsbc mission`: what it says when nobody answers."""

import re

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.runtime.environment import free_domain
from ptnsbc_tools.commands.fly import mission as command


def test_an_empty_domain_says_what_is_expected_there(monkeypatch):
    monkeypatch.setattr(command, "_PATIENCE_S", 0.3)
    with free_domain() as number:
        words = re.escape(
            f"domain {number}: no fleet answered: expected one there that flies a scenario with the key "
            "mission; choose another by --domain N or --namespace NAME"
        )
        with pytest.raises(command.MissionError, match=words):
            command.list_(domain=number)
        with pytest.raises(command.MissionError, match="expected one there that waits for"):
            command.arm(domain=number)
