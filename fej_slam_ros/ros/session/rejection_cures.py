# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Input that is rejected, by reason: what it is, and what the user can do."""

from fej_slam_ros.core.rejections import RejectionReason as Reason
from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.ros.topic_types import INITIALPOSE

#: Description of rejected input by reason, and what the user can do.
CURES: dict[Reason, tuple[str, str]] = {
    Reason.NOT_FINITE: (
        'NaN or infinity', 'do not publish missing measurements: omit the point or message'),
    Reason.OUT_OF_RANGE: (
        'implausibly large number, or variance outside 1e-12 to 1e12',
        'give metres and m^2, and all zero if a covariance is unknown'),
    Reason.WRONG_FRAME: (
        'frame of another robot or sensor',
        ('set frame_id to {robot}/base_link, set {robot}.sensor_frame and {robot}.sensor_pose, or'
         ' publish the mount of the sensor on /tf_static (with tf_topics: robot, on'
         ' /{robot}/tf_static)')),
    Reason.TILTED: (
        'tilt of more than 0.2 rad', 'give the pose in the plane: x ahead, z up (REP-103)'),
    Reason.BAD_QUATERNION: (
        'quaternion whose norm is not 1', 'normalise it; orientation.w is 1 without rotation'),
    Reason.BAD_COVARIANCE: (
        'covariance that is not positive definite', 'correct it, or give all zero if unknown'),
    Reason.BAD_CLOUD: (
        'point cloud with invalid fields', 'give x and y as floats, id as int32, and its sizes'),
    Reason.TOO_LARGE: (
        'scan of more points than max_observations', (
            'publish landmarks instead of a raw cloud, or raise max_observations (now'
            ' {max_observations})')),
    Reason.BAD_ID: (
        'ID below -1 or outside int32', 'number landmarks from 0, and use -1 for unknown'),
    Reason.BAD_MESSAGE: (
        'truncated message, or message of another type', 'publish whole ones of the right type'),
    Reason.BAD_STAMP: (
        'stamp with nanosec of a second or more', 'fill sec and nanosec from one clock reading'),
    Reason.DUPLICATE_ID: (
        'ID that is twice in a scan', 'give each landmark its own ID, reported once per scan'),
    Reason.BEFORE_CHECKPOINT: (
        'input older than the checkpoint remembers', 'leave the parameter restore empty'),
    Reason.LEFT: (
        'message of a robot that is no longer in `robots`', 'add the robot to robots'),
    Reason.NO_IDENTITY: (
        'observation without ID, or of no landmark of the map', (
            'give IDs, which filter ideal and node smoother need; fej_slam smooth matches'
            ' observations without')),
    Reason.DUPLICATE: ('repeated message', 'record each topic once, from one publisher'),
    Reason.CONFLICTING: (
        'different odometry at one stamp', 'publish from one node, with a new stamp each time'),
    Reason.BEFORE_ODOMETRY: (
        'scan before the first odometry',
        'start odometry before the detector, and use one clock for all stamps'),
    Reason.AFTER_ODOMETRY: (
        'scan after the last odometry', 'record all odometry, and use one clock for all stamps'),
    Reason.LATE: (
        'message after later ones were processed', (
            'raise max_delay (now {max_delay:g} s), or, if its stamps are seconds behind those of'
            ' other robots, set its clock')),
    Reason.FUTURE: (
        'stamp beyond future_limit, or far ahead of the odometry before and after it',
        'set the clock of the robot, or use_sim_time in simulation; raise future_limit for a bag'),
    Reason.BEFORE_TIME_JUMP: (
        'message from before a time jump', 'record without playing in a loop'),
    Reason.UNKNOWN_ROBOT: (
        'ID of no robot of the team', 'set <robot>.id of each robot to its ID in these clouds'),
    Reason.SELF_OBSERVATION: (
        'observation of the robot itself', 'set {robot}.id, and <robot>.id of the others'),
    Reason.TOO_MANY_NEW: (
        'scan with more new landmarks without ID than may be started',
        'let the detector report less clutter'),
    Reason.MAP_FULL: (
        'new landmark beyond max_landmarks', 'raise max_landmarks, or check the IDs'),
    Reason.OTHER_ROBOT_STALE: (
        'observed robot without odometry at that time',
        'record its odometry without gaps, unless it was off'),
    Reason.ALREADY_LOCATED: (
        'set_pose for a robot that joined `map` at the same step', 'give the pose again'),
    Reason.DOES_NOT_FIT: (
        'set_pose that contradicts the observations', 'give the pose of the robot in map'),
    Reason.IMPOSSIBLE_MOTION: (
        'motion that no robot can have driven', (
            'give metres, radians (yaw in degrees?) and seconds, from one driver without resets;'
            ' raise {robot}.max_speed or {robot}.max_turn_rate for a faster robot')),
    Reason.NOT_JOINED: (
        'repeated observation of a robot at rest', 'move it, to determine its heading'),
}

#: The same where they are other ones for poses on ``set_pose`` or `INITIALPOSE`.
CURES_OF_PRIORS: dict[Reason, tuple[str, str]] = {
    Reason.WRONG_FRAME: (
        'pose that is not in the frame of the map',
        'give it in the frame of the parameter map_frame, the fixed frame of RViz'),
    Reason.BAD_COVARIANCE: (
        'covariance that is not positive definite',
        'give the variances of x, y and yaw, all of them above zero'),
}

#: What ignores the covariance of recorded odometry, too.
IGNORE = '{robot}.use_odometry_covariance to false, to use odometry_sigma'
#: The same for odometry.
CURES_OF_ODOMETRY: dict[Reason, tuple[str, str]] = {
    Reason.NOT_FINITE: (
        'NaN or infinity',
        f'do not publish missing measurements; if only twist.covariance has them, set {IGNORE}'),
    Reason.OUT_OF_RANGE: (
        'implausibly large number, or variance above 1e12',
        f'give metres, and all zero if the covariance is unknown, or set {IGNORE}'),
    Reason.BAD_COVARIANCE: (
        'covariance that is not positive definite',
        f'correct twist.covariance, give all zero if unknown, or set {IGNORE}'),
}


def description_and_cure(topic: str, reason: Reason, settings: CommonSettings) -> tuple[str, str]:
    """Return what the rejected input on a topic is, and the cure; '' where there is none."""
    of_topic = {}
    if topic == INITIALPOSE or topic.endswith('/set_pose'):
        of_topic = CURES_OF_PRIORS
    elif topic.endswith('/odom'):
        of_topic = CURES_OF_ODOMETRY
    what, cure = (CURES | of_topic).get(reason, ('', ''))
    return what, cure.format(
        robot=topic.partition('/')[0], max_delay=settings.max_delay,
        max_observations=settings.max_observations)
