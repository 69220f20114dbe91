# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Observations in a row that failed the gate show a wrong pose, those of one landmark do not."""

import numpy as np
import pytest

from fej_slam_ros.core.ekf.consecutive_rejections import ConsecutiveRejections
from fej_slam_ros.core.ekf.covariance import Slot
from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import Association, GatedObservation, ScanGateStatistics
from fej_slam_ros.core.ekf.state import Landmark, Robot

R1, R2 = (Robot(name, Slot(0, 3), 100) for name in ('r1', 'r2'))
LANDMARKS = [Landmark(('', k), Slot(0, 2), 'r2', 0) for k in range(3)]
#: Started by r1 in its row.
OWN = Landmark(('', 9), Slot(0, 2), 'r1', 100)
#: Scans with too few landmarks to check a pose.
SMALL = dict.fromkeys(['r1', 'r2'], ScanGateStatistics(known=1, gated=1))
#: Squared distances above the limit 13.8, within and beyond what contradicts a pose.
OFF, FAR = 20.0, 1e3


def failed(observer, observed, d2=OFF, on_arcs=np.inf):
    return Innovation((), np.empty(0), [
        GatedObservation(Association(observer, observed, None), d2, 13.8, on_arcs)])


def passed(observer, observed):
    return Innovation([Association(observer, observed, None)], np.zeros(2))


def after(*innovations, statistics=SMALL):
    rejections = ConsecutiveRejections()
    for innovation in innovations:
        rejections.add(innovation, statistics)
    return rejections


def test_the_factor_makes_the_mean_distance_the_expected_one():
    a, b, _ = LANDMARKS
    rejections = after(failed(R1, a, 20.0), failed(R1, b, 30.0), failed(R1, a, 28.0))

    # The mean, 26, over the two dimensions of an observation.
    assert rejections.factor('r1') == pytest.approx(13.0)
    assert rejections.count('r1') == 3


def test_the_distance_is_that_by_which_the_observation_is_most_likely():
    a, b, _ = LANDMARKS
    rejections = after(*[failed(R1, x, FAR, on_arcs=24.0) for x in (a, b, a)])

    assert rejections.factor('r1') == pytest.approx(12.0)


def test_an_observation_counts_for_both_robots():
    rejections = after(failed(R1, R2), failed(R2, R1), failed(R2, LANDMARKS[0]))

    assert rejections.count('r2') == 3
    # All of r1 are with r2, which may be the wrong one.
    assert rejections.count('r1') == 0
    assert rejections.factor('r1') == 1.0


@pytest.mark.parametrize('innovations', [
    [failed(R1, LANDMARKS[0])] * 20,
    [failed(R1, LANDMARKS[0]), failed(R1, LANDMARKS[1])],
    [failed(R1, landmark, FAR) for landmark in LANDMARKS[:2]] * 10,
    [failed(R1, landmark, FAR) for landmark in (*LANDMARKS, *LANDMARKS, *LANDMARKS[:2])],
], ids=['one landmark', 'two observations', 'two landmarks far off', 'eight far off'])
def test_few_observations_or_landmarks_show_nothing(innovations):
    rejections = after(*innovations)

    assert (rejections.count('r1'), rejections.factor('r1')) == (0, 1.0)


def test_nine_observations_of_three_landmarks_show_a_lost_robot_at_any_distance():
    rejections = after(*[failed(R1, landmark, FAR) for landmark in LANDMARKS] * 3)

    assert (rejections.count('r1'), rejections.factor('r1')) == (9, 1.0)


def test_of_each_landmark_the_latest_nine_observations_count():
    a, b, _ = LANDMARKS
    early, late = [failed(R1, a, 15.0)] * 100, [failed(R1, a, 35.0)] * 9

    rejections = after(*early, *late, failed(R1, b, 25.0))

    assert rejections.count('r1') == 10
    # Half of the mean, (9 * 35 + 25) / 10.
    assert rejections.factor('r1') == pytest.approx(17.0)


@pytest.mark.parametrize(('innovation', 'count'), [
    (passed(R1, LANDMARKS[2]), 0), (passed(R1, R2), 0), (passed(R2, R1), 0),
    (passed(R2, LANDMARKS[2]), 3),
    # It fits the pose from which the robot has started it.
    (passed(R1, OWN), 3)], ids=['landmark', 'robot', 'observed', 'other robot', 'own landmark'])
def test_an_observation_that_passes_ends_the_row(innovation, count):
    a, b, _ = LANDMARKS

    assert after(failed(R1, a), failed(R1, b), failed(R1, a), innovation).count('r1') == count


def test_scans_that_check_the_pose_are_left_to_the_detection_of_lost_robots():
    large = dict.fromkeys(['r1', 'r2'], ScanGateStatistics(known=3, gated=3))
    a, b, c = LANDMARKS

    rejections = after(*[failed(R1, x) for x in (a, b, c)], statistics=large)

    assert rejections.count('r1') == 0


def test_observations_of_a_suspected_scan_that_passed_the_gate_do_not_count():
    a, b, _ = LANDMARKS

    assert after(failed(R1, a, 1.0), failed(R1, b, 1.0), failed(R1, a, 1.0)).count('r1') == 0
