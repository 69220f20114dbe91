# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Command line: one module for each verb, run by `main`.

Shared parts: `arguments` (options), `bag_input` (messages of a bag), `offline_run` (bag in, files
out), `monte_carlo` (many runs), `run_table` (table of a run), and `converters` of data sets.
"""

import os

# Repeatable to the bit: with several threads the order of BLAS sums depends on timing. BLAS reads
# these variables when numpy is imported, so that nothing above may import numpy.
os.environ.update(OPENBLAS_NUM_THREADS='1', OMP_NUM_THREADS='1', MKL_NUM_THREADS='1')
