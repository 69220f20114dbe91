# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What holds for the tests of verbs."""

import pytest

from helpers.ros import write_parameters


@pytest.fixture
def places(tmp_path):
    """Return where the bag, the parameters and the results are, the parameters being there."""
    return tmp_path / 'in', write_parameters(tmp_path / 'params.yaml'), tmp_path / 'out'
