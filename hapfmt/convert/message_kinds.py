"""Channels -> topics: which channels share a message, and of which type of ROS it is.

The channels of a topic have one rate, one coverage and one device, so each message holds a sample
of all of them. Vectors, joints and some single numbers have types of ROS. All others share a type
of their own, with a field for each channel.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import product

import numpy as np

from ..recording import Channel, Recording, Span
from .own import restored_counts
from .ros_types import TOPICS

OWN_KIND = "hapfmt_msgs/msg/Samples"
_NAME_LIMIT = 255
"""Characters of the name of a topic."""
_FIELDS = 1000
"""Channels of a message of our own type."""
_SLICE = 1 << 18
_SURE_BITS = 40
"""Physical values give the counts back if their offset is below 2^40 counts."""
_WORDS = re.compile(r"[^0-9a-z]+")
_JOINT = re.compile(r"(.+)\.(position|velocity|effort)", re.S)
_JOINT_UNITS = {
    "position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "effort": ("N.m", "N"),
}  # fmt: skip
_PARTS = re.compile(
    r"(^|[._ /-])(force|torque|position|orientation|linear_acceleration|angular_velocity|linear"
    r"|angular)$"
)

_QUANTITIES = {
    "N": "force", "N.m": "torque", "m": "position", "m/s": "velocity", "rad/s": "velocity",
    "m/s2": "acceleration", "rad/s2": "acceleration", "T": "magnetic field", "1": "orientation",
}  # fmt: skip
"""By unit."""

_VECTORS: tuple[tuple[str, tuple[tuple[str, str, str], ...]], ...] = (
    (
        "sensor_msgs/msg/Imu",
        (
            ("linear_acceleration", "m/s2", "xyz"),
            ("angular_velocity", "rad/s", "xyz"),
            ("orientation", "1", "xyzw"),
        ),
    ),
    (
        "sensor_msgs/msg/Imu",
        (("linear_acceleration", "m/s2", "xyz"), ("angular_velocity", "rad/s", "xyz")),
    ),
    (
        "geometry_msgs/msg/PoseStamped",
        (("pose.position", "m", "xyz"), ("pose.orientation", "1", "xyzw")),
    ),
    (
        "geometry_msgs/msg/WrenchStamped",
        (("wrench.force", "N", "xyz"), ("wrench.torque", "N.m", "xyz")),
    ),
    (
        "geometry_msgs/msg/TwistStamped",
        (("twist.linear", "m/s", "xyz"), ("twist.angular", "rad/s", "xyz")),
    ),
    (
        "geometry_msgs/msg/AccelStamped",
        (("accel.linear", "m/s2", "xyz"), ("accel.angular", "rad/s2", "xyz")),
    ),
    ("geometry_msgs/msg/PointStamped", (("point", "m", "xyz"),)),
    ("geometry_msgs/msg/QuaternionStamped", (("quaternion", "1", "xyzw"),)),
    ("sensor_msgs/msg/MagneticField", (("magnetic_field", "T", "xyz"),)),
)
"""Types with vectors (path, unit, axes), the largest first."""

_SINGLES = {
    ("Pa", "pressure"): ("sensor_msgs/msg/FluidPressure", "fluid_pressure"),
    ("Cel", "temperature"): ("sensor_msgs/msg/Temperature", "temperature"),
    ("lx", "illuminance"): ("sensor_msgs/msg/Illuminance", "illuminance"),
}
_CONSTANTS = {"orientation_covariance[0]": -1.0}
"""An Imu says by it that it has no orientation."""


@dataclass(frozen=True)
class WrittenTopic:
    """A topic and its channels: their numbers, and the paths of their values in a message.

    ``joints``: their names. ``fields``: (type, name) of the fields of a type of our own.
    """

    name: str
    kind: str
    rate: Fraction
    spans: tuple[Span, ...]
    device: str
    channels: tuple[int, ...]
    paths: tuple[str, ...]
    joints: tuple[str, ...] = ()
    fields: tuple[tuple[str, str], ...] = ()
    constants: Mapping[str, float] = field(default_factory=dict)


def holds_counts(channel: Channel) -> bool:
    """Whether the physical values, as doubles, do not give the counts back."""
    calibration = channel.calibration
    if calibration is None or channel.exact is not None:
        return False
    if channel.stored.dtype.itemsize <= 4 and abs(calibration.b) < abs(calibration.a) << _SURE_BITS:
        return False
    for first in range(0, channel.stored.size, _SLICE):
        counts = channel.stored[first : first + _SLICE]
        back = restored_counts(calibration.physical(counts), calibration, counts.dtype)
        if back is None or not np.array_equal(back, counts):
            return True
    return False


def number_type(channel: Channel) -> str:
    """The type of ROS that holds the values of a channel exactly."""
    if holds_counts(channel):
        return "int32" if channel.stored.dtype in ("i1", "i2", "i4", "u1", "u2") else "int64"
    if channel.calibration is not None:
        return "float64"
    known = {"float16": "float32", "float32": "float32", "int64": "int64", "uint64": "uint64"}
    return known.get(channel.stored.dtype.name, "float64")


def topics_of(recording: Recording, *, standard: bool) -> list[WrittenTopic]:
    """The topics of a recording. ``standard``: with types of ROS where they fit."""
    types = [number_type(channel) for channel in recording.channels]
    groups: dict[tuple[Fraction, tuple[Span, ...], str, str], list[int]] = {}
    names = _topic_names(recording)
    for number, channel in enumerate(recording.channels):
        topic = names.get(channel.label, "")
        key = (channel.rate_exact, channel.coverage, channel.device, topic)
        groups.setdefault(key, []).append(number)
    taken = {"/events": 1}
    found = []
    own = 0
    for (rate, spans, device, topic), members in groups.items():
        left = list(members)
        if standard:
            fitting = [number for number in members if types[number].startswith("float")]
            for kind, channels, places, joints in _standard(recording, fitting):
                title = topic or f"/{_title(recording, channels, kind)}"
                constants = _CONSTANTS if "Imu" in kind and len(channels) == 6 else {}
                found.append(
                    WrittenTopic(
                        _unused(title, taken), kind, rate, spans, device, tuple(channels),
                        tuple(places), tuple(joints), (), constants,
                    )
                )  # fmt: skip
                used = set(channels)
                left = [number for number in left if number not in used]
        for first in range(0, len(left), _FIELDS):
            some = left[first : first + _FIELDS]
            paths = field_names([recording.channels[number].label for number in some])
            own += 1
            kind = OWN_KIND + (str(own) if own > 1 else "")
            title = topic or f"/{_title(recording, some, 'samples')}"
            found.append(
                WrittenTopic(
                    _unused(title, taken), kind, rate, spans, device, tuple(some),
                    tuple(paths), (), tuple(zip([types[n] for n in some], paths, strict=True)),
                )
            )  # fmt: skip
    return found


def _topic_names(recording: Recording) -> dict[str, str]:
    """By label, from the metadata of a recording of a bag; {} where they are something else."""
    found = recording.metadata.get(TOPICS)
    return {
        label: name
        for name, labels in (found.items() if isinstance(found, dict) else ())
        if isinstance(labels, list) and 0 < len(name) <= _NAME_LIMIT and _is_text(name)
        for label in labels
        if isinstance(label, str)
    }


def _standard(
    recording: Recording, members: Sequence[int]
) -> Iterator[tuple[str, list[int], list[str], list[str]]]:
    """Type, channels, paths and joints of what has a type of ROS."""
    channels = recording.channels
    stems: dict[str, dict[tuple[str, str], list[int]]] = {}
    for number in members:
        one = channels[number]
        if one.axis in ("x", "y", "z", "w") and one.quantity in (
            "",
            _QUANTITIES.get(one.unit, one.quantity),
        ):
            stem = stems.setdefault(_PARTS.sub("", one.group), {})
            stem.setdefault((one.unit, one.axis), []).append(number)
    for places in stems.values():
        held = {key: numbers[0] for key, numbers in places.items() if len(numbers) == 1}
        units = {unit for unit, _ in held}
        others = [
            ("geometry_msgs/msg/Vector3Stamped", (("vector", unit, "xyz"),))
            for unit in sorted(units)
        ]
        for kind, vectors in (*_VECTORS, *others):
            keys = [(unit, axis) for _, unit, axes in vectors for axis in axes]
            if all(key in held for key in keys):
                paths = [f"{path}.{axis}" for path, _, axes in vectors for axis in axes]
                yield kind, [held.pop(key) for key in keys], paths, []
    joints: dict[str, dict[str, int]] = {}
    twice = False
    for number in members:
        one = channels[number]
        match = _JOINT.fullmatch(one.label)
        if match and not one.axis and one.unit in _JOINT_UNITS[match[2]] and _is_text(match[1]):
            own = joints.setdefault(match[1], {})
            twice |= match[2] in own
            own[match[2]] = number
    kinds = [frozenset(own) for own in joints.values()]
    if joints and not twice and len(set(kinds)) == 1:
        used = [kind for kind in _JOINT_UNITS if kind in kinds[0]]
        order = list(product(used, enumerate(joints)))
        yield (
            "sensor_msgs/msg/JointState",
            [joints[name][kind] for kind, (_, name) in order],
            [f"{kind}[{place}]" for kind, (place, _) in order],
            list(joints),
        )
    for (unit, quantity), (kind, path) in _SINGLES.items():
        alone = [n for n in members if (channels[n].unit, channels[n].quantity) == (unit, quantity)]
        if len(alone) == 1 and channels[alone[0]].axis not in ("x", "y", "z", "w"):
            yield kind, alone, [path], []


def _is_text(name: str) -> bool:
    """Whether a message can hold it."""
    return "\0" not in name and not any("\ud800" <= c <= "\udfff" for c in name)


def field_names(labels: Sequence[str]) -> list[str]:
    """Names of fields of ROS: a to z, 0 to 9 and single underscores."""
    taken = {"header": 1, "timestamp": 1}
    found = []
    for number, label in enumerate(labels, start=1):
        short = _name(label)
        if not short or short[0].isdigit():
            short = f"ch{number}" if not short else f"ch{number}_{short}"
        found.append(_unused(short, taken))
    return found


def _name(text: str) -> str:
    return _WORDS.sub("_", text.lower()).strip("_")[:60].strip("_")


def _unused(name: str, taken: dict[str, int]) -> str:
    """The name with a number behind it that makes it one of its own. ``taken``: names, and the
    last number of each."""
    free = name
    while free in taken:
        taken[name] += 1
        free = f"{name}_{taken[name]}"
    taken[free] = 1
    return free


def _title(recording: Recording, numbers: Sequence[int], kind: str) -> str:
    """The group that the channels share, else their device, else the type."""
    groups = {_PARTS.sub("", recording.channels[number].group) for number in numbers}
    device = recording.channels[numbers[0]].device
    for text in (*(groups if len(groups) == 1 else ()), device):
        name = _name(text)
        if name and not name[0].isdigit():
            return name
    short = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", kind.rpartition("/")[2]).lower()
    return short.removesuffix("_stamped")
