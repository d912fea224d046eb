"""`security: required`: what a process needs before it starts."""

import sys
from types import SimpleNamespace

import pytest

from ptnsbc_nodes.security import middleware
from ptnsbc_nodes.security.middleware import DdsSecurityError

REQUIRED = SimpleNamespace(security="required")


@pytest.fixture
def keystore(tmp_path, monkeypatch):
    """A keystore, and a middleware with DDS Security."""
    (tmp_path / "keys/enclaves").mkdir(parents=True)
    (tmp_path / "keys/enclaves/governance.p7s").write_text("signed")
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "librmw_fastrtps_shared_cpp.so").write_bytes(b"\x7fELF")
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.delenv("LD_LIBRARY_PATH", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path / "keys"))
    return tmp_path


def test_with_a_keystore_every_process_enforces_it(keystore, monkeypatch):
    settings = middleware.enforced({"ROS_SECURITY_KEYSTORE": str(keystore / "keys")})
    assert settings == {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    middleware.check_enforced(REQUIRED)


@pytest.mark.parametrize("folder", ["", "/nonexistent"])
def test_without_a_keystore_nothing_starts(folder):
    with pytest.raises(DdsSecurityError, match="expected the folder of a keystore"):
        middleware.enforced({"ROS_SECURITY_KEYSTORE": folder})


def test_without_dds_security_nothing_starts(keystore):
    library = keystore / "lib" / "librmw_fastrtps_shared_cpp.so"
    library.write_bytes(b"This Fast DDS version doesn't have the security libraries")
    with pytest.raises(DdsSecurityError, match="built without DDS Security"):
        middleware.enforced({"ROS_SECURITY_KEYSTORE": str(keystore / "keys")})


@pytest.mark.parametrize("strategy", ["", "Permissive"])
def test_a_process_that_would_go_on_unprotected_does_not_start(keystore, monkeypatch, strategy):
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", strategy)
    with pytest.raises(DdsSecurityError, match="STRATEGY: expected Enforce"):
        middleware.check_enforced(REQUIRED)


def test_a_scenario_that_asks_for_nothing_needs_nothing(monkeypatch):
    monkeypatch.delenv("ROS_SECURITY_ENABLE", raising=False)
    middleware.check_enforced(SimpleNamespace(security="signed"))
