# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of the machine, and the distribution of times."""

import pytest

from fej_slam_ros.benchmark.machine import drift, fastest, Machine, Times, versions


@pytest.mark.parametrize(('states', 'observations'), [(50, 10), (2000, 10), (2000, 1)])
def test_the_limit_is_that_of_arithmetic_or_of_memory(states, observations):
    machine = Machine(flops=1e9, bandwidth=1e10)

    # A triangle of n (n + 1) / 2 numbers is read and written: 8 bytes each, twice.
    triangle = states * (states + 1) / 2
    arithmetic, memory = 4.0 * triangle * observations / 1e9, 16.0 * triangle / 1e10
    assert machine.limit(states, observations) == pytest.approx(max(arithmetic, memory))


def test_drift_is_the_ratio_of_the_measured_limits():
    measured = [Machine(4e9, 1e10), Machine(2e9, 3e10), Machine(3e9, 2e10)]

    assert drift(measured) == (2.0, 3.0)
    assert fastest(measured) == Machine(4e9, 3e10)


def test_one_of_a_hundred_steps_is_above_the_99th_percentile():
    times = Times.of([*[1.0] * 60, *[2.0] * 39, 42.0])

    assert (times.median, times.mean, times.longest) == (1.0, 1.8, 42.0)
    assert times.longest > times.p99 >= 2.0


def test_versions_name_processor_and_libraries():
    names = versions()

    assert {'processor', 'BLAS core', 'python', 'numpy', 'scipy'} <= names.keys()
    assert all(names.values())
