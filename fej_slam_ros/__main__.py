# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m fej_slam_ros VERB`` is ``fej_slam VERB``."""

import sys

from fej_slam_ros.cli.main import main

sys.exit(main())
