# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
All checks of a bag, in one pass: what its messages say, and what the estimator makes of them.

Where no parameters are given, robots are those of the topics and all else is the default. Nobody
then says whether numbers of landmarks are shared, so what fits better is taken.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.doctor import (
    frames, observations, odometry, rejections, team, timing, topics)
from fej_slam_ros.ros.doctor.findings import ERROR, Finding
from fej_slam_ros.ros.doctor.survey import Survey
from fej_slam_ros.ros.doctor.trial import Trial
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import RawMessage

#: Shows the progress through so many messages.
Progress = Callable[[Iterable[RawMessage], int], Iterable[RawMessage]]

#: What follows from time that jumps back.
OF_TIME_JUMPS = {'delayed', 'stamps_go_back', 'clock_drift', 'clock_skew', 'clock_offset'}


def examine(path: Path, given: Settings | None, progress: Progress) -> list[Finding]:
    """
    Return all findings in a bag, the errors first.

    Parameters
    ----------
    path : of the bag
    given : the parameters, None where the topics are to tell the robots
    progress : wraps the messages of a pass

    Raises
    ------
    UserError
        The bag cannot be read, or nothing in it is of a robot.

    """
    of_bag = bags.topics(path)
    settings = given or _default(path, of_bag)
    total = sum(topic.messages for topic in of_bag.values())
    survey, trial = Survey(), Trial(settings)
    wanted = frozenset(trial.inputs.topics)
    for message in progress(bags.read(path), total):
        if message.topic in wanted:
            survey.add(message)
            trial.receive(message)
    trial.close()
    found: list[Finding] = []
    if len(settings.robots) > 1 and not team.fits(trial) and not settings.prior_landmarks:
        other = _with_other_ids(settings, path, total, progress)
        if team.fits(other):
            trial, settings = other, other.estimator.settings
            if given is not None:
                found.append(_wrong_ids(settings))
    found += _findings(of_bag, survey, trial, settings)
    names = {finding.name for finding in found}
    explained = OF_TIME_JUMPS if rejections.TIME_JUMP in names else set()
    return sorted(
        (finding for finding in found if finding.name not in explained),
        key=lambda finding: finding.severity != ERROR)


def _findings(
    of_bag: dict[str, bags.BagTopic], survey: Survey, trial: Trial, settings: Settings
) -> list[Finding]:
    robots: Sequence[str] = [robot.name for robot in settings.robots]
    found = [
        *topics.check(of_bag, robots), *timing.check(survey, settings),
        *frames.check(survey, robots)]
    for robot in robots:
        found += odometry.check(f'{robot}/odom', survey.motion(robot))
        for kind in topics.SEEING:
            topic = f'{robot}/{kind}'
            found += observations.check(topic, survey.sight(topic), not trial.estimator.not_in_map)
    return [
        *found, *rejections.check(survey, trial, settings), *team.check(survey, trial, settings)]


def _default(path: Path, of_bag: dict[str, bags.BagTopic]) -> Settings:
    robots = topics.robots_in(of_bag)
    if not robots:
        raise UserError(
            f'{path} has no topic <robot>/odom, <robot>/landmarks or <robot>/robots, it has'
            f' {", ".join(sorted(of_bag)) or "none"}: remap its topics when you record')
    return parameters.parse({'robots': robots})


def _with_other_ids(settings: Settings, path: Path, total: int, progress: Progress) -> Trial:
    """Return a trial in which numbers of landmarks are shared, or not, other than was said."""
    trial = Trial(replace(settings, shared_landmark_ids=not settings.shared_landmark_ids))
    for message in progress(bags.read(path), total):
        trial.receive(message)
    trial.close()
    return trial


def _wrong_ids(right: Settings) -> Finding:
    shared = right.shared_landmark_ids
    whose = 'the same for all robots' if shared else "each robot's own"
    return Finding(
        ERROR, 'wrong_ids', 'all robots', f'numbers of landmarks seem to be {whose}: so they fit',
        f'set the parameter shared_landmark_ids to {str(shared).lower()}')
