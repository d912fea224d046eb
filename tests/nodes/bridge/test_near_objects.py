"""The vehicles that a bridge sees, and those of them that its UAV avoids."""

import numpy as np
import pytest

from ptnsbc_io.wire import OdometryTemplate
from ptnsbc_nodes.bridge.near_objects import NearObjects
from ptnsbc_sim.scenario import load_scenario

HERE = np.zeros(3)
PLACES = {2: (2.0, 0.0, 3.0), 4: (0.0, 1.0, 3.0)}
LINKED = (2,)


def near_objects(near):
    """Those of UAV 3: UAV 2 has an edge with it, UAV 4 has none and is closer."""
    made = load_scenario("experiment_4", {"mavlink.near": near})
    objects, template = NearObjects(made, 3, LINKED), OdometryTemplate("map", "x")
    for uav, place in PLACES.items():
        odometry = np.zeros(13)
        odometry[0:3], odometry[6], odometry[7] = place, 1.0, 0.5
        objects.on_odometry(uav, 10.0, template.encode(0, odometry))
    return objects


@pytest.mark.parametrize(("near", "avoided"), [("links", [2]), ("all", [2, 4])])
def test_it_sees_all_vehicles_and_its_uav_avoids_what_the_scenario_says(near, avoided):
    objects = near_objects(near)
    assert objects.uavs(10.0)[:, 0:3].tolist() == [list(PLACES[i]) for i in (2, 4)]
    assert objects.rows(10.0, HERE)[:, 0:3].tolist() == [list(PLACES[i]) for i in avoided]


def test_a_silent_vehicle_flies_on_then_stays_and_is_forgotten():
    objects = near_objects("all")
    assert objects.uavs(10.4)[0, [0, 4]].tolist() == pytest.approx([2.2, 0.5])
    assert objects.uavs(11.0)[0, [0, 4]].tolist() == [2.0, 0.0]
    assert not len(objects.uavs(15.1))
