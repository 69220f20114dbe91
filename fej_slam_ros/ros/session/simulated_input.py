# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the node ``simulator``: records of a simulation, stamped with the present time."""

from collections.abc import Callable, Iterator
from dataclasses import replace

from fej_slam_ros.core.geometry import between
from fej_slam_ros.core.records import NS, Odometry
from fej_slam_ros.detection.records import AnyRecord, measured_at, RobotLaserScan
from fej_slam_ros.ros.messages import outgoing, RawMessage, serialize
from fej_slam_ros.ros.session.simulation import FIRST_STAMP, Simulation


def messages(simulated: Simulation, now: Callable[[], int] | None) -> Iterator[RawMessage]:
    """
    Yield the messages of the records, each received at its simulated time.

    Odometry has the mean velocity since the message before, which records and bags do not have.

    Parameters
    ----------
    now : returns the present time [ns], from which the stamps begin; None: simulated time

    """
    begin = None if now is None else now()
    newest: dict[str, Odometry] = {}
    for record in simulated.records():
        stamped = record if begin is None else in_real_time(record, begin, simulated.speed)
        topic, message = outgoing.input_message(stamped, simulated.robot_ids)
        if isinstance(stamped, Odometry):
            before = newest.get(stamped.robot)
            newest[stamped.robot] = stamped
            if before is not None:
                dt = (stamped.stamp - before.stamp) / NS
                message = outgoing.moving(message, between(before.pose, stamped.pose) / dt)
        yield RawMessage(topic, message.__msgtype__, measured_at(record), serialize(message))


def in_real_time(record: AnyRecord, begin: int, speed: float) -> AnyRecord:
    """Return a record of the world that begins at a time [ns] and moves faster by a factor."""
    stamp = begin + round((record.stamp - FIRST_STAMP) / speed)
    if isinstance(record, Odometry) and record.twist_covariance is not None:
        covariance = record.twist_covariance * speed**2
        return replace(record, stamp=stamp, twist_covariance=covariance)
    if isinstance(record, RobotLaserScan):
        increment = record.scan.time_increment / speed
        return replace(record, stamp=stamp, scan=replace(record.scan, time_increment=increment))
    return replace(record, stamp=stamp)
