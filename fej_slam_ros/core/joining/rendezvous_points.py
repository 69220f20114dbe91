# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Rendezvous points: positions of robots observed from another frame, which relate the two frames.

When a robot is observed from another frame, its position is known in both: in its own frame by its
pose, in the observer's by the observation. Both states keep it like a landmark that is never
observed again. A few such points determine the pose of one frame in the other.
"""

from collections.abc import Iterable

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.records import RendezvousKey, RobotObservation

#: Rendezvous points kept for each pair of observer and observed robot; the oldest is dropped.
MAX_RENDEZVOUS_POINTS = 20


def add_rendezvous_point(
    observer: Filter, observed: Filter, key: RendezvousKey, observation: RobotObservation
) -> bool:
    """
    Add the position of an observed robot to the states of both frames.

    The two filters have predicted their robots to the stamp of the key. Returns False, and adds
    nothing, if the observed robot has moved by less than the noise of the observation since the
    last point.

    """
    robot = observed.state.robots[key.observed]
    position = observed.state.estimate(robot)[:2]
    earlier = [
        point for point in observed.state.rendezvous_points.values()
        if (point.key.observer, point.key.observed) == (key.observer, key.observed)]
    if earlier:
        moved = position - observed.state.estimate(earlier[-1])
        if moved @ moved < np.linalg.eigvalsh(observation.R)[-1]:
            return False
    marginalize(
        [point.key for point in earlier[:-MAX_RENDEZVOUS_POINTS + 1]],
        (observer.state, observed.state))
    F = models.F(observed.linearization.offset(observed.state, robot, key, position))
    observed.state.augment_rendezvous_point(key, robot, position, F, np.zeros((2, 2)))
    observer.start_rendezvous_point(key, observation)
    return True


def rendezvous_keys_of(robot: str, states: Iterable[JointState]) -> list[RendezvousKey]:
    """Return the keys of the points at which a robot was observer or observed."""
    keys = [
        key for state in states for key in state.rendezvous_points
        if robot in (key.observer, key.observed)]
    return [*dict.fromkeys(keys)]


def marginalize(keys: Iterable[RendezvousKey], states: Iterable[JointState]) -> None:
    """Marginalise rendezvous points out of the states that have them."""
    removed = [*keys]
    for state in states:
        state.remove_all([
            state.rendezvous_points[key] for key in removed if key in state.rendezvous_points])
