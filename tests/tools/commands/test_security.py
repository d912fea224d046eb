"""`ptnsbc security policy` prints what `ros2 security` makes a keystore of."""

from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

pytest.importorskip("rclpy")

from ptnsbc_tools.cli import app


def security(*words):
    return CliRunner().invoke(app, ["security", *words])


def test_each_process_of_the_flight_has_an_enclave():
    told = security("policy", "experiment_4", "--backend", "mavlink", "--namespace", "blue")
    assert told.exit_code == 0, told.output
    paths = {one.get("path") for one in ElementTree.fromstring(told.stdout).iter("enclave")}
    vehicles = {f"{kind}{uav}" for kind in ("uav", "bridge") for uav in (1, 2, 3, 4)}
    assert paths == {f"/blue/{name}" for name in (*vehicles, "recorder", "fleet", "operator")}


def test_where_the_middleware_has_no_dds_security_the_flight_is_refused(tmp_path, monkeypatch):
    from ptnsbc_nodes.security import middleware

    (tmp_path / "keys/enclaves").mkdir(parents=True)
    (tmp_path / "keys/enclaves/governance.p7s").write_text("signed")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path / "keys"))
    monkeypatch.setattr(middleware, "lacks_security", lambda: True)
    told = CliRunner().invoke(app, ["fleet", "paper_5", "--set", "security=required"])
    assert told.exit_code == 2
    assert "built without DDS Security" in told.output
    assert "Traceback" not in told.output
