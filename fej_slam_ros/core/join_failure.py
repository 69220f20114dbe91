# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result of an attempt to join two frames or maps that failed."""

from dataclasses import dataclass

from fej_slam_ros.core.records import LandmarkKey, RendezvousKey


@dataclass(frozen=True, slots=True)
class JoinFailure:
    """Reason why two frames or maps were not joined."""

    reason: str  #: sentence for users
    #: names of the robots concerned, where these are known to the method that joins
    robots: tuple[str, ...] = ()
    #: rendezvous observation that contradicts the rest, None if no single one does
    outlier: RendezvousKey | None = None
    d2: float = 0.0  #: decrease of chi-square if the outlier is left out
    #: shared landmarks that contradict the others, which fit
    outlying_landmarks: tuple[LandmarkKey, ...] = ()

    def has_outliers(self) -> bool:
        """Return whether the maps may join without the outliers."""
        return self.outlier is not None or bool(self.outlying_landmarks)
