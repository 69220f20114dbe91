# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Which part of the map the filter works in, see :mod:`fej_slam_ros.core.compression`.

That depends on the estimate and on what is seen, never on a clock, so that it is the same whenever
the same data comes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.compression import Compressed
from fej_slam_ros.core.covariance import Indices
from fej_slam_ros.core.state import JointState, Variable


#: A region is worth it in a state that is so many times as large.
WORTH_IT = 4


@dataclass(frozen=True)
class Regions:
    """
    Regions around the robots.

    Parameters
    ----------
    from_states : joint states of so many states have one, smaller ones are worked on as a whole
    landmarks : around each robot so many landmarks are in it

    """

    from_states: float
    landmarks: int

    def attend(self, state: JointState, seen: Indices) -> None:
        """Enter another region if something that is seen, given by its states, is outside."""
        covariance = state.covariance
        if isinstance(covariance, Compressed) and covariance.holds(seen):
            return
        n = state.whole().dimension
        if n >= self.from_states:
            region = self._around(state, seen)
            # It is carried twice, itself and its ghost.
            if n > WORTH_IT * len(region):
                state.enter(region)

    def _around(self, state: JointState, seen: Indices) -> Indices:
        landmarks = [*state.landmarks.values()]
        there = state.positions(landmarks)
        points = state.x_hat[there]
        near = [seen.ravel()]
        for robot in state.robots.values():
            away = np.hypot(*(points - state.x_hat[state.positions([robot])]).T)
            nearest = np.argpartition(away, min(self.landmarks, len(away) - 1))[:self.landmarks]
            near.append(there[nearest].ravel())
        always: Sequence[Variable] = [*state.robots.values(), *state.places.values()]
        near += [variable.slot.indices for variable in always]
        return np.unique(np.concatenate(near))


#: The joint state is always worked on as a whole, or around the robots where that is faster.
EVERYWHERE = Regions(np.inf, 0)
AROUND = Regions(600, 25)
