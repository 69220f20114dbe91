# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long computations pause, and are told to end early."""

import numpy as np
import pytest

from fej_slam_ros.core.pieces import between_pieces, must_end, pause, ranges


def test_ranges_cover_all_items_with_a_pause_between_them():
    served = []

    with between_pieces(lambda: served.append(1)):
        covered = [np.arange(10)[part].tolist() for part in ranges(10, 4.9)]

    assert covered == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9]]
    assert len(served) == 2


def test_the_functions_of_the_innermost_context_are_called():
    assert not pause()
    with between_pieces(lambda: pytest.fail('outer'), lambda: False):
        with between_pieces(lambda: None, lambda: True):
            assert pause()
        assert not must_end()
