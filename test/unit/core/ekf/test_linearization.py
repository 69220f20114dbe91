# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A spy on the models: where each kind of filter takes its Jacobians, during a run with noise.

What is expected is kept by the tests themselves, from the estimates between the filter's calls.

Mutations, each tried once in a copy of the sources, that no other test caught without the data of
the authors: innovation at a robot's first estimate, the start covariance of ideal at the estimate,
headings not wrapped after a correction.

Those of robot-to-robot observations that fail here: in FEJ the current pose of the observed robot
or of the observer; in ideal the observed robot at its estimate.
"""

from collections import defaultdict
from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core import models
from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.ekf.state import JointState, position_indices, Robot
from fej_slam_ros.core.joining.initial_alignment import align
from fej_slam_ros.core.joining.initialization import initialize
from fej_slam_ros.core.records import Scan
from helpers.core import circles, estimate, SmallTeam, turn, wrapped

KINDS = ['standard', 'fej', 'ideal', 'invariant']

#: Who moves, who looks, at which landmarks, who looks for the other robot. Robots stand still
#: while the other one corrects them, look and are seen long after they moved, and see new
#: landmarks together and alone.
SCHEDULE = [
    (['r1', 'r2'], ['r1', 'r2'], [0, 1], []),
    (['r1'], ['r1'], [0, 2], ['r1']),
    (['r1', 'r2'], ['r2'], [0, 1, 2], []),
    (['r2'], ['r2'], [0, 1], ['r2']),
    ([], ['r1'], [0, 1, 3], ['r2']),
    (['r2'], [], [], ['r1']),
    (['r1', 'r2'], ['r1', 'r2'], [1, 3, 4], []),
    ([], ['r2'], [0, 4], ['r1', 'r2']),
    (['r1'], ['r1', 'r2'], [0, 4, 5], ['r2']),
    (['r1', 'r2'], ['r2', 'r1'], [0, 1, 2, 3, 4, 5], ['r2', 'r1'])]


@pytest.fixture
def calls(monkeypatch):
    """Return the arguments of all calls of each model, in order."""
    history = defaultdict(list)

    def spied(name, model):
        def call(*arguments):
            history[name].append(arguments)
            return model(*arguments)
        return call

    G, transition = models.G, KERNEL.Phi

    def Phi(x, x_next):
        history['Phi'].append((x_next[:2] - x[:2],))
        return transition(x, x_next)

    def moved(x, u, Q):
        history['G'].append((x[2],))
        return models.f(x, u), G(x[2]) @ Q @ G(x[2]).T

    for name in ('G', 'F'):
        monkeypatch.setattr(models, name, spied(name, getattr(models, name)))
    for name in ('h', 'H'):
        monkeypatch.setattr(KERNEL, name, spied(name, getattr(KERNEL, name)))
    monkeypatch.setattr(KERNEL, 'Phi', Phi)
    monkeypatch.setattr(KERNEL, 'moved', moved)
    return history


class Journey:
    """
    Drives a filter by the schedule and notes where each kind of filter would linearise.

    Attributes
    ----------
    expected : for each model the arguments of each call, for the Jacobians one for each kind
    first : the first estimates, of robots by name and of landmarks by key

    """

    def __init__(self, kind):
        self._team = SmallTeam(seed=5, landmarks=6)
        self.filter = self._team.start(kind)
        self.state, self._truth = self.filter.state, self._team.truth
        self.first = {name: self._estimate(name) for name in self._team.names}
        self.expected = defaultdict(list)
        for stamp, (moving, looking, numbers, watching) in enumerate(SCHEDULE, start=1):
            for name in moving:
                self._move(name, stamp)
            self._look(
                [self._team.look(name, numbers) for name in looking],
                [self._team.look_for_robots(name) for name in watching])

    def _estimate(self, key):
        variables = self.state.robots if key in self.state.robots else self.state.landmarks
        return self.state.estimate(variables[key])

    def _true(self, key):
        if key in self.state.robots:
            return self._truth.pose(key, self._truth.newest(key))
        return self._truth.landmark(key)

    def _move(self, name, stamp):
        x, x_true = self._estimate(name), self._true(name)
        self.filter.predict(self._team.drive(name, stamp))
        p = self._estimate(name)[:2]
        self.expected['Phi'].append({
            'standard': (p - x[:2],), 'invariant': (p - x[:2],),
            'fej': (p - self.first[name][:2],), 'ideal': (self._true(name)[:2] - x_true[:2],)})
        self.expected['G'].append((x[2],))
        self.first[name] = self._estimate(name)

    def _look(self, scans, meetings):
        observations = [
            *self.filter.start_landmarks(scans), *self.filter.associate_robots(meetings)]
        for key, landmark in self.state.landmarks.items():
            if key not in self.first:
                x, x_true = self._estimate(landmark.owner), self._true(landmark.owner)
                f = self.first[key] = self._estimate(key)
                b, b_true = f - x[:2], self._true(key) - x_true[:2]
                b_first = f - self.first[landmark.owner][:2]
                self.expected['F'].append({
                    'standard': (b,), 'invariant': (b,), 'fej': (b_first,), 'ideal': (b_true,)})
                self.expected['G'].append((x[2],))
        if observations:
            current = self._at(self._estimate, observations)
            self.expected['h'].append(current)
            self.expected['H'].append({
                'standard': current, 'invariant': current,
                'fej': self._at(self.first.get, observations),
                'ideal': self._at(self._true, observations)})
        self.filter.update(observations)

    @staticmethod
    def _at(value, observations):
        keys = [
            a.observed.name if isinstance(a.observed, Robot) else a.observed.key
            for a in observations]
        return (np.array([
            [*value(a.observer.name), *value(key)[:2]] for a, key in zip(observations, keys)]),)


def assert_arguments(calls, expected):
    """Check calls to rounding: what is subtracted may be subtracted in another order."""
    assert len(calls) == len(expected)
    for arguments, where in zip(calls, expected):
        for argument, at in zip(arguments, where):
            assert_allclose(argument, at, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('model', ['Phi', 'F', 'H'])
def test_jacobians_are_evaluated_at_the_points_of_the_policy(model, kind, calls):
    journey = Journey(kind)

    assert_arguments(calls[model], [at[kind] for at in journey.expected[model]])


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('model', ['G', 'h'])
def test_innovation_and_noise_are_evaluated_at_the_current_estimate(model, kind, calls):
    journey = Journey(kind)

    assert_arguments(calls[model], journey.expected[model])


@pytest.mark.parametrize(
    ('model', 'states'), [('Phi', slice(2)), ('H', slice(3)), ('H', slice(3, 5))])
def test_linearization_points_differ_between_the_policies(model, states):
    expected = Journey('fej').expected[model]

    for a, b in (('standard', 'fej'), ('fej', 'ideal'), ('ideal', 'standard')):
        differences = [np.abs(at[a][0] - at[b][0])[..., states].max() for at in expected]
        assert max(differences) > 0.01


@pytest.mark.parametrize('kind', KINDS)
def test_first_estimates_are_values_before_any_update(kind):
    journey = Journey(kind)

    state = journey.state
    moved = []
    for key, variable in (*state.robots.items(), *state.landmarks.items()):
        assert_array_equal(state.first_estimate(variable), journey.first[key])
        moved.append(np.abs(state.estimate(variable) - journey.first[key]).max())
    assert min(moved) > 1e-4


def test_displacements_of_fej_add_up_across_corrections(calls):
    # Scans halfway between odometry, so that every other stop is an interpolated one.
    records = [
        replace(record, stamp=record.stamp + 100_000_000) if isinstance(record, Scan) else record
        for record in circles(seed=2, robots=1)]

    estimator, _ = estimate(records, ['r1'])

    state = estimator.groups.team.state
    assert len(calls['Phi']) == 2 * 63
    total = np.sum([d for d, in calls['Phi']], axis=0)
    assert_allclose(total, state.first_estimate(state.robots['r1'])[:2], atol=1e-12)


@pytest.mark.parametrize('kind', KINDS)
def test_a_correction_leaves_headings_in_range(kind):
    journey = Journey(kind)
    filter_, state = journey.filter, journey.state
    for robot in state.robots.values():
        state.x_hat[robot.slot.start + 2] = 3.1
    dx = np.full(len(state.x_hat), 4.0)

    x = filter_.linearization.retract(state, state.x_hat, dx)

    expected = state.x_hat + dx
    if kind == 'invariant':
        # V(4) (4, 4), the mean of a shift that turns by 4 on its way.
        V = (turn(4.0) - np.eye(2)) @ turn(-np.pi / 2) / 4.0
        expected[position_indices(state.variables())] += V @ [4.0, 4.0] - 4.0
    expected[[2, 5]] = wrapped(7.1)
    assert_allclose(x, expected, atol=1e-14)


@pytest.mark.parametrize('kind', KINDS)
def test_the_start_covariance_is_linearized_at_the_points_of_the_policy(kind, monkeypatch):
    calls, H = [], models.H
    monkeypatch.setattr(models, 'H', lambda *points: calls.append(points) or H(*points))
    team = SmallTeam(seed=6, landmarks=3)
    filter_, state = team.start(kind), JointState()
    state.insert_robot('r1', 0, team.truth.pose('r1', 0), np.diag([0.01, 0.01, 0.01]))
    scans = {
        name: [(('', s.id), s) for s in team.look(name).observations] for name in team.names}

    started = initialize(state, 'r1', scans, 0, filter_.linearization, align)

    x = started.x_hat
    if kind == 'ideal':
        x = np.concatenate([team.truth.pose(name, 0) for name in team.names] + [
            team.truth.landmark(key) for key in started.landmarks])
    poses, points = x[:6].reshape(2, 3), x[6:].reshape(3, 2)
    at_last = [(poses[[i]], points[[k]]) for i in (0, 1) for k in (0, 1, 2)]
    # The solution is known to the last increment of the iteration.
    for arguments, at in zip(calls[-6:], at_last, strict=True):
        assert_allclose(np.hstack(arguments), np.hstack(at), rtol=0.0, atol=1e-11)
