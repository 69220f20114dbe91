# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Places where robots of different frames saw each other, by which the frames join.

Where the seen robot is at that moment both frames know: its own by its pose, that of the seer by
the sighting. So both keep it, like a landmark that nobody will see again. A few of them, from
where the robot was at different times, tell how one frame lies in the other.
"""

from collections.abc import Iterable

import numpy as np

from fej_slam_ros.core.filter import Filter
from fej_slam_ros.core.records import PlaceKey, RobotSighting
from fej_slam_ros.core.state import JointState

#: So many places of one robot seen by another are kept, the newest.
MAX_PLACES = 20


def meet(seer: Filter, seen: Filter, key: PlaceKey, sighting: RobotSighting) -> bool:
    """
    Let two frames keep the place where a robot of the one sees a robot of the other.

    Parameters
    ----------
    seer, seen : the filters of the two frames, in which both robots are at the stamp of the key
    key : who sees whom, and when
    sighting : what is seen

    Returns
    -------
    bool
        Whether that was done: not where the seen robot has moved, since the last place, by less
        than a sighting can tell.

    """
    robot = seen.state.robots[key.seen]
    here = seen.state.estimate(robot)[:2]
    kept = [
        place for place in seen.state.places.values()
        if (place.key.seer, place.key.seen) == (key.seer, key.seen)]
    if kept:
        moved = here - seen.state.estimate(kept[-1])
        if moved @ moved < np.linalg.eigvalsh(sighting.R)[-1]:
            return False
    for place in kept[:-MAX_PLACES + 1]:
        forget([place.key], (seer.state, seen.state))
    seen.state.augment_place(key, robot, here, np.eye(2, 3), np.zeros((2, 2)))
    seer.start_place(key, sighting)
    return True


def places_of(robot: str, states: Iterable[JointState]) -> list[PlaceKey]:
    """Return the places where a robot saw or was seen."""
    keys = [key for state in states for key in state.places if robot in (key.seer, key.seen)]
    return [*dict.fromkeys(keys)]


def forget(keys: Iterable[PlaceKey], states: Iterable[JointState]) -> None:
    """Marginalise places out of all frames."""
    for state in states:
        for key in keys:
            if key in state.places:
                state.remove(state.places[key])
