"""Drawings of a flight for RViz and Foxglove: markers, and a UAV as URDF of one link without meshes.

The markers are UAVs, trails, keep-outs, obstacles, edges of the tree, and the leader's path.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from math import pi
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Quaternion
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import Array
from ptnsbc_io.cdr import encode, split_stamp
from ptnsbc_io.wire import WireError, decode_odometry
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME
from ptnsbc_nodes.comm.announcements import decode_leg
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_sim.counters import STATUS_HZ
from ptnsbc_sim.scenario import Scenario, agent_config

_LEADER = (0.95, 0.55, 0.1, 1.0)  # red, green, blue, opacity
_FOLLOWER = (0.15, 0.45, 0.85, 1.0)
_KEEP_OUT = (0.8, 0.1, 0.1, 0.35)
_AROUND = (0.8, 0.1, 0.1, 0.12)
_EDGE = (0.5, 0.5, 0.5, 0.9)
_PATH = (0.95, 0.55, 0.1, 0.5)
_TRAIL_OPACITY = 0.8
_UAV_DIAMETER_M = 0.4
_LINE_M = 0.04
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

    def __init__(self, scenario: Scenario) -> None:
        """The leader differs in colour from the others."""
        ids = scenario.uav_ids
        colours = {i: _LEADER if i == scenario.leader.id else _FOLLOWER for i in ids}
        self._trails: Array | None = None  # positions (U, TRAIL_POINTS, 3), the newest first
        drawn = () if scenario.formation.has_open_slots else ids
        tree = {i: scenario.communication.parent(i) for i in drawn}
        edges = [end for edge in tree.items() if edge[1] is not None for end in edge]
        self._rows = [ids.index(uav) for uav in (*ids, *ids, *edges) if uav is not None]
        self._moving = [k for k, body in enumerate(scenario.world.bodies) if body.path is not None]
        self._buffer = bytearray(
            encode(MarkerArray(markers=_all_markers(scenario, colours, len(edges))))
        )
        self._times_at = _find_all(self._buffer, _TIME.pack(*_SOMETIME))
        places_at = _find_all(self._buffer, _PLACE.pack(*_SOMEWHERE))
        trails = len(ids) * TRAIL_POINTS  # the last places; points of a trail are side by side
        self._places_at, self._trails_at = places_at[:-trails], places_at[-trails::TRAIL_POINTS]

    def markers(self, stamp_ns: int, places: Array, obstacles: Array) -> bytes:
        """A serialised MarkerArray: the positions of the UAVs (U, 3) and of all bodies (O, 3) at an instant."""
        stamp = split_stamp(stamp_ns)
        for at in self._times_at:
            _TIME.pack_into(self._buffer, at, *stamp)
        drawn = [*places[self._rows], *obstacles[self._moving]]
        for at, place in zip(self._places_at, drawn, strict=True):
            _PLACE.pack_into(self._buffer, at, *place)
        if self._trails is None:  # at the beginning the first position repeats
            self._trails = np.repeat(places[:, None], TRAIL_POINTS, axis=1)
        self._trails = np.concatenate((places[:, None], self._trails[:, :-1]), axis=1)
        for at, trail in zip(self._trails_at, self._trails, strict=True):
            self._buffer[at : at + trail.nbytes] = trail.tobytes()
        return bytes(self._buffer)


class OdometryMarkers:
    """/formation/markers made of recorded odometry, for a bag of real vehicles, where no simulator draws.

    One message is made at the leader's first odometry in each period, once every UAV has been heard.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._uav = {topics.odom(uav).name: uav for uav in scenario.uav_ids}
        self._places: dict[int, Array] = {}  # the newest
        self._period = -1
        self._epoch_ns: int | None = None
        self._scene = Scene(scenario)

    def of(self, topic: str, data: bytes) -> bytes | None:
        """The MarkerArray to record beside a message, None when none is due."""
        scenario, uav = self._scenario, self._uav.get(topic)
        try:
            if topic == topics.EPOCH.name and self._epoch_ns is None:
                self._epoch_ns = decode_leg(data).stamp_ns
            if uav is None:
                return None
            stamp_ns, odometry = decode_odometry(data)
        except WireError:  # a broken message of another program
            return None
        self._places[uav] = odometry[0:3]
        period, heard = stamp_ns // _PERIOD_NS, len(self._places) == len(self._uav)
        if uav != scenario.leader.id or period == self._period or not heard:
            return None
        self._period = period
        # Bodies that move stand still before the epoch.
        since_s = -1.0 if self._epoch_ns is None else seconds(stamp_ns - self._epoch_ns)
        places = np.array([self._places[i] for i in scenario.uav_ids])
        return self._scene.markers(stamp_ns, places, scenario.world.body_positions(since_s))


