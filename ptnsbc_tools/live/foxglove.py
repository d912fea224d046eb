"""The live view for Foxglove: its own server, with the scene, the frames of the bodies and the numbers of every UAV."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import ros
from ptnsbc_tools.live.server import HOST, LiveServerError
from ptnsbc_tools.plotting.charts import COLOURS, look

_WORLD = "map"
_UAV_M = 0.4
_WITHOUT_END_M = 100.0  # of planes and endless cylinders
_LEVEL = (0.0, 0.0, 0.0, 1.0)  # quaternion
_KEEP_OUT = (0.5, 0.5, 0.5, 0.35)  # red, green, blue, opacity


class FoxgloveSink:
    """Publishes every frame on a port of this host; use it as a context manager.

    Topics: `/scene` (foxglove.SceneUpdate), `/tf` (foxglove.FrameTransforms), `/formation/live` (JSON: the frame).
    PtnsbcError when foxglove-sdk is not installed, or the port is taken.
    """

    def __init__(self, scenario: Scenario, port: int) -> None:
        self._scenario = scenario
        self._sdk = ros.library("foxglove", "--foxglove", "foxglove")
        self._kinds = ros.library("foxglove.messages", "--foxglove", "foxglove")
        channels = ros.library("foxglove.channels", "--foxglove", "foxglove")
        self._context = self._sdk.Context()
        self._scene = channels.SceneUpdateChannel("/scene", context=self._context)
        self._frames = channels.FrameTransformsChannel("/tf", context=self._context)
        self._numbers = self._sdk.Channel(
            "/formation/live", message_encoding="json", context=self._context
        )
        try:
            self._server = self._sdk.start_server(
                name=f"ptnsbc {scenario.name}", host=HOST, port=port, context=self._context
            )
        except (RuntimeError, OSError) as error:
            raise LiveServerError(
                f"--foxglove {port}: {' '.join(str(error).split())}: expected a free port"
            ) from None

    def __enter__(self) -> FoxgloveSink:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop()

    def __call__(self, frame: dict[str, Any]) -> None:
        """Publish a frame."""
        self._numbers.log(frame)
        kinds, flying = self._kinds, [uav for uav in frame["uavs"] if uav["pose"] is not None]
        turns = [
            kinds.FrameTransform(
                parent_frame_id=_WORLD,
                child_frame_id=f"uav{uav['id']}/base_link",
                translation=self._made("Vector3", "xyz", uav["pose"][:3]),
                rotation=self._made("Quaternion", "xyzw", uav["pose"][3:]),
            )
            for uav in flying
        ]
        self._frames.log(kinds.FrameTransforms(transforms=turns))
        entities = [self._uav(uav) for uav in flying]
        since_s = max(float(frame.get("t") or 0.0), 0.0)
        self._scene.log(kinds.SceneUpdate(entities=[*entities, self._obstacles(since_s)]))

    def _made(self, kind: str, names: str, values: Iterable[float]) -> Any:
        """A message of Foxglove with these fields."""
        return getattr(self._kinds, kind)(**dict(zip(names, map(float, values), strict=True)))

    def _body(
        self, place: Any, turn: Iterable[float], size: Any, colour: Iterable[float]
    ) -> dict[str, Any]:
        """Pose, size and colour of a primitive."""
        position, quaternion = (
            self._made("Vector3", "xyz", place),
            self._made("Quaternion", "xyzw", turn),
        )
        return {
            "pose": self._kinds.Pose(position=position, orientation=quaternion),
            "size": self._made("Vector3", "xyz", size),
            "color": self._made("Color", "rgba", colour),
        }

    def _sphere(self, place: Any, diameter: float, colour: Iterable[float]) -> Any:
        return self._kinds.SpherePrimitive(**self._body(place, _LEVEL, [diameter] * 3, colour))

    def _uav(self, uav: dict[str, Any]) -> Any:
        chosen = COLOURS[look(self._scenario.uav_ids.index(uav["id"])).colour]
        colour = (*(int(chosen[at : at + 2], 16) / 255 for at in (1, 3, 5)), 1.0)
        sphere = self._sphere(uav["pose"][:3], _UAV_M, colour)
        return self._kinds.SceneEntity(frame_id=_WORLD, id=f"uav{uav['id']}", spheres=[sphere])

    def _obstacles(self, since_s: float) -> Any:
        kinds, bodies = self._kinds, self._scenario.world.bodies
        places = self._scenario.world.body_positions(since_s)
        spheres, cubes, cylinders = [], [], []
        for body, place in zip(bodies, places, strict=True):
            if body.kind == "sphere":
                spheres.append(self._sphere(place, 2.0 * body.keep_out_m, _KEEP_OUT))
                continue
            drawn = body.drawn(_WITHOUT_END_M)
            keys = self._body(
                drawn.centre - body.position + place, drawn.quaternion, drawn.size, _KEEP_OUT
            )
            if body.kind == "cylinder":
                cylinders.append(kinds.CylinderPrimitive(bottom_scale=1.0, top_scale=1.0, **keys))
            else:
                cubes.append(kinds.CubePrimitive(**keys))
        return kinds.SceneEntity(
            frame_id=_WORLD, id="obstacles", spheres=spheres, cubes=cubes, cylinders=cylinders
        )
