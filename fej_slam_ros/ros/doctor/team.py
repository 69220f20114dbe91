# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the robots of a bag come into one map, and observations and odometry fit each other."""

from collections import Counter
from collections.abc import Iterator

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.ros.doctor.findings import ERROR, Finding, WARNING
from fej_slam_ros.ros.doctor.survey import Survey
from fej_slam_ros.ros.doctor.trial import Trial
from fej_slam_ros.ros.session.diagnostics import NIS_ERROR

#: So much of what is known may fail the gate: of right observations one in a thousand does.
GATED, MOSTLY_GATED = 0.05, 0.2
#: So many failures of one landmark are no chance.
FAILED = 5
#: Numbers are swapped for each other in pairs, of which there may be two.
SWAPPED = 4
#: NIS per degree of freedom between these is a matter of tuning, beyond the outer ones an error.
NIS = (0.2, 2.0)
NIS_ABSURD = (0.01, NIS_ERROR)
#: So many degrees of freedom tell NIS well enough.
NIS_DOF = 40

CALIBRATE = (
    'check that x is ahead and y to the left in metres, that ids, stamps and sensor_pose are'
    ' right, and let fej_slam calibrate find the noise')


def fits(trial: Trial) -> bool:
    """Return whether all robots have come into one map in which most observations fit."""
    estimator = trial.estimator
    return (
        trial.broken is None and not estimator.not_in_map and not estimator.moved_landmarks()
        and all(trial.gated(robot) < GATED for robot in estimator.robots))


def check(survey: Survey, trial: Trial, settings: Settings) -> Iterator[Finding]:
    """Yield who does not come into the map, and whose measurements contradict each other."""
    if trial.broken is not None:
        yield Finding(
            ERROR, 'broken_estimate', 'all robots', str(trial.broken),
            'correct what is found besides, above all covariances and jumps')
        return
    yield from _unlocated(survey, trial, settings)
    yield from _contradictions(survey, trial)


def _unlocated(survey: Survey, trial: Trial, settings: Settings) -> Iterator[Finding]:
    estimator = trial.estimator
    for robot in settings.robots:
        why = estimator.not_in_map.get(robot.name)
        if why is None or not survey.motion(robot.name).stamps:
            continue
        yield Finding(
            ERROR, 'never_joins', robot.name,
            f'it never comes into {MAP}: {why} ({_ties(survey, robot, settings)})',
            _tie(robot, settings))
    anchor = settings.anchor
    sees = any(len(scan) for scan in survey.sight(f'{anchor}/landmarks').ids)
    if anchor and not sees and len(settings.robots) > 1:
        yield Finding(
            ERROR, 'blind_anchor', anchor, 'the anchor never sees a landmark',
            'choose another robot for the parameter anchor, or see to its detector')


def _tie(robot: RobotSettings, settings: Settings) -> str:
    shared = (
        'let both see the same landmarks with the same numbers' if settings.shared_landmark_ids
        else 'set shared_landmark_ids: true if all robots use the same numbers')
    return (
        f'{shared}, let robots see each other ({robot.name}/robots), or give'
        f' {robot.name}.start_pose')


def _ties(survey: Survey, robot: RobotSettings, settings: Settings) -> str:
    """Return what a robot shares with each of the others."""
    own, told = _seen(survey, robot.name), []
    for other in settings.robots:
        if other is not robot:
            shared = len(own & _seen(survey, other.name)) if settings.shared_landmark_ids else 0
            meetings = (
                _numbers(survey, f'{robot.name}/robots')[other.id]
                + _numbers(survey, f'{other.name}/robots')[robot.id])
            told.append(
                f'with {other.name}: {shared} shared landmarks, {meetings} observations of each'
                ' other')
    return '; '.join(told) or 'it is alone'


def _seen(survey: Survey, robot: str) -> set[int]:
    return _numbers(survey, f'{robot}/landmarks').keys() - {NO_ID}


def _numbers(survey: Survey, topic: str) -> Counter[int]:
    """Return how often each number is in the scans of a topic."""
    return Counter(number for scan in survey.sight(topic).ids for number in scan.tolist())


def _contradictions(survey: Survey, trial: Trial) -> Iterator[Finding]:
    estimator = trial.estimator
    for robot in estimator.robots:
        lost, gated = estimator.lost.why(robot), trial.gated(robot)
        if lost or gated > GATED:
            yield Finding(
                ERROR if lost or gated > MOSTLY_GATED else WARNING, 'does_not_fit', robot,
                f'{100 * gated:.0f} % of its observations of what is known contradict the map'
                + (f', likely lost: {lost}' if lost else ''), CALIBRATE)
        if not lost and gated <= MOSTLY_GATED:
            yield from _contradicted(robot, survey, trial)
        yield from _nis(robot, trial)
    moved = estimator.moved_landmarks()
    if moved:
        names = [f'{owner} {number}'.strip() for owner, number in moved]
        yield Finding(
            WARNING, 'moved_landmark', 'all robots',
            f'{len(moved)} landmarks are seen in several places: {", ".join(names[:8])}',
            'see that a number stands for one landmark only that does not move, or set'
            ' moved_landmarks: forget', len(moved))


def _contradicted(robot: str, survey: Survey, trial: Trial) -> Iterator[Finding]:
    """Yield which numbers of a robot contradict the map, where the others fit."""
    topic = f'{robot}/landmarks'
    seen = _numbers(survey, topic)
    wrong = sorted(
        number for (who, number), failed in trial.contradicted.items()
        if who == robot and number > NO_ID
        and failed >= max(FAILED, MOSTLY_GATED * seen[number]))
    # Where it is many, rather the robot is wrong, or the noise that it claims.
    if 0 < len(wrong) <= SWAPPED:
        yield Finding(
            ERROR if len(wrong) > 1 else WARNING, 'contradicted_id', topic,
            f'observations of {", ".join(map(str, wrong))} contradict the map, those of others'
            ' fit', 'see that a number stands for one landmark at all times and for all robots:'
            ' these may be swapped, given twice, or moved', len(wrong))


def _nis(robot: str, trial: Trial) -> Iterator[Finding]:
    nis = trial.estimator.nis[robot]
    if nis.dof < NIS_DOF:
        return
    ratio = nis.total / nis.dof
    if NIS[0] <= ratio <= NIS[1]:
        return
    is_absurd = not NIS_ABSURD[0] <= ratio <= NIS_ABSURD[1]
    claim = 'too small' if ratio > 1.0 else 'too large'
    yield Finding(
        ERROR if is_absurd else WARNING, 'inconsistent_noise', robot,
        f'NIS is {ratio:.3g} where 1 is right: the covariances of its odometry or observations are'
        f' {claim}', 'let fej_slam calibrate find the noise, after errors found besides are cured')
