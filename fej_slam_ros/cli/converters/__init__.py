# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Converters of data sets, and of bags of single robots, to bags; one module each.

To add one: read the files in a sub-package of `datasets` that yields records and settings; write a
module here with a docstring and SUMMARY for the help, ``add_arguments(parser)``, which calls
`common.add_paths`, and ``convert(arguments)``, which calls `common.write`; add it to CONVERTERS of
`cli.convert`.
"""
