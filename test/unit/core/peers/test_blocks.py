# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measurements as bytes: exact, and rejected where they are none."""

from dataclasses import fields
import zlib

import numpy as np
import pytest

from fej_slam_ros.core.geometry import rotation
from fej_slam_ros.core.peers.blocks import BadBlockError, decoded, encoded, MAX_CONTENT
from fej_slam_ros.core.records import Observation, Odometry, RobotObservation, RobotScan, Scan
from fej_slam_ros.ros.messages.incoming_clouds import observation_faults

R = np.array([[0.04, 0.01], [0.01, 0.02]])


def measurements():
    rng = np.random.default_rng(0)
    return [
        Odometry('p', 10**18, rng.normal(size=3), None),
        Odometry('p', 10**18 + 7, rng.normal(size=3), np.diag([1e-3, 2e-3, 1e-5])),
        Scan('p', 10**18 + 7, tuple(
            Observation(k, rng.normal(size=2), R) for k in (0, 5, 2**31 - 1))),
        Scan('p', 10**18 + 9, ()),
        RobotScan('p', 10**18 + 3, (
            RobotObservation('q', rng.normal(size=2), R),
            RobotObservation('robot_7', rng.normal(size=2), 2.0 * R))),
    ]


def plain(record):
    """Return all values of a record, to the last bit."""
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    return type(record), {
        name: value.tobytes() if isinstance(value, np.ndarray)
        else tuple(map(plain, value)) if isinstance(value, tuple) else value
        for name, value in values.items()}


def test_measurements_keep_every_bit_and_their_order():
    given = measurements()

    assert [*map(plain, decoded(encoded(given), 'p'))] == [*map(plain, given)]


def test_no_measurements_are_a_block_too():
    assert decoded(encoded([]), 'p') == []


@pytest.mark.parametrize('bad', [
    [Odometry('p', 1, np.array([0.0, np.nan, 0.0]), None)],
    [Odometry('p', 1, np.array([0.0, 1e300, 0.0]), None)],
    [Odometry('p', -1, np.zeros(3), None)],
    [Odometry('p', 2**62, np.zeros(3), None)],
    [Odometry('p', 1, np.zeros(3), np.diag([1.0, -1.0, 1.0]))],
    [Scan('p', 1, (Observation(3, np.array([np.inf, 0.0]), R),))],
    [Scan('p', 1, (Observation(3, np.zeros(2), np.array([[1.0, 0.5], [0.0, 1.0]])),))],
    [Scan('p', 1, (Observation(3, np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]])),))],
    [Scan('p', 1, (Observation(-1, np.zeros(2), R),))],
    [RobotScan('p', 1, (RobotObservation('p', np.zeros(2), R),))],
])
def test_what_no_robot_measures_is_rejected(bad):
    with pytest.raises(BadBlockError):
        decoded(encoded(bad), 'p')


def test_every_shorter_or_longer_content_is_rejected():
    content = zlib.decompress(encoded(measurements()))

    for wrong in [content[:k] for k in range(len(content))] + [content + b'\0']:
        with pytest.raises(BadBlockError):
            decoded(zlib.compress(wrong), 'p')


def test_random_bytes_are_rejected():
    rng = np.random.default_rng(1)
    for size in range(200):
        for data in (rng.bytes(size), zlib.compress(rng.bytes(size))):
            with pytest.raises(BadBlockError):
                decoded(data, 'p')


def test_a_small_block_cannot_fill_the_memory():
    with pytest.raises(BadBlockError):
        decoded(zlib.compress(bytes(100 * MAX_CONTENT)), 'p')


def test_every_observation_that_a_robot_accepts_can_be_read_by_others():
    """Also of a bearing with almost unknown range, turned into the base frame."""
    rng = np.random.default_rng(2)
    accepted = 0
    for _ in range(2_000):
        C, sensor = (rotation(angle) for angle in rng.uniform(-np.pi, np.pi, 2))
        variances = 10.0 ** np.array([12.0, -2.0 + rng.uniform(-1.0, 1.0)])
        in_sensor = C @ np.diag(variances * 10.0 ** rng.uniform(-12.0, 0.0)) @ C.T
        in_sensor[1, 0] = in_sensor[0, 1]
        if observation_faults(np.ones((1, 2)), in_sensor[None]) != [None]:
            continue
        accepted += 1
        decoded(encoded([Scan('p', 1, (
            Observation(3, np.ones(2), sensor @ in_sensor @ sensor.T),))]), 'p')
    assert accepted > 500

    largest = 1e12 * np.array([[1.0, 0.99], [0.99, 1.0]])
    turned = rotation(np.pi / 4.0) @ largest @ rotation(np.pi / 4.0).T
    decoded(encoded([Scan('p', 1, (Observation(3, np.ones(2), turned),))]), 'p')
