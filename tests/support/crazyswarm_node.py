"""A stand-in of Crazyswarm2's server: its messages by their names and fields, and what a bridge asks of it."""

from types import ModuleType, SimpleNamespace

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Pose, Twist, Vector3
from std_msgs.msg import Header


class FullState:
    """As `crazyflie_interfaces/msg/FullState`."""

    def __init__(self):
        self.header, self.pose, self.twist, self.acc = Header(), Pose(), Twist(), Vector3()

    @classmethod
    def get_fields_and_field_types(cls):
        types = (
            "std_msgs/Header",
            "geometry_msgs/Pose",
            "geometry_msgs/Twist",
            "geometry_msgs/Vector3",
        )
        return dict(zip(("header", "pose", "twist", "acc"), types, strict=True))


class VelocityWorld:
    """As `crazyflie_interfaces/msg/VelocityWorld`."""

    def __init__(self):
        self.header, self.vel, self.yaw_rate = Header(), Vector3(), 0.0

    @classmethod
    def get_fields_and_field_types(cls):
        return {"header": "std_msgs/Header", "vel": "geometry_msgs/Vector3", "yaw_rate": "float"}


class _Planned:
    """The request of `crazyflie_interfaces/srv/Takeoff` and `Land`."""

    def __init__(self):
        self.group_mask, self.height, self.duration = 0, 0.0, Duration()


class _Stop:
    """That of `crazyflie_interfaces/srv/NotifySetpointsStop`."""

    def __init__(self):
        self.group_mask, self.remain_valid_millisecs = 0, 0


MODULES = {
    name: ModuleType(name) for name in ("crazyflie_interfaces.msg", "crazyflie_interfaces.srv")
}
MODULES["crazyflie_interfaces.msg"].FullState = FullState
MODULES["crazyflie_interfaces.msg"].VelocityWorld = VelocityWorld
for _name, _request in {
    "Takeoff": _Planned,
    "Land": _Planned,
    "NotifySetpointsStop": _Stop,
}.items():
    setattr(MODULES["crazyflie_interfaces.srv"], _name, SimpleNamespace(Request=_request))
MODULES["crazyflie_interfaces"] = ModuleType("crazyflie_interfaces")


class _Client:
    def __init__(self, name, server):
        self.srv_name, self._server = name, server

    def service_is_ready(self):
        return True

    def call_async(self, request):
        self._server.called.append((self.srv_name, request))
        answer = SimpleNamespace(result=object)  # an answer without fields
        answer.add_done_callback = lambda function: self._server.asked(function, answer)
        return answer


class Server:
    """A node in the place of the bridge's; it answers every call at once, or the newest one when it is told to."""

    answers = True
    offered = ("tf2_msgs/msg/TFMessage",)  # types of the poses

    def __init__(self):
        self.sent, self.called, self.pose, self.output = [], [], "", ""

    def create_subscription(self, _kind, topic, *_rest, **_more):
        self.pose = topic
        return SimpleNamespace(get_publisher_count=lambda: 1)

    def create_publisher(self, _kind, topic, *_rest, **_more):
        self.output = topic
        return SimpleNamespace(publish=self.sent.append, get_subscription_count=lambda: 1)

    def get_publishers_info_by_topic(self, _topic):
        return [SimpleNamespace(topic_type=one) for one in self.offered]

    def create_client(self, _kind, name):
        return _Client(name, self)

    def asked(self, function, answer):
        self._answer = function, answer
        if self.answers:
            function(answer)

    def answer(self, message):
        """Refuse the newest call."""
        function, answer = self._answer
        answer.result = lambda: SimpleNamespace(success=False, message=message)
        function(answer)

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: Time(sec=7)))
