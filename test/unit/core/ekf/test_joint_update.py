# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Updates of many observations in blocks: those of the joint update, at a bounded cost."""

from copy import deepcopy
from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.ekf import first_estimates, joint_update
from fej_slam_ros.core.ekf.active_submap import ActiveSubmap
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import RenewedFirstEstimates
from fej_slam_ros.core.pieces import between_pieces
from helpers.core import SmallTeam

#: Rounding of sums of some hundred terms, relative to the largest.
ROUNDING = 1e-12


def known_map(kind, iterations, landmarks=24, noise=1.0, robots=2):
    """Return a team that knows all landmarks, and its filter."""
    team = SmallTeam(seed=3, robots=robots, landmarks=landmarks, noise=noise)
    filter_ = team.start(kind, iterations=iterations)
    for stamp in (1, 2):
        team.step(filter_, stamp, team.names, team.names)
    return team, filter_


def divided(monkeypatch, size):
    """Divide updates into blocks of a size."""
    for name in ('MAX_JOINT_OBSERVATIONS', 'MAX_BLOCK_OBSERVATIONS', 'MIN_BLOCK_OBSERVATIONS'):
        monkeypatch.setattr(joint_update, name, size)


def in_both_ways(monkeypatch, filter_, scans, block):
    """Return the filter and the innovation of a joint update, and of one in blocks."""
    results = []
    for size in (10_000, block):
        divided(monkeypatch, size)
        copy = deepcopy(filter_)
        results.append((copy, copy.update(copy.start_landmarks(scans))))
    return results


def marginal(filter_):
    return filter_.state.marginal(filter_.state.variables())


def assert_same(joint, blocks):
    (a, of_a), (b, of_b) = joint, blocks
    assert_allclose(b.state.estimates(), a.state.estimates(), rtol=0, atol=ROUNDING * 10)
    assert_allclose(marginal(b), marginal(a), rtol=0, atol=ROUNDING)
    assert_allclose(of_b.y, of_a.y, rtol=0, atol=ROUNDING * 100)
    assert_allclose(of_b.log_det, of_a.log_det, rtol=ROUNDING)
    assert [o.observation.id for o in of_b.used] == [o.observation.id for o in of_a.used]


@pytest.mark.parametrize('block', [1, 7, 16, 47])
@pytest.mark.parametrize(('kind', 'iterations'), [
    ('standard', 1), ('fej', 1), ('fej', 3), ('ideal', 1), ('invariant', 1), ('invariant', 3)])
def test_blocks_give_the_joint_update(monkeypatch, kind, iterations, block):
    team, filter_ = known_map(kind, iterations)
    scans = [team.look(name) for name in team.names]

    joint, blocks = in_both_ways(monkeypatch, filter_, scans, block)

    assert_same(joint, blocks)


def test_blocks_are_iterated_and_renew_first_estimates_as_the_joint_update_does(monkeypatch):
    team, filter_ = known_map('fej', 1)
    filter_.linearization = RenewedFirstEstimates()
    # Less than any correction and any distance from a first estimate.
    monkeypatch.setattr(RenewedFirstEstimates, 'max_correction', 0.0)
    monkeypatch.setattr(first_estimates, 'MAX_DISPLACED', 0.0)

    joint, blocks = in_both_ways(monkeypatch, filter_, [team.look('r1')], 7)

    first = joint[0].state.x_first
    assert np.count_nonzero(first != filter_.state.x_first) > 20
    assert_allclose(blocks[0].state.x_first, first, rtol=0, atol=ROUNDING * 10)
    assert_same(joint, blocks)


def test_blocks_gate_as_the_joint_update_does(monkeypatch):
    team, filter_ = known_map('fej', 1, noise=2.5)
    filter_.gate = Gate(0.9)
    scans = [team.look(name) for name in team.names]

    joint, blocks = in_both_ways(monkeypatch, filter_, scans, 5)

    rejected = [[(g.association.observation.id, round(g.d2, 9)) for g in innovation.rejected]
                for _, innovation in (joint, blocks)]
    assert 3 < len(rejected[0]) < 45
    assert rejected[0] == rejected[1]
    assert_same(joint, blocks)


def test_blocks_in_a_submap_give_its_joint_update(monkeypatch):
    team, filter_ = known_map('fej', 1, landmarks=60)
    filter_.submap = ActiveSubmap(0, 3)
    scans = [team.look('r1', range(8))]

    joint, blocks = in_both_ways(monkeypatch, filter_, scans, 3)

    whole, core = blocks[0].state.covariance.matrices
    assert core.dimension < whole.dimension
    assert_same(joint, blocks)


def test_an_update_that_ends_early_is_that_of_the_first_observations(monkeypatch):
    team, filter_ = known_map('fej', 1)
    scan = team.look('r1')
    divided(monkeypatch, 4)
    whole = deepcopy(filter_)
    expected = whole.update(whole.start_landmarks([scan])[:8])
    pauses = iter([False, True])

    with between_pieces(lambda: None, lambda: next(pauses)):
        innovation = filter_.update(filter_.start_landmarks([scan]))

    assert [a.observation.id for a in innovation.interrupted] == [*range(8, 24)]
    assert_allclose(filter_.state.x_hat, whole.state.x_hat, rtol=0, atol=ROUNDING)
    assert_allclose(innovation.y, expected.y, rtol=0, atol=100 * ROUNDING)


def test_iterations_that_end_early_leave_the_estimate_as_it_was(monkeypatch):
    team, filter_ = known_map('invariant', 3)
    before, P = filter_.state.x_hat.copy(), marginal(filter_)
    divided(monkeypatch, 4)

    with between_pieces(lambda: None, lambda: True):
        innovation = filter_.update(filter_.start_landmarks([team.look('r1')]))

    assert len(innovation.interrupted) == 24
    assert (filter_.state.x_hat == before).all()
    assert (marginal(filter_) == P).all()


def test_a_block_is_a_bounded_piece_of_work():
    sizes = {
        n: joint_update.block_size(SimpleNamespace(matrices=[SimpleNamespace(dimension=n)]))
        for n in (100, 3000, 10_000)}

    assert sizes[100] == joint_update.MAX_BLOCK_OBSERVATIONS
    assert 2 * sizes[3000] * 3000 ** 2 <= joint_update.PIECE_FLOPS
    assert sizes[10_000] == joint_update.MIN_BLOCK_OBSERVATIONS


def test_observations_of_few_landmarks_by_many_robots_are_one_update(monkeypatch):
    team, filter_ = known_map('standard', 1, landmarks=3, robots=6)
    scans = [team.look(name) for name in team.names]

    joint, blocks = in_both_ways(monkeypatch, filter_, scans, 4)

    assert len(joint[1].used) == 18
    assert_same(joint, blocks)
