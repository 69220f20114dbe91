# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Which part of the map the filter works in, see :mod:`fej_slam_ros.core.ekf.compressed_covariance`.

That depends on the estimate and on what is seen, never on a clock, so that it is the same whenever
the same data comes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.ekf.compressed_covariance import CompressedCovariance
from fej_slam_ros.core.ekf.state import JointState, Variable
from fej_slam_ros.core.geometry import Indices


#: A region is worth it in a state that is so many times as large.
WORTH_IT = 4


@dataclass(frozen=True)
class ActiveSubmap:
    """
    Regions around the robots.

    Parameters
    ----------
    from_states : joint states of so many states have one, smaller ones are worked on as a whole
    landmarks : around each robot so many landmarks are in it

    """

    from_states: float
    landmarks: int

    def ensure_contains(self, state: JointState, seen: Indices) -> None:
        """
        Enter another region where this one is not what is worked in any more.

        Parameters
        ----------
        state : whose region it is
        seen : indices of the states of what is seen, which are in it in the end

        """
        covariance = state.covariance
        if (isinstance(covariance, CompressedCovariance)
                and covariance.holds(seen) and not covariance.is_outgrown()):
            return
        n = state.whole().dimension
        if n >= self.from_states and len(state.landmarks) > self.landmarks:
            region = self._around(state, seen)
            # It is carried twice, itself and its ghost.
            if n > WORTH_IT * len(region):
                state.enter(region)

    def _around(self, state: JointState, seen: Indices) -> Indices:
        landmarks = [*state.landmarks.values()]
        there = state.positions(landmarks)
        robots = [*state.robots.values()]
        x, y = state.x_hat[there].T
        x_robot, y_robot = state.x_hat[state.positions(robots)].T[:, :, None]
        away = (x - x_robot) ** 2 + (y - y_robot) ** 2
        nearest = there[np.argpartition(away, self.landmarks)[:, :self.landmarks]]
        region = np.zeros(len(state.x_hat), np.bool_)
        region[nearest] = region[seen] = True
        always: Sequence[Variable] = [*robots, *state.places.values()]
        for variable in always:
            region[variable.slot.start:variable.slot.stop] = True
        return np.flatnonzero(region)


#: The joint state is always worked on as a whole, or around the robots where that is faster.
WHOLE_MAP = ActiveSubmap(np.inf, 0)
AROUND_ROBOTS = ActiveSubmap(500, 25)
