# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robot observations are used once or rejected with a reason that blames the right robot."""

from collections import Counter
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from fej_slam_ros.core.ekf.gating import Association, InflatingGate
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import between, compose, transform
from fej_slam_ros.core.joining.rendezvous_points import MAX_RENDEZVOUS_POINTS
from fej_slam_ros.core.records import Observation, PosePrior, RobotObservation
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.snapshot import restore, snapshot
from fej_slam_ros.sim.environments import ENVIRONMENTS
from helpers.core import circles, estimate, frames
from helpers.optional import settings, stateful, strategies as st
from helpers.records import MS, odometry, robot_scan, scan, team

FILTERS = ['standard', 'fej', 'ideal', 'invariant']
TEAM = 'r1', 'r2', 'r3', 'r4'

#: Landmarks in the frame of r1, and r2 as r1 sees it.
LANDMARKS = [(1, (5.0, 1.0)), (2, (5.0, -1.0)), (3, (3.0, 4.0)), (4, (-2.0, 2.0))]
R2 = (1.0, -3.0)


def side_by_side(steps, seen_at=R2, **options):
    """Return a team that stands among landmarks, of which r1 sees r2 at a place."""
    estimator = Estimator(team(**options))
    for ms in range(0, 100 * steps, 100):
        seen = [(number, (x - R2[0], y - R2[1])) for number, (x, y) in LANDMARKS]
        for name, at in ('r1', LANDMARKS), ('r2', seen):
            estimator.add(odometry(name, ms, (0.0, 0.0, 0.0)))
            estimator.add(scan(name, ms, at))
        if ms:
            estimator.add(robot_scan('r1', ms, [('r2', seen_at)]))
    list(estimator.close())
    return estimator


@pytest.mark.parametrize('inflate_rejected_scans', [False, True])
@pytest.mark.parametrize('moved_landmarks', ['report', 'forget'])
def test_a_wrong_robot_observation_is_rejected_and_nothing_else_is_blamed(
    inflate_rejected_scans, moved_landmarks,
):
    estimator = side_by_side(
        30, (9.0, 9.0), inflate_rejected_scans=inflate_rejected_scans,
        moved_landmarks=moved_landmarks)

    statistics = estimator.statistics
    assert statistics.rejection_counts['r1'] == {RejectionReason.GATED: 29}
    assert {(r.id, r.observed) for r in statistics.rejections} == {(2, 'r2')}
    assert all(r.d2 > r.threshold for r in statistics.rejections)
    assert statistics.observations_used == {'r1': 120, 'r2': 120}
    assert statistics.observations_inflated.total() == 0
    assert estimator.groups.moved_landmarks() == []
    lost_robots = estimator.innovations.lost_robots
    assert (lost_robots.reason('r1'), lost_robots.reason('r2')) == (None, None)
    assert len(estimator.groups.team.state.landmarks) == len(LANDMARKS)


def test_a_correct_robot_observation_is_counted_for_its_observer():
    estimator = side_by_side(5)

    assert estimator.statistics.rejection_counts['r1'] == {}
    assert estimator.statistics.observations_used == {'r1': 24, 'r2': 20}
    # Step 0 rates nothing; then come 4 landmarks of each and a robot at 4 stamps.
    nis = estimator.innovations.nis
    assert (nis['r1'].dof, nis['r2'].dof) == (2 * 4 * 5, 2 * 4 * 4)


def test_accepted_robot_observations_do_not_hide_a_lost_robot():
    estimator = side_by_side(3)
    wrong = [(number, (x + 40.0, y)) for number, (x, y) in LANDMARKS]
    for ms in range(300, 700, 100):
        for record in (
                odometry('r1', ms, (0.0, 0.0, 0.0)), odometry('r2', ms, (0.0, 0.0, 0.0)),
                scan('r1', ms, wrong), robot_scan('r1', ms, [('r2', R2)])):
            estimator.add(record)
    list(estimator.release())

    assert estimator.innovations.lost_robots.reason('r1') == '12 of 12 observations gated in a row'


