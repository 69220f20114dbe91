# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bags in the repository are what their README says."""

import numpy as np
import pytest

from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import deserialize, incoming, incoming_clouds
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.paths import BAGS
from helpers.ros import run_bag

NAMES = sorted(path.parent.name for path in BAGS.glob('*/metadata.yaml'))


def numbers(message):
    """Return what was measured, as the estimator reads it."""
    decoded = deserialize(message.raw, message.type_name)
    robot, kind = message.topic.split('/')
    if kind == 'odom':
        return incoming.odometry(decoded, robot).pose.tolist()
    if robot == 'ground_truth':
        positions = incoming_clouds.true_landmarks(decoded).positions
        return [value for number in positions for value in (number, *positions[number])]
    if kind == 'ground_truth':
        return incoming.true_pose(decoded, robot).pose.tolist()
    scan, _ = incoming_clouds.scan(decoded, RobotSettings(robot, 1))
    return [value for s in scan.observations for value in (s.id, *s.z, *s.R.ravel())]


@pytest.mark.parametrize('name', NAMES)
def test_a_shipped_bag_is_reproduced_from_its_parameters(name, tmp_path):
    simulated = simulation.load(BAGS / f'{name}.yaml')
    bags.write(tmp_path / name, simulated.records(), robot_ids=simulated.robot_ids)

    again, shipped = list(bags.read(tmp_path / name)), list(bags.read(BAGS / name))
    assert [(m.topic, m.received) for m in again] == [(m.topic, m.received) for m in shipped]
    for new, old in zip(again, shipped):
        # Another processor or C library may round sines and logarithms differently.
        np.testing.assert_allclose(numbers(new), numbers(old), atol=1e-9)


@pytest.mark.parametrize('name', NAMES)
def test_poses_of_a_shipped_bag_are_within_three_sigma(name):
    run = run_bag(BAGS / name)

    scores = run.estimator.evaluation.scores
    assert set(scores) == {robot.name for robot in run.settings.estimation.robots}
    # NEES of 3 degrees of freedom at 3 sigma is 9, divided by 3; the mean of a run stays below.
    assert all((score.mean_nees_per_dof() or np.inf) < 3.0 for score in scores.values())


def test_robots_of_the_rendezvous_bag_join_where_they_meet():
    run, joined_at = EstimatorSession(parameters.load(BAGS / 'rendezvous.yaml'), None), []

    for message in bags.read(BAGS / 'rendezvous'):
        run.receive(message)
        list(run.take())
        if run.estimator.groups.team.state.robots.keys() == {'p', 'q'}:
            joined_at.append(message.received)

    # They meet from 23 s on.
    assert 23_000_000_000 < joined_at[0] < 25_000_000_000


@pytest.mark.parametrize('name', NAMES)
def test_a_shipped_bag_is_small(name):
    assert sum(path.stat().st_size for path in (BAGS / name).iterdir()) < 1_000_000


def test_robots_of_the_rendezvous_bag_observe_each_other_while_they_pass():
    ids, met = {'p': 1, 'q': 2}, []
    for message in bags.read(BAGS / 'rendezvous'):
        robot, _, kind = message.topic.partition('/')
        if kind == 'robots':
            cloud = deserialize(message.raw, message.type_name)
            scan, _ = incoming_clouds.robot_scan(
                cloud, RobotSettings(robot, ids[robot]), {n: name for name, n in ids.items()})
            met.append((scan.stamp, robot, [s.observed for s in scan.observations]))

    # Samples 44 to 52, two a second, from the first second on.
    stamps = [1_000_000_000 + 500_000_000 * k for k in range(44, 53)]
    assert met == [(at, *pair) for at in stamps for pair in (('p', ['q']), ('q', ['p']))]
