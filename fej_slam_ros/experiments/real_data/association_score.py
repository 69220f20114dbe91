# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rate of false associations of observations without IDs, by known data association."""

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import replace

from fej_slam_ros.core.matches import observation_key, ObservationKey
from fej_slam_ros.core.records import NO_ID, Scan


class AssociationScore:
    """
    Compares the landmark IDs that an estimator assigns with the true ones.

    An assigned ID stands for the true landmark of most observations with it. A match is an
    observation with an ID that an earlier one has; it is false if the two are of different
    landmarks. Observations without a true ID are ignored.
    """

    def __init__(self) -> None:
        self._true_ids: dict[ObservationKey, int] = {}
        self._assigned: defaultdict[int, list[int]] = defaultdict(list)

    def without_ids(self, scan: Scan) -> Scan:
        """Return a scan without IDs, and remember them."""
        self._true_ids |= {observation_key(scan, s): s.id for s in scan.observations}
        return replace(scan, observations=tuple(replace(s, id=NO_ID) for s in scan.observations))

    def add(self, scans: Iterable[Scan]) -> None:
        """Add scans with assigned IDs."""
        for scan in scans:
            for s in scan.observations:
                true_id = self._true_ids[observation_key(scan, s)]
                if true_id != NO_ID:
                    self._assigned[s.id].append(true_id)

    def count(self) -> int:
        """Return the number of matches."""
        return sum(len(true_ids) - 1 for true_ids in self._assigned.values())

    def false(self) -> int:
        """Return the number of false matches."""
        return sum(
            len(true_ids) - Counter(true_ids).most_common(1)[0][1]
            for true_ids in self._assigned.values())

    def landmarks(self, ids: Iterable[int]) -> Counter[int]:
        """Return the number of assigned IDs for each true landmark, `NO_ID` for unknown ones."""
        return Counter(
            Counter(self._assigned[id_]).most_common(1)[0][0] if id_ in self._assigned else NO_ID
            for id_ in ids)
