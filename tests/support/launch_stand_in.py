"""As much of ROS's `launch` and `launch_ros` as our launch files use, with the signatures of Jazzy.

`launch` has no wheel. A keyword that it does not know is refused here too, as is a value of the wrong kind:
what is passed to a process must be text.
"""

from __future__ import annotations

import sys
from types import ModuleType


class LaunchContext:
    def __init__(self):
        self.launch_configurations = {}


class LaunchDescriptionEntity:
    def __init__(self, *, condition=None):
        self.condition = condition

    def visit(self, context):
        if self.condition is None or self.condition.evaluate(context):
            return self.execute(context)
        return None

    def execute(self, context):
        return None


class LaunchDescription:
    def __init__(self, initial_entities=None):
        self.entities = list(initial_entities or [])
        assert all(isinstance(entity, LaunchDescriptionEntity) for entity in self.entities)


class LaunchConfiguration:
    def __init__(self, variable_name, *, default=None):
        self._name, self._default = variable_name, default

    def perform(self, context):
        value = context.launch_configurations.get(self._name, self._default)
        assert isinstance(value, str), f"launch configuration {self._name} does not exist"
        return value


class DeclareLaunchArgument(LaunchDescriptionEntity):
    def __init__(self, name, *, default_value=None, description=None, choices=None, **kwargs):
        super().__init__(**kwargs)
        assert default_value is None or isinstance(default_value, str)
        assert choices is None or default_value in choices
        self.name, self.description, self.choices = name, description, choices
        self.default_value = default_value

    def execute(self, context):
        given = context.launch_configurations.setdefault(self.name, self.default_value)
        if given is None:
            raise RuntimeError(f"Required launch argument '{self.name}' was not provided")
        if self.choices and given not in self.choices:
            raise RuntimeError(f"Argument '{self.name}' provided value '{given}' is not valid")


class OpaqueFunction(LaunchDescriptionEntity):
    def __init__(self, *, function, args=None, kwargs=None, **left):
        super().__init__(**left)
        self._function, self._args, self._kwargs = function, args or (), kwargs or {}

    def execute(self, context):
        return self._function(context, *self._args, **self._kwargs)


def matches_action(target_action):
    return lambda action: action is target_action


class ShutdownProcess:
    def __init__(self, *, process_matcher):
        self.process_matcher = process_matcher


class ProcessExited:
    def __init__(self, *, returncode, **_):
        self.returncode = returncode


class EmitEvent(LaunchDescriptionEntity):
    def __init__(self, *, event, **kwargs):
        super().__init__(**kwargs)
        self.event = event


class OnProcessExit:
    def __init__(self, *, target_action=None, on_exit, handle_once=False):
        assert isinstance(target_action, ExecuteProcess)
        self.target_action, self._on_exit = target_action, on_exit

    def handle(self, event, context):
        if callable(self._on_exit):
            return self._on_exit(event, context)
        return self._on_exit


class RegisterEventHandler(LaunchDescriptionEntity):
    def __init__(self, event_handler, **kwargs):
        super().__init__(**kwargs)
        self.event_handler = event_handler


class ExecuteProcess(LaunchDescriptionEntity):
    def __init__(
        self, *, cmd, name=None, output="log", sigterm_timeout="5", additional_env=None, **kwargs
    ):
        super().__init__(**kwargs)
        assert all(isinstance(word, str) for word in [*cmd, *(additional_env or {}).values()])
        assert isinstance(sigterm_timeout, str)
        self.cmd = cmd


_NODE_KEYWORDS = {"executable", "package", "name", "namespace", "parameters", "remappings"}
_NODE_KEYWORDS |= {"arguments", "ros_arguments", "additional_env", "output", "condition"}
_NODE_KEYWORDS |= {"on_exit", "sigterm_timeout", "sigkill_timeout"}


class Node(LaunchDescriptionEntity):
    def __init__(self, **given):
        unknown = given.keys() - _NODE_KEYWORDS
        if unknown:
            raise TypeError(f"Node: unexpected {', '.join(sorted(unknown))}")
        super().__init__(condition=given.get("condition"))
        self.package, self.executable = given.get("package"), given["executable"]
        self.namespace, self.arguments = given.get("namespace"), list(given.get("arguments") or ())
        self.parameters = given.get("parameters")
        self.sigterm_timeout = given.get("sigterm_timeout", "5")
        assert all(isinstance(word, str) for word in self.arguments), self.arguments
        assert all(isinstance(v, str) for v in given.get("additional_env", {}).values())
        assert isinstance(self.sigterm_timeout, str)
        assert self.parameters is None or isinstance(self.parameters, list)


MODULES = {
    "launch": (LaunchContext, LaunchDescription, LaunchDescriptionEntity),
    "launch.actions": (
        DeclareLaunchArgument,
        EmitEvent,
        ExecuteProcess,
        OpaqueFunction,
        RegisterEventHandler,
    ),
    "launch.event_handlers": (OnProcessExit,),
    "launch.events": (matches_action,),
    "launch.events.process": (ProcessExited, ShutdownProcess),
    "launch.substitutions": (LaunchConfiguration,),
    "launch_ros": (),
    "launch_ros.actions": (Node,),
}


def install(monkeypatch) -> None:
    """Put the stand-ins where `import launch` finds them."""
    for name, kinds in MODULES.items():
        module = ModuleType(name)
        for kind in kinds:
            setattr(module, kind.__name__, kind)
        monkeypatch.setitem(sys.modules, name, module)
