# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Change of a joint state into the frame of one of its robots.

The origin of a frame is a past pose of a robot. Drift before the robot's first observation rotates
its whole map; in the frame of its present pose that uncertainty cancels.
"""

import numpy as np
from scipy.sparse import csr_array

from fej_slam_ros.core import models
from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.ekf.linearization import Linearization
from fej_slam_ros.core.ekf.state import JointState, observation_columns, Robot
from fej_slam_ros.core.geometry import Array, between


def in_frame_of(state: JointState, robot: Robot, linearization: Linearization) -> JointState:
    """
    Return a joint state in the frame of one of its robots, whose pose is then exactly zero.

    The change is linearised like an observation of all variables by this robot. The given state is
    not changed.

    """
    variables = state.variables()
    J = np.zeros((len(state.x_hat), len(state.x_hat)))
    columns = observation_columns([robot] * len(variables), variables)
    points = linearization.observation_points(state, columns)
    for variable, H in zip(variables, KERNEL.H(points)):
        slot = variable.slot
        position, heading = slice(slot.start, slot.start + 2), slice(slot.start + 2, slot.stop)
        J[position, position] = H[:, 3:]
        J[position, robot.slot.start:robot.slot.stop] += H[:, :3]
        if isinstance(variable, Robot):
            J[heading, heading] = 1.0
            J[heading, robot.slot.start + 2] -= 1.0
    # J has five entries per row; for a large map the dense product would take seconds.
    sparse = csr_array(J)
    P: Array = sparse @ (sparse @ state.marginal(variables)).T
    covariance = Covariance()
    covariance.insert(P)
    x_hat, x_first = (
        np.concatenate([np.empty(0), *(
            _in_frame(value_of(robot), value_of(variable)) for variable in variables)])
        for value_of in (state.estimate, state.first_estimate))
    return JointState(variables, x_hat, x_first, covariance)


def _in_frame(pose: Array, value: Array) -> Array:
    """Return a pose (3,) or point (2,) in the frame of a pose (3,)."""
    if len(value) == len(pose):
        return between(pose, value)
    local: Array = models.h(pose[None], value[None])[0]
    return local
