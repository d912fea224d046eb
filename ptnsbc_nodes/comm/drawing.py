"""Drawings of a flight for RViz and Foxglove: markers, and a UAV as URDF of one link without meshes.

The markers are UAVs, trails, keep-outs, obstacles, edges of the tree, and the leader's path.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import pi
from typing import Any
from xml.etree import ElementTree

import numpy as np
from geometry_msgs.msg import Point, Quaternion
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.types import Array
from ptnsbc_io.wire import WireError, decode_odometry
from ptnsbc_io.wire.cdr import encode, split_stamp
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME
from ptnsbc_nodes.comm.announcements import decode_leg
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_sim.counters import STATUS_HZ
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.slots import are_open
from ptnsbc_sim.world import World

_LEADER = (0.95, 0.55, 0.1, 1.0)  # red, green, blue, opacity
_FOLLOWER = (0.15, 0.45, 0.85, 1.0)
_KEEP_OUT = (0.8, 0.1, 0.1, 0.35)
_AROUND = (0.8, 0.1, 0.1, 0.12)
_EDGE = (0.5, 0.5, 0.5, 0.9)
_PATH = (0.95, 0.55, 0.1, 0.5)
_TRAIL_OPACITY = 0.8
_UAV_DIAMETER_M = 0.4
_LINE_M = 0.04
_WITHOUT_END_M = 100.0  # of planes and endless cylinders
_FORMS = {"sphere": Marker.SPHERE, "cylinder": Marker.CYLINDER}
_PATH_POINTS = 200
TRAIL_POINTS = 6 * STATUS_HZ
"""The trail of a UAV has the positions of so many of the newest messages: six seconds."""
_PERIOD_NS = 10**9 // STATUS_HZ

_TIME, _PLACE = struct.Struct("<iI"), struct.Struct("<3d")
_SOMETIME, _SOMEWHERE = (0x7AB0C0DE, 0x3AB0C0DE), (-1.25e297, -1.5e297, -1.75e297)


class Scene:
    """The markers of one flight: serialised once; then only times and positions are written into the bytes.

    The edges of the tree are drawn where every UAV has its own slot.
    """

    def __init__(self, scenario: Scenario, world: World) -> None:
        self._world = world
        self._trails: Array | None = None  # positions (U, TRAIL_POINTS, 3), the newest first
        parents = (
            {} if are_open(scenario) else {i: scenario.communication.parent(i) for i in world.ids}
        )
        children = {i: parent for i, parent in parents.items() if parent is not None}
        self._shown = [*world.ids, *world.ids, *(end for edge in children.items() for end in edge)]
        self._moving = [k for k, one in enumerate(scenario.world.bodies) if one.path is not None]
        self._buffer = bytearray(encode(MarkerArray(markers=_all_markers(scenario, len(children)))))
        self._times_at = _find_all(self._buffer, _TIME.pack(*_SOMETIME))
        places_at = _find_all(self._buffer, _PLACE.pack(*_SOMEWHERE))
        trails = (
            len(world.ids) * TRAIL_POINTS
        )  # the last places; the points of a trail are side by side
        self._places_at, self._trails_at = places_at[:-trails], places_at[-trails::TRAIL_POINTS]

    def markers(self, stamp_ns: int) -> bytes:
        """A serialised MarkerArray of this instant."""
        stamp = split_stamp(stamp_ns)
        for at in self._times_at:
            _TIME.pack_into(self._buffer, at, *stamp)
        places = [self._world.odometry(i)[0:3] for i in self._shown]
        if self._moving:
            places += [*self._world.obstacle_positions()[self._moving]]
        for at, place in zip(self._places_at, places, strict=True):
            _PLACE.pack_into(self._buffer, at, *place)
        for at, trail in zip(self._trails_at, self._newest_trails(), strict=True):
            self._buffer[at : at + trail.nbytes] = trail.tobytes()
        return bytes(self._buffer)

    def _newest_trails(self) -> Array:
        """The trails (U, TRAIL_POINTS, 3) with the present positions; at the beginning the first position repeats."""
        now = np.array([self._world.odometry(i)[0:3] for i in self._world.ids])[:, None]
        if self._trails is None:
            self._trails = np.repeat(now, TRAIL_POINTS, axis=1)
        self._trails = np.concatenate((now, self._trails[:, :-1]), axis=1)
        return self._trails


class OdometryMarkers:
    """/formation/markers made of recorded odometry, for a bag of real vehicles, where no simulator draws.

    One message is made at the leader's first odometry in each period, once every UAV has been heard.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.ids = scenario.uav_ids
        self._uav = {topics.odom(uav).name: uav for uav in self.ids}
        self._leader = scenario.leader.id
        self._newest: dict[int, Array] = {}
        self._period = -1
        self._scenario = scenario
        self._epoch_ns: int | None = None
        self._newest_ns = 0
        # Only `ids`, `odometry` and `obstacle_positions` of a World are read.
        self._scene = Scene(scenario, self)  # type: ignore[arg-type]

    def odometry(self, uav_id: int) -> Array:
        """Newest odometry vector (13,) of one UAV."""
        return self._newest[uav_id]

    def obstacle_positions(self) -> Array:
        """Positions (O, 3) of all obstacles at the newest odometry; those that move stand still before the epoch."""
        since = -1.0 if self._epoch_ns is None else (self._newest_ns - self._epoch_ns) * 1e-9
        return self._scenario.world.body_positions(since)

    def of(self, topic: str, data: bytes) -> bytes | None:
        """The MarkerArray to record beside a message, None when none is due."""
        if topic == topics.EPOCH.name and self._epoch_ns is None:
            self._epoch_ns = _epoch_of(data)
        uav = self._uav.get(topic)
        if uav is None:
            return None
        try:
            stamp_ns, self._newest[uav] = decode_odometry(data)
        except WireError:  # a broken message of another program
            return None
        period = stamp_ns // _PERIOD_NS
        if uav != self._leader or period == self._period or len(self._newest) < len(self.ids):
            return None
        self._period, self._newest_ns = period, stamp_ns
        return self._scene.markers(stamp_ns)


