# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The line from images of tags to poses of robots in one map."""

import numpy as np
import pytest

from fej_slam_ros.sim.tags import CAMERA_POSE, robot_tags, TAG_DEPTH
from helpers.ros import run_verb, summary_of, write_parameters

#: Number of worlds.
SEEDS = 10


def line(tmp_path, seed, **world):
    """Return the summary of a run from simulated tags to poses, the start of r2 unknown."""
    folder = tmp_path / str(seed)
    folder.mkdir()
    simulator = write_parameters(
        folder / 's.yaml', environment='tags', seed=seed, loops=1, **world)
    of_robots = {
        f'{name}.{key}': value for name, tags in robot_tags(('r1', 'r2')).items()
        for key, value in (
            ('sensor_pose', [*CAMERA_POSE]), ('tag_depth', TAG_DEPTH),
            ('tags', [f'tags:{tag}' for tag in tags]))}
    adapter = write_parameters(
        folder / 'a.yaml', robots=['r1', 'r2'], formats=['marker_array'], **of_robots)
    estimator = write_parameters(folder / 'e.yaml', robots=['r1', 'r2'], max_delay=0.3)
    for words in (
            ('simulate', '--params', simulator, '--output', folder / 'bag'),
            ('adapt', folder / 'bag', '--params', adapter, '--output', folder / 'seen'),
            ('replay', folder / 'seen', '--params', estimator, '--output', folder / 'run')):
        assert run_verb(*words) == 0
    return summary_of(folder / 'run')


def test_robots_with_cameras_join_and_know_where_they_are(tmp_path):
    summary = line(tmp_path, 3)

    assert not summary['not_in_map']
    # A tag on a post is seen from 5 m with a standard deviation of 0.25 m.
    assert max(summary['rmse'][name]['position'] for name in ('r1', 'r2')) < 0.25
    assert {*summary['nis']} == {'r1', 'r2'}


@pytest.mark.slow
def test_the_estimates_from_tags_are_consistent(tmp_path):
    summaries = [line(tmp_path, seed) for seed in range(1, SEEDS + 1)]

    assert not any(summary['not_in_map'] for summary in summaries)
    # The errors of a run are correlated over its minute, so that a run counts as a few samples of
    # three degrees of freedom: 20 runs of robots of 3 each have a standard deviation of 0.11.
    assert 0.7 < np.mean([s['nees'][name] for s in summaries for name in ('r1', 'r2')]) < 1.3
    # Innovations are not correlated: some 15,000 numbers.
    nis = [s['nis'][name] for s in summaries for name in ('r1', 'r2')]
    total, dof = sum(sums['sum'] for sums in nis), sum(sums['dof'] for sums in nis)
    assert total / dof == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / dof))
