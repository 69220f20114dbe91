# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
from mypy import api
import numpy as np
import pytest

from helpers.paths import ROOT



@pytest.mark.linter
@pytest.mark.skipif(
    np.lib.NumpyVersion(np.__version__) < '2.4.0', reason='older numpy is typed differently',
)
def test_every_function_is_typed_and_right():
    report, errors, status = api.run(
        ['--config-file', str(ROOT / 'setup.cfg'), str(ROOT / 'fej_slam_ros'),
         str(ROOT / 'docs' / 'generate.py')]
    )

    assert status == 0, report + errors
