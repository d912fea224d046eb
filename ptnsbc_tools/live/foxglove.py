"""The live view for Foxglove: its own server, with the scene, the frames of the bodies and the numbers of every UAV."""

from __future__ import annotations

from types import TracebackType
from typing import Any

from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools.library.optional import required
from ptnsbc_tools.live.server import HOST, LiveServerError
from ptnsbc_tools.plotting.chart import COLOURS, look

_WORLD = "map"
_UAV_M = 0.4
_WITHOUT_END_M = 100.0  # of planes and endless cylinders
_KEEP_OUT = (0.5, 0.5, 0.5, 0.35)  # red, green, blue, opacity


class FoxgloveSink:
    """Publishes every frame; use it as a context manager.

    Topics: `/scene` (foxglove.SceneUpdate), `/tf` (foxglove.FrameTransforms), `/formation/live` (JSON: the frame).

    Args:
        scenario: what is flown.
        port: of the server, on this host alone.

    Raises:
        PtnsbcError: foxglove-sdk is not installed, or the port is taken.
    """

    def __init__(self, scenario: Scenario, port: int) -> None:
        self._scenario = scenario
        self._sdk = required("foxglove", "--foxglove", "foxglove")
        self._kinds = required("foxglove.messages", "--foxglove", "foxglove")
        channels = required("foxglove.channels", "--foxglove", "foxglove")
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._server.stop()

    def __call__(self, frame: dict[str, Any]) -> None:
        """Publish a frame."""
        self._numbers.log(frame)
        flying = [uav for uav in frame["uavs"] if uav["pose"] is not None]
        kinds = self._kinds
        turns = [
            kinds.FrameTransform(
                parent_frame_id=_WORLD,
                child_frame_id=f"uav{uav['id']}/base_link",
                translation=kinds.Vector3(**dict(zip("xyz", uav["pose"][:3], strict=True))),
                rotation=kinds.Quaternion(**dict(zip("xyzw", uav["pose"][3:], strict=True))),
            )
            for uav in flying
        ]
        self._frames.log(kinds.FrameTransforms(transforms=turns))
        entities = [self._uav(uav) for uav in flying]
        since_s = max(float(frame.get("t") or 0.0), 0.0)
        self._scene.log(kinds.SceneUpdate(entities=[*entities, self._obstacles(since_s)]))

    def _sphere(self, place: Any, diameter: float, colour: tuple[float, ...]) -> Any:
        kinds = self._kinds
        x, y, z = map(float, place)
        return kinds.SpherePrimitive(
            pose=kinds.Pose(
                position=kinds.Vector3(x=x, y=y, z=z), orientation=kinds.Quaternion(w=1.0)
            ),
            size=kinds.Vector3(x=diameter, y=diameter, z=diameter),
            color=kinds.Color(**dict(zip("rgba", colour, strict=True))),
        )

    def _uav(self, uav: dict[str, Any]) -> Any:
        chosen = COLOURS[look(self._scenario.uav_ids.index(uav["id"])).colour]
        colour = (*(int(chosen[at : at + 2], 16) / 255 for at in (1, 3, 5)), 1.0)
        return self._kinds.SceneEntity(
            frame_id=_WORLD,
            id=f"uav{uav['id']}",
            spheres=[self._sphere(uav["pose"][:3], _UAV_M, colour)],
        )

    def _obstacles(self, since_s: float) -> Any:
        kinds, found = self._kinds, self._scenario.world.bodies
        places = self._scenario.world.body_positions(since_s)
        spheres, cubes, cylinders = [], [], []
        for one, place in zip(found, places, strict=True):
            drawn = one.drawn(_WITHOUT_END_M)
            if one.kind == "sphere":
                spheres.append(self._sphere(place, 2.0 * one.keep_out_m, _KEEP_OUT))
                continue
            centre = drawn.centre - one.position + place
            keys = {
                "pose": kinds.Pose(
                    position=kinds.Vector3(**dict(zip("xyz", map(float, centre), strict=True))),
                    orientation=kinds.Quaternion(
                        **dict(zip("xyzw", drawn.quaternion, strict=True))
                    ),
                ),
                "size": kinds.Vector3(**dict(zip("xyz", map(float, drawn.size), strict=True))),
                "color": kinds.Color(**dict(zip("rgba", _KEEP_OUT, strict=True))),
            }
            if one.kind == "cylinder":
                cylinders.append(kinds.CylinderPrimitive(bottom_scale=1.0, top_scale=1.0, **keys))
            else:
                cubes.append(kinds.CubePrimitive(**keys))
        return kinds.SceneEntity(
            frame_id=_WORLD, id="obstacles", spheres=spheres, cubes=cubes, cylinders=cylinders
        )
