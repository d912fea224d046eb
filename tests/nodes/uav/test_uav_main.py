"""The command line of a UAV process."""

import pytest

pytest.importorskip("rclpy")


from ptnsbc_nodes.uav import uav_main

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--scenario", "nowhere.yaml", "--uav", "1"], "nowhere.yaml"),
        (["--scenario", "paper_5", "--uav", "9"], "UAV 9: expected one of 1, 2, 3, 4, 5"),
        (["--scenario", "paper_5"], "--uav"),
        (["--scenario", "paper_5", "--uav", "x"], "invalid int value: 'x'"),
    ],
)
def test_a_users_error_is_one_line_and_exit_2(arguments, line, capsys):
    try:
        code = uav_main.main(arguments)
    except SystemExit as exit:
        code = exit.code
    assert code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("uav: ")
    assert line in err
    assert err.count("\n") == 1
