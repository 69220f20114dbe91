# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots with unknown poses join by robot-to-robot observations."""

from dataclasses import replace
from itertools import pairwise
from math import radians
import re

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.optimize import least_squares

from fej_slam_ros.core.ekf.observability import rigid_motions
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.ground_truth import MissingTruthError
from fej_slam_ros.core.joining.rendezvous_points import MAX_RENDEZVOUS_POINTS
from fej_slam_ros.core.records import (
    NS, Odometry, PosePrior, RendezvousKey, RobotScan, Scan, TruePose)
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.core.snapshot import restore, snapshot
from fej_slam_ros.sim.sensors import SensorSettings
from helpers.core import circles, estimate, frames, pose_difference, turn, unknown_place, wrapped
from helpers.records import MS, odometry, robot_scan, scan, team, true_pose

FILTERS = ['standard', 'fej', 'ideal', 'invariant']
TEAM = 'r1', 'r2', 'r3'
#: Robots that observe each other in the whole run.
SENSORS = SensorSettings((0.05, 0.05, 0.01), (0.1, 0.1), range=60.0, robot_sigma=(0.1, 0.1))
#: With the noise of [Liu], by which step 0 moves what has joined before.
NOISY = SensorSettings(
    (0.3, 0.3, radians(2.0)), (0.5, 0.5), range=60.0, robot_sigma=(0.3, 0.3))


def meetings(seed, robots=2, until=12.6, sensors=SENSORS, observers=TEAM):
    """Return a run without landmarks, in which some robots observe the others."""
    return [
        record for record in circles(seed, robots, sensors=sensors)
        if record.stamp <= until * NS and not isinstance(record, Scan)
        and not (isinstance(record, RobotScan) and record.robot not in observers)]


def truth_of(records):
    """Return the true pose of each robot at each stamp."""
    return {(r.robot, r.stamp): r.pose for r in records if isinstance(r, TruePose)}


def points_in(estimator):
    """Return the keys of the rendezvous points in each frame that has any."""
    return {
        frame: list(state.rendezvous_points) for frame, state in frames(estimator).items()
        if state.rendezvous_points}


def assert_all_in_map(estimator, records):
    """Check that all robots are in ``map`` near the truth, and no rendezvous point is left."""
    state, truth = estimator.groups.team.state, truth_of(records)
    assert estimator.groups.not_in_map == points_in(estimator) == {}
    assert state.robots.keys() == estimator.robots.keys()
    for name, robot in state.robots.items():
        e = pose_difference(state.estimate(robot), truth[name, robot.stamp])
        # Chi-square with 3 degrees of freedom is below 30 but for 1 in a million.
        assert e @ np.linalg.solve(state.marginal([robot]), e) < 30.0


@pytest.mark.parametrize('kind', FILTERS)
@pytest.mark.parametrize('observers', [('r1',), ('r2',), ('r1', 'r2')])
def test_two_robots_without_a_landmark_join_if_one_observes_the_other(kind, observers):
    records = meetings(1, observers=observers)

    estimator, steps = estimate(records, filter=kind)

    assert_all_in_map(estimator, records)
    assert {pose.frame for pose in steps[0].poses} == {'map', 'r2/map'}


@pytest.mark.parametrize('wrong', [0, 1, 2])
def test_one_wrong_observation_is_rejected_and_does_not_prevent_the_join(wrong):
    records = meetings(1, observers=('r1',))
    number = [k for k, r in enumerate(records) if isinstance(r, RobotScan)][wrong]
    observation, = records[number].observations
    records[number] = replace(records[number], observations=(
        replace(observation, z=observation.z + np.array([0.0, 3.0])),))

    estimator, _ = estimate(records)

    assert_all_in_map(estimator, records)
    rejected, = (r for r in estimator.statistics.rejections if r.reason is RejectionReason.GATED)
    assert (rejected.robot, rejected.observed) == ('r1', 'r2')
    assert rejected.stamp == records[number].stamp
    # 3 m at 0.1 m, less by the uncertainty of the few other observations.
    assert rejected.threshold < rejected.d2 < 30.0**2


@pytest.mark.parametrize('kind', FILTERS)
@pytest.mark.parametrize('pairs', [
    [('r1', 'r2'), ('r2', 'r3')], [('r3', 'r2'), ('r3', 'r1')], [('r2', 'r3'), ('r1', 'r3')]])
