"""Tables as spreadsheets, planners and NumPy write them: one reader, whatever stands between the numbers."""

from __future__ import annotations

import numpy as np
import pytest

from ptnsbc_io.number_table import read_table

PATH = ("t", "x", "y", "z", "yaw")
ROWS = [[0.0, 0.5, -1.0, 6.0], [0.5, 1.0, 2.0, 6.25]]
TURN = [[0.0, 0.5, -1.0, 6.0, 0.0], [0.5, 1.0, 2.0, 6.25, np.pi / 2]]


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("0,0.5,-1,6\n0.5,1,2,6.25\n", ROWS),
        ("\ufeff0,0.5,-1,6\r\n0.5,1,2,6.25\r\n", ROWS),
        ("\ufefft,x,y,z\n0,0.5,-1,6\n0.5,1,2,6.25\n", ROWS),
        ("# a planner's\n\nt,x,y,z\n0,0.5,-1,6\n\n# half way\n0.5,1,2,6.25\n", ROWS),
        ("# t,y,x,z\n0,-1,0.5,6\n0.5,2,1,6.25\n", ROWS),  # the names of numpy.savetxt
        ("# by A, B, C, 2024\n0,0.5,-1,6\n0.5,1,2,6.25\n", ROWS),
        ("0;0,5;-1;6\n0,5;1;2;6,25\n", ROWS),
        ("t;x;y;z\n0;0.5;-1;6\n0.5;1;2;6.25\n", ROWS),
        ("t\tx\ty\tz\n0\t0,5\t-1\t6\n0,5\t1\t2\t6,25\n", ROWS),
        ("  0  0.5 -1 6\n0.5 1  2 6.25 \n", ROWS),
        ('t,x,y,z\n0,"0,5",-1,6\n0.5,1,2,"6,25"\n', ROWS),
        ("t,x,y,z,\n0,0.5,-1,6,\n0.5,1,2,6.25,\n", ROWS),
        ("sep=;\nt;x;y;z\n0;0,5;-1;6\n0,5;1;2;6,25\n", ROWS),  # Excel's own mark
        ("t,x,y,z,note\n0,0.5,-1,6,\n,,,,\n0.5,1,2,6.25,\n", ROWS),
        ("t,y,x,z\n0,-1,0.5,6\n0.5,2,1,6.25\n", ROWS),
        ("Time [msec],x [m],y [m],z [m],Red\n0,0.5,-1,6,no\n500,1,2,6.25,7\n", ROWS),
        ("t_ms,x_cm,y (mm),z\n0,50,-1000,6\n500,100,2000,6.25\n", ROWS),
        ("frame,time,pose.position.x,pose.position.y,posZ\na,0,0.5,-1,6\na,0.5,1,2,6.25\n", ROWS),
        ("t,x,y,z,yaw_deg\n0,0.5,-1,6,0\n0.5,1,2,6.25,90\n", TURN),
        ("yaw [°],t,x,y,z\n0,0,0.5,-1,6\n90,0.5,1,2,6.25\n", TURN),
        ("yaw,t,x,y,z\n0,0,0.5,-1,6\n1.5707963267948966,0.5,1,2,6.25\n", TURN),
        ("t,x,y,z,vx\n0,0.5,-1,6,1\n0.5,1,2,6.25,1\n", ROWS),
    ],
)
def test_a_table_is_read_as_it_says(text: str, rows: list[list[float]]) -> None:
    np.testing.assert_array_equal(read_table(text, PATH, optional=1), rows)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t [min],x,y,z\n0,0,0,6\n", r"row 1: column t \[min\]: expected one named t, in s, sec"),
        ("t,x,y,z,yaw_ned\n0,0,0,6,0\n", "row 1: column yaw_ned: expected one named yaw, in rad"),
        ("t,x [deg],y,z\n0,0,0,6\n", r"row 1: column x \[deg\]: expected one named x, in m"),
        ("t,x,y,alt\n0,0,0,6\n", "row 1: column t, x, y, alt: expected one named z"),
        ("t,x,tx,y,z\n0,0,0,0,6\n", "row 1: column x, tx: expected one named x"),
        ("\nt,x,y,z\n0,0,0\n", "row 3: 3 numbers: expected 4, one for each name"),
        ("t,x,y,z\n0,5,1,2,3,0,6,0\n", "row 2: 8 numbers: expected 4, one"),  # decimal commas
        ("t [s] x y z a b\n0 1 2 6 7 8\n", "row 2: 6 numbers: expected 7, one"),
        ("0,O,0,6\n", "row 1: expected numbers t, x, y, z"),
        ("0,0,0,6\n1,0,,6\n", "row 2: expected numbers"),
        ("0,0,0,6\n1;0;0;6\n", "row 2: 1 numbers: expected t"),
        ("0,0,0,6\n0,0,inf,6\n", "row 2: expected finite numbers"),
        ("0,0,0,6,0,0\n", "row 1: 6 numbers"),
        ("0,0,0\n", "row 1: 3 numbers"),
    ],
)
def test_what_contradicts_is_named_with_its_row_and_column(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        read_table(text, PATH, optional=1)


def test_a_table_without_rows_has_none() -> None:
    for text in ("", "# nothing\n", "t,x,y,z,yaw\n"):
        assert read_table(text, PATH, optional=1).shape == (0, 5)


def test_rows_of_points_may_be_longer_and_unknown() -> None:
    rows = read_table("1,2,3,wall\nnan,0,0,floor\n", ("x", "y", "z"), loose=True)
    np.testing.assert_array_equal(rows, [[1, 2, 3], [np.nan, 0, 0]])
