"""The vehicles that a bridge sees, and those of them that its UAV avoids."""

import numpy as np
import pytest

from ptnsbc_nodes.bridge.near_objects import NearObjects
from ptnsbc_sim.scenario import load_scenario

HERE = np.zeros(3)
PLACES = {2: (2.0, 0.0, 3.0), 4: (0.0, 1.0, 3.0)}
LINKED = (2,)


def near_objects(near, **keys):
    """Those of UAV 3: UAV 2 has an edge with it, UAV 4 has none and is closer."""
    made = load_scenario("experiment_4", {"mavlink.near": near, **keys})
    objects = NearObjects(made, 3, LINKED)
    for uav, place in PLACES.items():
        odometry = np.zeros(13)
        odometry[0:3], odometry[6], odometry[7] = place, 1.0, 0.5
        objects.on_odometry(uav, 10.0, odometry)
    return objects


@pytest.mark.parametrize(("near", "avoided"), [("links", [2]), ("all", [2, 4])])
def test_it_sees_all_vehicles_and_its_uav_avoids_what_the_scenario_says(near, avoided):
    objects = near_objects(near)
    assert objects.uavs(10.0)[:, 0:3].tolist() == [list(PLACES[i]) for i in (2, 4)]
    assert objects.rows(10.0, HERE)[:, 0:3].tolist() == [list(PLACES[i]) for i in avoided]


def test_a_silent_vehicle_flies_on_may_have_stopped_on_its_way_and_is_not_forgotten():
    """It flies with 0.5 m/s, and everybody keeps 0.5 m from it."""
    objects, beside = near_objects("links"), np.array(PLACES[2])
    assert objects.rows(10.4, beside)[:, [0, 4]].tolist() == [pytest.approx([2.2, 0.5])]
    late = objects.rows(11.0, beside)
    assert late[:, 0].tolist() == pytest.approx([2.0, 2.0 + 0.5 / 3, 2.0 + 1.0 / 3, 2.5])
    assert late[:, 4].tolist() == [0.0] * 3 + [0.5]
    stopped = objects.rows(14.9, beside)
    stopped = stopped[stopped[:, 1] == 0.0]  # without UAV 4
    assert stopped[-1, 0] == pytest.approx(4.0)
    assert not stopped[:, 4].any()
    way = np.linspace(2.0, 4.0, 101)[:, None]
    nearest = np.abs(way - stopped[:, 0]).min(axis=1)
    assert (stopped[0, 3] ** 2 - nearest**2).min() > 0.5**2 - 1e-9  # nowhere nearer to the way
    later = objects.rows(99.0, beside)
    assert later[later[:, 1] == 0.0].tolist() == stopped.tolist()  # it may hover there for good


def test_the_keep_out_may_be_higher_than_wide():
    for now_s in (10.0, 11.0):
        rows = near_objects("all", **{"formation.uav_keep_out_above_m": 1.5}).uavs(now_s)
        assert rows[:, 7] == pytest.approx(3.0 * rows[:, 3])
    assert not near_objects("all").uavs(11.0)[:, 7].any()


def test_everybody_avoids_a_vehicle_that_is_silent_or_has_left_the_formation():
    """Also one without an edge."""
    objects, odometry = near_objects("links"), np.zeros(13)
    odometry[0:3], odometry[6] = PLACES[4], 1.0
    for now_s, left, avoided in ((10.9, False, 1), (11.0, True, 2), (11.1, False, 1)):
        objects.on_odometry(2, now_s, odometry)
        objects.on_odometry(4, now_s, odometry, left=left)
        assert len(objects.rows(now_s, HERE)) == avoided
    assert len({*objects.rows(12.2, HERE)[:, 1]}) == 1
    assert len(objects.rows(12.2, HERE)) == 4
