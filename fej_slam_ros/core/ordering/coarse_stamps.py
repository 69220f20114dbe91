# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps of messages in steps that are longer than their period, as whole seconds at 10 Hz."""

import numpy as np

from fej_slam_ros.core.geometry import Array, Stamps

#: Minimum mean number of messages at a stamp.
MIN_MESSAGES = 1.5
#: Largest share of the motion from stamp to stamp that remains after the last message at each. It
#: is 1 / n where a robot drives on through n messages, and about 1 or more where one message is
#: repeated, or where two nodes or sensors send one each.
MAX_REMAINING = 0.75


def coarse_step(stamps: Stamps, positions: Array) -> float | None:
    """
    Return the usual step [ns] of stamps within which positions move on from message to message.

    The stamps (n,) [ns] and positions (n, d), by odometry or of what is observed, are in the order
    of recording. None if there is no such step, as where most stamps differ.

    """
    order = np.argsort(stamps, kind='stable')
    positions = positions[order]
    times, first = np.unique(stamps[order], return_index=True)
    if len(times) < 2 or len(stamps) < MIN_MESSAGES * len(times):
        return None
    begins, ends = positions[first], positions[first[1:] - 1]
    remaining = np.nansum(np.linalg.norm(begins[1:] - ends, axis=1))
    driven = np.nansum(np.linalg.norm(np.diff(begins, axis=0), axis=1))
    return float(np.median(np.diff(times))) if remaining < MAX_REMAINING * driven else None
