# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Maps join if what they share fits and determines the heading, and join consistently.

Changes that lose observability fail the first test: columns at J C f of the group's landmarks, or
at estimates where first estimates are carried. In the invariant filter, no transport of errors,
or one from first estimates, fails it, and the first test of test_joined_state.
"""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import (
    FirstEstimates, Invariant, RenewedFirstEstimates)
from fej_slam_ros.core.ekf.state import JointState, position_indices
from fej_slam_ros.core.geometry import rigid_fit
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.joining.map_joining import MapJoiner, most_certain_robot
from fej_slam_ros.core.records import NS, Odometry, PosePrior, RendezvousKey, Scan, TrueLandmarks
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.sim.sensors import SensorSettings
from helpers.core import estimate, frames, pose_difference, turn, unknown_place
from helpers.joining import two_maps

#: The second robot's odometry begins at this step.
LATE = 40
ANCHOR_SIGMA = (0.1, 0.2, 0.05)
TEAM = ('r1', 'r2')
#: Filters to which the global pose stays unobservable, but for that which needs ground truth.
CONSISTENT = ['fej', 'invariant']


def late_robot(seed, *, known=False, **settings):
    """Return an estimator whose second robot begins late, its steps, and the true poses of it."""
    environment = ENVIRONMENTS['circles']
    environment = replace(
        environment, world=replace(environment.world, landmarks=40, loops=1))
    true = environment.true_world(np.random.default_rng(seed)).true_poses['r2']
    begin = LATE * NS // 5
    records = [
        record for record in environment.records(np.random.default_rng(seed))
        if isinstance(record, TrueLandmarks) or record.robot == 'r1' or record.stamp >= begin]
    start = tuple(true[LATE].tolist()) if known else None
    team = (RobotSettings('r1', 1), RobotSettings('r2', 2, start_pose=start))
    estimator, steps = estimate(records, team, gate_probability=1.0, **settings)
    return estimator, steps, true


def without_anchor_uncertainty(kind, state):
    """Return the covariance less that by the anchor's start, indefinite if this was reduced."""
    P = state.marginal(state.variables())
    at = state.x_first if kind == 'fej' else state.x_hat
    return P - unknown_place(state, at, ANCHOR_SIGMA)


@pytest.mark.parametrize('kind', CONSISTENT)
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_join_during_a_run_adds_no_information_about_the_global_pose(seed, kind):
    estimator, _, _ = late_robot(seed, anchor_sigma=ANCHOR_SIGMA, filter=kind)
    state = estimator.groups.team.state
    assert 'r2' in state.robots

    # The uncertainty of the anchor's start is in P to the end.
    left = np.linalg.eigvalsh(without_anchor_uncertainty(kind, state))

    assert left.min() > 0.0


def test_the_standard_filter_gains_spurious_information_about_the_global_pose():
    estimator, _, _ = late_robot(1, anchor_sigma=ANCHOR_SIGMA, filter='standard')

    left = np.linalg.eigvalsh(without_anchor_uncertainty('standard', estimator.groups.team.state))

    assert left.min() < -1.0


@pytest.mark.parametrize(('shared', 'least', 'why'), [
    (1, 3, '1 shared landmark, needs 3'), (2, 3, '2 shared landmarks, needs 3'),
    (2, 2, None), (3, 3, None)])
def test_a_minimum_number_of_landmarks_must_be_shared(shared, least, why):
    team, group, _ = two_maps(shared=shared)
    into = Filter(team, FirstEstimates(), Gate(1.0))

    failure = MapJoiner(least, 0.999).join(into, Filter(group, FirstEstimates(), Gate(1.0)))

    assert failure == (None if why is None else JoinFailure(why))
    assert ('r2' in into.state.robots) is (why is None)


@pytest.mark.parametrize(('policy', 'after'), [
    (FirstEstimates, RenewedFirstEstimates), (Invariant, Invariant)])
def test_a_join_lets_first_estimates_of_the_team_be_renewed_from_then_on(policy, after):
    team, group, _ = two_maps()
    into = Filter(team, policy(), Gate(1.0))

    MapJoiner(3, 0.999).join(into, Filter(group, policy(), Gate(1.0)))

    assert type(into.linearization) is after


def test_maps_that_contradict_each_other_stay_apart():
    team, group, _ = two_maps()
    group.x_hat[3:5] += 5.0
    into = Filter(team, FirstEstimates(), Gate(1.0))

    failure = MapJoiner(3, 0.99).join(into, Filter(group, FirstEstimates(), Gate(1.0)))

    assert failure.reason.startswith('4 shared landmarks do not fit: chi-square ')
    assert failure.outlier is None
    assert into.state is team


