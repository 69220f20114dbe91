# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A pause begins where input has arrived before, and ends with the next input."""

import pytest

from fej_slam_ros.ros.nodes.input_pause import InputPause

SECOND = 1_000_000_000


def after_input():
    """Return a pause whose last input arrived at 100 s."""
    pause = InputPause()
    pause.receive(100 * SECOND)
    return pause


@pytest.mark.parametrize(('now', 'is_paused'), [
    (100, False), (101, False), (101.001, True), (99.95, False), (99.8, True), (0.001, True)])
def test_input_pauses_after_a_silence_and_where_the_clock_goes_back_by_more_than_jitter(
        now, is_paused):
    assert after_input().has_begun(round(now * SECOND), stale_after=1.0) is is_paused


def test_without_input_or_clock_there_is_no_pause():
    handled = after_input()
    handled.rest()

    assert not InputPause().has_begun(100 * SECOND, stale_after=1.0)
    assert not handled.has_begun(200 * SECOND, stale_after=1.0)
    assert not after_input().has_begun(None, stale_after=1.0)
    assert (InputPause().is_at_rest, handled.is_at_rest, after_input().is_at_rest) == (
        True, True, False)
