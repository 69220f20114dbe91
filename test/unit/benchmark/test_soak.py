# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory of a long run does not grow once all landmarks are known."""

import numpy as np
import pytest

from fej_slam_ros.benchmark.soak import soak
from fej_slam_ros.experiments.common.executor import in_order, processes


def soaked(minutes):
    """Return the minutes of a run in a process of its own."""
    with processes(1) as executor:
        return next(in_order(executor, soak, [minutes]))


@pytest.mark.slow
def test_each_minute_has_its_steps_and_memory():
    first, second = soaked(2)

    # A step waits for what may come within max_delay.
    assert 590 <= first.steps <= second.steps == 600
    assert 0.0 < second.median <= second.p99 <= second.longest
    # A Python process with numpy and scipy.
    assert first.memory > 40e6
    assert first.landmarks <= second.landmarks <= 300


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_memory_does_not_grow_in_an_hour_of_five_robots_among_three_hundred_landmarks():
    minutes = soaked(60)

    # All landmarks have been seen, all that is remembered of the input has been filled up.
    warm = minutes[19:]
    memory = np.array([minute.memory for minute in warm]) * 1e-6
    a_minute = np.polyfit(range(len(warm)), memory, 1)[0]
    p99 = 1e3 * np.median([minute.p99 for minute in warm])
    print(f'{memory[0]:.1f} to {memory[-1]:.1f} MB; p99 of a step {p99:.1f} ms')  # noqa: T201
    assert warm[0].landmarks == 300
    # 10 bytes for each of the 900,000 messages of an hour would be as much.
    assert 60 * a_minute < 9.0
    assert np.ptp(memory) < 9.0
