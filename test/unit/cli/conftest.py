# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of verbs."""

import pytest

from helpers.ros import write_parameters


@pytest.fixture
def places(tmp_path):
    """Return the paths of bag, parameter file (which exists) and results."""
    return tmp_path / 'in', write_parameters(tmp_path / 'params.yaml'), tmp_path / 'out'
