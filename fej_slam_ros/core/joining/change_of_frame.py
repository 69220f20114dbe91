# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A joint state in the frame of one of its robots.

Where a frame begins is where a robot happened to be first. What that robot did until it saw
something turns all of its map alike; seen from where it is now, nothing of that is left.
"""

import numpy as np
from scipy.sparse import csr_array

from fej_slam_ros.core import models
from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.linearization import Linearization
from fej_slam_ros.core.ekf.state import JointState, observation_columns, Robot
from fej_slam_ros.core.geometry import Array, between


def in_frame_of(state: JointState, robot: Robot, linearization: Linearization) -> JointState:
    """
    Return a state in the frame of a robot, which is at its origin for certain.

    Parameters
    ----------
    state : the state, which is not changed
    robot : of it
    linearization : where the change of frames is linearised, as if everything had been sighted

    """
    variables = state.variables()
    pose = state.estimate(robot)
    x, J = [np.empty(0)], np.zeros((len(state.x_hat), len(state.x_hat)))
    sighted = observation_columns([robot] * len(variables), variables)
    poses, points = linearization.observation_points(state, sighted)
    for variable, H in zip(variables, models.H(poses, points)):
        place, value = variable.slot, state.estimate(variable)
        position, heading = slice(place.start, place.start + 2), slice(place.start + 2, place.stop)
        J[position, position] = H[:, 3:]
        J[position, robot.slot.start:robot.slot.stop] += H[:, :3]
        if isinstance(variable, Robot):
            x.append(between(pose, value))
            J[heading, heading] = 1.0
            J[heading, robot.slot.start + 2] -= 1.0
        else:
            x.append(models.h(pose[None], value[None])[0])
    # Five entries a row: of a large map the dense product would take seconds.
    sparse = csr_array(J)
    P: Array = sparse @ (sparse @ state.marginal(variables)).T
    covariance = Covariance()
    covariance.insert(P)
    x_hat = np.concatenate(x)
    return JointState(variables, x_hat, x_hat.copy(), covariance)
