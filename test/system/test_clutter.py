# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots that know no landmark, miss one in ten, and see clutter three times in ten observations.

The world is the first environment of [Liu] with the noise of ordinary robots: 0.1 m and 1 degree
of odometry a step of 2.6 m, 0.15 m of an observation, 15 m of range.

"""

from dataclasses import replace
from itertools import count
import math

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import NO_ID, Scan
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.experiments.real_data.association_score import AssociationScore
from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.sim.sensors import measure, SensorSettings
from helpers.slow import slow

SENSORS = SensorSettings(
    (0.1, 0.1, math.radians(1.0)), (0.15, 0.15), clutter=0.3, missed=0.1)
START_SIGMA = (1.0, 1.0, 0.1)

#: First ID of clutter; each clutter point has its own ID.
CLUTTER = 1000


class Run:
    """
    A run of two loops in which no observation has a number.

    Attributes
    ----------
    matches : what the numbers that were given stand for
    estimator : the estimator at the end

    """

    def __init__(self, seed, robots, start_sigma=START_SIGMA, start_error=0.0, **settings):
        environment, rng = ENVIRONMENTS['circles'], np.random.default_rng(seed)
        names = tuple(f'r{i + 1}' for i in range(robots))
        world = replace(environment, world=replace(
            environment.world, robots=names, loops=2)).true_world(rng)
        starts = {name: tuple(world.true_poses[name][0].tolist()) for name in names}
        errors = start_error * np.random.default_rng(seed).normal(0.0, start_sigma, (robots, 3))
        others = (
            RobotSettings(name, i, tuple((starts[name] + errors[i - 1]).tolist()), start_sigma)
            for i, name in enumerate(names[1:], start=2))
        self.estimator = Estimator(Settings(
            (RobotSettings('r1', 1), *others), 'r1', anchor_pose=starts['r1'], **settings))
        self.matches, nothing = AssociationScore(), count(CLUTTER)
        for record in measure(world, SENSORS, rng):
            if isinstance(record, Scan):
                seen = [record.observations[k] for k in rng.permutation(len(record.observations))]
                self.estimator.add(self.matches.without_ids(replace(record, observations=tuple(
                    replace(s, id=next(nothing)) if s.id == NO_ID else s for s in seen))))
            else:
                self.estimator.add(record)
        for step in self.estimator.close():
            self.matches.add(step.associated)

    def landmarks(self):
        """Return how many landmarks that count stand for each true one."""
        return self.matches.landmarks(
            f.key[1] for f in self.estimator.groups.team.state.confirmed_landmarks())


def assert_consistent(runs):
    nees = [
        score.mean_nees_per_dof() for run in runs
        for score in run.estimator.evaluation.scores.values()]
    # Errors of a run last long: with numbers, runs have a standard deviation of 0.26.
    assert abs(np.mean(nees) - 1.0) < 3.0 * 0.3 / math.sqrt(len(nees))


@pytest.mark.parametrize('robots', [1, 2])
@pytest.mark.parametrize('seeds', [range(2), slow(range(20))], ids=['2', '20'])
def test_matches_are_correct_landmarks_unique_and_poses_consistent(
    seeds, robots
):
    runs = [Run(seed, robots) for seed in seeds]

    matches = [run.matches for run in runs]
    assert sum(m.false() for m in matches) < 0.01 * sum(m.count() for m in matches)
    for run in runs:
        landmarks = run.landmarks()
        assert set(landmarks.values()) == {1}
        assert len(landmarks) > 50
        assert max(landmarks) < CLUTTER
    assert_consistent(runs)


@pytest.mark.slow
def test_robots_that_start_with_an_uncertain_heading_close_no_loop_wrongly():
    """To first order, a pose 0.3 rad off is outside of its covariance after a few metres."""
    runs = [Run(seed, 4, (1.0, 1.0, 0.3), 1.0, filter='invariant') for seed in range(8)]

    for run in runs:
        assert run.matches.false() < 0.01 * run.matches.count()
        assert set(run.landmarks().values()) == {1}
    assert_consistent(runs)
