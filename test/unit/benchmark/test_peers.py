# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Peers estimate the same from the same data."""

from functools import partial

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.benchmark import mrpt
from fej_slam_ros.benchmark.peers import OURS, Ours, peer_times, PEERS, race
from fej_slam_ros.benchmark.synthetic_drive import (
    cartesian, drive, DRIVE_ROBOTS, range_bearing, START_P)
from fej_slam_ros.core.consistency import nees_per_dof
from fej_slam_ros.core.ekf.active_submap import AROUND_ROBOTS


def ends(peer, course):
    """Return the final poses and covariances of a peer."""
    for name, pose in course.starts.items():
        peer.insert_robot(name, 0, pose, START_P)
    for motions, scans in course.steps:
        found = peer.step(motions, scans)
    return found


class Diary:
    """A peer that returns ground truth and records when it is called."""

    def __init__(self, name, asked, truth):
        self._name, self._asked, self._truth = name, asked, iter(truth)

    def insert_robot(self, *about):
        pass

    def step(self, motions, scans):
        self._asked.append(self._name)
        return {name: (pose, None) for name, pose in zip(DRIVE_ROBOTS, next(self._truth))}


@pytest.mark.parametrize('skip', [10, 1])
def test_isam2_estimates_agree_with_our_filter(skip):
    isam2 = pytest.importorskip(
        'fej_slam_ros.benchmark.isam2', reason='gtsam is not installed')
    course = drive(40, 80, 1.0, 8, np.random.default_rng(1))

    smoothed, ours = ends(isam2.Isam2(skip), course), ends(Ours(AROUND_ROBOTS), course)

    for name in DRIVE_ROBOTS:
        (x, P), (x_hat, P_hat) = smoothed[name], ours[name]
        # A smoother linearises at better points: they agree to a fraction of the uncertainty.
        assert np.linalg.norm((x - x_hat)[:2]) < np.sqrt(np.trace(P_hat[:2, :2]))
        # Only gtsam's covariance is in the frame of the robot, which keeps the trace.
        assert np.trace(P[:2, :2]) == pytest.approx(np.trace(P_hat[:2, :2]), rel=0.2)
        assert P[2, 2] == pytest.approx(P_hat[2, 2], rel=0.2)


def test_a_fixed_lag_smoother_forgets_what_is_older_only():
    isam2 = pytest.importorskip(
        'fej_slam_ros.benchmark.isam2', reason='gtsam is not installed')
    # On a disc of 16 m, landmarks are observed again after tens of steps.
    course = drive(40, 100, 1.0, 3, np.random.default_rng(1))

    whole, longer, shorter = (
        ends(peer, course)['r1'][1] for peer in (
            isam2.Isam2(1), isam2.FixedLag(1, lag=120), isam2.FixedLag(1, lag=10)))

    # Both relinearise by a threshold.
    assert_allclose(longer, whole, rtol=0.05, atol=1e-5)
    assert np.trace(shorter) > 3.0 * np.trace(whole)


@pytest.mark.slow
@pytest.mark.skipif(not mrpt.is_installed(), reason='MRPT is not installed')
@pytest.mark.parametrize('method', mrpt.METHODS)
def test_mrpt_estimates_agree_with_our_filter(method):
    course = drive(
        40, 80, 1.0, 8, np.random.default_rng(1), robots=1, sensor=range_bearing)

    with mrpt.built() as program:
        peer = mrpt.Mrpt(program, method)
        (x, P), (x_hat, P_hat) = ends(peer, course)['r1'], ends(Ours(AROUND_ROBOTS), course)['r1']
        peer.close()

    observed = {s.id for _, scans in course.steps for scan in scans for s in scan.observations}
    assert peer.landmarks == len(observed)
    assert peer.seconds > 0.0
    # The standard EKF linearises at other points: they agree to a fraction of the uncertainty.
    assert np.linalg.norm((x - x_hat)[:2]) < np.sqrt(np.trace(P_hat[:2, :2]))
    assert np.trace(P) == pytest.approx(np.trace(P_hat), rel=0.3)


@pytest.mark.parametrize('sensor', [cartesian, range_bearing])
def test_sensors_state_the_covariance_of_their_errors(sensor):
    rng = np.random.default_rng(4)
    true = np.tile([[6.0, 2.0]], (4000, 1))

    z, R = sensor(true, rng)

    # NEES/2 of 4000 samples has a standard deviation of 0.016.
    assert nees_per_dof(z - true, R).mean() == pytest.approx(1.0, abs=0.06)


def test_all_peers_make_the_same_steps_in_all_orders():
    course = drive(10, 40, 1.0, 3, np.random.default_rng(2))
    asked = []

    times = race(
        {name: partial(Diary, name, asked, course.poses) for name in 'abc'}, course, 10)

    rounds = [''.join(asked[i:i + 3]) for i in range(0, 120, 3)]
    assert set(rounds) == {'abc', 'acb', 'bac', 'bca', 'cab', 'cba'}
    assert asked[120:] == [*40 * 'a', *40 * 'b', *40 * 'c']  # then alone
    assert [time.steps for time in times] == [40, 40, 40]
    assert [time.rmse for time in times] == [0.0, 0.0, 0.0]


def test_given_peers_take_part_beside_ours_and_the_textbook():
    times = peer_times(20, 8, {'mine': PEERS[OURS]})

    assert [time.name for time in times] == [*PEERS, 'mine']
    assert {time.rmse for time in times if time.name in (OURS, 'mine')} == {times[0].rmse}
    # Odometry alone is off by a few centimetres after 8 m, and observations by 0.1 m.
    assert_allclose([time.rmse for time in times], times[0].rmse, atol=0.05)