def test_only_landmark_scans_are_inflated():
    state = JointState()
    observer, seen = (state.insert_robot(name, 0, np.zeros(3), np.eye(3)) for name in ('r1', 'r2'))
    landmarks = [state.augment(('', k), observer, np.zeros(2), np.eye(2, 3), np.eye(2))
                 for k in range(3)]
    R = np.eye(2)
    scanned = [
        *(Association(observer, landmark, Observation(k, np.zeros(2), R))
          for k, landmark in enumerate(landmarks)),
        *(Association(observer, seen, RobotObservation('r2', np.zeros(2), R)) for _ in range(4))]

    sifted = InflatingGate(0.99).apply(
        scanned, np.full((7, 2), 10.0), np.tile(2.0 * np.eye(2), (7, 1, 1)),
        lambda: np.full(7, np.inf))

    assert [g.association.observed for g in sifted.rejected] == 4 * [seen]
    assert [g.association.observed for g in sifted.inflated] == landmarks
    assert all((g.association.observation.R == R).all() for g in sifted.rejected)


class Teams(stateful.RuleBasedStateMachine):
    """
    Robots that drive at random, observe each other, get lost, leave and return.

    All observations are correct except for some of robots; all robots are near each other.
    """

    def __init__(self):
        super().__init__()
        self.rng = np.random.default_rng(0)
        self.estimator = Estimator(team(*TEAM, shared_landmark_ids=False))
        self.settings = self.estimator.settings
        self.true = {name: self.rng.uniform([-4, -4, -3], [4, 4, 3]) for name in TEAM}
        self.odometry = {name: np.zeros(3) for name in TEAM}
        self.start = self.true['r1']
        self.ms = 0
        self.sent = Counter()

    @stateful.rule(
        looking=st.sets(st.sampled_from([*permutations(TEAM, 2)])),
        mapping=st.sets(st.sampled_from(TEAM)), silent=st.sets(st.sampled_from(TEAM), max_size=1),
        lost=st.sampled_from([None, None, None, *TEAM]), error=st.sampled_from([0.0, 0.0, 3.0]))
    def drive(self, looking, mapping, silent, lost, error):
        self.ms += 100
        for name in TEAM:
            u = self.rng.normal([0.3, 0.0, 0.1], [0.2, 0.1, 0.2])
            self.true[name] = compose(self.true[name], u)
            self.odometry[name] = compose(self.odometry[name], u)
        for name in self.estimator.robots.keys() - silent:
            Q = 1e-4 * np.eye(3) if name != lost else np.eye(3)
            self.estimator.add(odometry(name, self.ms, self.odometry[name], Q / 0.01))
            self.look(name, [b for a, b in sorted(looking) if a == name], name in mapping, error)
        list(self.estimator.release())

    def look(self, name, others, maps, error):
        towards = between(self.true[name], np.zeros(3))
        landmarks = enumerate([(-3.0, 0.0), (0.0, 4.0), (5.0, 1.0), (2.0, -4.0)] if maps else [])
        self.estimator.add(scan(
            name, self.ms, [(k, transform(towards, np.array(at))) for k, at in landmarks]))
        self.estimator.add(robot_scan(name, self.ms, [
            (other, transform(towards, self.true[other][:2]) + error) for other in others]))
        self.sent[name] += len(others) + 4 * maps

    @stateful.precondition(lambda self: len(self.estimator.robots) > 1)
    @stateful.rule(name=st.sampled_from(TEAM))
    def leave(self, name):
        if name in self.estimator.robots and self.estimator.groups.may_leave(name):
            self.change(self.estimator.robots.keys() - {name})

    @stateful.rule(name=st.sampled_from(TEAM))
    def join(self, name):
        self.change(self.estimator.robots.keys() | {name})

    @stateful.rule(
        name=st.sampled_from(TEAM), sigma=st.sampled_from([0.01, 1.0]),
        error=st.sampled_from([0.0, 3.0]))
    def add_pose_prior(self, name, sigma, error):
        pose, P = between(self.start, self.true[name]), np.diag([0.01, 0.01, sigma**2])
        self.estimator.add(PosePrior(name, self.ms * MS, pose + error, P))

    @stateful.rule()
    def restart_from_checkpoint(self):
        self.estimator = restore(snapshot(self.estimator), self.settings, Estimator)

    def change(self, names):
        known = {robot.name: robot for robot in self.settings.robots}
        self.estimator.change_team([known[name] for name in TEAM if name in names])

    @stateful.invariant()
    def every_robot_is_in_one_frame_that_is_named_after_one_of_its_robots(self):
        states = frames(self.estimator)
        count = Counter(name for state in states.values() for name in state.robots)
        assert set(count.values()) <= {1}
        assert count.keys() <= self.estimator.robots.keys()
        assert self.estimator.groups.not_in_map.keys() == (
            self.estimator.robots.keys() - states['map'].robots.keys())
        for group in self.estimator.groups.others:
            assert group.owner in group.robots or not group.robots

    @stateful.invariant()
    def every_rendezvous_point_is_in_two_frames(self):
        kept = Counter(
            key for state in frames(self.estimator).values() for key in state.rendezvous_points)
        assert set(kept.values()) <= {2}
        pairs = Counter((key.observer, key.observed) for key in kept)
        assert max(pairs.values(), default=0) <= MAX_RENDEZVOUS_POINTS
        assert {name for pair in pairs for name in pair} <= self.estimator.robots.keys()

    @stateful.invariant()
    def every_observation_is_used_or_rejected(self):
        # Nothing waits, and no scan is rejected as a whole.
        rejected = Counter(
            r.robot for r in self.estimator.statistics.rejections if r.id is not None)
        for name, count in self.sent.items():
            assert count == self.estimator.statistics.observations_used[name] + rejected[name]

    @stateful.invariant()
    def every_covariance_is_positive_semidefinite(self):
        for state in frames(self.estimator).values():
            variables = state.variables()
            assert len(state.x_hat) == len(state.x_first) == state.covariance.dimension
            if variables:
                eigenvalues = np.linalg.eigvalsh(state.marginal(variables))
                # Rendezvous points are positions of robots without further noise, but rounding.
                assert eigenvalues[0] > -1e-10 * max(1.0, eigenvalues[-1])


