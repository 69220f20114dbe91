# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of the trial run: all robots join one map, and observations agree with odometry."""

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array, rigid_fit, transform
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.core.sentences import counted
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.ros.doctor.findings import error, error_if, Finding, warning
from fej_slam_ros.ros.doctor.survey import Survey
from fej_slam_ros.ros.doctor.trial import Trial
from fej_slam_ros.ros.session.input_health import are_repeated
from fej_slam_ros.ros.topic_types import OBSERVATION_TOPICS

#: Upper bounds of the share of observations that fail the gate, for a consistent robot and for one
#: whose pose may be correct; 0.1 % of correct observations fail.
MAX_GATED_SHARE, MAX_PARTLY_GATED_SHARE = 0.05, 0.2
#: Upper bound of the share of observations without ID that may be of several landmarks, or of a
#: known or a new one, for a robot whose pose may be correct.
MAX_DOUBTFUL_SHARE = 0.25
#: Minimum number of gate failures of one landmark ID to report it; fewer may be outliers.
MIN_ID_FAILURES = 5
#: Maximum number of contradicted IDs to report (two swapped pairs); more of them indicate a wrong
#: pose or noise of the robot.
MAX_CONTRADICTED_IDS = 4
#: Minimum number of common IDs of two maps, and largest difference of these, relative to their
#: size, where the IDs are of the same landmarks: those of different ones do not fit at all.
MIN_COMMON_IDS, MAX_DIFFERENCE = 5, 0.2
#: Minimum number of IDs on <robot>/robots, and more than robots, that are those of landmarks.
MIN_LANDMARK_IDS = 8
#: Minimum number of shared landmarks that join two frames.
MIN_JOINING = 2
#: What to do where robots share enough.
MISFIT_CURE = (
    'correct the other findings, and run fej_slam calibrate: what they share does not fit by the'
    ' covariances')
EXCHANGED_TOPICS, DOES_NOT_FIT, NOTHING_USED = (
    'exchanged_topics', 'does_not_fit', 'nothing_used')


def check(survey: Survey, trial: Trial, settings: Settings) -> Iterator[Finding]:
    """Yield robots that never join the map, and measurements that contradict each other."""
    ids = {robot.id for robot in settings.robots}
    for robot in settings.robots:
        yield from _exchanged(robot.name, survey, ids)
    if trial.failure is not None:
        yield error(
            'broken_estimate', 'all robots', str(trial.failure),
            'correct the other findings first, especially covariances and jumps')
        return
    for robot in settings.robots:
        yield from _not_joined(robot, survey, trial, settings)
    anchor = settings.anchor
    observes = any(len(scan) for scan in survey.observations(f'{anchor}/landmarks').ids)
    if anchor and not observes and trial.estimator.groups.not_in_map:
        yield error(
            'blind_anchor', anchor, 'the anchor never observes a landmark',
            'choose another robot for the parameter anchor, or check its detector')
    if not any(trial.estimator.statistics.observations_used.values()):
        yield error(
            NOTHING_USED, 'all robots',
            'the estimator uses no observation: all poses are those of odometry alone',
            'correct what the warnings name, and check the detectors')
    yield from _repeated_poses(trial)
    for name in trial.estimator.robots:
        yield from _restarts(name, trial)
        yield from _contradictions(name, survey, trial)
    moved = trial.estimator.groups.moved_landmarks()
    if moved:
        names = [f'{owner} {id_}'.strip() for owner, id_ in moved]
        yield warning(
            'moved_landmark', 'all robots',
            f'{len(moved)} landmarks are observed at several positions: {", ".join(names[:8])}',
            'give each landmark its own ID, or set moved_landmarks: forget', len(moved))


def is_consistent(trial: Trial) -> bool:
    """Return whether all robots joined one map, and most observations fit it."""
    groups = trial.estimator.groups
    return (
        trial.failure is None and not groups.not_in_map and not groups.moved_landmarks()
        and all(
            trial.gated_share(name) < MAX_GATED_SHARE
            and trial.doubtful_share(name) < MAX_DOUBTFUL_SHARE
            for name in trial.estimator.robots))


def restarts(trial: Trial) -> int:
    """Return how often robots restarted in frames of their own, and no poses made them."""
    return sum(_restarts_of(name, trial) for name in trial.estimator.robots)


