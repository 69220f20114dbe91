# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Real robots, live through the node from `play`: what `replay` finds, bit for bit."""

import json
import os
from pathlib import Path

import pytest
from ros_helpers import run_verb

from fej_slam_ros.ros import bags, parameters

pytest.importorskip('live_helpers', reason='rclpy is not installed')

#: No run takes longer [s], converted and replayed on a busy machine.
LONGEST = 1200

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(LONGEST)]


@pytest.fixture
def data():
    if 'FEJ_SLAM_DATA' not in os.environ:
        pytest.skip('FEJ_SLAM_DATA does not name the folder of the data sets')
    return Path(os.environ['FEJ_SLAM_DATA'])


def live_values(parameter_file, output):
    """Return the parameters of a live run that loses nothing, however busy the machine is."""
    values = parameters.load_values(parameter_file, ['estimator'])
    policies = {'reliability': 'reliable', 'depth': 3000}
    reliable = {
        f'qos_overrides./{robot}/{kind}.subscription.{policy}': value
        for robot in values['robots'] for kind in ('odom', 'landmarks', 'robots', 'ground_truth')
        for policy, value in policies.items()}
    return {**values, **reliable, 'stale_after': 30.0, 'output': str(output)}


# At these rates the busiest second of either takes less than a second here.
@pytest.mark.parametrize(('words', 'folder', 'rate'), [
    (['mrclam'], 'mrclam_6', 2),
    (['victoria_park', '--raw', '--robots', '2'], 'victoria_park', 4)], ids=['mrclam', 'park'])
def test_real_robots_live_are_their_replay(domain, tmp_path, data, words, folder, rate):
    bag = tmp_path / 'bag'
    assert run_verb('convert', *words, '--input', data / folder, '--output', bag) == 0
    team = Path(f'{bag}.yaml')
    assert run_verb('replay', bag, '--params', team, '--output', tmp_path / 'replayed') == 0

    domain.estimate(**live_values(team, tmp_path / 'live'))
    # The player waits for whoever takes each topic, and the estimator takes no GPS.
    fixes = {
        name: domain.record(name, topic.type_name) for name, topic in bags.topics(bag).items()
        if name.endswith('/gps')}
    player = domain.start('play', bag, '--rate', rate)
    assert domain.finish(player, deadline=LONGEST) == (0, '')
    domain.end_estimate()

    live, replayed = (
        json.loads((tmp_path / run / 'summary.json').read_text()) for run in ('live', 'replayed'))
    assert live['state_hash'] == replayed['state_hash']
    assert live['counts'] == replayed['counts']
    assert all(map(len, fixes.values()))