@pytest.mark.parametrize(('shared', 'moved'), [(5, 1), (9, 1), (10, 2), (40, 8)])
def test_a_fifth_of_the_shared_landmarks_may_contradict_the_others(shared, moved):
    team, group, g = two_maps(shared=shared)
    wrong = {('', number) for number in range(moved)}
    for key in wrong:
        group.x_hat[group.landmarks[key].slot.indices] += [4.0, -3.0]
    into, of_group = (Filter(state, FirstEstimates(), Gate(1.0)) for state in (team, group))
    joiner = MapJoiner(3, 0.999)

    failure = joiner.join(into, of_group)

    assert set(failure.outlying_landmarks) == wrong
    assert failure.reason == f'{moved} of {shared} shared landmarks contradict the others'
    for state in (team, group):
        for key in failure.outlying_landmarks:
            state.remove(state.landmarks[key])
    assert joiner.join(into, of_group) is None
    # The robot of the group has an error of its own; five sigma of the largest noise.
    assert_allclose(into.state.estimate(into.state.robots['r2'])[:2], g[:2], atol=0.5)


@pytest.mark.parametrize(('most', 'found'), [(3, [0, 4]), (2, [0, 4]), (1, [])])
def test_the_landmarks_without_which_the_others_fit_are_named_unless_too_many(most, found):
    team, group, _ = two_maps(shared=8)
    filters = [Filter(state, FirstEstimates(), Gate(0.999)) for state in (team, group)]
    for number in (0, 4):
        group.x_hat[group.landmarks['', number].slot.indices] += 1.0

    misfits = MapJoiner(3, 0.999).misfits(*filters, most)

    assert sorted(misfits) == [('', number) for number in found]


def test_errors_that_all_landmarks_share_hide_no_outlier():
    team, group, _ = two_maps(shared=12)
    wrong = ('', 3)
    group.x_hat[group.landmarks[wrong].slot.indices] += [1.0, -1.0]
    # The whole map of the team has drifted, by an unknown 10 m.
    n = len(team.x_hat)
    for axis in range(2):
        drift = np.zeros(n)
        drift[[variable.slot.start + axis for variable in team.variables()]] = 10.0
        team.covariance.matrix.lower[:n, :n] += np.tril(np.outer(drift, drift))

    failure = MapJoiner(3, 0.999).join(*(
        Filter(state, FirstEstimates(), Gate(1.0)) for state in (team, group)))

    assert failure.outlying_landmarks == (wrong,)


@pytest.mark.parametrize(('shared', 'moved', 'least'), [(4, 1, 3), (9, 2, 3), (5, 1, 5)])
def test_of_fewer_landmarks_none_is_left_out(shared, moved, least):
    team, group, _ = two_maps(shared=shared)
    for number in range(moved):
        group.x_hat[group.landmarks['', number].slot.indices] += [4.0 + number, -3.0]

    failure = MapJoiner(least, 0.999).join(*(
        Filter(state, FirstEstimates(), Gate(1.0)) for state in (team, group)))

    assert failure.outlying_landmarks == ()
    assert 'do not fit' in failure.reason


def reobserve(states, number):
    """Mark a landmark of some states as observed a second time."""
    for state in states:
        state.landmarks['', number].is_reobserved = True


def meet(team, group, g, positions):
    """Add an observation between the robots at each position (2,) in the frame of the team."""
    for stamp, position in enumerate(positions):
        key = RendezvousKey('r1', 'r2', stamp)
        of_group = turn(g[2]).T @ (position - g[:2])
        for state, name, point in ((team, 'r1', np.array(position)), (group, 'r2', of_group)):
            state.augment_rendezvous_point(
                key, state.robots[name], point, np.zeros((2, 3)), 0.01 * np.eye(2))


def test_a_landmark_that_was_observed_once_does_not_determine_the_heading_alone():
    team, group, g = two_maps(shared=1)
    # The robots met twice at one position.
    meet(team, group, g, ([2.0, 1.0], [2.1, 1.1]))
    filters = [Filter(state, FirstEstimates(), Gate(1.0)) for state in (team, group)]

    failure = MapJoiner(3, 0.999).join(*filters)

    assert failure == JoinFailure(
        'landmark 0, which was observed once, determines the heading alone')
    reobserve((team, group), 0)
    assert MapJoiner(3, 0.999).join(*filters) is None


