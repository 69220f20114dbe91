# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Choice of the active submap, see :mod:`fej_slam_ros.core.ekf.compressed_covariance`.

It depends on the estimate and the observed landmarks only, so that equal input gives equal bits.
"""

from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.ekf.compressed_covariance import CompressedCovariance
from fej_slam_ros.core.ekf.outside_points import OutsidePoints, TurningPoints
from fej_slam_ros.core.ekf.state import JointState, position_indices, Variable
from fej_slam_ros.core.geometry import Indices

#: Minimum ratio of the joint state to the submap. The filter carries the submap twice, with its
#: proxy states, so that with half of the joint state nothing would be gained.
MIN_STATE_RATIO = 4
#: Updates of the whole map before a submap is looked for again, if the robots were too far apart.
RETRY_UPDATES = 50


@dataclass(frozen=True)
class ActiveSubmap:
    """
    Rule by which the filter works on the landmarks around the robots only.

    Parameters
    ----------
    min_states : size of the joint state from which a submap is used
    landmarks_per_robot : number of nearest landmarks of each robot in the submap

    """

    min_states: float
    landmarks_per_robot: int

    def ensure_contains(
        self, state: JointState, observed: Indices, turns_points: bool, may_end: bool = False
    ) -> None:
        """
        Let observed states enter the active submap, or re-centre it if that pays.

        Parameters
        ----------
        state : its covariance becomes that of a submap, or of all states if there are few
        observed : indices of the observed states, in any shape
        turns_points : whether corrections turn points with robots, as of the linearisation policy
        may_end : whether to raise EndedError, and change nothing, if the process ends meanwhile

        """
        if isinstance(state.covariance, CompressedCovariance):
            x_hat = state.covariance.with_states(observed, state.x_hat)
            if x_hat is not None:
                state.x_hat = x_hat
                return
        whole = state.whole(may_end)
        if (whole.dimension < self.min_states
                or len(state.landmarks) <= self.landmarks_per_robot):
            return
        if whole.updates_without_submap:
            whole.updates_without_submap -= 1
            return
        submap = self._around_robots(state, observed)
        if submap is None:
            whole.updates_without_submap = RETRY_UPDATES
        else:
            outside = OutsidePoints() if not turns_points else TurningPoints(
                state.landmark_positions(),
                [landmark.rotation_owner for landmark in state.landmarks.values()],
                len(whole.matrix.lower))
            state.covariance = CompressedCovariance(whole, submap, outside)

    def _around_robots(self, state: JointState, observed: Indices) -> Indices | None:
        """
        Return the indices of robots, rendezvous points, observed and nearest landmarks.

        Returns None if there are too many for a submap.

        """
        in_submap = np.zeros(len(state.x_hat), np.bool_)
        in_submap[observed] = True
        robots = [*state.robots.values()]
        always: list[Variable] = [*robots, *state.rendezvous_points.values()]
        for variable in always:
            in_submap[variable.slot.start:variable.slot.stop] = True
        count, landmarks = self.landmarks_per_robot, state.landmark_positions()
        x, y = state.x_hat[landmarks].T
        for x_robot, y_robot in state.x_hat[position_indices(robots)].tolist():
            d2 = (x - x_robot) ** 2 + (y - y_robot) ** 2
            in_submap[landmarks[np.argpartition(d2, count)[:count]]] = True
            # A large team is often spread over the whole map, which a few robots show.
            if MIN_STATE_RATIO * np.count_nonzero(in_submap) >= len(in_submap):
                return None
        return np.flatnonzero(in_submap)


WHOLE_MAP = ActiveSubmap(np.inf, 0)
#: From 500 states on a step in a submap is faster, with few landmarks at the start fastest.
AROUND_ROBOTS = ActiveSubmap(500, 10)
