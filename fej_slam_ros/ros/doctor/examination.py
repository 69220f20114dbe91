# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
All checks of a bag: a survey of its messages and a trial run of the estimator, in one pass.

Without parameters the robots are those of the topics and all else is the default; whether
landmark IDs are shared between robots is then found by trying both.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.doctor import (
    clocks, frames, observations, odometry, rejections, team, timing, topics)
from fej_slam_ros.ros.doctor.findings import error, Finding, Severity
from fej_slam_ros.ros.doctor.survey import Survey
from fej_slam_ros.ros.doctor.trial import Trial
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.parameters import RunSettings

#: Wraps the messages of a pass, of the given number, to show the progress.
Progress = Callable[[Iterable[RawMessage], int], Iterable[RawMessage]]

#: Findings that a time jump explains; they are left out beside it.
EFFECTS_OF_TIME_JUMPS = {
    'delayed', 'stamps_go_back', 'clock_drift', 'clock_skew', 'clock_offset'}


def examine(path: Path, given: RunSettings | None, progress: Progress) -> list[Finding]:
    """
    Return all findings in a bag, errors first.

    Parameters
    ----------
    path : of the bag
    given : the parameters, None to derive the robots from the topics
    progress : wraps the messages of a pass

    Raises
    ------
    UserError
        The bag cannot be read, or it has no topic of a robot.

    """
    bag_topics = bags.topics(path)
    settings = given or _default_settings(path, bag_topics)
    total = sum(topic.messages for topic in bag_topics.values())
    estimation = settings.estimation
    prior = prior_map(settings.node.prior_landmarks)
    survey, trial = Survey(), Trial(estimation, prior)
    wanted = frozenset(trial.inputs.topics)
    for message in progress(bags.read(path), total):
        if message.topic in wanted:
            survey.add(message)
            trial.receive(message)
    trial.close()
    findings: list[Finding] = []
    if len(estimation.robots) > 1 and prior is None and not team.is_consistent(trial):
        other = Trial(replace(estimation, shared_landmark_ids=not estimation.shared_landmark_ids))
        for message in progress(bags.read(path), total):
            other.receive(message)
        other.close()
        if team.is_consistent(other):
            trial, estimation = other, other.estimator.settings
            if given is not None:
                findings.append(_wrong_ids(estimation))
    findings += _check_all(bag_topics, survey, trial, replace(settings, estimation=estimation))
    has_time_jump = any(finding.name == rejections.TIME_JUMP for finding in findings)
    explained = EFFECTS_OF_TIME_JUMPS if has_time_jump else set()
    return sorted(
        (finding for finding in findings if finding.name not in explained),
        key=lambda finding: finding.severity is not Severity.ERROR)


def _check_all(
    bag_topics: Mapping[str, bags.BagTopic], survey: Survey, trial: Trial, settings: RunSettings
) -> Iterator[Finding]:
    estimation = settings.estimation
    robots = [robot.name for robot in estimation.robots]
    yield from topics.check(bag_topics, robots)
    yield from timing.check(survey, estimation)
    yield from clocks.check(survey, estimation, settings.node.clock_limit)
    yield from frames.check(survey, robots)
    for robot in robots:
        yield from odometry.check(f'{robot}/odom', survey.odometry(robot))
        for kind in topics.OBSERVATION_TOPICS:
            topic = f'{robot}/{kind}'
            yield from observations.check(
                topic, survey.observations(topic), not trial.estimator.groups.not_in_map)
    yield from rejections.check(survey, trial, estimation)
    yield from team.check(survey, trial, estimation)


def _default_settings(path: Path, bag_topics: Mapping[str, bags.BagTopic]) -> RunSettings:
    robots = topics.robots_in(bag_topics)
    if not robots:
        raise UserError(
            f'{path} has no topic <robot>/odom, <robot>/landmarks or <robot>/robots, it has'
            f' {", ".join(sorted(bag_topics)) or "none"}: remap its topics when you record')
    return parameters.parse({'robots': robots})


def _wrong_ids(right: Settings) -> Finding:
    shared = right.shared_landmark_ids
    whose = 'shared by all robots' if shared else "each robot's own"
    return error(
        'wrong_ids', 'all robots',
        f'landmark IDs seem to be {whose}: only then do the observations fit',
        f'set the parameter shared_landmark_ids to {str(shared).lower()}')
