"""`ptnsbc network`: profiles; refusals in one line."""

import pytest
from typer.testing import CliRunner

from ptnsbc_nodes.runtime import dds_profiles
from ptnsbc_tools.cli import app


@pytest.fixture
def ptnsbc():
    def call(*arguments):
        return CliRunner().invoke(app, ["network", *map(str, arguments)])

    return call


def test_peers_are_printed_or_written(ptnsbc, tmp_path):
    expected = dds_profiles.static_peers(["10.0.0.7", "10.0.0.8"], 16)
    printed = ptnsbc("peers", "10.0.0.7", "10.0.0.8", "--processes", 16)
    assert (printed.exit_code, printed.stdout) == (0, f"{expected}\n")
    file = tmp_path / "fleet.xml"
    written = ptnsbc("peers", "10.0.0.7", "10.0.0.8", "--processes", 16, "-o", file)
    assert (written.exit_code, written.stdout) == (0, "")
    assert file.read_text() == f"{expected}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["fleet.xml"]


def test_hosts_may_come_from_a_file(ptnsbc, tmp_path):
    hosts = tmp_path / "hosts"
    hosts.write_text("# the ground\n10.0.0.7\n\n10.0.0.8  # uav 1\n")
    found = ptnsbc("peers", "--hosts", hosts)
    assert found.stdout == dds_profiles.static_peers(["10.0.0.7", "10.0.0.8"]) + "\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("peers",), "no computer named"),
        (("peers", "--hosts", "/nowhere"), "/nowhere: No such file"),
        (
            ("peers", "10.0.0.1", "-o", "/nowhere/x.xml"),
            "/nowhere/x.xml: cannot be written: No such file",
        ),
    ],
)
def test_refusals_are_one_line(ptnsbc, arguments, words):
    refused = ptnsbc(*arguments)
    assert refused.exit_code == 2
    (line,) = refused.stderr.splitlines()
    assert line.startswith("error: ") and words in line
    assert refused.stdout == ""
