# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Input that the estimator rejects, by reason, with the cures."""

from collections.abc import Iterator, Mapping

from fej_slam_ros.core.rejections import RejectionReason as Reason
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.ros.doctor.findings import error, Finding, most_frequent, seconds, Severity
from fej_slam_ros.ros.doctor.survey import ObservationSeries, Survey, TopicSeries
from fej_slam_ros.ros.doctor.trial import Trial


#: Description of rejected input by reason, and what the user can do.
CURES: Mapping[Reason, tuple[str, str]] = {
    Reason.NOT_FINITE: (
        'NaN or infinity', 'do not publish missing measurements: omit the point or message'),
    Reason.OUT_OF_RANGE: (
        'implausibly large numbers, or variances outside 1e-12 to 1e12',
        'give metres and m^2, and all zero if a covariance is unknown'),
    Reason.WRONG_FRAME: (
        'frame of another robot or sensor',
        'set frame_id to {robot}/base_link, or set {robot}.sensor_frame and {robot}.sensor_pose'),
    Reason.TILTED: (
        'tilt of more than 0.2 rad', 'give the pose in the plane: x ahead, z up (REP-103)'),
    Reason.BAD_QUATERNION: (
        'quaternion whose norm is not 1', 'normalise it; orientation.w is 1 without rotation'),
    Reason.BAD_COVARIANCE: (
        'covariance that is not positive definite',
        'give a positive definite covariance, or all zero if unknown'),
    Reason.BAD_CLOUD: (
        'point cloud with invalid fields',
        'give x and y as float32 or float64, id as an integer, and matching sizes'),
    Reason.BAD_ID: (
        'ID below -1 or outside int32', 'number landmarks from 0, and use -1 for unknown'),
    Reason.BAD_MESSAGE: (
        'truncated message, or message of another type',
        'record it again, with the type of the topic'),
    Reason.BAD_STAMP: (
        'stamp with nanosec of a second or more', 'fill sec and nanosec from one clock reading'),
    Reason.DUPLICATE_ID: (
        'ID that is twice in a scan, so both observations are rejected',
        'give each landmark its own ID, and report it once per scan'),
    Reason.BEFORE_CHECKPOINT: (
        'input older than the checkpoint remembers', 'leave the parameter restore empty'),
    Reason.LEFT: (
        'message of a robot that is no longer in `robots`', 'add the robot to robots'),
    Reason.NO_IDENTITY: ('observation without ID', 'choose another filter than ideal'),
    Reason.DUPLICATE: (
        'repeated message', 'record each topic once, from one publisher'),
    Reason.CONFLICTING: (
        'odometry that differs from an earlier message of the same stamp',
        'publish the topic from one node, with a new stamp for each message'),
    Reason.BEFORE_ODOMETRY: (
        'scan before the first odometry', 'start odometry before the detector'),
    Reason.AFTER_ODOMETRY: (
        'scan after the last odometry',
        'record odometry to the end, and stamp scans by the same clock'),
    Reason.LATE: (
        'message that arrives after later ones were processed',
        'raise max_delay (now {max_delay:g} s), or shorten the transport of the messages'),
    Reason.FUTURE: (
        'stamp further ahead of reception than future_limit',
        'set the clock of the robot, or use_sim_time for simulated time'),
    Reason.BEFORE_TIME_JUMP: (
        'message from before a time jump', 'record without playing in a loop'),
    Reason.UNKNOWN_ROBOT: (
        'ID of no robot of the team',
        'set <robot>.id of each robot to its ID in these clouds'),
    Reason.SELF_OBSERVATION: (
        'observation of the robot itself',
        'set {robot}.id to its own ID, and <robot>.id of the others to theirs'),
    Reason.OTHER_ROBOT_STALE: (
        'observation of a robot without odometry at that time',
        'record the odometry of the observed robot without gaps, by one clock'),
    Reason.ALREADY_LOCATED: (
        'set_pose for a robot that is already in `map`', 'set the pose before the robot joins'),
    Reason.DOES_NOT_FIT: (
        'set_pose that contradicts the observations', 'give the pose of the robot in map'),
    Reason.NOT_JOINED: (
        'observation of a robot that has not moved since the last one',
        'move the observed robot, so that the observations determine its heading'),
}

#: Reasons that lose no data, or only data that most recordings lose too.
HARMLESS_REASONS = {
    Reason.DUPLICATE, Reason.BEFORE_ODOMETRY, Reason.AFTER_ODOMETRY, Reason.ALREADY_LOCATED,
    Reason.OTHER_ROBOT_STALE, Reason.NOT_JOINED}
#: Reasons that occur at the begin and end of every recording, and the number of rejections up to
#: which they are not reported.
BOUNDARY_REASONS = {Reason.BEFORE_ODOMETRY, Reason.AFTER_ODOMETRY, Reason.OTHER_ROBOT_STALE}
MAX_BOUNDARY_REJECTIONS = 5
#: Share of the messages of a topic above which rejections are neither usual nor harmless.
MAX_HARMLESS_SHARE = 0.2
#: Name of the finding of a time jump.
TIME_JUMP = 'time_jump'


def check(survey: Survey, trial: Trial, settings: Settings) -> Iterator[Finding]:
    """Yield one finding for each topic and reason of rejected input, and for a time jump."""
    for (topic, reason), count in sorted(trial.rejected.items()):
        series = survey.topics.get(topic)
        limit = MAX_HARMLESS_SHARE * (len(series.stamps) if series is not None else count)
        if reason is Reason.AFTER_TIME_JUMP or _is_usual(reason, count, limit, trial):
            continue
        robot = topic.partition('/')[0]
        what, cure = CURES[reason]
        is_harmless = reason in HARMLESS_REASONS and (reason is Reason.DUPLICATE or count < limit)
        often = 'once' if count == 1 else f'{count} times'
        yield Finding(
            Severity.WARNING if is_harmless else Severity.ERROR, reason.value, topic,
            f'{what}, {often}{_detail(reason, series)}',
            cure.format(robot=robot, max_delay=settings.max_delay), count,
            trial.first[topic, reason])
    jump = trial.inputs.time_jump_detector.jump
    if jump is not None:
        yield error(
            TIME_JUMP, 'all robots',
            f'time jumps back by {seconds(jump.by)}, and all later input is rejected',
            'record without playing in a loop, cut the bag there, or set on_time_jump: reset',
            trial.estimator.statistics.total(Reason.AFTER_TIME_JUMP), jump.end)


def _is_usual(reason: Reason, count: int, limit: float, trial: Trial) -> bool:
    """Return whether a bag without problems has as many rejections for a reason."""
    if reason is Reason.NOT_JOINED:
        return not trial.estimator.groups.not_in_map
    return reason in BOUNDARY_REASONS and count <= MAX_BOUNDARY_REJECTIONS and count < limit


def _detail(reason: Reason, topic: TopicSeries | None) -> str:
    """Return the rejected frames or IDs of scans."""
    if not isinstance(topic, ObservationSeries):
        return ''
    if reason is Reason.WRONG_FRAME:
        return f': {most_frequent(topic.frames)}'
    if reason is Reason.UNKNOWN_ROBOT:
        return f' (observed IDs: {", ".join(map(str, sorted(topic.id_counts())[:8]))})'
    return ''