def test_three_robots_join_by_observations_of_any_two_pairs(kind, pairs):
    records = [
        replace(r, observations=tuple(s for s in r.observations if (r.robot, s.observed) in pairs))
        if isinstance(r, RobotScan) else r for r in meetings(1, robots=3)]

    estimator, _ = estimate(records, TEAM, filter=kind)

    assert_all_in_map(estimator, records)


@pytest.mark.parametrize('begin', [0.0, 4.0])
@pytest.mark.parametrize('kind', FILTERS)
def test_robots_join_without_shared_landmark_ids(kind, begin):
    # Step 0 is at the first stamp; later observations join maps.
    records = [
        record for record in circles(2, landmarks=20, sensors=SENSORS)
        if not (isinstance(record, RobotScan) and record.stamp < begin * NS)]

    estimator, _ = estimate(records, filter=kind, shared_landmark_ids=False)

    assert_all_in_map(estimator, records)
    assert {owner for owner, _ in estimator.groups.team.state.landmarks} == {'r1', 'r2'}


def blinded(record):
    """Remove landmarks seen by r1 in the first 4 s, and observations of robots by or of r3."""
    if isinstance(record, RobotScan):
        return replace(record, observations=tuple(
            s for s in record.observations if 'r3' not in (record.robot, s.observed)))
    is_blind = isinstance(record, Scan) and record.robot == 'r1' and record.stamp < 4 * NS
    return replace(record, observations=()) if is_blind else record


def test_step_0_may_come_after_robots_have_joined_and_maps_have_grown():
    records = circles(3, 3, landmarks=20, sensors=replace(SENSORS, range=40.0))

    estimator, steps = estimate(map(blinded, records), TEAM)

    frames = [{pose.robot: pose.frame for pose in step.poses} for step in steps]
    assert frames[10] == {'r1': 'map', 'r2': 'map', 'r3': 'r3/map'}
    assert_all_in_map(estimator, records)


def least_squares_of(records):
    """Return the last poses of r1, which starts at the origin, and r2, and their covariance."""
    odom = {(r.robot, r.stamp): r for r in records if isinstance(r, Odometry)}
    met = [r for r in records if isinstance(r, RobotScan)]
    stamps = sorted({r.stamp for r in records})
    truth = truth_of(records)
    free = [key for key in odom if key != ('r1', stamps[0])]

    def moved(a, b):
        return np.array([*(turn(a[2]).T @ (b - a)[:2]), wrapped(b[2] - a[2])])

    def residuals(x):
        at = {('r1', stamps[0]): np.zeros(3), **dict(zip(free, x.reshape(-1, 3)))}
        r = []
        for name in ('r1', 'r2'):
            for a, b in pairwise(stamps):
                sigma = np.sqrt(np.diag(odom[name, b].twist_covariance)) * (b - a) / NS
                u = moved(odom[name, a].pose, odom[name, b].pose)
                r.append((moved(at[name, a], at[name, b]) - u) / sigma)
        r += [
            (moved(at[m.robot, m.stamp], at[s.observed, m.stamp])[:2] - s.z)
            / np.sqrt(np.diag(s.R))
            for m in met for s in m.observations]
        return np.concatenate(r)

    best = least_squares(
        residuals, np.concatenate([truth[key] for key in free]), x_scale=1e-4, xtol=1e-15,
        ftol=1e-15, gtol=1e-15)
    last = [3 * free.index((name, stamps[-1])) + k for name in ('r1', 'r2') for k in range(3)]
    return best.x[last], np.linalg.inv(best.jac.T @ best.jac)[np.ix_(last, last)]


#: Noise that is small enough for the first-order approximation.
EXACT = SensorSettings((3e-5, 3e-5, 1e-5), (1.0, 1.0), range=60.0, robot_sigma=(5e-5, 5e-5))


@pytest.fixture(scope='module')
def exact():
    """Return a short run almost without noise, and its batch least-squares solution."""
    records = meetings(1, until=2.4, sensors=EXACT)
    return records, *least_squares_of(records)


@pytest.mark.parametrize('kind', FILTERS)
def test_joined_robots_have_estimate_and_covariance_of_batch_least_squares(kind, exact):
    records, x, P = exact

    estimator, _ = estimate(records, filter=kind)

    state = estimator.groups.team.state
    robots = [state.robots[name] for name in ('r1', 'r2')]
    assert_allclose(np.concatenate([state.estimate(robot) for robot in robots]), x, atol=1e-8)
    scale = np.sqrt(np.outer(np.diag(P), np.diag(P)))
    # Noise of 5e-5 m over distances of some m.
    assert_allclose(state.marginal(robots) / scale, P / scale, atol=1e-4)


