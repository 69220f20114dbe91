# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots that know no landmark, miss one in ten, and see clutter three times in ten sightings.

The world is the first environment of [Liu] with the noise of ordinary robots: 0.1 m and 1 degree
of odometry a step of 2.6 m, 0.15 m of a sighting, 15 m of range.

"""

from collections import Counter, defaultdict
from dataclasses import replace
import math

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.identities import Identities
from fej_slam_ros.core.records import NO_ID, Scan
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.sim.sensors import measure, SensorSettings

SENSORS = SensorSettings(
    (0.1, 0.1, math.radians(1.0)), (0.15, 0.15), clutter=0.3, missed=0.1)
START_SIGMA = (1.0, 1.0, 0.1)


def unnamed(scan, rng):
    """Return a scan in which nobody knows what is seen, in no order."""
    order = rng.permutation(len(scan.sightings))
    return replace(scan, sightings=tuple(replace(scan.sightings[k], id=NO_ID) for k in order))


class Run:
    """
    A run of two loops in which no sighting has a number.

    Attributes
    ----------
    seen : for each number that was given, what its sightings were truly of
    estimator : the estimator at the end

    """

    def __init__(self, seed, robots, monkeypatch):
        self.seen = defaultdict(list)
        environment, rng = ENVIRONMENTS['circles'], np.random.default_rng(seed)
        names = tuple(f'r{i + 1}' for i in range(robots))
        world = replace(environment, world=replace(
            environment.world, robots=names, loops=2)).true_world(rng)
        starts = {name: tuple(world.true_poses[name][0].tolist()) for name in names}
        others = (RobotSettings(name, i, starts[name], START_SIGMA)
                  for i, name in enumerate(names[1:], start=2))
        self.estimator = Estimator(Settings(
            (RobotSettings('r1', 1), *others), 'r1', anchor_pose=starts['r1']))
        origin, number = {}, Identities.named

        def spy(*args):
            named = number(*args)
            for sighting in named.scan.sightings:
                self.seen[sighting.id].append(origin[sighting.z.tobytes()])
            return named

        with monkeypatch.context() as spied:
            spied.setattr(Identities, 'named', spy)
            for record in measure(world, SENSORS, rng):
                if isinstance(record, Scan):
                    origin |= {s.z.tobytes(): s.id for s in record.sightings}
                    self.estimator.add(unnamed(record, rng))
                else:
                    self.estimator.add(record)
            list(self.estimator.close())

    def wrong_matches(self):
        """Return how many sightings are not of what most with the same number are of; and all."""
        again = [origins for origins in self.seen.values() if len(origins) > 1]
        right = sum(Counter(origins).most_common(1)[0][1] for origins in again)
        return sum(map(len, again)) - right, sum(len(origins) - 1 for origins in again)

    def landmarks(self):
        """Return which landmark each that counts is, with those that were merged with none."""
        return [Counter(self.seen[f.key[1]]).most_common(1)[0][0]
                for f in self.estimator.team.state.settled_landmarks()]


@pytest.mark.parametrize('robots', [1, 2])
@pytest.mark.parametrize(
    'seeds', [range(2), pytest.param(range(20), marks=pytest.mark.slow)], ids=['2', '20'])
def test_matches_are_right_each_landmark_is_there_once_and_poses_are_consistent(
    seeds, robots, monkeypatch
):
    runs = [Run(seed, robots, monkeypatch) for seed in seeds]

    wrong, matched = np.sum([run.wrong_matches() for run in runs], axis=0)
    assert wrong < 0.01 * matched
    for run in runs:
        there = run.landmarks()
        assert len(there) == len(set(there)) > 50
        assert NO_ID not in there
    nees = [
        score.mean_nees() for run in runs for score in run.estimator.evaluation.scores.values()]
    # Errors of a run last long: with numbers, runs have a standard deviation of 0.26.
    assert abs(np.mean(nees) - 1.0) < 3.0 * 0.3 / math.sqrt(len(nees))
