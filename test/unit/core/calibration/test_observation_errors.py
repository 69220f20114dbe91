# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Range scale and bearing bias of observations are found by ground truth."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_array_equal
import pytest

from fej_slam_ros.core.calibration.observation_errors import fit_observations
from fej_slam_ros.core.calibration.systematic_errors import errors_by_truth
from fej_slam_ros.core.calibration.team_records import TeamRecords
from fej_slam_ros.core.geometry import compose, inverse, rotation, transform
from fej_slam_ros.core.records import (
    NS, Observation, Odometry, RobotObservation, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.settings import numbered_robots, Settings
from helpers.calibration import received

SIGMA, SECONDS = 0.05, 400
R = SIGMA ** 2 * np.eye(2)
NO_ERRORS = np.array([1.0, 0.0])
TEAM = Settings(numbered_robots('pq'), 'p')


def run(scale=1.0, bias=0.0, seed=1, speed=0.6, misaligned=0.0):
    """
    Return the records of two robots, p and q, among landmarks, and the true landmarks.

    Only p observes: its ranges are to be multiplied by `scale`, its bearings to be reduced by
    `bias`. Its true headings are too large by the angle `misaligned`.

    """
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-8.0, 8.0, (20, 2))

    def observed(pose, point):
        z = transform(inverse(pose), point[None])[0]
        return rotation(bias) @ z / scale + rng.normal(0.0, SIGMA, 2)

    pose, odometry, other = np.zeros(3), np.zeros(3), np.array([3.0, -2.0, 0.5])
    records = []
    for second in range(SECONDS):
        turn = 0.25 + 0.3 * np.sin(0.1 * second)
        pose = compose(pose, np.array([speed, 0.0, turn if speed else 0.0]))
        odometry = compose(
            odometry, np.array([speed, 0.0, turn if speed else 0.0]) + rng.normal(0.0, 1e-3, 3))
        stamp = second * NS
        records += [
            TruePose('p', stamp, pose + np.array([0.0, 0.0, misaligned])),
            TruePose('q', stamp, other),
            Odometry('p', stamp, odometry, None), Odometry('q', stamp, other, None),
            Scan('p', stamp, tuple(
                Observation(int(k), observed(pose, landmarks[k]), R)
                for k in rng.choice(len(landmarks), 3, replace=False))),
            RobotScan('p', stamp, (RobotObservation('q', observed(pose, other[:2]), R),))]
    return records, TrueLandmarks(dict(enumerate(landmarks)))


def fit(records, given=NO_ERRORS, use=('landmarks', 'robots')):
    team = TeamRecords(received(records), TEAM)
    scans = [
        *(team.scans['p'] if 'landmarks' in use else ()),
        *(team.robot_scans['p'] if 'robots' in use else ())]
    return fit_observations(scans, team.truth.landmarks, team.near, 0.0, given)


@pytest.mark.parametrize('is_recorded', [True, False])
@pytest.mark.parametrize(('scale', 'bias'), [(1.03, 0.0), (1.0, -0.02), (0.95, 0.1)])
def test_errors_are_those_of_the_simulation(scale, bias, is_recorded):
    records, landmarks = run(scale, bias)

    errors = fit([*records, landmarks] if is_recorded else records)

    # Beyond 4 standard errors once in 16,000 values.
    assert (np.abs(errors.values - [scale, bias]) < 4.0 * errors.sigma).all()
    assert (errors.sigma < 0.002).all()
    assert_array_equal(errors.values != NO_ERRORS, np.array([scale, bias]) != NO_ERRORS)
    assert errors.is_known.all()


def test_observations_of_robots_alone_are_enough():
    records, _ = run(1.04, 0.03)

    errors = fit(records, use=['robots'])

    assert (np.abs(errors.values - [1.04, 0.03]) < 4.0 * errors.sigma).all()
    assert (errors.values != NO_ERRORS).all()


@pytest.mark.slow
def test_standard_errors_are_the_scatter_of_many_runs():
    found = [fit(run(1.03, 0.02, seed)[0]) for seed in range(40)]

    ratio = [(e.values - [1.03, 0.02]) / e.sigma for e in found]
    # The standard deviation of 40 normal numbers is known to 11 %; 3.5 such errors.
    assert (np.abs(np.std(ratio, axis=0) - 1.0) < 0.4).all()


def test_wrong_ids_are_left_out():
    records, _ = run(1.03, 0.02)
    rng = np.random.default_rng(7)

    def misread(record):
        if not isinstance(record, Scan):
            return record
        return replace(record, observations=tuple(
            replace(o, id=int(rng.integers(20))) if rng.random() < 0.05 else o
            for o in record.observations))

    errors = fit([*map(misread, records)])

    assert (np.abs(errors.values - [1.03, 0.02]) < 4.0 * errors.sigma).all()
    assert (errors.sigma < 0.002).all()


def test_a_turned_frame_of_motion_capture_is_no_bearing_bias():
    """Odometry shows in which direction a robot travels, in the frame of its sensor."""
    records, _ = run(1.03, 0.0, misaligned=0.05)

    errors = errors_by_truth(received(records), TEAM)

    # Four standard errors of the direction of 79 motions of about 3 m with errors of 5 mm.
    heading, sigma = errors.headings['p']
    assert heading == pytest.approx(0.05, abs=4.0 * sigma)
    assert sigma < 0.001
    assert errors.headings.keys() == {'p'}
    assert errors.observations_by_truth['p'].values == pytest.approx([1.03, 0.0], abs=0.002)


def test_odometry_that_stands_still_shows_no_direction_of_travel():
    records, _ = run()
    stuck = [
        replace(r, pose=np.zeros(3)) if isinstance(r, Odometry) else r for r in records]

    assert errors_by_truth(received(stuck), TEAM).headings == {}


@pytest.mark.parametrize('error', [(1.5, 0.0), (1.0, np.pi / 2.0)])
def test_errors_that_no_sensor_has_are_reported_and_not_used(error):
    errors = fit(run(*error)[0], given=np.array([1.01, 0.01]))

    assert errors.is_at_limit.any()
    wrong = np.array(error) != NO_ERRORS
    assert_array_equal(errors.is_known, ~wrong)
    assert_array_equal(errors.values[wrong], np.array([1.01, 0.01])[wrong])


def test_a_robot_at_rest_shows_no_errors_by_landmarks_that_are_not_recorded():
    records, landmarks = run(1.03, 0.02, speed=0.0)

    assert fit(records, use=['landmarks']) is None
    assert fit([*records, landmarks], use=['landmarks']).values == pytest.approx(
        [1.03, 0.02], abs=0.005)


def test_few_observations_show_nothing():
    records, _ = run(1.03)

    assert fit([r for r in records if r.stamp < 90 * NS]) is None