@pytest.mark.parametrize('seed', [1, 2, 3])
@pytest.mark.parametrize('kind', ['fej', 'invariant'])
def test_the_global_pose_of_the_team_gains_no_information(kind, seed):
    sigma = (1.0, 1.0, 0.1)
    estimator, _ = estimate(meetings(seed), filter=kind, anchor_sigma=sigma)
    state = estimator.groups.team.state
    x = state.x_first if kind == 'fej' else state.x_hat

    P = state.marginal(state.variables())

    assert np.linalg.eigvalsh(P - unknown_place(state, x, sigma)).min() > 0.0


@pytest.mark.parametrize('seed', [3, 4, 6])
@pytest.mark.parametrize('kind', ['fej', 'invariant'])
def test_step_0_after_a_join_adds_no_information_about_the_global_pose(kind, seed):
    sigma, dark = (1.0, 1.0, 0.3), 5 * NS
    records = [
        replace(record, observations=()) if isinstance(record, Scan) and record.stamp < dark
        else record for record in circles(seed, landmarks=20, sensors=NOISY)
        if record.stamp < 12 * NS]

    estimator, steps = estimate(records, filter=kind, anchor_sigma=sigma, gate_probability=1.0)

    assert any(step.stamp < dark and len(step.joined) == 2 for step in steps)
    state = estimator.groups.team.state
    assert len(state.landmarks) == 20
    x = state.x_first if kind == 'fej' else state.x_hat
    unknown = unknown_place(state, x, sigma)
    assert np.linalg.eigvalsh(state.marginal(state.variables()) - unknown).min() > 0.0


def mean_nees(kind, seeds, observers):
    """Return the mean NEES / 3 of r2 in ``map`` over runs and steps."""
    values = []
    for seed in seeds:
        records = meetings(seed, observers=observers)
        truth = truth_of(records)
        _, steps = estimate(records, filter=kind, gate_probability=1.0)
        for pose in (pose for step in steps for pose in step.poses):
            if (pose.robot, pose.frame) == ('r2', 'map'):
                e = pose_difference(pose.pose, truth['r2', pose.stamp])
                values.append(e @ np.linalg.solve(pose.P, e) / 3.0)
    return np.mean(values)


@pytest.mark.parametrize('kind', ['fej', 'invariant'])
def test_robots_that_joined_by_observations_of_each_other_are_consistent(kind):
    # Means of 15 correlated runs scatter by about 0.12.
    assert 0.7 < mean_nees(kind, range(15), TEAM) < 1.35


@pytest.mark.slow
@pytest.mark.parametrize('observers', [TEAM, ('r1',), ('r2',)])
@pytest.mark.parametrize('kind', ['fej', 'invariant'])
def test_robots_that_joined_are_consistent_over_a_hundred_runs(kind, observers):
    assert 0.85 < mean_nees(kind, range(100, 200), observers) < 1.25


#: Observation of r2, which drives abreast of the observer r1.
BESIDE = ('r2', (1.0, -3.0))


def abreast(until, *names, since=0, sees=(BESIDE,)):
    """Return records of robots that drive abreast at 1 m/s, some of which r1 observes."""
    return [
        record for ms in range(since, until + 1, 200)
        for record in (
            *(odometry(name, ms) for name in names or ('r1', 'r2')),
            *([robot_scan('r1', ms, sees)] if sees else ()))]


def after(*records, **options):
    """Return an estimator of r1, r2 and r3 that has processed records."""
    estimator = Estimator(team(*TEAM, **options))
    give(estimator, *records)
    return estimator


def give(estimator, *records):
    """Process further records without waiting for more; return the steps."""
    for record in records:
        estimator.add(record)
    return list(estimator.release())


