"""The modules of ROS that are made here, and what each of them has."""

from __future__ import annotations

import importlib
import sys
import time
import types
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from rospy_stand_in import actionlib, genpy, images, node, transformations, transforms
from rospy_stand_in.genpy import message_class, service_class

FOLDERS: dict[str, Path] = {}
"""The ROS packages around the program, by name."""

ROS_PACKAGES = frozenset(
    {"catkin", "catkin_pkg", "dynamic_reconfigure", "mavros", "mavros_msgs", "rosbag", "roslaunch"}
    | {"rosnode", "rosservice", "rostest", "rostopic", "smach", "smach_ros", "tf2_geometry_msgs"}
    | {"tf2_py", "tf2_sensor_msgs"}
)
"""Packages of ROS that are neither here nor on the package index."""


def public(module: types.ModuleType) -> dict[str, Any]:
    return {name: value for name, value in vars(module).items() if not name.startswith("_")}


def copied(name: str, values: Mapping[str, Any]) -> types.ModuleType:
    """A module of that name with those values."""
    module = types.ModuleType(name)
    module.__dict__.update({key: value for key, value in values.items() if key[:2] != "__"})
    return module


_GENPY = {"Time": genpy.RosTime, "Duration": genpy.RosDuration, "Message": genpy.RosMessage}


def _rospy() -> dict[str, Any]:
    found = public(node) | {"__path__": []}
    found |= _GENPY
    found["Header"] = message_class("std_msgs/Header")
    exceptions = {name: value for name, value in found.items() if name.endswith("Exception")}
    times = ("Time", "Duration", "get_time", "get_rostime")
    inner = {
        "exceptions": exceptions,
        "service": exceptions | {"ServiceProxy": node.ServiceProxy, "Service": node.Service},
        "rostime": {name: found[name] for name in times} | {"wallsleep": time.sleep},
        "topics": {name: found[name] for name in ("Publisher", "Subscriber", "Topic")},
        "core": found,
        "client": found,
        "timer": {name: found[name] for name in ("Rate", "Timer", "TimerEvent", "sleep")},
        "msg": {"AnyMsg": node.AnyMsg},
        "numpy_msg": {"numpy_msg": lambda kind: kind},
        "names": {"resolve_name": node.resolve_name},
    }
    for name, values in inner.items():
        module = sys.modules[f"rospy.{name}"] = copied(f"rospy.{name}", values)
        found.setdefault(name, module)
    return found


def _actionlib() -> dict[str, Any]:
    return public(actionlib) | {"GoalStatus": actionlib.GoalStateNames}


class _RosPack:
    """Where the packages of the workspace are."""

    def get_path(self, name: str) -> str:
        if name not in FOLDERS:
            raise LookupError(f"there is no package {name} around this program")
        return str(FOLDERS[name])

    def list(self) -> Iterable[str]:
        return list(FOLDERS)


def _tf() -> dict[str, Any]:
    names = ("LookupException", "ConnectivityException", "ExtrapolationException", "Exception")
    return {
        **dict.fromkeys((*names, "TransformException"), transforms.TransformException),
        "__path__": [],
        "TransformListener": transforms.TransformListener,
        "TransformBroadcaster": transforms.TransformBroadcaster,
        "transformations": importlib.import_module("tf.transformations"),
    }


def _tf2_ros() -> dict[str, Any]:
    return _tf() | {
        "TransformListener": transforms.Tf2Listener,
        "TransformBroadcaster": transforms.Tf2Broadcaster,
        "StaticTransformBroadcaster": transforms.StaticBroadcaster,
        "Buffer": transforms.Buffer,
    }


def _rosparam() -> dict[str, Any]:
    def upload(namespace: str, values: Mapping[str, Any]) -> None:
        for key, value in values.items():
            node.set_param(f"{namespace.rstrip('/')}/{key}", value)

    names = ("get_param", "set_param", "delete_param")
    return {name: getattr(node, name) for name in names} | {"upload_params": upload}


MADE: dict[str, Callable[[], dict[str, Any]]] = {
    "rospy": _rospy,
    "actionlib": lambda: _actionlib() | {"__path__": []},
    "actionlib.simple_action_client": lambda: _actionlib(),
    "cv_bridge": lambda: {"CvBridge": images.CvBridge, "CvBridgeError": images.CvBridgeError},
    "genpy": lambda: {**_GENPY, "SerializationError": genpy.SerializationError},
    "message_filters": lambda: public(images),
    "tf": _tf,
    "tf.transformations": lambda: public(transformations),
    "tf2_ros": _tf2_ros,
    "tf_conversions": lambda: {"transformations": importlib.import_module("tf.transformations")},
    "roslib": lambda: {
        "load_manifest": lambda *_: None,
        "message": types.SimpleNamespace(
            get_message_class=message_class, get_service_class=service_class
        ),
        "packages": types.SimpleNamespace(get_pkg_dir=_RosPack().get_path),
    },
    "rosgraph": lambda: {"is_master_online": lambda *_: True},
    "rosparam": _rosparam,
    "rospkg": lambda: {"RosPack": _RosPack, "ResourceNotFound": LookupError},
}
"""Modules that are made here, and their names."""
