# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The executables: one small module a verb."""

import os

# Same input, same bits: with more than one thread BLAS adds in an order that depends on timing.
# It reads these when numpy is imported, so nothing above may import numpy.
os.environ.update(OPENBLAS_NUM_THREADS='1', OMP_NUM_THREADS='1', MKL_NUM_THREADS='1')
