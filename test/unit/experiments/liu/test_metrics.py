# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Entries as the paper defines them, and their ranges as statistics predicts."""

from math import sqrt
from statistics import fmean

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.stats import binom

from fej_slam_ros.experiments.liu.metrics import (
    entries, entries_of_each, entries_of_run, error_curves, ranges, sample_mean)
from fej_slam_ros.experiments.liu.monte_carlo import Errors, stack

RUNS, STEPS, LANDMARKS = 4, 5, 3
NAMES = ['r1_nees', 'r1_pos', 'r1_head', 'r2_nees', 'r2_pos', 'r2_head', 'f_nees', 'f_pos']


def made_up(runs=RUNS, seed=1):
    """Return errors of made-up runs, stacked; the first robot has a step less than the other."""
    rng = np.random.default_rng(seed)
    poses = {
        name: rng.gamma(2.0, size=(runs, 3, steps))
        for name, steps in (('a', STEPS), ('b', STEPS + 1))}
    return Errors(poses, rng.gamma(2.0, size=(runs, 2, LANDMARKS)))


def one_step(values):
    """Return runs of one step and one landmark, all of whose squares and NEES are the values."""
    return Errors(
        {robot: np.tile(np.reshape(values, (-1, 1, 1)), (1, 3, 1)) for robot in 'ab'},
        np.tile(np.reshape(values, (-1, 1, 1)), (1, 2, 1)))


def rmse(squares):
    """Return the mean over steps of the root of the mean over runs, of (runs, steps) squares."""
    runs, steps = squares.shape
    return fmean(sqrt(fmean(squares[r, k] for r in range(runs))) for k in range(steps))


def by_definition(errors):
    """Return the eight entries, spelled out."""
    found = []
    for steps in errors.poses.values():
        nees = fmean(value for run in steps[:, 2] for value in run)
        found += [nees, rmse(steps[:, 0]), rmse(steps[:, 1])]
    nees = fmean(value for run in errors.landmarks[:, 1] for value in run)
    return [*found, nees, rmse(errors.landmarks[:, 0])]


def test_entries_follow_the_definitions_of_the_paper():
    found = entries(made_up())

    assert list(found) == NAMES
    assert_allclose(list(found.values()), by_definition(made_up()), rtol=1e-14)  # rounding


def test_entries_of_each_run_are_those_of_the_run_alone():
    runs = [made_up(1, seed) for seed in range(3)]
    errors = stack([
        Errors({name: steps[0] for name, steps in run.poses.items()}, run.landmarks[0])
        for run in runs])

    found = entries_of_each(errors)

    for entries_of_one, run in zip(found, runs, strict=True):
        assert list(entries_of_one) == NAMES
        squares = [steps[0].mean(axis=1) for steps in run.poses.values()]
        assert entries_of_one['r1_pos'] == pytest.approx(sqrt(squares[0][0]), rel=1e-14)
        assert entries_of_one['r2_head'] == pytest.approx(sqrt(squares[1][1]), rel=1e-14)


def test_a_run_alone_has_root_mean_squares_over_its_steps_and_landmarks():
    run = Errors(
        {'a': np.array([[1.0, 7.0], [0.0, 2.0], [1.0, 4.0]]), 'b': np.ones((3, 5))},
        np.array([[1.0, 9.0, 8.0], [2.0, 3.0, 4.0]]))

    assert entries_of_run(run) == dict(zip(NAMES, [
        2.5, 2.0, 1.0, 1.0, 1.0, 1.0, 3.0, sqrt(6.0)]))


def test_a_mean_has_the_interval_of_students_t():
    found = sample_mean(np.array([1.0, 2.0, 3.0, 4.0, 5.0]))

    # The squares of deviations add up to 10; tables say 2.7764 for 4 degrees of freedom.
    assert (found.value, found.runs) == (3.0, 5)
    assert found.error == pytest.approx(sqrt(10.0 / 4.0 / 5.0), rel=1e-14)  # rounding
    assert found.margin == pytest.approx(2.7764 * sqrt(0.5), abs=1e-4)  # as the table


def test_a_single_run_has_a_mean_and_no_interval():
    found = sample_mean(np.array([4.0]))

    assert (found.value, found.runs, found.error, found.margin) == (4.0, 1, None, None)


def test_the_mean_of_100_runs_varies_by_a_tenth_of_a_single_run():
    errors = made_up(runs=400)
    each, found = entries_of_each(errors), ranges(errors, np.random.default_rng(1))

    # NEES is a plain mean over runs. Of 2000 draws the sd is known to 1.6 %, taken 4 times.
    for name in ('r1_nees', 'r2_nees', 'f_nees'):
        of_runs = np.array([of_run[name] for of_run in each])
        sd = np.std(of_runs) / 10.0
        assert found[name].mean == pytest.approx(of_runs.mean(), abs=4.0 * sd / sqrt(2000))
        assert found[name].sd100 == pytest.approx(sd, rel=0.064)


@pytest.mark.parametrize(('name', 'probability'), [
    ('lo95', 0.025), ('hi95', 0.975), ('lo997', 0.0015), ('hi997', 0.9985)])
def test_the_bounds_are_quantiles_of_entries_of_100_runs(name, probability):
    found = ranges(one_step([1.0] * 3 + [0.0] * 7), np.random.default_rng(1))

    # How many of 100 runs drawn from these have a 1 is binomial. 2000 draws hit the quantiles of
    # 95 % to one run with any seed, those of 99.7 % with nine of ten.
    count = binom.ppf(probability, 100, 0.3)
    for entry in ('r1_nees', 'r2_nees', 'f_nees'):
        assert 100.0 * getattr(found[entry], name) == pytest.approx(count, abs=1.0)
    for entry in ('r1_pos', 'r1_head', 'r2_pos', 'r2_head', 'f_pos'):
        assert 100.0 * getattr(found[entry], name) ** 2 == pytest.approx(count, abs=1.0)


def test_ranges_depend_on_the_generator():
    errors = made_up(runs=20)
    first, again, other = (ranges(errors, np.random.default_rng(seed)) for seed in (1, 1, 2))

    assert first == again
    assert all(first[name] != other[name] for name in NAMES)


def test_error_curves_are_the_metrics_step_by_step():
    errors = made_up()

    found = error_curves(errors)

    assert list(found) == ['a', 'b']
    for name, course in found.items():
        of_step = errors.poses[name].transpose(2, 1, 0).tolist()
        expected = [
            (fmean(nees), sqrt(fmean(position)), sqrt(fmean(heading)))
            for position, heading, nees in of_step]
        assert_allclose(
            np.transpose([course.nees, course.position, course.heading]), expected, rtol=1e-14)
