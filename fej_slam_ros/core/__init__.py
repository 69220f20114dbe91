# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Estimation and smoothing for a team of robots, without ROS: the public Python API.

The names in ``__all__`` are documented in docs/api.md and stay until 2.0.0; all others may change.
The sub-packages use numpy, scipy and the standard library only: no I/O, clock, logging or
randomness.
"""

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import SmoothedMap, SmoothedTrajectory, solve, TeamMap
from fej_slam_ros.core.estimates import (
    FrameMap, LandmarkEstimate, PoseEstimate, RelativePose, StepResult)
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import (
    Observation, Odometry, PosePrior, PriorMap, RobotObservation, RobotScan, Scan, TrueLandmarks,
    TruePose)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import RobotSettings, Settings

__all__ = [
    'Estimator', 'FrameMap', 'LandmarkEstimate', 'Observation', 'Odometry', 'PoseEstimate',
    'PosePrior', 'PriorMap', 'Rejection', 'RejectionReason', 'RelativePose', 'RobotObservation',
    'RobotScan', 'RobotSettings', 'Scan', 'Settings', 'SmoothedMap', 'SmoothedTrajectory',
    'StepResult', 'TeamMap', 'TeamSmoother', 'TrueLandmarks', 'TruePose', 'solve']
