# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is sent for an alignment is enough for it, and no more than needed."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.base_node import align
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.csam.message_sizes import FORMS, forms, received, sizes, smallest
from helpers.csam import in_another_frame, Met, rendezvous_of

MET = [(0, 1, k) for k in range(3, 9)]


def numbers_of(team, robot):
    """Return the numbers of the poses of a robot that met."""
    return np.unique([
        met.pose if met.observer == robot else met.observed_pose for met in team.meetings])


@pytest.mark.parametrize('form', FORMS)
@pytest.mark.parametrize('frame', [[0.0, 0.0, 0.0], [40.0, -20.0, 2.0]])
def test_every_form_leads_to_the_base_node_of_the_maps_themselves(form, frame):
    team = Met(1, [(0, 1, 0), *MET])
    maps = [team.maps[0], in_another_frame(team.maps[1], np.array(frame))]
    p, q, sighted = rendezvous_of(maps, team.meetings)
    expected = align(p, q, sighted)

    sent = forms(JointMap.of(maps[1]), numbers_of(team, 'r2'))[form]
    found = align(p, received(form, sent), sighted)

    # Rounding in P^-1, whose eigenvalues span eight orders of magnitude.
    assert_allclose(found.base_node.pose, expected.base_node.pose, atol=1e-6)
    assert_allclose(found.base_node.P, expected.base_node.P, rtol=1e-4, atol=1e-9)
    assert found.chi_square == pytest.approx(expected.chi_square, rel=1e-6)


def test_for_a_short_meeting_the_poses_that_met_are_least():
    team = Met(2, MET, steps=40)

    messages = sizes(team.maps, team.meetings)['r2', 'r1']

    assert smallest(messages) == 'subset'
    # Six poses and the start: 18 (18 + 1) / 2 numbers of R_sqrt and 7 x 3 of poses; an origin,
    # two rows, and some text between.
    assert messages['subset'] == pytest.approx(8 * (171 + 21), abs=100)
    assert messages['subset'] < messages['log'] < messages['map']


def test_for_a_long_meeting_the_log_is_least():
    team = Met(3, [(0, 1, k) for k in range(41)], steps=40)

    messages = sizes(team.maps, team.meetings)['r2', 'r1']

    assert smallest(messages) == 'log'