def _restarts_of(robot: str, trial: Trial) -> int:
    statistics = trial.estimator.statistics
    return 0 if statistics.pose_priors_used[robot] else statistics.relocalized[robot]


def maps_agree(trial: Trial) -> bool:
    """Return whether maps of two robots by their own IDs have the same shape."""
    maps: defaultdict[str, dict[int, Array]] = defaultdict(dict)
    for landmark in trial.estimator.landmarks():
        maps[landmark.robot][landmark.id] = landmark.position
    return any(_have_one_shape(*pair) for pair in combinations(maps.values(), 2))


def _have_one_shape(first: Mapping[int, Array], second: Mapping[int, Array]) -> bool:
    common = [*(first.keys() & second.keys())]
    if len(common) < MIN_COMMON_IDS:
        return False
    source, target = (np.array([points[id_] for id_ in common]) for points in (first, second))
    differences = target - transform(rigid_fit(source, target), source)
    return bool(differences.std() < MAX_DIFFERENCE * target.std(axis=0).mean())


def _exchanged(robot: str, survey: Survey, team: Collection[int]) -> Iterator[Finding]:
    """Yield that the IDs on the topic of robots are those of landmarks."""
    landmarks, robots = (
        survey.observations(f'{robot}/{kind}').id_counts.keys() - {NO_ID}
        for kind in OBSERVATION_TOPICS)
    if len(robots) >= max(MIN_LANDMARK_IDS, len(team) + 1) and landmarks.issubset(team):
        rules = f'/{robot}/robots:=/{robot}/landmarks' + (
            f' /{robot}/landmarks:=/{robot}/robots' if landmarks else '')
        yield error(
            EXCHANGED_TOPICS, f'{robot}/robots',
            f'its {len(robots)} IDs are those of landmarks, and {robot}/landmarks has none but'
            ' those of robots', f'exchange the topics: --remap {rules}')


def _not_joined(
    robot: RobotSettings, survey: Survey, trial: Trial, settings: Settings
) -> Iterator[Finding]:
    reason = trial.estimator.groups.not_in_map.get(robot.name)
    if reason is not None and survey.odometry(robot.name).stamps:
        shared = [
            _Shared.by(robot, other, survey, settings.shared_landmark_ids)
            for other in settings.robots if other is not robot]
        has_left = robot.name in trial.joined
        do_not_fit = has_left or any(
            common.landmarks + common.mutual >= settings.join_min_landmarks for common in shared)
        yield error(
            'never_joins', robot.name,
            (f'it leaves {MAP} and is outside at the end' if has_left else f'it never joins {MAP}')
            + f': {reason} ({"; ".join(map(str, shared)) or "it is the only robot"})',
            (MISFIT_CURE if do_not_fit else
             _cure_of_landmarks(robot, survey, settings, shared)
             + f', let robots observe each other ({robot.name}/robots)')
            + f', or give {robot.name}.start_pose')


class _Shared(NamedTuple):
    """What a robot shares with another."""

    other: str
    landmarks: int
    mutual: int  #: number of observations of each other

    @classmethod
    def by(
        cls, robot: RobotSettings, other: RobotSettings, survey: Survey, shared_ids: bool
    ) -> '_Shared':
        mine, theirs = (
            survey.observations(f'{name}/landmarks').id_counts.keys() - {NO_ID}
            for name in (robot.name, other.name))
        return cls(other.name, len(mine & theirs) if shared_ids else 0, sum(
            survey.observations(f'{observer.name}/robots').id_counts[observed.id]
            for observer, observed in ((robot, other), (other, robot))))

    def __str__(self) -> str:
        return (
            f'with {self.other}: {counted(self.landmarks, "shared landmark")},'
            f' {counted(self.mutual, "observation")} of each other')


