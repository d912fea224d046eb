"""The URDF of a UAV, for RViz and Foxglove: one link, no meshes."""

from __future__ import annotations

from math import pi
from xml.etree import ElementTree

from std_msgs.msg import String

from ptnsbc_io.wire.cdr import encode
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_sim.scenario import Scenario

_SPAN_M = 0.4  # between opposite rotors, as the markers draw it
_BODY_M = (0.14, 0.10, 0.05)
_ARM_M = (_SPAN_M, 0.02, 0.015)
_ROTOR_RADIUS_M, _ROTOR_M = 0.09, 0.008
_DIAGONALS = (pi / 4, 3 * pi / 4)
_BODY, _ARMS, _FRONT, _REAR = "body", "arms", "front rotors", "rear rotors"
_COLOURS = {
    _BODY: "0.2 0.2 0.22 1",
    _ARMS: "0.45 0.45 0.48 1",
    _FRONT: "0.95 0.55 0.1 0.8",
    _REAR: "0.15 0.45 0.85 0.8",
}


def publish_description(endpoints: Endpoints, scenario: Scenario, uav_id: int) -> None:
    """Publish the URDF of a UAV once, latched."""
    publish = endpoints.publisher(topics.robot_description(uav_id), 0)
    publish(encode(String(data=robot_description(scenario, uav_id))))


def robot_description(scenario: Scenario, uav_id: int) -> str:
    """URDF of a quadrotor with the mass and inertia of one UAV.

    The link is `base_link`; viewers take the UAV's frames with its prefix, `uav3`. Lengths are in metres, axes are
    forward, left, up.
    """
    robot = ElementTree.Element("robot", name=f"uav{uav_id}")
    for name, rgba in _COLOURS.items():
        ElementTree.SubElement(
            ElementTree.SubElement(robot, "material", name=name), "color", rgba=rgba
        )
    link = ElementTree.SubElement(robot, "link", name="base_link")
    _inertial(link, scenario, uav_id)
    _visual(link, _BODY, "box", {"size": _numbers(_BODY_M)})
    for turn in _DIAGONALS:
        _visual(link, _ARMS, "box", {"size": _numbers(_ARM_M)}, yaw=turn)
    along = _SPAN_M / 2 / 2**0.5
    rotor = {"radius": f"{_ROTOR_RADIUS_M:g}", "length": f"{_ROTOR_M:g}"}
    for x in (along, -along):
        for y in (along, -along):
            place = (x, y, _BODY_M[2] / 2)
            _visual(link, _FRONT if x > 0 else _REAR, "cylinder", rotor, place)
    return ElementTree.tostring(robot, encoding="unicode")


def _inertial(link: ElementTree.Element, scenario: Scenario, uav_id: int) -> None:
    uav, vehicle = scenario.uav(uav_id), scenario.vehicle(uav_id)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "mass", value=f"{vehicle.mass_kg * uav.mass_scale:g}")
    moments = zip(vehicle.inertia_kg_m2, uav.inertia_scale, strict=True)
    xx, yy, zz = (f"{moment * scale:g}" for moment, scale in moments)
    inertia = {"ixx": xx, "iyy": yy, "izz": zz, "ixy": "0", "ixz": "0", "iyz": "0"}
    ElementTree.SubElement(inertial, "inertia", inertia)


def _visual(
    link: ElementTree.Element,
    material: str,
    shape: str,
    sizes: dict[str, str],
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
) -> None:
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=_numbers(place), rpy=f"0 0 {yaw:g}")
    ElementTree.SubElement(ElementTree.SubElement(visual, "geometry"), shape, sizes)
    ElementTree.SubElement(visual, "material", name=material)


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)
