# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The entries of the paper's tables, and what a CSV file tells of them."""

import csv
from io import StringIO

ENTRIES = ['r1_nees', 'r1_pos', 'r1_head', 'r2_nees', 'r2_pos', 'r2_head', 'f_nees', 'f_pos']


def rows_of(lines):
    """Return what a CSV file of these lines holds, by the names of its columns."""
    file = StringIO()
    csv.writer(file).writerows(lines)
    return list(csv.DictReader(StringIO(file.getvalue())))
