# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The hash depends on every bit of the estimate, and not on how it is stored."""

from itertools import permutations

import numpy as np
import pytest

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.state import JointState, Landmark, Robot
from fej_slam_ros.core.ekf.state_hash import state_hash
from fej_slam_ros.core.records import RendezvousKey

ROBOTS = ('r1', 'r2')
#: Two robots with their stamps, two landmarks with whose numbers they are; 10 states in all.
VARIABLES = (('r1', 700), ('r2', 800), ('', 4), ('', 9))
PLACES = (slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 10))

X_HAT = np.arange(1.0, 11.0)
X_FIRST = np.arange(1.5, 11.5)
P = np.diag(np.arange(20.0, 30.0)) + np.outer(X_HAT, X_HAT) / 64.0


def joint_state(variables=VARIABLES, x_hat=X_HAT, x_first=X_FIRST, P=P, order=(0, 1, 2, 3)):
    """Return a state whose variables have their slots in the order given."""
    indices = np.concatenate([np.arange(10)[PLACES[i]] for i in order])
    covariance = Covariance()
    sizes = [PLACES[i].stop - PLACES[i].start for i in order]
    slots = dict(zip(order, covariance.insert(P[np.ix_(indices, indices)]).split(sizes)))
    robots = [Robot(*variables[i][:1], slots[i], variables[i][1]) for i in order if i < 2]
    landmarks = [Landmark(variables[i], slots[i], 'r1', 0) for i in order if i >= 2]
    return JointState([*robots, *landmarks], x_hat[indices], x_first[indices], covariance)


def hash_of(robots=ROBOTS, frame='map', **changes):
    return state_hash({frame: joint_state(**changes)}, robots)


def with_last_bit_changed(array, *index):
    changed = array.copy()
    changed[index] = np.nextafter(changed[index], np.inf)
    return changed


def test_equal_states_have_equal_hashes_of_256_bits():
    assert hash_of() == hash_of()
    assert len(bytes.fromhex(hash_of())) == 32


@pytest.mark.parametrize('order', [*permutations(range(4))])
def test_the_hash_does_not_depend_on_the_order_of_the_slots(order):
    assert hash_of(order=order) == hash_of()


def test_the_last_bit_of_every_estimate_changes_the_hash():
    hashes = {hash_of(x_hat=with_last_bit_changed(X_HAT, i)) for i in range(10)}
    hashes |= {hash_of(x_first=with_last_bit_changed(X_FIRST, i)) for i in range(10)}

    assert len(hashes | {hash_of()}) == 21


def test_the_last_bit_of_every_covariance_changes_the_hash():
    lower = zip(*np.tril_indices(10))

    hashes = {hash_of(P=with_last_bit_changed(P, i, j)) for i, j in lower}

    assert len(hashes | {hash_of()}) == 56


def test_negative_zero_is_not_zero():
    zero = X_HAT * (np.arange(10) != 4)
    negative = np.where(np.arange(10) == 4, -0.0, X_HAT)

    assert hash_of(x_hat=zero) != hash_of(x_hat=negative)


@pytest.mark.parametrize('variables', [
    (('r1', 701), ('r2', 800), ('', 4), ('', 9)),
    (('r1', 700), ('r2', 801), ('', 4), ('', 9)),
    (('r1', 700), ('r2', 800), ('', 5), ('', 9)),
    (('r1', 700), ('r2', 800), ('', -4), ('', 9)),
    (('r1', 700), ('r2', 800), ('', 4), ('r1', 9)),
    (('r1', 700), ('r2', 800), ('', 4), ('r2', 9)),
])
def test_every_stamp_and_identity_changes_the_hash(variables):
    assert hash_of(variables=variables) != hash_of()


def test_names_change_the_hash():
    renamed = (('r1', 700), ('r3', 800), ('', 4), ('', 9))

    assert hash_of(variables=renamed, robots=('r1', 'r3')) != hash_of()
    assert hash_of(frame='r1/map') != hash_of()


def test_every_frame_is_part_of_the_hash():
    alone = JointState()
    alone.insert_robot('r3', 900, np.zeros(3), np.zeros((3, 3)))
    frames, robots = {'map': joint_state(), 'r3/map': alone}, (*ROBOTS, 'r3')
    before = state_hash(frames, robots)

    alone.move(alone.robots['r3'], 900, np.array([0.0, 0.0, 1e-300]))

    assert len({before, state_hash(frames, robots), hash_of(robots)}) == 3


@pytest.mark.parametrize('changes', [
    {'observer': 'r2'}, {'observed': 'r4'}, {'stamp': 6}, {'x': 1.5}, {'sigma': 0.2}])
def test_every_part_of_a_rendezvous_point_changes_the_hash(changes):
    def hash_with(observer='r1', observed='r3', stamp=5, x=1.0, sigma=0.1):
        state = joint_state()
        state.augment_rendezvous_point(
            RendezvousKey(observer, observed, stamp), state.robots['r1'], np.array([x, 2.0]),
            np.eye(2, 3),
            sigma**2 * np.eye(2))
        return state_hash({'map': state}, ROBOTS)

    assert hash_with(**changes) != hash_with()


def test_the_hash_does_not_depend_on_the_order_of_rendezvous_points():
    hashes = set()
    for stamps in ((5, 6), (6, 5)):
        state = joint_state()
        for stamp in stamps:
            state.augment_rendezvous_point(
                RendezvousKey('r1', 'r3', stamp), state.robots['r1'], np.array([stamp, 2.0]),
                np.eye(2, 3), stamp * np.eye(2))
        hashes.add(state_hash({'map': state}, ROBOTS))

    assert len(hashes) == 1


def test_a_team_without_input_has_a_hash():
    assert state_hash({'map': JointState()}, ROBOTS) != hash_of()
