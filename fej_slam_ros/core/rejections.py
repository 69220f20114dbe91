# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reasons for the rejection of input, with the names that all reports use."""

from dataclasses import dataclass
from enum import Enum


class RejectionReason(str, Enum):
    """Reason for the rejection of a message or observation; the value is its reported name."""

    NOT_FINITE = 'not_finite'
    OUT_OF_RANGE = 'out_of_range'
    WRONG_FRAME = 'wrong_frame'
    TILTED = 'tilted'
    BAD_QUATERNION = 'bad_quaternion'
    BAD_COVARIANCE = 'bad_covariance'
    BAD_CLOUD = 'bad_cloud'
    TOO_LARGE = 'too_large'
    BAD_ID = 'bad_id'
    BAD_MESSAGE = 'bad_message'
    BAD_STAMP = 'bad_stamp'
    DUPLICATE_ID = 'duplicate_id'
    NO_IDENTITY = 'no_identity'
    DUPLICATE = 'duplicate'
    CONFLICTING = 'conflicting'
    BEFORE_ODOMETRY = 'before_odometry'
    AFTER_ODOMETRY = 'after_odometry'
    LATE = 'late'
    BEFORE_CHECKPOINT = 'before_checkpoint'
    FUTURE = 'future'
    BEFORE_TIME_JUMP = 'before_time_jump'
    AFTER_TIME_JUMP = 'after_time_jump'
    GATED = 'gated'
    MOVED_LANDMARK = 'moved_landmark'
    LOST_ROBOT = 'lost_robot'
    IMPOSSIBLE_MOTION = 'impossible_motion'
    UNKNOWN_ROBOT = 'unknown_robot'
    SELF_OBSERVATION = 'self_sighting'
    DOUBTFUL_MATCH = 'doubtful_match'
    TOO_MANY_NEW = 'too_many_new'
    MAP_FULL = 'map_full'
    OVERLOAD = 'overload'
    INTERRUPTED = 'interrupted'
    OTHER_ROBOT_STALE = 'other_robot_stale'
    ALREADY_LOCATED = 'already_located'
    DOES_NOT_FIT = 'does_not_fit'
    NOT_JOINED = 'not_joined'
    LEFT = 'left'


@dataclass(frozen=True, slots=True)
class Rejection:
    """One rejected message or observation."""

    robot: str  #: name of the robot that sent it
    stamp: int  #: its stamp [ns]
    reason: RejectionReason  #: reason for the rejection
    id: int | None = None  #: ID of the landmark or robot if a single observation was rejected
    #: d2, threshold: squared Mahalanobis distance and its limit if a gate rejected it
    d2: float | None = None
    threshold: float | None = None
    delay: int | None = None  #: lag behind the newest odometry of the team [ns] if it was late
    observed: str | None = None  #: name of the observed robot of a robot-to-robot observation
