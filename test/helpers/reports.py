# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Entries of the tables of [Liu], and CSV lines as rows."""

import csv
from io import StringIO

ENTRIES = ['r1_nees', 'r1_pos', 'r1_head', 'r2_nees', 'r2_pos', 'r2_head', 'f_nees', 'f_pos']


def rows_of(lines):
    """Return the rows of a CSV file with these lines as dicts by column."""
    file = StringIO()
    csv.writer(file).writerows(lines)
    return list(csv.DictReader(StringIO(file.getvalue())))
