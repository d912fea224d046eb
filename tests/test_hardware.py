"""hardware/: parameter files that a bridge has no word about, poses in the right axes, units that systemd accepts."""

from __future__ import annotations

import math
import re
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("pymavlink")

from ptnsbc_io.mavlink.autopilots import ARDUPILOT, PX4, advice, refusal
from ptnsbc_io.mavlink.dialect import mavlink

ROOT = Path(__file__).parents[1]
HARDWARE = ROOT / "hardware"
MOCAP = runpy.run_path(str(HARDWARE / "mocap_to_mavlink.py"))
HALF = math.sqrt(0.5)


def values(name: str) -> dict[str, float]:
    """The values of a parameter file."""
    lines = (HARDWARE / name).read_text("utf-8").splitlines()
    rows = [re.split(r"[\t,]", line) for line in lines if not line.startswith("#")]
    found = {row[-3]: float(row[-2]) for row in rows} if name.endswith("params") else {}
    return found or {row[0]: float(row[1]) for row in rows}


@pytest.mark.parametrize(
    ("name", "autopilot"), [("px4.params", PX4), ("arducopter.parm", ARDUPILOT)]
)
def test_a_bridge_has_no_word_about_the_file(name: str, autopilot: object) -> None:
    found = values(name)
    assert set(found) & set(autopilot.parameters)  # type: ignore[attr-defined]
    assert list(advice(found, 30.0)) == []
    assert refusal(autopilot, found, "velocity") is None  # type: ignore[arg-type]


def test_every_parameter_has_its_reason_in_the_pages() -> None:
    text = "".join(
        (ROOT / "docs" / name).read_text("utf-8") for name in ("hardware.md", "positioning.md")
    )
    files = ("px4.params", "px4_mocap.params", "arducopter.parm", "arducopter_mocap.parm")
    named = {key for name in files for key in values(name)}
    assert not [key for key in sorted(named) if key not in text]


def test_px4_reads_vehicle_component_name_value_type() -> None:
    for name in ("px4.params", "px4_mocap.params"):
        for line in (HARDWARE / name).read_text("utf-8").splitlines():
            if not line.startswith("#"):
                vehicle, component, _, value, kind = line.split("\t")
                assert (vehicle, component) == ("1", "1")
                assert kind == ("9" if "." in value else "6")


@pytest.mark.parametrize(
    ("xyzw", "wxyz"),
    [
        ((0.0, 0.0, 0.0, 1.0), (HALF, 0.0, 0.0, HALF)),  # nose east: 90 deg from north
        ((0.0, 0.0, HALF, HALF), (1.0, 0.0, 0.0, 0.0)),  # nose north
    ],
)
def test_a_pose_has_the_axes_of_the_autopilot(
    xyzw: tuple[float, ...], wxyz: tuple[float, ...]
) -> None:
    pose = MOCAP["converted"]((1.0, 2.0, 3.0), xyzw)
    assert pose.position == (2.0, 1.0, -3.0)
    assert pose.quaternion == pytest.approx(wxyz)
    sent = MOCAP["odometry"](pose, 5_000_000, "px4")
    packed = sent.pack(mavlink.MAVLink(None, srcSystem=3, srcComponent=197))
    back = mavlink.MAVLink(None).decode(bytearray(packed))
    assert (back.get_type(), back.get_srcSystem(), back.time_usec) == ("ODOMETRY", 3, 5_000_000)
    assert (back.frame_id, back.child_frame_id) == (1, 12)
    assert (back.x, back.y, back.z) == (2.0, 1.0, -3.0)
    assert math.isnan(back.vx) and math.isnan(back.pose_covariance[0])


@pytest.mark.parametrize("broken", [(math.nan, 0.0, 0.0), None])
def test_hidden_markers_send_nothing(broken: tuple[float, ...] | None) -> None:
    place, turn = broken or (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0 if broken is None else 1.0)
    assert MOCAP["converted"](place, turn) is None


def test_the_unit_starts_what_the_program_has() -> None:
    from tests.support.commands import every_command

    text = (HARDWARE / "systemd" / "ptnsbc-uav@.service").read_text("utf-8")
    (line,) = [one for one in text.splitlines() if one.startswith("ExecStart=")]
    fleet = every_command().commands["fleet"]
    known = {name for option in fleet.params for name in option.opts}
    assert set(re.findall(r" (--[a-z-]+)", line)) <= known
    variables = set(re.findall(r"\$\{?([A-Z_]+)", line))
    given = (HARDWARE / "systemd" / "fleet.env").read_text("utf-8")
    assert variables <= set(re.findall(r"(?m)^([A-Z_]+)=", given))


def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("no systemd-analyze")
    unit = (HARDWARE / "systemd" / "ptnsbc-uav@.service").read_text("utf-8")
    copy = tmp_path / "ptnsbc-uav@3.service"
    copy.write_text(unit.replace("/opt/ptnsbc/venv/bin/ptnsbc", "/bin/true"), "utf-8")
    said = subprocess.run([program, "verify", copy], capture_output=True, text=True, check=False)
    ours = [line for line in said.stderr.splitlines() if "ptnsbc" in line]
    assert ours == []
