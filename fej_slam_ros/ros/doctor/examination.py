# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
All checks of a bag: a survey of its messages and a trial run of the estimator, in one pass.

Without parameters, the robots are those of the topics.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.doctor import (
    clocks, frames, observations, odometry, rejections, sensors, stated_noise, team, timing,
    topics)
from fej_slam_ros.ros.doctor.findings import Finding, Severity
from fej_slam_ros.ros.doctor.survey import Survey
from fej_slam_ros.ros.doctor.trial import Trial
from fej_slam_ros.ros.doctor.wrong_settings import wrong_settings
from fej_slam_ros.ros.files import bags, front_end_topics
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.files.recorded_robots import RecordedRobots, robots_in
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.parameters.detector_settings import detector_in
from fej_slam_ros.ros.topic_types import expected_topics, OBSERVATION_TOPICS

#: Findings that a time jump explains; they are left out beside it.
EFFECTS_OF_TIME_JUMPS = {
    'delayed', 'stamps_go_back', 'clock_drift', 'clock_skew', 'clock_offset'}

#: Findings that stamps in coarse steps explain, and more of them if they are an error.
EFFECTS_OF_COARSE_STAMPS = {RejectionReason.CONFLICTING.value, RejectionReason.DUPLICATE.value}
EFFECTS_OF_WRONG_STAMPS = {
    RejectionReason.LATE.value, 'delayed', 'clock_skew', 'slow_odometry', 'slow_scans',
    'sensor_time'}

#: Findings that any error may explain.
EFFECTS_OF_ERRORS = {RejectionReason.NOT_JOINED.value, 'restarted'}

#: Errors of observations, stamps or odometry after which observations fit nothing, and what they
#: explain.
FAULTS_OF_FIT = {
    team.EXCHANGED_TOPICS, sensors.DOES_NOT_MOVE, sensors.BEARINGS, *sensors.WRONG_POSES,
    timing.COARSE_STAMPS, stated_noise.OPTIMISTIC_ODOMETRY}
EFFECTS_ON_FIT = {
    'never_joins', team.DOES_NOT_FIT, 'contradicted_id', 'inconsistent_noise'}

#: Findings on odometry that explain the rejection of its motion.
FAULTS_OF_ODOMETRY = {'jump', 'speed'}

#: Findings on distances in other units than metres, and on poses of sensors that they explain.
FAULTS_OF_UNITS = {'range', 'speed'}
EFFECTS_OF_UNITS = 'sensor_pose', sensors.DOES_NOT_MOVE

#: Rejections that exchanged topics explain.
EFFECTS_OF_EXCHANGED_TOPICS = RejectionReason.UNKNOWN_ROBOT, RejectionReason.SELF_OBSERVATION

#: Findings that a team without any landmark explains.
EFFECTS_OF_NO_LANDMARKS = {'never_joins', 'blind_anchor'}


def examine(
    path: Path, given: RunSettings | None, names: TopicNames, parameter_file: Path | None,
) -> list[Finding]:
    """
    Return all findings in a bag, errors first; its own robots are checked without settings.

    The file may have parameters of the detector, too. A UserError says that the bag cannot be
    read, or that it has no topic of a robot.

    """
    bag_topics = bags.topics(path, names)
    settings = given or _default_settings(path, names, robots_in(bag_topics))
    team_names = [robot.name for robot in settings.estimation.robots]
    names.check_new(
        [*expected_topics(team_names), *front_end_topics.inputs(bag_topics, team_names)])
    recorded = RecordedRobots(path, names, team_names)
    messages = partial(bags.read_with_bar, path, names, bag_topics)
    survey, trial = Survey(), Trial(settings.estimation, settings.node, prior_map(settings))
    for message in messages():
        if message.topic in trial.topics:
            survey.add(message)
        trial.receive(message)
    trial.close()
    wrong, used = wrong_settings(settings, survey, trial, messages)
    findings = [
        *(wrong if given is not None else ()),
        *topics.check_files(path, names),
        *topics.check(
            bag_topics, team_names, settings.estimation.initialpose_robot, recorded),
        *sensors.check(path, names, settings, detector_in(parameter_file, team_names)),
        *_check_messages(
            survey, used, replace(settings, estimation=used.estimator.settings),
            recorded.recorded_names())]
    return sorted(
        unexplained(findings, len(team_names)),
        key=lambda finding: finding.severity is not Severity.ERROR)