def _cure_of_landmarks(
    robot: RobotSettings, survey: Survey, settings: Settings, shared: Sequence[_Shared]
) -> str:
    """Return what helps a robot to join by landmarks."""
    have_ids = {
        name: any(id_ > NO_ID for id_ in survey.observations(f'{name}/landmarks').id_counts)
        for name in (other.name for other in settings.robots)}
    if not have_ids[robot.name] and any(have_ids.values()):
        return (
            'give its landmarks IDs, as those of '
            + ', '.join(name for name, has in have_ids.items() if has)
            + ' have: without, they are compared with landmarks without ID only')
    if not have_ids[robot.name]:
        return (
            'drive both among the same five landmarks or more, at irregular distances; of lasers'
            ' check reversed_beams and scan_duration of the detector')
    if not settings.shared_landmark_ids:
        return 'set shared_landmark_ids: true if all robots use the same IDs'
    most = max((common.landmarks for common in shared), default=0)
    lower = f', set join_min_landmarks: {most} if these are certain'
    return 'let both observe the same landmarks with the same IDs' + (
        lower if MIN_JOINING <= most < settings.join_min_landmarks else '')


def _repeated_poses(trial: Trial) -> Iterator[Finding]:
    for robot, stamps in trial.inputs.health.pose_priors.items():
        if are_repeated(sorted(stamps)):
            yield warning(
                'repeated_poses', f'{robot}/set_pose',
                f'it has {len(stamps)} poses, each of which restarts the robot',
                'use set_pose for relocalisation only: poses of GPS or of another localisation'
                ' make the robot less accurate', len(stamps), min(stamps))


def _restarts(robot: str, trial: Trial) -> Iterator[Finding]:
    """Yield that a robot restarted in its own frame, unless poses were given for that."""
    count = _restarts_of(robot, trial)
    if count:
        yield warning(
            'restarted', robot,
            f'it restarted in its own frame {counted(count, "time")}, the last one:'
            f' {trial.estimator.statistics.restart_reasons[robot]}',
            f'check its odometry there, and {robot}.start_pose and {robot}.start_sigma if given;'
            ' if its heading becomes uncertain where little is observed, set filter: invariant',
            count)


def _contradictions(robot: str, survey: Survey, trial: Trial) -> Iterator[Finding]:
    lost, gated = trial.estimator.innovations.lost_robots.reason(robot), trial.gated_share(robot)
    is_wrong = bool(lost) or gated > MAX_PARTLY_GATED_SHARE
    if lost or gated > MAX_GATED_SHARE:
        of_robots = trial.failed_of_robots[robot]
        ids, what = (
            ('the IDs on <robot>/robots and <robot>.id, ', 'of robots')
            if 2 * of_robots > trial.failed(robot) else ('IDs, ', 'of mapped landmarks'))
        yield error_if(is_wrong)(
            DOES_NOT_FIT, robot,
            f'{100 * gated:.0f} % of its observations, most of them {what}, contradict the map'
            + (f', likely lost: {lost}' if lost else ''),
            f'check {ids}stamps, sensor_pose, the size of tags, the covariance of odometry, and x'
            ' ahead and y left in metres; then run fej_slam calibrate')
    elif (doubtful := trial.doubtful_share(robot)) > MAX_DOUBTFUL_SHARE:
        yield warning(
            DOES_NOT_FIT, robot,
            f'{100 * doubtful:.0f} % of its observations without ID may be of several landmarks,'
            ' or of a known or a new one, and are not used',
            f'check {robot}.start_pose and {robot}.start_sigma if given, sensor_pose, and the'
            ' covariances of observations and odometry')
    if not is_wrong:
        yield from _contradicted_ids(robot, survey, trial)


def _contradicted_ids(robot: str, survey: Survey, trial: Trial) -> Iterator[Finding]:
    """Yield the IDs of a robot that contradict the map while its other observations fit."""
    topic = f'{robot}/landmarks'
    observed = survey.observations(topic).id_counts
    wrong = sorted(
        id_ for (name, id_), failures in trial.gate_failures.items()
        if name == robot and id_ > NO_ID
        and failures >= max(MIN_ID_FAILURES, MAX_PARTLY_GATED_SHARE * observed[id_]))
    if 0 < len(wrong) <= MAX_CONTRADICTED_IDS:
        yield error_if(len(wrong) > 1)(
            'contradicted_id', topic,
            f'observations of {", ".join(map(str, wrong))} contradict the map, others fit',
            'check whether these landmark IDs are swapped or used twice, or the landmarks moved;'
            ' list tags on a robot in <robot>.tags of the adapter',
            len(wrong))
