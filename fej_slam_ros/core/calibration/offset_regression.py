# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Regression of planar vectors, as complex numbers, by others that are turned, scaled and offset.

In b = c a + g o + noise, c turns and scales the vectors a, and an offset o is where on a robot is
the point that a motion-capture system locates. Where the data do not tell both apart, as on
circles about one centre, a prior of the offset keeps c uncertain.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.calibration.scales_of_errors import inliers, noise_scale
from fej_slam_ros.core.geometry import Array, Flags

Complex = NDArray[np.complex128]

#: Standard deviation of a coordinate of the offset [m].
OFFSET_SIGMA = 0.2
#: Maximum number of fits, each without the outliers of the last one.
MAX_FITS = 20


class Regression(NamedTuple):
    """Turn and scale of vectors."""

    c: complex
    relative: Complex  #: (n,) array, relative error of c by each vector, 0 of outliers
    sigma: float  #: relative standard error of c, in each part, if errors are independent


def regression(
    equations: Callable[[Flags], tuple[Complex, Complex]], weights: Array
) -> Regression | None:
    """
    Return c by least squares without outliers, None if all a or all b are 0.

    Parameters
    ----------
    equations : returns [a] or [a, g], a (n, 1) or (n, 2) array, and b (n,), given those vectors
        that are no outliers
    weights : (n,) array, inverse of the variance of a coordinate, up to a common factor

    """
    now, kept, scale, root = np.ones(len(weights), bool), np.zeros(0, bool), 1.0, np.sqrt(weights)
    for _ in range(MAX_FITS):
        if np.array_equal(now, kept):
            break
        kept = now
        A, b = equations(kept)
        A, b = root[:, None] * A, root * b
        if not (A[:, 0].any() and b.any()):
            return None
        prior = scale / OFFSET_SIGMA * np.eye(A.shape[1])[1:]
        N = np.linalg.pinv(np.vstack([A[kept], prior]))
        x = N @ np.append(b[kept], np.zeros(len(prior)))
        e = b - A @ x
        squared = np.abs(e) ** 2
        now, scale = inliers(squared), noise_scale(squared.tolist(), 2).scale
    relative = np.zeros(len(weights), complex)
    relative[kept] = N[0, :np.count_nonzero(kept)] * e[kept] / x[0]
    return Regression(complex(x[0]), relative, scale * float(np.linalg.norm(N[0]) / abs(x[0])))
