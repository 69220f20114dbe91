# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A lost robot does not poison the map of the others.

Three robots drive one behind the other, the first of them gets lost: odometry jumps, the robot is
carried, its wheels slip, or its sensor is moved. The others follow into what it has mapped.
"""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.records import Scan
from helpers.lost_robots import (
    drive, fault_at, FAULTS, HEALTHY, is_of_lost, LOST, run, SENSORS, set_clock, slip, STEP,
    survey)
from helpers.slow import slow

#: Faults during a run, and from its start.
DURING = [name for name in FAULTS if 'start' not in name]


def pair(seed, fault, **settings):
    """Return the errors of a run with a fault, and without it."""
    records, (rng, since) = drive(seed), fault_at(seed)
    return run(FAULTS[fault](records, since, rng), since, **settings), run(records, **settings)


def is_poisoned(faulty, sound):
    """
    Return whether the fault has harmed the healthy robots.

    The errors of a run are correlated in time, so its NEES/3 may be above 1.3 without a fault.
    """
    return faulty.rmse > 1.1 * sound.rmse or faulty.nees > max(1.3, 1.1 * sound.nees)


@pytest.mark.parametrize('fault', ['jump of 30.0 m', 'carried 4 m'])
def test_the_followers_of_a_lost_robot_are_where_they_would_be_without_its_fault(fault):
    seed, since, end = 0, 60 * STEP, 150 * STEP
    records = drive(seed)
    faulty = run(FAULTS[fault](records, since, np.random.default_rng(1)), since, end)

    assert not is_poisoned(faulty, run(records, end=end))
    assert faulty.map_error < 0.5
    # The lost robot has joined again.
    assert faulty.estimator.groups.team.robots.keys() == {'r1', 'r2', 'r3'}
    assert faulty.lost_error < 0.5
    relocalized = faulty.estimator.statistics.relocalized
    assert (relocalized['r1'], relocalized['r2'], relocalized['r3']) == (0, 0, 1)


@pytest.mark.parametrize('kind', ['fej', 'invariant'])
@pytest.mark.parametrize('turned', [0.05, 0.1, 0.15])
def test_a_robot_that_turns_by_a_slip_is_corrected_by_the_next_scan(turned, kind):
    """Before, its scans failed the gate for seconds, or it was lost."""
    since, end = 60 * STEP, 70 * STEP
    inject = slip(1.0, turned, seconds=0.1)
    faulty = run(
        inject(drive(0), since, np.random.default_rng(1)), since, end, filter=kind)

    assert faulty.lost_share == 1.0
    assert not faulty.estimator.statistics.relocalized[LOST]
    # Ten observations of 0.1 m in each of nine scans, with the correlation of a map.
    assert faulty.lost_error < 0.15


@pytest.mark.parametrize('kind', ['fej', 'invariant'])
@pytest.mark.parametrize('fault', [slow('slip, 3 times'), 'slip, turning'])
def test_a_robot_that_only_others_observe_is_found_after_its_wheels_slipped(fault, kind):
    since, rng = 150 * STEP, np.random.default_rng(1)
    records = [
        replace(r, observations=()) if is_of_lost(r, Scan, -1) else r
        for r in drive(2, replace(SENSORS, robot_sigma=(0.1, 0.1), range=15.0))]
    faulty = run(FAULTS[fault](records, since, rng), since, filter=kind)

    statistics = faulty.estimator.statistics
    assert not is_poisoned(faulty, run(records, filter=kind))
    assert {name: statistics.relocalized[name] for name in (*HEALTHY, LOST)} == {
        'r1': 0, 'r2': 0, LOST: 1}
    # Nine contradictions, ten in a second, and some observations from which it joins again.
    assert faulty.lost_share > 0.9
    assert faulty.lost_error < 0.5


def test_a_robot_whose_own_map_has_a_slip_in_it_begins_another():
    """Before, it stayed outside `map` with ten landmarks of the team, which did not fit."""
    seed = 4
    records, (rng, since) = drive(seed), fault_at(seed)

    faulty = run(FAULTS['slip, 3 times'](records, since, rng), since)

    assert 'does not fit' in faulty.estimator.statistics.restart_reasons[LOST]
    assert LOST in faulty.estimator.groups.team.robots
    assert faulty.lost_error < 0.5


@pytest.mark.slow
@pytest.mark.parametrize('seconds', [-20.0, -3.0, -1.0, -0.3, 0.3, 3.0])
def test_a_clock_that_is_set_harms_nobody(seconds):
    runs = []
    for seed in range(6):
        records, (rng, since) = drive(seed), fault_at(seed)
        faulty = run(set_clock(seconds)(records, since, rng), since)
        runs.append((faulty, run(records)))

    # A healthy robot misses at most the observations of the time that passed twice.
    assert max(faulty.rmse / sound.rmse for faulty, sound in runs) < 1.2
    assert max(faulty.nees / sound.nees for faulty, sound in runs) < 1.1
    # 0.27 m without a fault, in the worst of these runs.
    assert max(faulty.lost_error for faulty, _ in runs) < 0.5
    assert min(faulty.lost_share for faulty, _ in runs) > 0.85


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['fej', 'invariant'])
def test_of_100_lost_robots_at_most_two_harm_the_others(kind):
    runs = [pair(seed, DURING[seed % len(DURING)], filter=kind) for seed in range(100)]

    assert sum(is_poisoned(*of_both) for of_both in runs) <= 2
    assert np.mean([faulty.nees for faulty, _ in runs]) < 1.3
    restarts = [faulty.estimator.statistics.relocalized for faulty, _ in runs]
    assert not any(counts[name] for counts in restarts for name in HEALTHY)


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['fej', 'invariant'])
def test_among_surveyed_landmarks_the_others_stay_accurate_and_consistent(kind):
    """There the errors of a run are hardly correlated: none is above 1.3 without a fault."""
    runs = [
        pair(
            seed, DURING[seed % len(DURING)], prior=survey(drive(seed), seed), filter=kind)
        for seed in range(100)]

    good = [
        faulty.nees < 1.3 and abs(faulty.rmse / sound.rmse - 1.0) < 0.1 for faulty, sound in runs]
    assert sum(good) >= 98
    assert max(sound.nees for _, sound in runs) < 1.3


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_inflated_scans_of_a_lost_robot_harm_nobody():
    runs = [
        pair(seed, DURING[seed % len(DURING)], inflate_rejected_scans=True) for seed in range(80)]

    # One in 40: without the landmarks of the lost robot the errors of some runs are larger.
    assert sum(is_poisoned(*of_both) for of_both in runs) <= 2
