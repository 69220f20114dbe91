# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots without a central node: after they have met, each has what a central smoother would."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.geometry import between, compose, pose_difference
from fej_slam_ros.core.ordering.record_memory import identity
from fej_slam_ros.core.records import NS, Scan, TruePose
from fej_slam_ros.sim.environments import RENDEZVOUS_ENVIRONMENTS
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.world import make_world, WorldSettings
from helpers.radio import central, is_measurement, poses_in_frame_of, Radio, Robot, team_settings

#: Two robots are in reach while they observe each other, and as long before and after [s].
AROUND = 3.0
SENSORS = SensorSettings(
    odometry_sigma=(0.02, 0.02, 0.01), landmark_sigma=(0.1, 0.1), range=8.0,
    robot_sigma=(0.1, 0.1))


def largest_difference(team, other, frame):
    """Return the largest difference of two smoothers in the frame of a robot [m, rad]."""
    of_team, of_other = (poses_in_frame_of(smoother, frame) for smoother in (team, other))
    assert of_team.keys() == of_other.keys()
    return max(np.abs(of_team[name] - of_other[name]).max() for name in of_team)


def information_traces(team):
    """Return the sum of the variances of all poses of each robot, equal in all frames."""
    return {
        name: sum(np.trace(estimate.P[:2, :2]) for estimate in trajectory.estimates())
        for name, trajectory in team.trajectories.items()}


def drive(robots, measurements, until, begin=0):
    """Let robots measure up to a time; return the number of measurements used."""
    while begin < len(measurements) and measurements[begin].stamp <= until:
        robots[measurements[begin].robot].logs.record(measurements[begin])
        begin += 1
    return begin


@pytest.mark.parametrize('experiment', ['map_joining', 'sensor_extension'])
def test_two_robots_in_reach_around_their_rendezvous_have_the_central_result(experiment):
    environment = RENDEZVOUS_ENVIRONMENTS[experiment]
    measurements = [
        *filter(is_measurement, environment.records(np.random.default_rng(5)))]
    settings = team_settings(['p', 'q'], 'p', shared=False)
    robots = {name: Robot(name, settings) for name in 'pq'}
    radio, used = Radio(robots, np.random.default_rng(1), loss=0.2), 0
    steps = [window[2:] for window in environment.world.windows]
    first, last = (environment.world.stamps[f(k[f is max] for k in steps)] for f in (min, max))
    while radio.now < measurements[-1].stamp or radio.now < last + AROUND * NS:
        used = drive(robots, measurements, radio.now, used)
        is_near = first - AROUND * NS <= radio.now <= last + AROUND * NS
        radio.run(0.5, lambda a, b, is_near=is_near: is_near)

    for name, other in ('pq', 'qp'):
        logs = robots[name].logs
        known = [*logs.contents('p').measurements(), *logs.contents('q').measurements()]
        # All that was measured before they parted has arrived, but for the last period.
        parted = [m for m in measurements if m.stamp < last + (AROUND - 2.0) * NS]
        assert {*map(identity, parted)} <= {*map(identity, known)}
        union, expected = robots[name].union(), central(known, robots[name].settings)
        assert union.not_in_map() == {}
        # The iteration ends at an increment below 1e-9.
        assert largest_difference(union, expected, name) < 1e-9
        base, of_expected = (team.solution.maps[0].base_nodes[other] for team in (union, expected))
        assert_allclose(base.pose, of_expected.pose, rtol=0.0, atol=1e-9)
        assert_allclose(base.P, of_expected.P, rtol=1e-6)