def test_misread_landmarks_are_left_out_where_robots_observed_each_other_often_enough():
    team, group, g = two_maps(shared=2)
    meet(team, group, g, ([2.0, 1.0], [5.0, 1.0], [5.0, 4.0]))
    for number in range(2):
        group.x_hat[group.landmarks['', number].slot.indices] += [3.0, 4.0]
    reobserve((team,), 0)
    joiner = MapJoiner(3, 0.999)
    filters = [Filter(state, FirstEstimates(), Gate(1.0)) for state in (team, group)]

    failure = joiner.join(*filters)

    # The observations of robots, which agree, stay: only by them are the landmarks wrong.
    assert set(failure.outlying_landmarks) == {('', 0), ('', 1)}
    for key in failure.outlying_landmarks:
        for state in (team, group):
            state.remove(state.landmarks[key])
    assert joiner.join(*filters) is None


@pytest.mark.parametrize('confirmed_in', [[], [0], [1]])
def test_a_landmark_that_a_map_observed_once_and_contradicts_the_others_is_left_out(confirmed_in):
    team, group, _ = two_maps(shared=6)
    group.x_hat[group.landmarks['', 3].slot.indices] += [-0.6, 0.0]
    reobserve([(team, group)[k] for k in confirmed_in], 3)
    filters = [Filter(state, FirstEstimates(), Gate(1.0)) for state in (team, group)]
    # All six landmarks together pass.
    joiner = MapJoiner(3, 1.0 - 1e-15)

    failure = joiner.join(*filters)

    assert failure == JoinFailure(
        'landmark 3, which was observed once, contradicts the others',
        outlying_landmarks=(('', 3),))
    reobserve((team, group), 3)
    assert joiner.join(*filters) is None
    # It is known to both maps now.
    assert all(filters[0].state.landmarks['', k].is_reobserved for k in range(6))


def test_maps_that_determine_the_heading_poorly_stay_apart():
    team, group, _ = two_maps(noise=4.0, shared=2)
    into = Filter(team, FirstEstimates(), Gate(1.0))

    failure = MapJoiner(2, 1.0).join(into, Filter(group, FirstEstimates(), Gate(1.0)))

    assert 'determine the heading to' in failure.reason


def around_one_of_two(headings):
    """Return a state of two robots, of some sigmas of heading, among landmarks that both know."""
    state, rng = JointState(), np.random.default_rng(4)
    state.insert_robot('r2', 5, np.zeros(3), np.diag(np.square([0.01, 0.01, headings[0]])))
    state.insert_robot('r3', 5, np.ones(3), np.diag(np.square([0.01, 0.01, headings[1]])))
    for number in range(4):
        state.augment(
            ('', number), state.robots['r2'], rng.uniform(-6.0, 6.0, 2), np.zeros((2, 3)),
            1e-4 * np.eye(2))
    return state


@pytest.mark.parametrize('headings', [(0.05, 0.5), (0.5, 0.05)])
def test_maps_join_by_the_robots_whose_headings_are_known_whichever_comes_first(headings):
    team, _, _ = two_maps(noise=0.01)
    # The team's own first robot has drifted, too.
    team.covariance.matrix.lower[2, 2] += 0.5 ** 2
    team.insert_robot('r4', 5, np.ones(3), 1e-4 * np.eye(3))
    group = around_one_of_two(headings)
    for number in range(4):
        team.x_hat[team.landmarks['', number].slot.indices] = group.estimate(
            group.landmarks['', number])
    into = Filter(team, FirstEstimates(), Gate(1.0))

    failure = MapJoiner(3, 0.999).join(into, Filter(group, FirstEstimates(), Gate(1.0)))

    assert failure is None


@pytest.mark.parametrize('seed', range(5))
def test_the_most_certain_robot_is_that_from_which_points_turn_least_in_samples(seed):
    rng = np.random.default_rng(seed)
    state = JointState()
    for name in 'abc':
        state.insert_robot(name, 5, rng.uniform(-3.0, 3.0, 3), np.diag([1e-6, 1e-6, 1e-6]))
    for number in range(5):
        state.augment(
            ('', number), state.robots['a'], rng.uniform(-6.0, 6.0, 2), np.zeros((2, 3)),
            1e-6 * np.eye(2))
    # Headings and points are correlated, as those of a robot that has mapped them.
    A = 1e-2 * rng.normal(size=(len(state.x_hat), 3))
    state.covariance.matrix.lower[:len(A), :len(A)] += A @ A.T
    points = [*state.landmarks.values()]
    P = state.marginal(state.variables())
    x = rng.multivariate_normal(state.x_hat, P, 4000)
    positions, true = position_indices(points), state.x_hat

    def turns_from(robot):
        heading = robot.slot.start + 2
        return [
            rigid_fit(true[positions], sample[positions])[2] - sample[heading] + true[heading]
            for sample in x]

    least = min(state.robots.values(), key=lambda robot: np.std(turns_from(robot)))

    assert most_certain_robot(state, points) is least


