# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How often what had no identity was taken for the right landmark, where somebody knows it."""

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import replace

from fej_slam_ros.core.records import NO_ID, Scan


class AssociationScore:
    """
    What the numbers that an estimator gives stand for.

    A number stands for the landmark of which most observations with it are. A match is an observation
    with a number that another had before; it is false where the two landmarks differ. What not
    even the truth can name is left out.

    """

    def __init__(self) -> None:
        self._names: dict[tuple[str, int, bytes], int] = {}
        self._seen: defaultdict[int, list[int]] = defaultdict(list)

    def unnamed(self, scan: Scan) -> Scan:
        """Return a scan without identities, and remember them."""
        self._names |= {
            (scan.robot, scan.stamp, s.z.tobytes()): s.id for s in scan.observations}
        return replace(scan, observations=tuple(replace(s, id=NO_ID) for s in scan.observations))

    def add(self, numbered: Iterable[Scan]) -> None:
        """Take in scans with the numbers that an estimator gave."""
        for scan in numbered:
            for s in scan.observations:
                name = self._names[scan.robot, scan.stamp, s.z.tobytes()]
                if name != NO_ID:
                    self._seen[s.id].append(name)

    def count(self) -> int:
        """Return how many matches there were."""
        return sum(len(names) - 1 for names in self._seen.values())

    def false(self) -> int:
        """Return how many of them were false."""
        return sum(
            len(names) - Counter(names).most_common(1)[0][1] for names in self._seen.values())

    def landmarks(self, numbers: Iterable[int]) -> Counter[int]:
        """Return how many of some numbers stand for each landmark, `NO_ID` for those of none."""
        return Counter(
            Counter(self._seen[n]).most_common(1)[0][0] if n in self._seen else NO_ID
            for n in numbers)
