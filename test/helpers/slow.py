# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of tests that `make test` leaves out."""

import pytest


def slow(*values):
    """Return the parameters of a case that runs in `make test-all` only."""
    return pytest.param(*values, marks=pytest.mark.slow)
