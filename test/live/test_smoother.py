# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The live smoother ends with what `smooth` finds, has it told on the way, and holds nobody up."""

from contextlib import suppress
import csv
import json
import os
from pathlib import Path
import signal

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.session import simulation
from helpers.optional import optional
from helpers.paths import BAGS
from helpers.ros import run_verb, write_parameters

rclpy_qos = optional('rclpy.qos')
live_helpers = optional('helpers.live')

pytestmark = [pytest.mark.ros, pytest.mark.slow]

RENDEZVOUS = BAGS / 'rendezvous'
CLOUD = 'sensor_msgs/msg/PointCloud2'


def live_parameters(folder, robots, **values):
    """Return a parameter file of a live run that loses nothing and writes files."""
    return write_parameters(
        folder / 'live.yaml', robots=robots, output=str(folder / 'live'),
        # A machine that is busy elsewhere for a second must not end the run.
        stale_after=30.0, **live_helpers.reliable_inputs(robots), **values)


def figures(folder, name, columns):
    """Return some columns of a table, from the front, as numbers."""
    with (folder / name).open() as file:
        _, *rows = csv.reader(file)
    return np.array([row[:columns] for row in rows], dtype=float)


def whole_state(reports):
    """Return what the latest report tells of the smoother as a whole."""
    *_, whole = reports[-1].status
    return {value.key: value.value for value in whole.values}


def test_a_live_run_ends_as_smooth_does(domain, tmp_path):
    given = live_parameters(tmp_path, ['p', 'q'], shared_landmark_ids=False)
    words = RENDEZVOUS, '--params', given, '--output', tmp_path / 'smoothed'
    assert run_verb('smooth', *words) == 0

    smoother = domain.start('smoother', '--ros-args', '--params-file', given)
    reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
    poses = domain.listen('q/pose', live_helpers.POSE)
    base_nodes = domain.listen('q/base_node', live_helpers.POSE)
    maps = domain.listen('smoother/landmarks', CLOUD)
    domain.until(lambda: reports)
    latched = domain.node.get_publishers_info_by_topic('/q/base_node')[0].qos_profile.durability
    assert domain.finish(domain.start('play', RENDEZVOUS, '--rate', 4)) == (0, '')
    domain.until(lambda: maps and base_nodes)
    status, _ = domain.finish(smoother, signal.SIGINT)

    assert status == 0
    assert latched is rclpy_qos.QoSDurabilityPolicy.TRANSIENT_LOCAL
    assert {pose.header.frame_id for pose in poses} == {'q/map', 'map'}
    assert {told.header.frame_id for told in [*base_nodes, *maps]} == {'map'}
    for name, columns in {
            'trajectory_p.csv': 10, 'trajectory_q.csv': 10, 'landmarks.csv': 6}.items():
        live, smoothed = (figures(tmp_path / f, name, columns) for f in ('live', 'smoothed'))
        assert_allclose(live, smoothed, rtol=0.0, atol=1e-9)
    base, expected = (
        json.loads((tmp_path / f / 'alignment.json').read_text())['maps'][0]
        for f in ('live', 'smoothed'))
    assert base['associations'] == expected['associations']
    assert_allclose(base['base_nodes']['q']['pose'], expected['base_nodes']['q']['pose'],
                    rtol=0.0, atol=1e-9)


def workers(process):
    """Return the numbers of the processes in the session of another one, but for that itself."""
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        with suppress(ProcessLookupError):  # it has ended meanwhile
            if os.getsid(int(folder.name)) == process.pid != int(folder.name):
                found.append(int(folder.name))
    return found


def test_what_solves_ends_with_a_node_that_is_killed(domain):
    smoother = domain.start('smoother', '--ros-args', '-p', 'robots:=[r1]')
    domain.until(lambda: workers(smoother))

    domain.finish(smoother, signal.SIGKILL)

    domain.until(lambda: not workers(smoother))


@pytest.mark.slow
def test_nothing_waits_longer_than_50_ms_on_a_map_of_2000_poses(domain, tmp_path):
    world = {'loops': 16, 'steps_per_loop': 63, 'landmarks': 60}
    bags.write(tmp_path / 'bag', simulation.parse(world).records())
    given = live_parameters(tmp_path, ['r1', 'r2'])
    smoother = domain.start('smoother', '--ros-args', '--params-file', given)
    reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
    paths = domain.listen('r1/path', 'nav_msgs/msg/Path')
    domain.until(lambda: reports)

    # 25 steps a second, five times as fast as it happened.
    assert domain.finish(domain.start('play', tmp_path / 'bag', '--rate', 5)) == (0, '')
    assert domain.finish(smoother, signal.SIGINT)[0] == 0

    holds = [
        float(value.value) for report in reports for value in report.status[-1].values
        if value.key == 'longest_hold_s']
    assert int(whole_state(reports)['poses']) > 2000
    assert float(whole_state(reports)['solve_time_s']) > 0.05
    assert paths
    # 0.023 s in the median of the seconds, 0.035 s at most; but whatever else runs on this machine
    # may take the processor away for a moment.
    assert np.percentile(holds, 90) < 0.05