def _all_markers(
    scenario: Scenario, colours: Mapping[int, Sequence[float]], tree_points: int
) -> list[Any]:
    """Every marker, with placeholders for values that change: the UAVs, their keep-outs, the ends of the
    tree's edges, the obstacles that move, then the trails of the UAVs.
    """
    somewhere, ids, leader = np.array(_SOMEWHERE), scenario.uav_ids, scenario.leader.id
    spheres = [("uavs", i, _UAV_DIAMETER_M, colours[i]) for i in ids]
    # Two UAVs whose spheres touch are at their least distance.
    spheres += [("keep_outs", i, scenario.keep_out_m(i), _AROUND) for i in ids]
    shown = []
    for namespace, i, diameter_m, colour in spheres:
        sphere = _marker(namespace, i, Marker.SPHERE, colour)
        sphere.scale.x = sphere.scale.y = sphere.scale.z = float(diameter_m)
        sphere.scale.z *= scenario.formation.keep_out_height if namespace == "keep_outs" else 1.0
        sphere.pose.position = _point(somewhere)
        shown.append(sphere)
    shown.append(_line("tree", 0, Marker.LINE_LIST, _EDGE, tree_points * [somewhere]))
    for number, body in enumerate(scenario.world.bodies):  # keep-outs of spheres, others themselves
        marker = _marker("obstacles", number, _FORMS.get(body.kind, Marker.CUBE), _KEEP_OUT)
        edges, centre, (x, y, z, w) = body.drawn()
        marker.scale.x, marker.scale.y, marker.scale.z = (float(edge) for edge in edges)
        marker.pose.position = _point(centre if body.path is None else somewhere)
        marker.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
        shown.append(marker)
    trajectory = agent_config(scenario, leader).trajectory
    times = np.linspace(0.0, float(scenario.timing.duration_s), _PATH_POINTS)
    path = [*curve_samples(trajectory, times)[:, :3]]
    shown.append(_line("leader_path", 0, Marker.LINE_STRIP, _PATH, path))
    for i in ids:
        colour = (*colours[i][:3], _TRAIL_OPACITY)
        shown.append(_line("trails", i, Marker.LINE_STRIP, colour, TRAIL_POINTS * [somewhere]))
    for marker in shown:
        marker.header.stamp.sec, marker.header.stamp.nanosec = _SOMETIME
    return shown


def _find_all(buffer: bytearray, pattern: bytes) -> list[int]:
    found = [buffer.find(pattern)]
    while found[-1] >= 0:
        found.append(buffer.find(pattern, found[-1] + len(pattern)))
    return found[:-1]


def _point(place: Array) -> Point:
    return Point(x=float(place[0]), y=float(place[1]), z=float(place[2]))


def _marker(namespace: str, number: int, kind: int, colour: Sequence[float]) -> Any:
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD)
    marker.header.frame_id = WORLD_FRAME
    marker.pose.orientation.w = 1.0
    red, green, blue, opacity = colour
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=opacity)
    return marker


def _line(
    namespace: str, number: int, kind: int, colour: Sequence[float], points: Sequence[Array]
) -> Any:
    line = _marker(namespace, number, kind, colour)
    line.scale.x = _LINE_M
    line.points = [_point(place) for place in points]
    return line


_SPAN_M = 0.4  # between opposite rotors, as the markers draw it
_ROTOR_UP_M = 0.025  # on the upper side of the body
_BODY, _ARM = '<box size="0.14 0.1 0.05"/>', f'<box size="{_SPAN_M} 0.02 0.015"/>'
_ROTOR = '<cylinder radius="0.09" length="0.008"/>'
_COLOURS = {
    "body": "0.2 0.2 0.22 1",
    "arms": "0.45 0.45 0.48 1",
    "front rotors": "0.95 0.55 0.1 0.8",
    "rear rotors": "0.15 0.45 0.85 0.8",
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
    uav, vehicle = scenario.uav(uav_id), scenario.vehicle(uav_id)
    moments = zip(vehicle.inertia_kg_m2, uav.inertia_scale, strict=True)
    xx, yy, zz = (f"{moment * scale:g}" for moment, scale in moments)
    along = _SPAN_M / 2 / 2**0.5
    parts = [("body", _BODY, "0 0 0", 0.0)]
    parts += [("arms", _ARM, "0 0 0", turn) for turn in (pi / 4, 3 * pi / 4)]
    for x in (along, -along):
        name = "front rotors" if x > 0 else "rear rotors"
        parts += [(name, _ROTOR, f"{x:g} {y:g} {_ROTOR_UP_M:g}", 0.0) for y in (along, -along)]
    materials = "".join(
        f'<material name="{name}"><color rgba="{rgba}"/></material>'
        for name, rgba in _COLOURS.items()
    )
    visuals = "".join(
        f'<visual><origin xyz="{place}" rpy="0 0 {yaw:g}"/><geometry>{shape}</geometry>'
        f'<material name="{name}"/></visual>'
        for name, shape, place, yaw in parts
    )
    return (
        f'<robot name="uav{uav_id}">{materials}<link name="base_link"><inertial>'
        f'<mass value="{vehicle.mass_kg * uav.mass_scale:g}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"{visuals}</link></robot>"
    )
