# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Other solvers solve the same problem as ours."""

from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.benchmark import ceres
from fej_slam_ros.benchmark.batch import batch_times, OUR_BATCH
from fej_slam_ros.benchmark.tables import batch_table
from helpers.smoothing import far_from, world


def other_solver(name):
    if name == 'Ceres':
        if not ceres.is_installed():
            pytest.skip('Ceres is not installed')
        return ceres.solve
    return pytest.importorskip(
        'fej_slam_ros.benchmark.gtsam_batch', reason='gtsam is not installed').solve


@pytest.mark.parametrize(('name', 'metres', 'relative'), [
    # Ceres ends at a relative decrease of 1e-9, at 0.0002 standard deviations of 0.1 m. GTSAM
    # minimises another cost, that of bearing and range.
    ('Ceres', 1e-4, 1e-8), ('GTSAM', 0.05, 0.005)])
def test_a_minimum_of_another_solver_is_ours(name, metres, relative):
    problem, truth = world(3, steps=20)

    ours, other = batch_times(
        'small', problem, far_from(truth, 1, metres=0.1), {name: other_solver(name)})

    assert (ours.solver, other.solver) == (OUR_BATCH, name)
    assert other.difference < metres
    assert_allclose(other.cost, ours.cost, rtol=relative)
    assert other.iterations > 0
    assert other.seconds > 0.0


def test_the_table_shows_the_ratio_to_our_time():
    problem, truth = world(3)

    times = batch_times('small', problem, truth, {})

    assert batch_table(times).splitlines()[1].split()[:3] == ['small', OUR_BATCH, str(
        3 * (len(truth.poses) - 1) + 2 * len(truth.points))]
