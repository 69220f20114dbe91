# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of the trial run: all robots join one map, and observations agree with odometry."""

from collections.abc import Iterator

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.ros.doctor.findings import error, Finding, Severity, warning
from fej_slam_ros.ros.doctor.survey import Survey
from fej_slam_ros.ros.doctor.trial import Trial
from fej_slam_ros.ros.session.diagnostics import NIS_ERROR

#: Upper bounds of the share of observations of mapped landmarks that fail the gate, of a
#: consistent robot and of one whose pose may be right; of correct observations 0.1 % fail.
MAX_GATED_SHARE, MAX_PARTLY_GATED_SHARE = 0.05, 0.2
#: Minimum number of gate failures of one landmark ID to report it; fewer may be outliers.
MIN_ID_FAILURES = 5
#: Upper bound of contradicted IDs to report by ID (two swapped pairs); with more of them rather
#: the pose or noise of the robot is wrong.
MAX_CONTRADICTED_IDS = 4
#: Range of NIS per degree of freedom in which the noise needs no tuning, and the range outside of
#: which it is an error.
NIS_RANGE = (0.2, 2.0)
NIS_PLAUSIBLE_RANGE = (0.01, NIS_ERROR)
#: Minimum degrees of freedom to judge NIS by.
MIN_NIS_DOF = 40


def is_consistent(trial: Trial) -> bool:
    """Return whether all robots joined one map in which most observations pass the gate."""
    groups = trial.estimator.groups
    return (
        trial.failure is None and not groups.not_in_map and not groups.moved_landmarks()
        and all(trial.gated_share(name) < MAX_GATED_SHARE for name in trial.estimator.robots))


def check(survey: Survey, trial: Trial, settings: Settings) -> Iterator[Finding]:
    """Yield robots that never join the map, and measurements that contradict each other."""
    if trial.failure is not None:
        yield error(
            'broken_estimate', 'all robots', str(trial.failure),
            'correct the other findings first, above all covariances and jumps')
        return
    for robot in settings.robots:
        yield from _not_joined(robot, survey, trial, settings)
    anchor = settings.anchor
    sees = any(len(scan) for scan in survey.observations(f'{anchor}/landmarks').ids)
    if anchor and not sees and len(settings.robots) > 1:
        yield error(
            'blind_anchor', anchor, 'the anchor never observes a landmark',
            'choose another robot for the parameter anchor, or check its detector')
    for name in trial.estimator.robots:
        yield from _contradictions(name, survey, trial)
        yield from _nis(name, trial)
    moved = trial.estimator.groups.moved_landmarks()
    if moved:
        names = [f'{owner} {id_}'.strip() for owner, id_ in moved]
        yield warning(
            'moved_landmark', 'all robots',
            f'{len(moved)} landmarks are observed at several positions: {", ".join(names[:8])}',
            'check that an ID is of one landmark only, which does not move, or set'
            ' moved_landmarks: forget', len(moved))


def _not_joined(
    robot: RobotSettings, survey: Survey, trial: Trial, settings: Settings
) -> Iterator[Finding]:
    reason = trial.estimator.groups.not_in_map.get(robot.name)
    if reason is None or not survey.odometry(robot.name).stamps:
        return
    shared = (
        'let both observe the same landmarks with the same IDs' if settings.shared_landmark_ids
        else 'set shared_landmark_ids: true if all robots use the same IDs')
    yield error(
        'never_joins', robot.name,
        f'it never joins {MAP}: {reason} ({_common_observations(survey, robot, settings)})',
        f'{shared}, let robots observe each other ({robot.name}/robots), or give'
        f' {robot.name}.start_pose')


def _common_observations(survey: Survey, robot: RobotSettings, settings: Settings) -> str:
    """Return what a robot shares with each of the others."""
    parts = []
    landmarks = _landmark_ids(survey, robot.name)
    for other in settings.robots:
        if other is not robot:
            shared = landmarks & _landmark_ids(survey, other.name)
            mutual = (
                survey.observations(f'{robot.name}/robots').id_counts()[other.id]
                + survey.observations(f'{other.name}/robots').id_counts()[robot.id])
            parts.append(
                f'with {other.name}: {len(shared) if settings.shared_landmark_ids else 0} shared'
                f' landmarks, {mutual} observations of each other')
    return '; '.join(parts) or 'it is the only robot'


def _landmark_ids(survey: Survey, robot: str) -> set[int]:
    return survey.observations(f'{robot}/landmarks').id_counts().keys() - {NO_ID}


def _contradictions(robot: str, survey: Survey, trial: Trial) -> Iterator[Finding]:
    lost, gated = trial.estimator.innovations.lost_robots.reason(robot), trial.gated_share(robot)
    is_wrong = bool(lost) or gated > MAX_PARTLY_GATED_SHARE
    if lost or gated > MAX_GATED_SHARE:
        yield Finding(
            Severity.ERROR if is_wrong else Severity.WARNING, 'does_not_fit', robot,
            f'{100 * gated:.0f} % of its observations of mapped landmarks contradict the map'
            + (f', likely lost: {lost}' if lost else ''),
            'check that x is ahead and y to the left in metres, check IDs, stamps and sensor_pose,'
            ' and let fej_slam calibrate find the noise')
    if not is_wrong:
        yield from _contradicted_ids(robot, survey, trial)


def _contradicted_ids(robot: str, survey: Survey, trial: Trial) -> Iterator[Finding]:
    """Yield the IDs of a robot that contradict the map while its other observations fit."""
    topic = f'{robot}/landmarks'
    observed = survey.observations(topic).id_counts()
    wrong = sorted(
        id_ for (name, id_), failures in trial.gate_failures.items()
        if name == robot and id_ > NO_ID
        and failures >= max(MIN_ID_FAILURES, MAX_PARTLY_GATED_SHARE * observed[id_]))
    if 0 < len(wrong) <= MAX_CONTRADICTED_IDS:
        yield Finding(
            Severity.ERROR if len(wrong) > 1 else Severity.WARNING, 'contradicted_id', topic,
            f'observations of {", ".join(map(str, wrong))} contradict the map, others fit',
            'check that an ID is of one landmark at all times and for all robots: these may be'
            ' swapped, given twice, or moved', len(wrong))


def _nis(robot: str, trial: Trial) -> Iterator[Finding]:
    nis = trial.estimator.innovations.nis[robot]
    if nis.dof < MIN_NIS_DOF:
        return
    ratio = nis.total / nis.dof
    if NIS_RANGE[0] <= ratio <= NIS_RANGE[1]:
        return
    is_plausible = NIS_PLAUSIBLE_RANGE[0] <= ratio <= NIS_PLAUSIBLE_RANGE[1]
    yield Finding(
        Severity.WARNING if is_plausible else Severity.ERROR, 'inconsistent_noise', robot,
        f'NIS/dof is {ratio:.3g} instead of 1: the covariances of its odometry or observations are'
        f' too {"small" if ratio > 1.0 else "large"}',
        'let fej_slam calibrate find the noise, after correcting the other errors')
