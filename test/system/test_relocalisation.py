# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A robot that was carried away while in ``map`` is consistent again after it is relocalised.

One robot of two, in the published world of circles, is carried along its course in the third loop,
observes for five steps what contradicts its pose, and is then given a pose.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.core.records import Odometry, PosePrior, TrueLandmarks, TruePose
from fej_slam_ros.sim.environments import ENVIRONMENTS
from helpers.records import team

CARRIED = 'r2'
#: Steps: when the robot is carried, along how many of its course, and until it is given a pose.
CARRIED_AT, SKIPPED, UNNOTICED = 130, 25, 5
#: Standard deviations of the arrow that is drawn in RViz, of a careful one, and of none at all.
RVIZ, CAREFUL, UNKNOWN = (0.5, 0.5, 0.26), (0.2, 0.2, 0.05), (1e3, 1e3, 3.0)


@cache
def carried_run(seed):
    """Return the records of a run in which a robot is carried, and the stamp to relocalise it."""
    circles = ENVIRONMENTS['circles']
    environment = replace(circles, world=replace(circles.world, loops=4))
    records = [
        r for r in environment.records(np.random.default_rng(seed))
        if not isinstance(r, TrueLandmarks)]
    stamps = sorted({record.stamp for record in records})
    begin, end = stamps[CARRIED_AT], stamps[CARRIED_AT + SKIPPED]
    odometry = {
        r.stamp: r.pose for r in records if isinstance(r, Odometry) and r.robot == CARRIED}

    def after(record):
        """Return a record of later on the course, as if its robot had been carried there."""
        earlier = replace(record, stamp=record.stamp - end + begin)
        if isinstance(record, Odometry):
            driven = between(odometry[end], record.pose)
            return replace(earlier, pose=compose(odometry[begin], driven))
        return earlier

    before = [r for r in records if r.robot != CARRIED or r.stamp <= begin]
    carried = [after(r) for r in records if r.robot == CARRIED and r.stamp > end]
    return (
        sorted(before + carried, key=lambda r: r.stamp), stamps[CARRIED_AT + UNNOTICED])


def nees_after(seed, sigma):
    """Return the mean NEES/3 of each robot since the robot was given a pose with some noise."""
    records, given_at = carried_run(seed)
    truth = {(r.robot, r.stamp): r.pose for r in records if isinstance(r, TruePose)}
    error = np.random.default_rng(1000 + seed).normal(size=3) * sigma
    prior = PosePrior(
        CARRIED, given_at, truth[CARRIED, given_at] + error, np.diag(np.square(sigma)))
    ratings = {'r1': [], 'r2': []}
    measured = [r for r in records if not isinstance(r, TruePose)]
    for result in Estimator(team()).run([prior, *measured]):
        for pose in result.poses:
            if pose.stamp >= given_at and pose.frame == 'map':
                e = pose.pose - truth[pose.robot, pose.stamp]
                e[2] = np.arctan2(np.sin(e[2]), np.cos(e[2]))
                ratings[pose.robot].append(e @ np.linalg.solve(pose.P, e) / 3.0)
    # A robot that noticed is on probation for 20 of 95 steps, which an unknown pose does not end.
    assert len(ratings[CARRIED]) > 70
    return {robot: np.mean(values) for robot, values in ratings.items()}


@pytest.mark.parametrize('sigma', [RVIZ, UNKNOWN])
def test_a_carried_robot_is_back_in_map(sigma):
    assert nees_after(0, sigma)[CARRIED] < 3.0


@pytest.mark.slow
@pytest.mark.parametrize('sigma', [RVIZ, CAREFUL, UNKNOWN])
def test_the_errors_after_a_relocalisation_have_their_covariance(sigma):
    ratings = [nees_after(seed, np.array(sigma)) for seed in range(20)]

    # The mean over a run has a standard deviation of about 0.3, since errors last for many steps.
    assert 0.7 < np.mean([nees[CARRIED] for nees in ratings]) < 1.3
    assert 0.7 < np.mean([nees['r1'] for nees in ratings]) < 1.3
