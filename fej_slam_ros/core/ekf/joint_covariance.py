# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The joint covariance in either of its two forms: of all states, or of an active submap."""

from collections.abc import Iterator, Sequence
from copy import deepcopy

import numpy as np

from fej_slam_ros.core.ekf.compressed_covariance import CompressedCovariance, MAX_DIRECT
from fej_slam_ros.core.ekf.covariance import Covariance, joint_indices, Slot
from fej_slam_ros.core.geometry import Array

#: The two forms of the joint covariance, with the same methods for the filter's steps.
JointCovariance = Covariance | CompressedCovariance


def reserve(covariance: JointCovariance, sizes: Sequence[int]) -> None:
    """Provide storage for variables of some sizes that will be added, which changes no bit."""
    for matrix in covariance.matrices:
        matrix.reserve(sizes)


def lower_rows(covariance: JointCovariance, slots: Sequence[Slot]) -> Iterator[Array]:
    """Yield the rows of the lower triangle of `marginal`, without making the whole matrix."""
    indices = joint_indices(slots)
    if isinstance(covariance, CompressedCovariance):
        if len(indices) ** 2 * covariance.matrices[-1].dimension <= MAX_DIRECT:
            for i, row in enumerate(covariance.marginal(slots)):
                yield row[:i + 1]
            return
        covariance, _ = deepcopy(covariance).leave(np.zeros(covariance.dimension))
    matrix = covariance.matrix.settled()
    for i, row in enumerate(indices):
        yield matrix.at(row, indices[:i + 1])
