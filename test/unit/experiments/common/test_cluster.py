# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs on a Dask cluster are the runs of this machine's own processes."""

import numpy as np
from numpy.testing import assert_array_equal
import pytest

from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments.common.executor import in_order, processes
from fej_slam_ros.experiments.liu.configurations import Configuration, own_world
from fej_slam_ros.experiments.liu.monte_carlo import simulate, table_tasks
from helpers.dying_workers import die_at_2
from helpers.optional import optional

distributed = optional('distributed')
cluster = optional('fej_slam_ros.experiments.common.cluster')

pytestmark = pytest.mark.needs('distributed')


@pytest.fixture
def address():
    """Return where the scheduler of a cluster of two worker processes listens."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
    ) as two_workers:
        yield two_workers.scheduler_address


@pytest.mark.slow
def test_a_cluster_gives_the_same_numbers(address):
    worlds = {c: own_world(c) for c in (Configuration(1, 20), Configuration(2, 20))}
    todo = table_tasks(worlds, seed=3, runs=range(1, 3))

    with cluster.dask(address) as executor:
        remote = list(in_order(executor, simulate, todo))
    with processes(2) as executor:
        local = list(in_order(executor, simulate, todo))

    for a, b in zip(remote, local, strict=True):
        assert a.keys() == b.keys()
        for name in a:
            assert_array_equal(np.hstack([*a[name].poses.values()]),
                               np.hstack([*b[name].poses.values()]))
            assert_array_equal(a[name].landmarks, b[name].landmarks)


@pytest.mark.slow
def test_a_run_that_ends_each_worker_ends_after_the_earlier_results(address):
    finished = []

    with pytest.raises(UserError, match='of the Dask cluster'), cluster.dask(address) as executor:
        finished.extend(in_order(executor, die_at_2, range(4)))

    assert finished == [0, 1]


def test_an_address_without_a_scheduler_is_rejected():
    with pytest.raises(UserError, match='no Dask scheduler answers at nonsense'), cluster.dask(
        'nonsense'
    ):
        pass
