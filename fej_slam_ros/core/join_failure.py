# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result of an attempt to join two frames or maps that failed."""

from dataclasses import dataclass

from fej_slam_ros.core.records import RendezvousKey


@dataclass(frozen=True, slots=True)
class JoinFailure:
    """
    Reason why two frames or maps were not joined.

    Attributes
    ----------
    reason : sentence for users
    robots : names of the robots concerned, where these are known to the method that joins
    outlier : rendezvous observation that contradicts the rest, None if no single one does
    d2 : decrease of chi-square if the outlier is left out

    """

    reason: str
    robots: tuple[str, ...] = ()
    outlier: RendezvousKey | None = None
    d2: float = 0.0