def pose_prior(stamp, pose, sigma=0.1):
    return PosePrior('r2', stamp, np.array(pose), sigma**2 * np.eye(3))


def test_a_pose_prior_places_a_robot_from_its_next_step_on():
    # Two robots that observe nothing and stand still.
    stamps = range(0, 5 * NS, NS)
    records = [Odometry(name, k, np.zeros(3), np.zeros((3, 3))) for k in stamps for name in TEAM]
    records.insert(3, pose_prior(NS, [2.0, 3.0, 0.5]))

    _, steps = estimate(records, TEAM)

    poses = [pose for step in steps for pose in step.poses if pose.robot == 'r2']
    assert [pose.frame for pose in poses] == ['r2/map', *['map'] * 4]
    assert_allclose(poses[-1].pose, [2.0, 3.0, 0.5], atol=1e-12)
    assert_allclose(poses[-1].P, 0.01 * np.eye(3), atol=1e-12)


def test_a_pose_prior_moves_a_robot_that_is_in_map():
    estimator, _ = estimate(
        [*(Odometry(name, k * NS, np.zeros(3), None) for k in range(3) for name in TEAM),
         pose_prior(NS, [5.0, 5.0, 0.0])], TEAM, anchor='r2')

    assert estimator.statistics.rejected.total() == 0
    assert_array_equal(estimator.pose('r2').pose, [5.0, 5.0, 0.0])


def test_a_pose_prior_must_fit_the_shared_landmarks():
    team, group, g = two_maps()
    into, of_group = (Filter(state, FirstEstimates(), Gate(1.0)) for state in (team, group))
    right = g[:2] + turn(g[2]) @ group.x_hat[:2], g[2] + group.x_hat[2]

    assert not MapJoiner(3, 0.99).apply_pose_prior(
        into, of_group, 'r2', np.array([*right[0] + 5.0, right[1]]), 0.01 * np.eye(3))
    assert into.state is team
    joiner = MapJoiner(3, 0.99)
    assert joiner.apply_pose_prior(
        into, of_group, 'r2', np.array([*right[0], right[1]]), 0.01 * np.eye(3))
    assert joiner.join_via_robot(into, of_group, 'r2')
    assert set(into.state.robots) == {'r1', 'r2'}


def test_a_robot_joins_while_it_drives_and_its_pose_changes_its_frame():
    estimator, steps, _ = late_robot(1)

    frames = [pose.frame for step in steps for pose in step.poses if pose.robot == 'r2']
    first = frames.index('map')

    assert set(frames[:first]) == {'r2/map'}
    assert set(frames[first:]) == {'map'}
    assert estimator.groups.not_in_map == {}


def test_robots_that_the_anchor_never_meets_join_each_other():
    records = [
        record for record in ENVIRONMENTS['circles'].records(np.random.default_rng(4))
        if isinstance(record, TrueLandmarks) or record.robot in ('r1', 'r2')]
    moved = [
        replace(record, robot={'r1': 'r2', 'r2': 'r3'}[record.robot])
        for record in records if not isinstance(record, TrueLandmarks)]
    # r1 stands among landmarks that no other robot observes.
    alone = [replace(record, robot='r1', **(
        {'observations': tuple(replace(s, id=s.id + 1000) for s in record.observations)}
        if hasattr(record, 'observations') else {}))
        for record in records if not isinstance(record, TrueLandmarks) and record.robot == 'r1']

    estimator, steps = estimate(
        sorted([*alone, *moved], key=lambda record: record.stamp), ('r1', 'r2', 'r3'))

    assert list(frames(estimator)) == ['map', 'r2/map']
    assert set(frames(estimator)['r2/map'].robots) == {'r2', 'r3'}
    assert {pose.frame for pose in steps[-1].poses} == {'map', 'r2/map'}
    assert estimator.groups.not_in_map['r3'] == '0 shared landmarks, needs 3'


def time_averaged_nees(run, seeds, kind):
    """Return the mean NEES / 3 of the second robot in the map over runs and steps."""
    values = []
    for seed in seeds:
        _, steps, *_, true = run(seed, filter=kind)
        for step in steps:
            for pose in step.poses:
                if pose.robot == 'r2' and pose.frame == 'map':
                    e = pose_difference(pose.pose, true[round(pose.stamp * 5 / NS)])
                    values.append(e @ np.linalg.solve(pose.P, e) / 3.0)
    return np.mean(values)