def unexplained(findings: Sequence[Finding], robots: int) -> Iterator[Finding]:
    """Yield the findings on a number of robots that no other one explains."""
    findings = [*_corrupting(findings)]
    names = Counter(finding.name for finding in findings)
    errors = {finding.name for finding in findings if finding.severity is Severity.ERROR}
    explained = {*EFFECTS_OF_TIME_JUMPS} if rejections.TIME_JUMP in names else set()
    if timing.COARSE_STAMPS in names:
        explained |= EFFECTS_OF_COARSE_STAMPS
    if timing.COARSE_STAMPS in errors:
        explained |= EFFECTS_OF_WRONG_STAMPS
    if names['no_landmarks'] == robots:
        explained |= EFFECTS_OF_NO_LANDMARKS
    if FAULTS_OF_FIT & errors:
        explained |= EFFECTS_ON_FIT
    if errors:
        explained |= EFFECTS_OF_ERRORS
    if errors - {team.NOTHING_USED}:
        explained.add(team.NOTHING_USED)
    # A detector that rejects all scans of a robot writes no landmarks.
    explained_at = {
        ('no_landmarks', f'{finding.where.rpartition("/")[0]}/landmarks')
        for finding in findings if finding.name in ('scans_rejected', team.EXCHANGED_TOPICS)} | {
        (reason.value, finding.where) for reason in EFFECTS_OF_EXCHANGED_TOPICS
        for finding in findings if finding.name == team.EXCHANGED_TOPICS} | {
        (RejectionReason.IMPOSSIBLE_MOTION.value, finding.where)
        for finding in findings if finding.name in FAULTS_OF_ODOMETRY} | {
        # Beside distances in other units, observations or odometry seem to stand still.
        (effect, f'{finding.where.partition("/")[0]}/{kind}')
        for finding in findings if finding.name in FAULTS_OF_UNITS
        for effect in EFFECTS_OF_UNITS for kind in OBSERVATION_TOPICS}
    return (
        finding for finding in findings if finding.name not in explained
        and (finding.name, finding.where) not in explained_at)


def _corrupting(findings: Sequence[Finding]) -> Iterator[Finding]:
    """Yield the findings; poses of sensors are errors if observations of the robot do not fit."""
    contradicted = {
        finding.where for finding in findings
        if finding.name == team.DOES_NOT_FIT and finding.severity is Severity.ERROR}
    for finding in findings:
        robot = finding.where.partition('/')[0]
        is_error = finding.name in sensors.WRONG_POSES and robot in contradicted
        yield replace(finding, severity=Severity.ERROR) if is_error else finding


def _check_messages(
    survey: Survey, trial: Trial, settings: RunSettings, recorded_names: Mapping[str, str]
) -> Iterator[Finding]:
    estimation = settings.estimation
    yield from timing.check(survey, estimation)
    yield from clocks.check(survey, estimation, settings.node.clock_limit)
    yield from frames.check(survey, recorded_names, settings.node.shares_tf())
    for robot in estimation.robots:
        yield from odometry.check(survey.odometry(robot.name), robot)
        yield from observations.check_first_estimates(robot.name, survey, estimation.filter)
        for kind in OBSERVATION_TOPICS:
            topic = f'{robot.name}/{kind}'
            yield from observations.check(
                topic, survey.observations(topic), not trial.estimator.groups.not_in_map)
    yield from rejections.check(survey, trial, estimation)
    yield from team.check(survey, trial, estimation)
    for robot in () if trial.failure else estimation.robots:
        yield from stated_noise.check(robot, survey.odometry(robot.name), trial)


def _default_settings(path: Path, names: TopicNames, robots: Sequence[str]) -> RunSettings:
    """Return the settings for the robots of a bag; a UserError says that there are none."""
    if not robots:
        recorded = RecordedRobots(path, names)
        raise UserError(
            f'{path} has no topic <robot>/odom, <robot>/landmarks or <robot>/robots, it has'
            f' {recorded.found()}: {recorded.cure()}')
    return parameters.parse({'robots': [*robots]})
