# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages for an alignment are sufficient, and their sizes as expected."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.base_node import align
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.message_sizes import (
    log_message, map_message, sizes, smallest, subset_message)
from helpers.csam import in_another_frame, Met, rendezvous_of, with_exact_odometry
from helpers.messages import received

MET = [(0, 1, k) for k in range(3, 9)]


def rendezvous_poses(team, robot):
    """Return the indices of a robot's rendezvous poses."""
    return np.unique([
        m.pose if m.observer == robot else m.observed_pose for m in team.measurements])


@pytest.mark.parametrize(
    ('form', 'message'), [('subset', subset_message), ('log', log_message), ('map', map_message)])
@pytest.mark.parametrize('frame', [[0.0, 0.0, 0.0], [40.0, -20.0, 2.0]])
def test_every_form_gives_the_base_node_of_the_complete_maps(form, message, frame):
    team = Met(1, [(0, 1, 0), *MET])
    maps = [team.maps[0], in_another_frame(team.maps[1], np.array(frame))]
    p, q, observations = rendezvous_of(maps, team.measurements)
    expected = align(p, q, observations)

    sent = message(JointMap.of(maps[1]), rendezvous_poses(team, 'r2'))
    found = align(p, received(form, sent), observations)

    # Rounding of P^-1, whose eigenvalues span eight orders of magnitude.
    assert_allclose(found.base_node.pose, expected.base_node.pose, atol=1e-6)
    assert_allclose(found.base_node.P, expected.base_node.P, rtol=1e-4, atol=1e-9)
    assert found.chi_square == pytest.approx(expected.chi_square, rel=1e-6)


def test_the_subset_is_smallest_for_a_short_rendezvous():
    team = Met(2, MET, steps=40)

    messages = sizes(team.maps, team.measurements)['r2', 'r1']

    assert smallest(messages) == 'subset'
    # Six poses and the start: 18 (18 + 1) / 2 entries of R_sqrt and 7 x 3 of poses; an origin,
    # two rows, and headers.
    assert messages['subset'] == pytest.approx(8 * (171 + 21), abs=100)
    assert messages['subset'] < messages['log'] < messages['map']


def test_the_log_is_smallest_for_a_long_rendezvous():
    team = Met(3, [(0, 1, k) for k in range(41)], steps=40)

    messages = sizes(team.maps, team.measurements)['r2', 'r1']

    assert smallest(messages) == 'log'


def test_a_robot_with_singular_information_sends_nothing_and_the_others_do():
    team = Met(4, MET)
    expected = sizes(team.maps, team.measurements)

    found = sizes([team.maps[0], with_exact_odometry(team.maps[1])], team.measurements)

    assert found == {('r1', 'r2'): expected['r1', 'r2']}