@pytest.mark.parametrize('kind', CONSISTENT)
def test_robots_that_joined_are_consistent(kind):
    # Means of 20 correlated runs scatter by about 0.1.
    assert 0.75 < time_averaged_nees(late_robot, range(20), kind) < 1.3


@pytest.mark.slow
@pytest.mark.parametrize('kind', CONSISTENT)
def test_robots_that_joined_are_consistent_over_a_hundred_runs(kind):
    assert 0.85 < time_averaged_nees(late_robot, range(100, 200), kind) < 1.25


@pytest.mark.parametrize('kind', CONSISTENT)
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_joined_robot_is_less_certain_than_one_with_a_known_start(seed, kind):
    P = {}
    for known in (False, True):
        estimator, _, _ = late_robot(seed, known=known, filter=kind)
        state = estimator.groups.team.state
        P[known] = state.marginal([state.robots['r2']])

    assert np.trace(P[False]) > np.trace(P[True])


def late_anchor(seed, sensors=None, **settings):
    """Return an estimator whose anchor is blind at first, its steps, the records and the truth."""
    environment = ENVIRONMENTS['circles']
    environment = replace(
        environment, world=replace(environment.world, landmarks=40, loops=1),
        sensors=sensors or environment.sensors)
    true = environment.true_world(np.random.default_rng(seed)).true_poses['r2']
    records = [
        replace(record, observations=()) if isinstance(record, Scan) and record.robot == 'r1'
        and record.stamp < LATE * NS // 5 else record
        for record in environment.records(np.random.default_rng(seed))]
    estimator, steps = estimate(records, TEAM, gate_probability=1.0, **settings)
    return estimator, steps, records, true


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_landmarks_mapped_before_step_0_are_kept(seed):
    # The anchor has a short range, so that it observes a part of the other map at step 0.
    sensors = SensorSettings((0.1, 0.1, 0.01), (0.1, 0.1), range=40.0)
    estimator, steps, records, _ = late_anchor(seed, sensors)
    step_0 = next(s.stamp for s in records if isinstance(s, Scan) and s.robot == 'r1'
                  and s.observations)
    before = {
        observation.id for s in records if isinstance(s, Scan) and s.robot == 'r2'
        and s.stamp < step_0 for observation in s.observations}
    at_step_0 = {
        observation.id for s in records if isinstance(s, Scan) and s.stamp == step_0
        for observation in s.observations}
    assert before - at_step_0

    after = {number: landmark.created
             for (_, number), landmark in estimator.groups.team.state.landmarks.items()}

    assert estimator.groups.others == []
    assert all(after[number] < step_0 for number in before - at_step_0)
    assert {pose.frame for step in steps if step.stamp >= step_0 for pose in step.poses} == {'map'}


@pytest.mark.parametrize('kind', CONSISTENT)
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_step_0_with_an_earlier_map_adds_no_information_about_the_global_pose(seed, kind):
    estimator, _, _, _ = late_anchor(seed, anchor_sigma=ANCHOR_SIGMA, filter=kind)

    left = np.linalg.eigvalsh(without_anchor_uncertainty(kind, estimator.groups.team.state))

    assert left.min() > 0.0


@pytest.mark.parametrize('kind', CONSISTENT)
def test_a_robot_with_a_map_from_before_step_0_is_consistent(kind):
    # Means of 20 correlated runs scatter by about 0.1.
    assert 0.75 < time_averaged_nees(late_anchor, range(20), kind) < 1.3


def test_a_map_does_not_join_by_a_pose_prior_with_an_uncertain_heading():
    team, group, _ = two_maps(noise=0.01)
    into, of_group = (Filter(state, FirstEstimates(), Gate(1.0)) for state in (team, group))
    for key in list(group.landmarks)[:3]:
        group.remove(group.landmarks[key])
    joiner, vague = MapJoiner(3, 0.99), np.diag([1.0, 1.0, 0.04])

    assert joiner.apply_pose_prior(into, of_group, 'r2', np.array([3.0, -2.0, 0.7]), vague)
    assert not joiner.join_via_robot(into, of_group, 'r2')

    assert set(into.state.robots) == {'r1', 'r2'}
    assert_allclose(into.state.marginal([into.state.robots['r2']]), vague)
    assert not group.robots
    assert len(group.landmarks) == 2
