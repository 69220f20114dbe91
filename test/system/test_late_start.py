# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Consistency of runs that begin after the robots have moved."""

from collections import Counter

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import NS, Odometry, TrueLandmarks, TruePose
from fej_slam_ros.ros.session.late_starts import ArrivedOdometry, LateStarts
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.world import make_world, WorldSettings
from helpers.records import team

TEAM = ('r1', 'r2', 'r3')
SENSORS = SensorSettings((0.01, 0.01, 0.002), (0.1, 0.1), range=8.0)
#: Start poses of the robots other than the anchor are known to 1 cm and 0.01 rad.
START_SIGMA = (0.01, 0.01, 0.01)


class Recording:
    """What three robots send in loops of 37.5 s, to a listener that misses the beginning."""

    def __init__(self, seed, late, lost, loops):
        world = make_world(
            WorldSettings(
                'circles', (40.0, 33.0), 375, TEAM, landmarks=20, loops=loops, rate=10.0),
            np.random.default_rng(seed))
        self.records = [*measure(world, SENSORS, np.random.default_rng(seed))]
        self.numbers = {}
        self._rng = np.random.default_rng(seed)
        self._begin, self._lost = round(late * NS), lost

    def starts(self):
        """Return the true pose of each robot at its first record."""
        poses = {}
        for record in self.records:
            if isinstance(record, TruePose):
                poses.setdefault(record.robot, tuple(record.pose))
        return poses

    def heard(self):
        """Yield what is received: some messages of the first second are lost."""
        sent = Counter()
        for record in self.records:
            if isinstance(record, Odometry):
                sent[record.robot] += 1
            late_by = getattr(record, 'stamp', self._begin) - self._begin
            if late_by >= NS or (late_by >= 0 and self._rng.uniform() >= self._lost):
                if isinstance(record, Odometry):
                    self.numbers.setdefault(record.robot, sent[record.robot] - 1)
                yield record

    def missed(self, topic):
        return self.numbers[topic.removesuffix('/odom')]

    def forget(self, _topic):
        """Go on."""


def nees_after(late, seed, loops=2, lost=0.2):
    """Return the NEES/3 of each robot in ``map`` in a run that begins late."""
    recording = Recording(seed, late, lost, loops)
    starts = recording.starts()
    estimator = Estimator(team(
        *TEAM, known=[(name, starts[name], START_SIGMA) for name in TEAM[1:]],
        anchor_pose=starts['r1']))
    check = LateStarts(estimator, recording, lambda *_: None, {})
    for record in recording.heard():
        if isinstance(record, TrueLandmarks):
            continue
        arrived = [record]
        if isinstance(record, Odometry):
            admitted = check.admit(ArrivedOdometry(record, None, None))
            arrived = [odometry.record for odometry in admitted]
        for each in arrived:
            estimator.add(each)
        for _ in estimator.take():
            pass
    for _ in estimator.close():
        pass
    assert estimator.groups.not_in_map == {}
    return [estimator.evaluation.scores[name].mean_nees_per_dof() for name in TEAM]


# The mean over 20 runs is 0.8 to 0.95 where the start is heard; late starts are assumed to be less
# certain than they are, so the bound of 1.5 is that of overconfidence alone.
@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize('late', [0.1, 1.0, 10.0, 60.0])
def test_twenty_late_runs_are_not_overconfident(late):
    values = [nees_after(late, seed) for seed in range(20)]

    assert np.mean(values, axis=0).max() < 1.5


def test_a_late_run_is_not_overconfident():
    assert max(nees_after(10.0, seed=1, loops=1)) < 1.5
