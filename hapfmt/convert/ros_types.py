"""What the numbers of common message types are: their quantity, unit and axis."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple


class NumberMeaning(NamedTuple):
    quantity: str
    unit: str


FORCE, TORQUE = NumberMeaning("force", "N"), NumberMeaning("torque", "N.m")
POSITION, ANGLE = NumberMeaning("position", "m"), NumberMeaning("position", "rad")
VELOCITY, TURNING = NumberMeaning("velocity", "m/s"), NumberMeaning("velocity", "rad/s")
ACCELERATION = NumberMeaning("acceleration", "m/s2")
TURNING_FASTER = NumberMeaning("acceleration", "rad/s2")
ORIENTATION = NumberMeaning("orientation", "1")
DISTANCE = NumberMeaning("position", "m")

MEANINGS = {
    "geometry_msgs/Wrench.force": FORCE,
    "geometry_msgs/Wrench.torque": TORQUE,
    "geometry_msgs/Twist.linear": VELOCITY,
    "geometry_msgs/Twist.angular": TURNING,
    "geometry_msgs/Accel.linear": ACCELERATION,
    "geometry_msgs/Accel.angular": TURNING_FASTER,
    "geometry_msgs/Point": POSITION,
    "geometry_msgs/Point32": POSITION,
    "geometry_msgs/Quaternion": ORIENTATION,
    "geometry_msgs/Transform.translation": POSITION,
    "geometry_msgs/Pose2D.x": POSITION,
    "geometry_msgs/Pose2D.y": POSITION,
    "geometry_msgs/Pose2D.theta": ANGLE,
    "geometry_msgs/Inertia.m": NumberMeaning("mass", "kg"),
    "sensor_msgs/Imu.angular_velocity": TURNING,
    "sensor_msgs/Imu.linear_acceleration": ACCELERATION,
    "sensor_msgs/JointState.position": ANGLE,
    "sensor_msgs/JointState.velocity": TURNING,
    "sensor_msgs/JointState.effort": TORQUE,
    "sensor_msgs/FluidPressure.fluid_pressure": NumberMeaning("pressure", "Pa"),
    "sensor_msgs/Temperature.temperature": NumberMeaning("temperature", "Cel"),
    "sensor_msgs/RelativeHumidity.relative_humidity": NumberMeaning("humidity", "1"),
    "sensor_msgs/Illuminance.illuminance": NumberMeaning("illuminance", "lx"),
    "sensor_msgs/MagneticField.magnetic_field": NumberMeaning("magnetic field", "T"),
    "sensor_msgs/Range.range": DISTANCE,
    "sensor_msgs/Range.min_range": DISTANCE,
    "sensor_msgs/Range.max_range": DISTANCE,
    "sensor_msgs/Range.field_of_view": ANGLE,
    "sensor_msgs/LaserScan.ranges": DISTANCE,
    "sensor_msgs/BatteryState.voltage": NumberMeaning("voltage", "V"),
    "sensor_msgs/BatteryState.current": NumberMeaning("current", "A"),
    "sensor_msgs/BatteryState.temperature": NumberMeaning("temperature", "Cel"),
    "builtin_interfaces/Time": NumberMeaning("", "ns"),
    "builtin_interfaces/Duration": NumberMeaning("", "ns"),
}
"""By a type, or by a field of one; the names of types are those of ROS 1."""

_AXES = {
    "geometry_msgs/Vector3", "geometry_msgs/Point", "geometry_msgs/Point32",
    "geometry_msgs/Quaternion",
}  # fmt: skip

NOT_READ = {
    "sensor_msgs/Image": "images",
    "sensor_msgs/CompressedImage": "images",
    "sensor_msgs/CameraInfo": "parameters of a camera",
    "sensor_msgs/PointCloud": "point clouds",
    "sensor_msgs/PointCloud2": "point clouds",
    "theora_image_transport/Packet": "images",
    "nav_msgs/OccupancyGrid": "maps",
    "nav_msgs/Path": "paths",
    "tf/tfMessage": "transforms",
    "tf2_msgs/TFMessage": "transforms",
    "visualization_msgs/Marker": "drawings",
    "visualization_msgs/MarkerArray": "drawings",
    "audio_common_msgs/AudioData": "coded sound",
    "audio_common_msgs/AudioDataStamped": "coded sound",
    "diagnostic_msgs/DiagnosticArray": "diagnostics",
    "foxglove.CompressedImage": "images",
    "foxglove.CompressedVideo": "images",
    "foxglove.RawImage": "images",
    "foxglove.RawAudio": "coded sound",
    "foxglove.CameraCalibration": "parameters of a camera",
    "foxglove.PointCloud": "point clouds",
    "foxglove.LaserScan": "point clouds",
    "foxglove.FrameTransform": "transforms",
    "foxglove.FrameTransforms": "transforms",
    "foxglove.SceneUpdate": "drawings",
}
"""Types without channels, and what they hold."""

TEXTS = {
    "std_msgs/String": "data",
    "rosgraph_msgs/Log": "msg",
    "rcl_interfaces/Log": "msg",
    "foxglove.Log": "message",
}
"""Types whose messages become events, and the field with the text."""

COVARIANCE = re.compile(r"(^|[._])(covariance|variance)(\[\d+\])*$")
"""Paths of what describes the noise of the other numbers."""

JOINTS = "sensor_msgs/JointState"
TOPICS = "topics"
"""Member of the metadata of a recording: the labels of the channels of each topic."""


def plain(kind: str) -> str:
    """``sensor_msgs/msg/Imu`` -> ``sensor_msgs/Imu``; foxglove.X, foxglove_msgs/msg/X alike."""
    short = kind.replace("/msg/", "/")
    return re.sub(r"^foxglove(?:_msgs/|\.)", "foxglove.", short)


def meaning(owners: Sequence[tuple[str, str]]) -> tuple[NumberMeaning, str]:
    """The meaning and the axis of a number, by the types and fields that lead to it."""
    found, axis = NumberMeaning("", "1"), ""
    if owners and plain(owners[-1][0]) in _AXES:
        axis = owners[-1][1]
    for kind, name in reversed(owners):
        short = plain(kind)
        one = MEANINGS.get(f"{short}.{name}") or MEANINGS.get(short)
        if one is not None:
            found = one
            break
    return found, axis