def _epoch_of(data: bytes) -> int | None:
    try:
        return decode_leg(data).stamp_ns
    except WireError:
        return None


def _all_markers(scenario: Scenario, edges: int) -> list[Any]:
    """Every marker, with placeholders for values that change: the UAVs, their keep-outs, the ends of the
    tree's edges, the obstacles that move, then the trails of the UAVs.
    """
    somewhere = np.array(_SOMEWHERE)
    shown = []
    for i in scenario.uav_ids:
        shown.append(_sphere("uavs", i, _UAV_DIAMETER_M, _colour(i == scenario.leader.id)))
    for i in scenario.uav_ids:  # two UAVs whose spheres touch are at their least distance
        shown.append(_sphere("keep_outs", i, scenario.keep_out_m(i), _AROUND))
    for marker in shown:
        marker.pose.position = _point(somewhere)
    tree = _marker("tree", 0, Marker.LINE_LIST, _EDGE)
    tree.scale.x = _LINE_M
    tree.points = [_point(somewhere) for _ in range(2 * edges)]
    shown += [tree, *_obstacles(scenario), _path(scenario), *_trails(scenario)]
    for marker in shown:
        marker.header.stamp.sec, marker.header.stamp.nanosec = _SOMETIME
    return shown


def _find_all(buffer: bytearray, pattern: bytes) -> list[int]:
    found = [buffer.find(pattern)]
    while found[-1] >= 0:
        found.append(buffer.find(pattern, found[-1] + len(pattern)))
    return found[:-1]


def _colour(leader: bool) -> Sequence[float]:
    return _LEADER if leader else _FOLLOWER


def _point(place: Array) -> Point:
    return Point(x=float(place[0]), y=float(place[1]), z=float(place[2]))


def _marker(namespace: str, number: int, kind: int, colour: Sequence[float]) -> Any:
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD)
    marker.header.frame_id = WORLD_FRAME
    marker.pose.orientation.w = 1.0
    red, green, blue, opacity = colour
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=opacity)
    return marker


def _sphere(namespace: str, number: int, diameter_m: float, colour: Sequence[float]) -> Any:
    marker = _marker(namespace, number, Marker.SPHERE, colour)
    marker.scale.x = marker.scale.y = marker.scale.z = float(diameter_m)
    return marker


def _obstacles(scenario: Scenario) -> list[Any]:
    """The keep-outs of spheres, and all other bodies themselves."""
    found = []
    for number, one in enumerate(scenario.world.bodies):
        form = _FORMS.get(one.kind, Marker.CUBE)
        marker = _marker("obstacles", number, form, _KEEP_OUT)
        edges, centre, turn = one.drawn(_WITHOUT_END_M)
        marker.scale.x, marker.scale.y, marker.scale.z = (float(edge) for edge in edges)
        marker.pose.position = _point(centre if one.path is None else np.array(_SOMEWHERE))
        x, y, z, w = turn
        marker.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
        found.append(marker)
    return found


def _path(scenario: Scenario) -> Any:
    path = _marker("leader_path", 0, Marker.LINE_STRIP, _PATH)
    path.scale.x = _LINE_M
    trajectory = agent_config(scenario, scenario.leader.id).trajectory
    times = np.linspace(0.0, float(scenario.timing.duration_s), _PATH_POINTS)
    path.points = [_point(np.array(reference(trajectory, t).position)) for t in times]
    return path


def _trails(scenario: Scenario) -> list[Any]:
    found = []
    for i in scenario.uav_ids:
        red, green, blue, _ = _colour(i == scenario.leader.id)
        trail = _marker("trails", i, Marker.LINE_STRIP, (red, green, blue, _TRAIL_OPACITY))
        trail.scale.x = _LINE_M
        trail.points = [_point(np.array(_SOMEWHERE)) for _ in range(TRAIL_POINTS)]
        found.append(trail)
    return found


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