def test_both_frames_keep_rendezvous_points_until_these_determine_the_join():
    estimator = after(*abreast(200))

    ours, theirs = frames(estimator)['map'], frames(estimator)['r2/map']
    assert [*ours.rendezvous_points] == [*theirs.rendezvous_points]
    assert [(k.observer, k.observed, k.stamp // MS) for k in ours.rendezvous_points] == [
        ('r1', 'r2', 0), ('r1', 'r2', 200)]
    # In its own frame, r2 was observed at the positions of its odometry.
    for ms, key in zip((0, 200), ours.rendezvous_points):
        in_map, in_own = (s.estimate(s.rendezvous_points[key]) for s in (ours, theirs))
        assert_allclose(in_map, [1.0 + ms / 1000.0, -3.0], atol=1e-12)
        assert_allclose(in_own, [ms / 1000.0, 0.0], atol=1e-12)
    assert estimator.groups.not_in_map['r2'] == (
        '0 shared landmarks and 2 observations of robots, needs 3')


def test_observations_over_a_short_distance_do_not_determine_the_heading():
    estimator = after(*abreast(400))

    assert estimator.groups.not_in_map['r2'].startswith(
        '0 shared landmarks and 3 observations of robots determine the heading to 0.')


def test_landmarks_and_observations_of_robots_count_together():
    seen = [(1, (5.0, 1.0)), (2, (5.0, -5.0))]
    estimator = after(odometry('r1', 0), odometry('r2', 0), scan('r1', 0, seen[:1]))
    assert estimator.groups.not_in_map['r2'] == '0 shared landmarks, needs 3'

    give(estimator, *abreast(400, since=400), scan('r1', 400, seen),
         scan('r2', 400, [(n, (x - 1.0, y + 3.0)) for n, (x, y) in seen]))

    assert estimator.groups.not_in_map.keys() == {'r3'}


def test_observations_that_contradict_each_other_are_the_reason_in_words():
    # r1 observes r2 anywhere while r2 drives straight ahead at 0.8 m/s: no single outlier.
    rng = np.random.default_rng(1)
    records = [
        record for ms in range(0, 2001, 200) for record in (
            odometry('r1', ms, (0.0, 0.0, 0.0)), odometry('r2', ms, (ms / 1250.0, 0.0, 0.0)),
            robot_scan('r1', ms, [('r2', tuple(rng.uniform(-9.0, 9.0, 2)))]))]

    estimator = after(*records)

    assert re.fullmatch(
        r'0 shared landmarks and \d observations of robots do not fit: chi-square .*',
        estimator.groups.not_in_map['r2'])
    assert points_in(estimator).keys() == {'map', 'r2/map'}


def test_further_observations_of_a_robot_that_stands_still_are_rejected():
    stands = [
        record for ms in range(0, 1001, 200) for record in (
            odometry('r1', ms), odometry('r2', ms, (0.0, 0.0, 0.0)),
            robot_scan('r1', ms, [('r2', (3.0 - ms / 1000.0, 1.0))]))]

    estimator = after(*stands)

    assert estimator.statistics.rejection_counts['r1'] == {RejectionReason.NOT_JOINED: 5}
    assert {(r.id, r.observed) for r in estimator.statistics.rejections} == {(2, 'r2')}
    assert estimator.statistics.observations_used == {'r1': 1}


def test_the_newest_rendezvous_points_of_each_pair_are_kept():
    last = 200 * (MAX_RENDEZVOUS_POINTS + 4)
    estimator = after(*abreast(last), join_min_landmarks=1000)

    (kept,) = {tuple(keys) for keys in points_in(estimator).values()}
    assert [key.stamp // MS for key in kept] == [*range(1000, last + 1, 200)]
    assert len(kept) == MAX_RENDEZVOUS_POINTS
    assert estimator.statistics.observations_used['r1'] == MAX_RENDEZVOUS_POINTS + 5


def test_the_true_position_of_a_rendezvous_point_is_kept_as_long_as_the_point():
    last = 200 * (MAX_RENDEZVOUS_POINTS + 4)
    records = [
        r for ms in range(0, last + 1, 200) for r in (
            true_pose('r1', ms, (ms / 1000.0, 0.0, 0.0)),
            true_pose('r2', ms, (1.0 + ms / 1000.0, -3.0, 0.0)))]

    estimator = after(*records, *abreast(last), filter='ideal', join_min_landmarks=1000)

    at = estimator.truth.rendezvous_point(RendezvousKey('r1', 'r2', 1000 * MS))
    assert_allclose(at, [2.0, -3.0], rtol=1e-15)
    with pytest.raises(MissingTruthError):
        estimator.truth.rendezvous_point(RendezvousKey('r1', 'r2', 800 * MS))


#: Observations of r2 and r3, abreast of r1; two of each are too few to join.
BOTH = BESIDE, ('r3', (0.0, 2.0))


def test_rendezvous_points_of_a_robot_are_removed_when_it_leaves():
    estimator = after(*abreast(200, *TEAM, sees=BOTH))

    estimator.change_team(team('r1', 'r3').robots)

    assert {key.observed for keys in points_in(estimator).values() for key in keys} == {'r3'}
    assert points_in(estimator).keys() == {'map', 'r3/map'}


def after_a_gap(robot, ms):
    """Return odometry after which the heading of a robot is unknown."""
    return odometry(robot, ms, twist_covariance=1e3 * np.eye(3))


def test_rendezvous_points_of_a_robot_are_removed_after_an_unknown_motion():
    estimator = after(*abreast(200, *TEAM, sees=BOTH))

    give(estimator, odometry('r1', 400), odometry('r3', 400), after_a_gap('r2', 400),
         robot_scan('r1', 400, BOTH))

    team_points = estimator.groups.team.state.rendezvous_points
    seen = [(key.observed, key.stamp // MS) for key in team_points]
    assert seen == [('r3', 0), ('r3', 200), ('r2', 400), ('r3', 400)]
    assert [key.stamp // MS for key in frames(estimator)['r2/map'].rendezvous_points] == [400]


def test_step_0_removes_the_rendezvous_points_of_robots_that_it_starts():
    seen = [(1, (5.0, 1.0)), (2, (5.0, -1.0))]
    estimator = after(*abreast(200, *TEAM, sees=BOTH))

    give(estimator, *abreast(400, *TEAM, since=400, sees=()), scan('r1', 400, seen),
         scan('r2', 400, [(n, (x - 1.0, y + 3.0)) for n, (x, y) in seen]))

    assert estimator.groups.not_in_map.keys() == {'r3'}
    assert points_in(estimator) == {}


def test_an_anchor_that_is_lost_before_step_0_joins_the_map_of_the_others():
    estimator = after(*abreast(3000))
    assert estimator.groups.not_in_map.keys() == {'r3'}

    give(estimator, odometry('r2', 3200), after_a_gap('r1', 3200))
    assert estimator.groups.not_in_map.keys() == {'r1', 'r3'}
    give(estimator, *abreast(6000, since=3400))

    assert estimator.groups.not_in_map.keys() == {'r3'}
    state = estimator.groups.team.state
    r1, r2 = (state.estimate(state.robots[name]) for name in ('r1', 'r2'))
    # Observations are exact, so both are abreast however far r2 has drifted.
    assert_allclose(turn(r1[2]).T @ (r2 - r1)[:2], [1.0, -3.0], atol=1e-6)


def test_an_anchor_that_is_lost_before_step_0_does_not_restart_at_its_start_in_a_grown_map():
    seen = [(1, (3.0, 1.0)), (2, (2.0, -2.0)), (3, (-1.0, 2.0))]
    estimator = after(*abreast(3000), scan('r2', 3000, seen))
    estimator.change_team(team('r1', 'r3').robots)

    (step,) = give(estimator, after_a_gap('r1', 3200))
    assert [pose.frame for pose in step.poses] == ['r1/map']
    give(estimator, odometry('r1', 3400), scan('r1', 3400, seen))

    assert estimator.groups.not_in_map.keys() == {'r3'}


def test_a_map_without_robots_is_named_after_the_robot_that_joins_it():
    # r1 is alone; r2 maps and leaves; r3 observes the landmarks of r2.
    seen = [(1, (3.0, 1.0)), (2, (2.0, -2.0)), (3, (-1.0, 2.0))]
    estimator = after(odometry('r1', 0), odometry('r2', 0), scan('r1', 0, [(9, (1.0, 1.0))]),
                      scan('r2', 0, seen))
    estimator.change_team(team('r1', 'r3').robots)

    give(estimator, odometry('r1', 200), odometry('r3', 200), scan('r3', 200, seen))
    estimator.change_team(team(*TEAM).robots)
    (pose,) = give(estimator, odometry('r2', 400))[-1].poses

    assert [*frames(estimator)] == ['map', 'r3/map', 'r2/map']
    assert pose.frame == 'r2/map'


def pose_prior(pose, sigma=0.01, ms=200):
    """Return a prior of the pose of r2 in ``map``."""
    return PosePrior('r2', ms * MS, np.array(pose), np.diag(np.square([0.01, 0.01, sigma])))


def test_a_pose_prior_must_fit_the_observations():
    estimator = after(*abreast(200), pose_prior((1.2, -3.0, 3.0)))
    give(estimator, *abreast(400, since=400), pose_prior((1.4, -3.0, 0.0), ms=400))

    assert estimator.statistics.rejection_counts['r2'] == {RejectionReason.DOES_NOT_FIT: 1}
    assert estimator.groups.not_in_map.keys() == {'r3'}
    assert points_in(estimator) == {}


def test_an_uncertain_pose_prior_replaces_the_frame_of_the_robot():
    seen = [(1, (5.0, 1.0)), (2, (5.0, -1.0))]
    estimator = after(*abreast(200), pose_prior((1.2, -3.0, 0.0), sigma=1.0))

    # A step 0 after this prior has nothing left to start.
    give(estimator, *abreast(400, since=400), scan('r1', 400, seen),
         scan('r2', 400, [(n, (x - 1.0, y + 3.0)) for n, (x, y) in seen]))

    assert estimator.groups.not_in_map.keys() == {'r3'}
    assert points_in(estimator) == {}
    assert estimator.groups.others == []


@pytest.mark.parametrize('kind', FILTERS)
def test_a_run_restored_before_each_record_equals_the_uninterrupted_run(kind):
    records = meetings(2, robots=3, until=3.0, observers=('r2',))
    options = team(*TEAM, filter=kind)
    whole, broken, kept = Estimator(options), Estimator(options), set()

    for record in records:
        broken = restore(snapshot(broken), options, Estimator)
        for estimator in (whole, broken):
            estimator.add(record)
            list(estimator.take())
        kept |= points_in(broken).keys()
        assert broken.state_hash() == whole.state_hash()
        assert points_in(broken) == points_in(whole)

    assert kept == {'map', 'r2/map', 'r3/map'}
    assert whole.groups.not_in_map == {}


def test_observations_by_three_robots_at_once_determine_no_heading():
    # One position, observed three times, does not determine the rotation between the frames.
    at = {'r1': (0.0, 0.0), 'r2': (3.0, 0.0), 'r3': (0.0, 3.0), 'r4': (3.0, 3.0)}
    seen = {
        name: [(other, np.subtract(at[other], at[name])) for other in at if other != name]
        for name in TEAM}
    estimator = Estimator(team(*at, shared_landmark_ids=False))
    for name in at:
        estimator.add(odometry(name, 0, (0.0, 0.0, 0.0), 1e-4 * np.eye(3)))
    for name, others in seen.items():
        estimator.add(robot_scan(name, 0, others))
    estimator.add(robot_scan('r1', 100, [('r2', (3.0, 1.0))]))
    for name in at:
        moved = (0.0, float(name == 'r2'), 0.0)
        estimator.add(odometry(name, 100, moved, 1e-4 * np.eye(3)))

    list(estimator.release())

    assert estimator.groups.team.robots.keys() == {'r1', 'r2', 'r3'}
    assert 'at one place, which determines no heading' in estimator.groups.not_in_map['r4']


def test_a_point_at_a_robot_that_step_0_has_moved_reveals_no_rotation_of_everything():
    robots = [
        'r1', RobotSettings('r2', 2, start_pose=(0.6, 5.5, 0.1), start_sigma=(0.5, 0.5, 0.1)),
        'r3']
    points = [(0, (3.0, 2.0)), (1, (3.0, -2.0)), (2, (4.0, 0.0)), (3, (2.0, 3.0))]
    estimator, _ = estimate([
        *(odometry(name, ms, (0.0, 0.0, 0.0)) for ms in (0, 100) for name in TEAM),
        scan('r1', 100, points), scan('r2', 100, [(k, (x, y - 5.0)) for k, (x, y) in points]),
        robot_scan('r3', 100, [('r2', (-4.0, 2.0))])], robots)
    state = estimator.groups.team.state
    (point,), r2 = state.rendezvous_points.values(), state.robots['r2']

    # The error of the point by that of r2, on which alone it depends.
    P = state.marginal([r2, point])
    F = P[3:, :3] @ np.linalg.inv(P[:3, :3])

    assert np.hypot(*(state.estimate(r2) - state.first_estimate(r2))[:2]) > 0.3
    moved = rigid_motions(state, state.x_first)[:, 2]
    assert_allclose(F @ moved[r2.slot.indices], moved[point.slot.indices], atol=1e-9)