TestTeams = Teams.TestCase
TestTeams.settings = settings(
    max_examples=30, stateful_step_count=30, deadline=None, derandomize=True)


@pytest.mark.slow
@pytest.mark.timeout(1800)
class TestManyTeams(Teams.TestCase):
    """The same for longer."""

    settings = settings(max_examples=200, stateful_step_count=50, deadline=None)


def mean_variance(kind, seed, sees_robots, landmarks):
    """Return the trace of the covariance of positions, averaged over robots and steps."""
    sensors = replace(ENVIRONMENTS['circles'].sensors, robot_sigma=(0.5, 0.5))
    records = circles(
        seed, landmarks=landmarks, sensors=sensors if sees_robots else
        replace(sensors, robot_sigma=None))
    _, steps = estimate(records, filter=kind, gate_probability=1.0)
    return np.mean([
        np.trace(pose.P[:2, :2]) for step in steps for pose in step.poses if pose.frame == 'map'])


def gain(kind, seeds, landmarks):
    """Return the mean over seeds with observations of robots, as a part of that without them."""
    with_them, without = (
        np.mean([mean_variance(kind, seed, sees, landmarks) for seed in seeds])
        for sees in (True, False))
    ratio = with_them / without
    print(f'{kind}, {landmarks} landmarks: {ratio:.4f} of {without:.4f} m^2')  # noqa: T201
    return ratio


@pytest.mark.parametrize('kind', FILTERS)
def test_robot_observations_improve_accuracy(kind):
    assert gain(kind, range(3), 20) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize('kind', FILTERS)
@pytest.mark.parametrize('landmarks', [20, 60])
def test_robot_observations_improve_accuracy_over_a_hundred_runs(kind, landmarks):
    assert gain(kind, range(100), landmarks) < 1.0
