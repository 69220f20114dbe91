# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Levels of noise: the runs, and the paired comparison of filters."""

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest

from fej_slam_ros.experiments.common import executor
from fej_slam_ros.experiments.liu import metrics, monte_carlo, noise
from fej_slam_ros.experiments.liu.configurations import authors_world, Configuration, own_world
from fej_slam_ros.sim.world import make_world
from helpers.reports import ENTRIES

ONE, TWO = noise.NOISE_CONFIGURATIONS
WORLDS = {ONE: own_world(ONE), TWO: own_world(TWO)}
FILTERS = ['standard', 'fej', 'ideal', 'invariant']


def made_up(standard, fej, ideal, invariant):
    """Return a run all of whose entries have the same value, one for each filter."""
    values = dict(zip(FILTERS, (standard, fej, ideal, invariant)))
    return {name: dict.fromkeys(ENTRIES, value) for name, value in values.items()}


@pytest.mark.parametrize(('configuration', 'sigmas'), [
    (ONE, [(0.3, 2.0, 0.5), (0.3, 4.0, 0.5), (0.5, 5.0, 0.5), (1.0, 10.0, 1.0)]),
    (TWO, [(0.3, 2.0, 0.6), (0.3, 4.0, 0.6), (0.5, 5.0, 0.6), (1.0, 10.0, 1.0)])])
def test_measurements_have_the_noise_of_the_level(configuration, sigmas):
    sensors = [task.sensors for task in noise.tasks({configuration: None}, 1, [1])]

    # Radians are rounded.
    assert [s.odometry_sigma for s in sensors] == [
        pytest.approx((m, m, degrees * pi / 180.0), rel=1e-15) for m, degrees, _ in sigmas]
    assert [s.landmark_sigma for s in sensors] == [(m, m) for *_, m in sigmas]
    assert {s.range for s in sensors} == {15.0}


def test_the_first_level_repeats_the_runs_of_table_1():
    ours = noise.tasks({ONE: WORLDS[ONE]}, 5, [3])[0]
    papers, = monte_carlo.table_tasks({ONE: WORLDS[ONE]}, 5, [3])

    assert (ours.world, ours.sensors, ours.seed) == (papers.world, papers.sensors, papers.seed)


def test_all_cases_of_a_number_come_before_the_next_one():
    found = noise.tasks(WORLDS, 5, [1, 2])

    assert [task.seed for task in found] == [
        (5, environment, 20, number)
        for number in (1, 2) for environment in (1, 2) for _ in noise.LEVELS]
    assert [task.world for task in found[:8]] == 4 * [WORLDS[ONE]] + 4 * [WORLDS[TWO]]


def test_a_run_has_the_entries_of_each_filter():
    circles = Configuration(1, 12).simulated
    world = make_world(replace(circles.world, loops=1), np.random.default_rng(1))
    task = monte_carlo.MonteCarloTask(world, circles.sensors, noise.NOISE_FILTERS, (1, 2))

    found = noise.run(task)

    assert list(found) == FILTERS
    for name, errors in monte_carlo.simulate(task).items():
        # NEES of a run is a plain mean, as in the tables; rounding.
        alone = metrics.entries(monte_carlo.stack([errors]))
        for entry in ('r1_nees', 'r2_nees', 'f_nees'):
            assert found[name][entry] == pytest.approx(alone[entry], rel=1e-14)
        assert found[name]['r2_pos'] == pytest.approx(
            np.linalg.norm(np.sqrt(errors.poses['r2'][0])) / 8.0, rel=1e-14)  # of 64 steps


def test_differences_are_taken_run_by_run():
    finished = [made_up(0.0, fej, 0.0, invariant) for fej, invariant in [
        (10.0, 9.0), (20.0, 18.0), (90.0, 87.0)] for _ in noise.LEVELS]

    found = noise.means(noise.gathered([ONE], finished))

    for rows in found.values():
        # -1, -2 and -3, although the runs themselves differ by far more.
        difference = rows['invariant - fej']['r1_pos']
        assert (difference.value, difference.runs) == (-2.0, 3)
        assert difference.error == pytest.approx(1.0 / sqrt(3.0), rel=1e-14)  # rounding
        assert rows['fej']['r1_pos'].value == 40.0
        assert list(rows['invariant - fej']) == ['r1_pos', 'r1_head', 'r2_pos', 'r2_head', 'f_pos']


@pytest.mark.parametrize(('finished', 'runs'), [
    (0, []), (1, [1]), (3, [1, 1, 1]), (5, [2, 1, 1, 1]), (8, [2, 2, 2, 2])])
def test_an_interrupted_sweep_keeps_its_finished_runs(finished, runs):
    samples = noise.gathered([TWO], [made_up(k, 0.0, 0.0, 0.0) for k in range(finished)])

    values = [by_filter['standard']['f_pos'].tolist() for by_filter in samples.values()]
    assert [case.level for case in samples] == list(noise.LEVELS[:len(runs)])
    assert [len(of_case) for of_case in values] == runs
    assert all(of_case == [*range(k, finished, 4)] for k, of_case in enumerate(values))


@pytest.mark.parametrize('configuration', [ONE, TWO])
def test_robots_stay_in_the_frame_at_the_highest_noise(configuration):
    *_, highest = noise.tasks(WORLDS, 1, [1])

    # A pose in another frame, whose start is exact, would have no NEES.
    found = noise.run(replace(highest, world=WORLDS[configuration], filters=('fej',)))

    assert all(np.isfinite(value) for value in found['fej'].values())


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_invariant_filter_is_consistent_at_any_noise_and_no_worse_than_fej(data):
    worlds = {c: authors_world(data / 'fej_ekf_paper', c) for c in noise.NOISE_CONFIGURATIONS}

    with executor.processes(2) as workers:
        todo = noise.tasks(worlds, 1, range(1, 101))
        finished = list(executor.in_order(workers, noise.run, todo))

    found = noise.means(noise.gathered(noise.NOISE_CONFIGURATIONS, finished))
    assert len(found) == 8
    for case, rows in found.items():
        for entry in ('r1_nees', 'r2_nees'):
            assert 0.9 <= rows['invariant'][entry].value <= 1.35, case
        assert all(d.value <= 2.0 * d.error for d in rows['invariant - fej'].values()), case
