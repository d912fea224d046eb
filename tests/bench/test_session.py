"""The ROS domains of the benches."""

from __future__ import annotations

import os

import pytest

from bench.session import own_domain
from ptnsbc_nodes.runtime import environment


def test_the_domain_of_each_flight_is_another_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setattr(environment.random, "sample", lambda domains, _: list(domains))
    used = []
    for _ in range(5):
        with own_domain() as domain:
            assert os.environ["ROS_DOMAIN_ID"] == str(domain)
            used.append(domain)
    assert len(set(used)) == 5
    assert os.environ["ROS_DOMAIN_ID"] == "7"
