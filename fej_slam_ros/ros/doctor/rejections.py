# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator refuses, under the names that users see, with the cures."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.ros.doctor.findings import ERROR, Finding, most_often, seconds, WARNING
from fej_slam_ros.ros.doctor.survey import ObservationSeries, Survey
from fej_slam_ros.ros.doctor.trial import Trial


class Reason(NamedTuple):
    """What is refused, and the cure."""

    what: str
    cure: str


CURES: Mapping[RejectionReason, Reason] = {
    RejectionReason.NOT_FINITE: Reason(
        'NaN or infinity', 'do not publish what was not measured: leave the point or message out'),
    RejectionReason.OUT_OF_RANGE: Reason(
        'numbers that no measurement has, or variances beyond 1e-12 to 1e12',
        'give metres and m^2, and all zero where a covariance is unknown'),
    RejectionReason.WRONG_FRAME: Reason(
        'a frame that is not of this robot',
        'set frame_id to {robot}/base_link or the child_frame_id of its odometry; of a sensor,'
        ' name it in {robot}.sensor_frame and tell its place in {robot}.sensor_pose'),
    RejectionReason.TILTED: Reason(
        'a tilt of more than 0.2 rad', 'give the pose in the plane: x ahead, z up (REP-103)'),
    RejectionReason.BAD_QUATERNION: Reason(
        'a quaternion whose norm is not 1',
        'set orientation.w to 1 where there is no turn, and normalise'),
    RejectionReason.BAD_COVARIANCE: Reason(
        'a covariance that is not positive definite',
        'give variances above 0 and a covariance that they allow, or all zero where unknown'),
    RejectionReason.BAD_CLOUD: Reason(
        'a cloud whose fields do not fit',
        'give x and y as float32 or float64, id as an integer, and sizes that belong to them'),
    RejectionReason.BAD_ID: Reason(
        'a number below -1 or beyond int32', 'number landmarks from 0 on, -1 for unknown'),
    RejectionReason.BAD_MESSAGE: Reason(
        'a message of another type, or cut short', 'record it anew, with the type of the topic'),
    RejectionReason.BAD_STAMP: Reason(
        'a stamp of a second of nanoseconds or more', 'fill sec and nanosec of one time'),
    RejectionReason.DUPLICATE_ID: Reason(
        'one number twice in a scan, so that both are lost',
        'give each landmark a number of its own, and report each once in a scan'),
    RejectionReason.BEFORE_CHECKPOINT: Reason(
        'what an earlier run may have had', 'leave the parameter restore empty'),
    RejectionReason.LEFT: Reason('data of who has left', 'name the robot in robots'),
    RejectionReason.NO_IDENTITY: Reason('ids of -1', 'choose another filter than ideal'),
    RejectionReason.DUPLICATE: Reason(
        'messages that came before', 'record each topic once, from one publisher'),
    RejectionReason.CONFLICTING: Reason(
        'odometry that differs from that of the same stamp',
        'let one node publish the topic, with a new stamp for each message'),
    RejectionReason.BEFORE_ODOMETRY: Reason(
        'scans from before the first odometry', 'start odometry before the detector'),
    RejectionReason.AFTER_ODOMETRY: Reason(
        'scans from after the last odometry',
        'record odometry to the end, and stamp scans by the same clock'),
    RejectionReason.LATE: Reason(
        'data that came after the time for it',
        'raise max_delay (now {max_delay:g} s), or make the way of the messages shorter'),
    RejectionReason.FUTURE: Reason(
        'stamps further ahead of their reception than future_limit',
        'set the clock of the robot, or use_sim_time where time is simulated'),
    RejectionReason.BEFORE_TIME_JUMP: Reason(
        'data of before a time jump', 'record without playing in a loop'),
    RejectionReason.UNKNOWN_ROBOT: Reason(
        "numbers that are no robot's",
        'set <robot>.id of each robot to its number in these clouds'),
    RejectionReason.SELF_OBSERVATION: Reason(
        'observations of itself', 'set {robot}.id to its own number, and <robot>.id of the others'),
    RejectionReason.OTHER_ROBOT_STALE: Reason(
        'observations of a robot whose odometry does not reach there',
        'record the odometry of who is seen without gaps, by one clock'),
    RejectionReason.ALREADY_LOCATED: Reason(
        'a place of who has one', 'tell it before the robot has joined'),
    RejectionReason.DOES_NOT_FIT: Reason('a place that does not fit', 'tell where the robot is, in map'),
    RejectionReason.NOT_JOINED: Reason(
        'observations of a robot that has not moved since the last',
        'let the one that is seen move, so that the observations tell its heading'),
}

#: Nothing is lost by these, or little that is usual.
HARMLESS = {
    RejectionReason.DUPLICATE, RejectionReason.BEFORE_ODOMETRY, RejectionReason.AFTER_ODOMETRY, RejectionReason.ALREADY_LOCATED,
    RejectionReason.OTHER_ROBOT_STALE, RejectionReason.NOT_JOINED}
#: Every recording begins and ends with some of these: so few are nothing.
AT_THE_ENDS = {RejectionReason.BEFORE_ODOMETRY, RejectionReason.AFTER_ODOMETRY, RejectionReason.OTHER_ROBOT_STALE}
FEW = 5
TIME_JUMP = 'time_jump'
#: But for so many of the messages of a topic.
MANY = 0.2


def check(survey: Survey, trial: Trial, settings: Settings) -> Iterator[Finding]:
    """Yield what the estimator has refused, each reason of each topic once."""
    for (topic, reason), count in sorted(trial.rejected.items()):
        told = survey.topics.get(topic)
        many = MANY * (len(told.stamps) if told is not None else count)
        if reason is RejectionReason.AFTER_TIME_JUMP or _is_usual(reason, count, many, trial):
            continue
        robot = topic.partition('/')[0]
        what, cure = CURES[reason]
        is_harmless = reason in HARMLESS and (reason is RejectionReason.DUPLICATE or count < many)
        detail = _detail(reason, told) if isinstance(told, ObservationSeries) else ''
        often = 'once' if count == 1 else f'{count} times'
        yield Finding(
            WARNING if is_harmless else ERROR, reason.value, topic, f'{what}, {often}{detail}',
            cure.format(robot=robot, max_delay=settings.max_delay), count,
            trial.first[topic, reason])
    jump = trial.inputs.time_jump_detector.jump
    if jump is not None:
        yield Finding(
            ERROR, TIME_JUMP, 'all robots',
            f'time jumps back by {seconds(jump.by)}, and all that comes then is refused',
            'record without playing in a loop, cut the bag there, or set on_time_jump: reset',
            trial.estimator.statistics.total(RejectionReason.AFTER_TIME_JUMP), jump.end)


def _is_usual(reason: RejectionReason, count: int, many: float, trial: Trial) -> bool:
    """Return whether a bag without faults has so many refusals for a reason, too."""
    if reason is RejectionReason.NOT_JOINED:
        return not trial.estimator.not_in_map
    return reason in AT_THE_ENDS and count <= FEW and count < many


def _detail(reason: RejectionReason, topic: ObservationSeries) -> str:
    if reason is RejectionReason.WRONG_FRAME:
        return f': {most_often(topic.frames)}'
    if reason is RejectionReason.UNKNOWN_ROBOT:
        numbers = sorted({number for scan in topic.ids for number in scan.tolist()})
        return f' (numbers there: {", ".join(map(str, numbers[:8]))})'
    return ''
