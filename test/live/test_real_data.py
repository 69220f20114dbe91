# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Data sets of real robots, played to a live node, equal their `replay` bit for bit."""

from pathlib import Path

import pytest

from fej_slam_ros.ros.files import bags
from helpers.optional import optional
from helpers.ros import run_verb, summary_of

live_helpers = optional('helpers.live')

#: Limit of a run with conversion and replay [s], generous for a busy machine.
LONGEST = 2400

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(LONGEST)]


# At these rates a node keeps up with the busiest second of either set.
@pytest.mark.parametrize(('words', 'folder', 'rate'), [
    (['mrclam'], 'mrclam_6', 2),
    (['victoria_park', '--raw', '--robots', '2'], 'victoria_park', 4)], ids=['mrclam', 'park'])
def test_a_live_run_of_real_robots_equals_its_replay(domain, tmp_path, data, words, folder, rate):
    bag = tmp_path / 'bag'
    assert run_verb('convert', *words, '--input', data / folder, '--output', bag) == 0
    team = Path(f'{bag}.yaml')
    assert run_verb('replay', bag, '--params', team, '--output', tmp_path / 'replayed') == 0

    domain.estimate(**live_helpers.live_values(team, tmp_path / 'live'))
    # The player waits for a subscriber of each topic, and the estimator subscribes to no GPS.
    fixes = {
        name: domain.record(name, topic.type_name) for name, topic in bags.topics(bag).items()
        if name.endswith('/gps')}
    player = domain.start('play', bag, '--rate', rate)
    assert domain.finish(player, deadline=LONGEST) == (0, '')
    domain.end_estimate()

    live, replayed = summary_of(tmp_path / 'live'), summary_of(tmp_path / 'replayed')
    assert live['state_hash'] == replayed['state_hash']
    assert live['counts'] == replayed['counts']
    assert all(map(len, fixes.values()))
