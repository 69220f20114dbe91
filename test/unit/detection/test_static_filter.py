# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What stays is a landmark; what moves is none."""

import numpy as np

from fej_slam_ros.core.records import NS
from fej_slam_ros.detection.static_filter import StaticFilter

R = np.diag([0.02**2, 0.02**2])[None]
CERTAIN = np.array([True])
ORIGIN = np.zeros(2)


def passed(track, seed=0):
    """Return whether a point that follows a track (stamps [s], positions) passes, at each scan."""
    rng, static = np.random.default_rng(seed), StaticFilter(round(0.8 * NS))
    return [
        bool(static.are_static(
            round(t * NS), p[None] + rng.normal(0.0, 0.02, (1, 2)), R, CERTAIN, ORIGIN)[0])
        for t, p in track]


def test_a_landmark_passes_as_soon_as_it_was_seen_for_long_enough():
    times = np.arange(30) / 10.0

    results = [passed([(t, np.array([3.0, 1.0])) for t in times], seed) for seed in range(50)]

    # One observation in a hundred is outside of the gate.
    assert np.mean(results, axis=0)[:8].max() == 0.0
    assert np.mean(results, axis=0)[10:].mean() > 0.97


def test_a_person_who_walks_never_passes():
    for seed in range(50):
        track = [(t, np.array([3.0 + 0.8 * t, 1.0])) for t in np.arange(50) / 10.0]
        assert not any(passed(track, seed))


def test_a_leg_that_stands_for_half_a_second_never_passes():
    stances = [np.array([3.0 + 0.7 * k, 1.0]) for k in range(10)]
    track = [(k / 10.0, stances[k // 5]) for k in range(50)]

    assert not any(passed(track))


def test_a_landmark_that_was_hidden_passes_at_once_when_it_is_seen_again():
    post = np.array([3.0, 1.0])
    track = [(t, post) for t in [*np.arange(20) / 10.0, 5.0, 5.1]]

    assert passed(track)[-2:] == [True, True]


def test_half_a_post_counts_only_where_a_landmark_is_known():
    static, post = StaticFilter(round(0.8 * NS)), np.array([[3.0, 1.0]])
    unsure = np.array([False])

    assert not any(
        static.are_static(round(t * NS), post, R, unsure, ORIGIN)[0] for t in (0.0, 0.5, 1.0, 1.5))
    for t in np.arange(20, 40) / 10.0:
        static.are_static(round(t * NS), post, R, CERTAIN, ORIGIN)
    assert static.are_static(4 * NS, post, R, unsure, ORIGIN)[0]


def test_what_too_few_beams_meet_is_not_used_for_a_second():
    static, post, nothing = StaticFilter(0), np.array([[3.0, 1.0]]), np.empty((0, 2))
    certain, thin = [], []
    for k in range(30):
        stamp = k * NS // 10
        static.are_static(stamp, post, R, CERTAIN, ORIGIN)
        # Once by its own beams, and once by others beside its place.
        beside = post + np.array([0.1, 0.2]) if k == 16 else nothing
        thin.append(bool(static.are_thin(stamp, post, np.array([k == 4]), beside)[0]))
        certain.append(k)

    assert [k for k, is_thin in zip(certain, thin) if is_thin] == [*range(4, 14), *range(16, 26)]


def test_something_thin_elsewhere_changes_nothing():
    static, post = StaticFilter(0), np.array([[3.0, 1.0]])
    static.are_static(0, post, R, CERTAIN, ORIGIN)

    assert not static.are_thin(0, post, np.array([False]), post + np.array([0.5, 0.0]))[0]
