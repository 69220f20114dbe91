# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Places where robots of different frames saw each other, by which the frames join.

Where the seen robot is at that moment both frames know: its own by its pose, that of the seer by
the observation. So both keep it, like a landmark that nobody will see again. A few of them, from
where the robot was at different times, tell how one frame lies in the other.
"""

from collections.abc import Iterable

import numpy as np

from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.records import RendezvousKey, RobotObservation

#: So many places of one robot seen by another are kept, the newest.
MAX_PLACES = 20


def add_rendezvous_point(observer: Filter, seen: Filter, key: RendezvousKey, observation: RobotObservation) -> bool:
    """
    Let two frames keep the place where a robot of the one sees a robot of the other.

    Parameters
    ----------
    seer, seen : the filters of the two frames, in which both robots are at the stamp of the key
    key : who sees whom, and when
    observation : what is seen

    Returns
    -------
    bool
        Whether that was done: not where the seen robot has moved, since the last place, by less
        than an observation can tell.

    """
    robot = seen.state.robots[key.seen]
    here = seen.state.estimate(robot)[:2]
    kept = [
        place for place in seen.state.rendezvous_points.values()
        if (place.key.observer, place.key.seen) == (key.observer, key.seen)]
    if kept:
        moved = here - seen.state.estimate(kept[-1])
        if moved @ moved < np.linalg.eigvalsh(observation.R)[-1]:
            return False
    for place in kept[:-MAX_PLACES + 1]:
        marginalize([place.key], (observer.state, seen.state))
    seen.state.augment_rendezvous_point(key, robot, here, np.eye(2, 3), np.zeros((2, 2)))
    observer.start_rendezvous_point(key, observation)
    return True


def rendezvous_keys_of(robot: str, states: Iterable[JointState]) -> list[RendezvousKey]:
    """Return the places where a robot saw or was seen."""
    keys = [key for state in states for key in state.rendezvous_points if robot in (key.observer, key.seen)]
    return [*dict.fromkeys(keys)]


def marginalize(keys: Iterable[RendezvousKey], states: Iterable[JointState]) -> None:
    """Marginalise places out of all frames."""
    for state in states:
        for key in keys:
            if key in state.rendezvous_points:
                state.remove(state.rendezvous_points[key])
