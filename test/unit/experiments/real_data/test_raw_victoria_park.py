# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from fej_slam_ros.experiments.real_data import raw_victoria_park


@pytest.mark.slow
@pytest.mark.parametrize('robots', [1, 2])
def test_trees_without_ids_are_recognized(data, robots):
    run = raw_victoria_park.run(
        raw_victoria_park.RawParkTask(data / 'victoria_park', robots, has_ids=False))

    # The requirement; the published association has 299 trees, its batch solution 0.90 m.
    assert abs(run.landmarks - 299) < 0.2 * 299
    assert np.median(run.fitted) < 2.0
    assert run.false < 0.01 * run.matches