def random_meetings(names, seed, duration):
    """
    Let robots drive among landmarks, with pairs of them in reach for some seconds each.

    Return the robots, the radio, and all records.

    """
    rng = np.random.default_rng(seed)
    world = make_world(WorldSettings(
        'circles', (60.0, 50.0), 2 * duration, names, landmarks=20 + 2 * len(names), loops=1,
        rate=2.0), rng)
    records = [*measure(world, SENSORS, rng)]
    measurements = [*filter(is_measurement, records)]
    settings = team_settings(names, names[0])
    robots = {name: Robot(name, settings) for name in names}
    radio, used = Radio(robots, rng, 0.2, repeated=0.1), 0
    for _ in range(duration // 5):
        links = {frozenset(rng.choice(names, 2, replace=False)) for _ in range(len(names) // 2)}
        for _ in range(5):
            used = drive(robots, measurements, radio.now, used)
            radio.run(1.0, lambda a, b, links=links: frozenset((a, b)) in links)
    drive(robots, measurements, measurements[-1].stamp, used)
    return robots, radio, records


def meet_in_a_chain(robots, radio):
    """Let each robot meet the next one, to the end and back, until all have heard of all."""
    names = [*robots]
    for order in (names, names[::-1]):
        for a, b in pairwise(order):
            for _ in range(60):
                radio.run(1.0, lambda *pair, met={a, b}: {*pair} == met)
                if all(
                        robots[one].exchange.is_complete(radio.now)
                        and other in robots[one].exchange.in_reach(radio.now)
                        for one, other in ((a, b), (b, a))):
                    break


def digests(robot):
    return {
        log.name: (len(log.blocks), log.digests[-1])
        for log in robot.logs.logs.values() if not log.name.about}


def nees_of(team, records, frame):
    """Return NEES/3 of the poses of a team in the frame of the first pose of a robot."""
    true = {(r.robot, r.stamp): r.pose for r in records if isinstance(r, TruePose)}
    start = min(stamp for _, stamp in true)
    estimates = {
        (estimate.robot, estimate.stamp): estimate
        for trajectory in team.trajectories.values() for estimate in trajectory.estimates()}
    own, values = estimates[frame, start].pose, []
    for key, estimate in estimates.items():
        if key != (frame, start):
            expected = compose(own, between(true[frame, start], true[key]))
            error = pose_difference(estimate.pose, expected)
            values.append(error @ np.linalg.solve(estimate.P, error) / 3.0)
    return np.mean(values)


def test_after_random_meetings_all_robots_have_the_central_result():
    names = ('r1', 'r2', 'r3')
    robots, radio, records = random_meetings(names, seed=1, duration=15)
    meet_in_a_chain(robots, radio)

    assert all(digests(robot) == digests(robots['r1']) for robot in robots.values())
    expected = central(records, team_settings(names, 'r1'))
    for name in ('r1', 'r3'):
        union = robots[name].union()
        assert largest_difference(union, expected, 'r1') < 1e-9
        # Measurements that were counted twice would halve variances.
        if name == 'r1':
            assert information_traces(union) == pytest.approx(
                information_traces(expected), rel=1e-6)


def with_another_landmark(measurement, liar):
    """Return a measurement, of a liar with another landmark in place of landmark 9."""
    if not isinstance(measurement, Scan):
        return measurement
    ninth = 10 if measurement.robot == liar else 9
    return replace(measurement, observations=tuple(
        replace(o, id=min(o.id, 9)) for o in measurement.observations
        if o.id < 9 or o.id == ninth))


@pytest.mark.parametrize('distance', [0.0, 1.0])
def test_robots_that_know_the_same_have_the_same_map(distance):
    """Also where it is open whose landmark is the right one, and of two observations at once."""
    names, rng = ('r1', 'r2'), np.random.default_rng(1)
    world = make_world(WorldSettings(
        'circles', (20.0, 15.0), 20, names, landmarks=11, loops=1, rate=1.0), rng)
    records = measure(world, replace(SENSORS, range=100.0), rng)
    measurements = [with_another_landmark(m, 'r2') for m in records if is_measurement(m)]
    settings = replace(team_settings(names), keyframe_distance=distance)
    robots = {name: Robot(name, settings) for name in names}
    radio = Radio(robots, rng)
    drive(robots, measurements, measurements[-1].stamp)
    meet_in_a_chain(robots, radio)

    first, second = (robots[name].union() for name in names)

    assert digests(robots['r1']) == digests(robots['r2'])
    assert largest_difference(first, second, 'r1') < 1e-9
    assert len(first.solution.outliers['r2']) == len(second.solution.outliers['r2'])


def displaced(measurement, liar):
    """Return a measurement, of a liar with every other landmark 2 m farther ahead."""
    if measurement.robot != liar or not isinstance(measurement, Scan):
        return measurement
    return replace(measurement, observations=tuple(
        replace(o, z=o.z + np.array([2.0 * (o.id % 2), 0.0])) for o in measurement.observations))


@pytest.mark.parametrize('liar', ['r1', 'r3'])
def test_a_robot_that_lies_is_rejected_and_the_others_have_what_they_have_without_it(liar):
    names = ('r1', 'r2', 'r3')
    rng = np.random.default_rng(1)
    world = make_world(WorldSettings(
        'circles', (60.0, 50.0), 30, names, landmarks=26, loops=1, rate=2.0), rng)
    measurements = [
        displaced(m, liar) for m in measure(world, SENSORS, rng) if is_measurement(m)]
    robots = {name: Robot(name, team_settings(names)) for name in names}
    radio = Radio(robots, rng, loss=0.2)
    drive(robots, measurements, measurements[-1].stamp)
    meet_in_a_chain(robots, radio)
    one, other = (name for name in names if name != liar)

    union = robots[one].union()

    assert 'inconsistent (chi-square' in union.not_in_map()[liar]
    honest = central(
        [m for m in measurements if m.robot != liar], team_settings((one, other), one))
    expected, found = (poses_in_frame_of(team, one) for team in (honest, union))
    for name in (one, other):
        assert_allclose(found[name], expected[name], rtol=0.0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(('count', 'seeds', 'duration'), [(5, 50, 10), (20, 50, 5)])
def test_over_many_seeds_robots_agree_with_the_central_result_and_are_consistent(
    count, seeds, duration
):
    names, nees = tuple(f'r{k:02}' for k in range(1, count + 1)), []
    for seed in range(seeds):
        robots, radio, records = random_meetings(names, seed, duration)
        meet_in_a_chain(robots, radio)

        assert all(digests(robot) == digests(robots['r01']) for robot in robots.values())
        union = robots[names[seed % count]].union()
        expected = central(records, team_settings(names, 'r01'))
        assert largest_difference(union, expected, 'r01') < 1e-9
        nees.append(nees_of(expected, records, 'r01'))
    # The poses of one run are correlated: NEES/3 of a run varies by 0.4.
    assert 0.85 < np.mean(nees) < 1.2
