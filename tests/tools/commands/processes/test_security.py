"""`ptnsbc security init` writes a keystore and says how to use it."""

import pytest
from typer.testing import CliRunner

pytest.importorskip("rclpy")
pytest.importorskip("cryptography")

from ptnsbc_tools.cli import app


def init(*words):
    return CliRunner().invoke(app, ["security", "init", *map(str, words)])


def test_each_process_of_the_flight_has_an_identity(tmp_path):
    told = init(
        "experiment_4", "-o", tmp_path / "keys", "--backend", "mavlink", "--namespace", "blue"
    )
    assert told.exit_code == 0, told.output
    names = {path.parent.name for path in (tmp_path / "keys/enclaves/blue").glob("*/key.pem")}
    vehicles = {f"{kind}{uav}" for kind in ("uav", "bridge") for uav in (1, 2, 3, 4)}
    assert names == {*vehicles, "recorder", "fleet", "operator"}
    assert f"ROS_SECURITY_KEYSTORE={tmp_path}/keys" in told.output
    assert "ROS_SECURITY_ENCLAVE_OVERRIDE=/blue/operator" in told.output


def test_a_folder_with_other_things_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    told = init("paper_5", "-o", tmp_path)
    assert told.exit_code == 2
    assert "expected a new or empty folder" in told.output
    assert len(list(tmp_path.iterdir())) == 1


def test_where_the_middleware_has_no_dds_security_the_flight_is_refused(tmp_path, monkeypatch):
    from ptnsbc_nodes.security import middleware

    assert init("paper_5", "-o", tmp_path / "keys").exit_code == 0
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path / "keys"))
    monkeypatch.setattr(middleware, "lacks_security", lambda: True)
    told = CliRunner().invoke(app, ["fleet", "paper_5", "--set", "security=required"])
    assert told.exit_code == 2
    assert "built without DDS Security" in told.output
    assert "Traceback" not in told.output
