# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Conversion between messages and records or estimates; no other part builds or reads a message.

Live topics use the message classes of rosbags too: nodes publish and receive serialised bytes, so
a live run and a replay share every conversion.
"""

from dataclasses import dataclass
from struct import Struct
from typing import Any

from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.messages.definitions import OTHER_PACKAGES
from fej_slam_ros.ros.messages.usual_cdr import decode_cloud, decode_odometry

_TYPES = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in OTHER_PACKAGES.items():
    _TYPES.register(get_types_from_msg(_text, _name))
#: Bytes of the header of CDR data that states its encoding; sec and nanosec follow it.
_ENCAPSULATION = 4
_STAMP = Struct('<iI')

#: Faster deserialisers of the usual messages in the usual encoding.
_DECODERS = {'nav_msgs/msg/Odometry': decode_odometry, 'sensor_msgs/msg/PointCloud2': decode_cloud}

#: A message of rosbags' type store; ``__msgtype__`` is its type name.
Message = Any


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A serialised message from a topic or a bag."""

    topic: str  #: its name without leading slash
    type_name: str  #: of the message, such as ``nav_msgs/msg/Odometry``
    #: time of reception or recording [ns]; None while simulated time has not begun
    received: int | None
    raw: bytes  #: its CDR bytes


def prepare(type_name: str) -> None:
    """Load the definition of a type, which would delay its first message."""
    _TYPES.get_msgdef(type_name)


def serialize(message: Message) -> bytes:
    """Return the CDR bytes of a message."""
    return bytes(_TYPES.serialize_cdr(message, message.__msgtype__))


def deserialize(raw: bytes, type_name: str) -> Message:
    """Return the message in CDR bytes."""
    message = _DECODERS[type_name](raw) if type_name in _DECODERS else None
    return _TYPES.deserialize_cdr(raw, type_name) if message is None else message


def decoded(raw: bytes, type_name: str) -> Message | None:
    """Return the message in CDR bytes, None if they are truncated."""
    try:
        return deserialize(raw, type_name)
    # The deserialiser raises errors of many types.
    except Exception:  # noqa: BLE001
        return None


def decoded_as(arrived: RawMessage, type_name: str) -> Message | None:
    """Return an arrived message, None if it has another type or is truncated."""
    return decoded(arrived.raw, type_name) if arrived.type_name == type_name else None


def stamp_of(raw: bytes) -> int:
    """Return the stamp [ns] in little-endian CDR bytes of a message that begins with a header."""
    sec, nanosec = _STAMP.unpack_from(raw, _ENCAPSULATION)
    return int(sec) * NS + int(nanosec)


def restamped(raw: bytes, stamp: int) -> bytes:
    """Return the same bytes with another stamp [ns]."""
    end = _ENCAPSULATION + _STAMP.size
    return raw[:_ENCAPSULATION] + _STAMP.pack(*divmod(stamp, NS)) + raw[end:]


def is_known(type_name: str) -> bool:
    """Return whether messages of a type can be converted and stored."""
    return type_name in _TYPES.types


def definition(type_name: str) -> tuple[str, str]:
    """Return the message definition and the RIHS01 hash of a type, as stored in bags."""
    text, _ = _TYPES.generate_msgdef(type_name, ros_version=2)
    return text, _TYPES.hash_rihs01(type_name)
