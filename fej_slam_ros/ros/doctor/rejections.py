# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Input that the estimator rejects, by reason, with the cures."""

from collections.abc import Iterator

from fej_slam_ros.core.rejections import RejectionReason as Reason
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.ros.doctor.findings import error, error_if, Finding, most_frequent, seconds
from fej_slam_ros.ros.doctor.survey import ObservationSeries, Survey, TopicSeries
from fej_slam_ros.ros.doctor.trial import Trial
from fej_slam_ros.ros.session.rejection_cures import description_and_cure

#: Reasons that occur at the begin and end of every recording, reported only above this number.
BOUNDARY_REASONS = {Reason.BEFORE_ODOMETRY, Reason.AFTER_ODOMETRY, Reason.OTHER_ROBOT_STALE}
MAX_BOUNDARY_REJECTIONS = 5
#: Reasons that lose no data, or only data that most recordings lose too.
HARMLESS_REASONS = {
    *BOUNDARY_REASONS, Reason.DUPLICATE, Reason.ALREADY_LOCATED, Reason.NOT_JOINED}
#: Share of the messages of a topic above which rejections are neither usual nor harmless.
MAX_HARMLESS_SHARE = 0.2
TIME_JUMP = 'time_jump'


def check(survey: Survey, trial: Trial, settings: Settings) -> Iterator[Finding]:
    """Yield one finding for each topic and reason of rejected input, and for a time jump."""
    for (topic, reason), count in sorted(trial.rejected.items()):
        series = survey.topics.get(topic)
        limit = MAX_HARMLESS_SHARE * (len(series.stamps) if series is not None else count)
        if reason is Reason.AFTER_TIME_JUMP or _is_usual(reason, count, limit, trial):
            continue
        what, cure = description_and_cure(topic, reason, settings)
        is_harmless = reason in HARMLESS_REASONS and (reason is Reason.DUPLICATE or count < limit)
        yield error_if(not is_harmless)(
            reason.value, topic,
            f'{what}: {count} rejected' + _detail(topic, reason, series, trial), cure, count,
            trial.first[topic, reason])
    jump = trial.inputs.time_jump_detector.jump
    if jump is not None:
        yield error(
            TIME_JUMP, 'all robots',
            f'time jumps back by {seconds(jump.length)}, and all later input is rejected',
            'record without playing in a loop, cut the bag there, or set on_time_jump: reset',
            trial.estimator.statistics.total(Reason.AFTER_TIME_JUMP), jump.end)


def _is_usual(reason: Reason, count: int, limit: float, trial: Trial) -> bool:
    """Return whether a bag without problems has as many rejections for a reason."""
    if reason is Reason.NOT_JOINED:
        return not trial.estimator.groups.not_in_map
    return reason in BOUNDARY_REASONS and count <= MAX_BOUNDARY_REJECTIONS and count < limit


def _detail(topic: str, reason: Reason, series: TopicSeries | None, trial: Trial) -> str:
    if reason is Reason.OTHER_ROBOT_STALE:
        return f', of {most_frequent(trial.stale[topic])}'
    if not isinstance(series, ObservationSeries):
        return ''
    if reason is Reason.WRONG_FRAME:
        return f', frames {most_frequent(series.frames)}'
    if reason is Reason.UNKNOWN_ROBOT:
        return f', observed IDs {", ".join(map(str, sorted(series.id_counts)[:8]))}'
    return ''
