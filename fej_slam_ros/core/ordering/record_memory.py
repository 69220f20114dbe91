# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognition of records that were received before."""

from collections.abc import Callable
import sys
from typing import NamedTuple

from fej_slam_ros.core.records import AnyScan, fingerprint, Odometry, PosePrior

#: Maximum number of stamps and kinds whose records are remembered, per robot: at 100 messages per
#: second the last 100 s. Beyond them a repeated record is late, not a duplicate.
MAX_REMEMBERED = 10_000


class RecordIdentity(NamedTuple):
    """Kind, stamp [ns] and fingerprint of the content of a record."""

    kind: str
    stamp: int
    content: int


def identity(record: Odometry | AnyScan | PosePrior) -> RecordIdentity:
    """Return the identity of a record; equal exactly for duplicates."""
    return RecordIdentity(type(record).__name__, record.stamp, fingerprint(record))


class RecordMemory:
    """The newest records of one robot, by their identities."""

    def __init__(self) -> None:
        self.forgotten = -sys.maxsize  #: newest stamp of a record that was forgotten [ns]
        # Almost always one, of which a tuple takes a quarter of a set's memory.
        self._contents: dict[tuple[str, int], tuple[int, ...]] = {}

    def contains(self, record: RecordIdentity) -> bool:
        """Return whether the same record was received before."""
        return record.content in self._contents.get(record[:2], ())

    def contains_stamp(self, record: RecordIdentity) -> bool:
        """Return whether a record of the same kind and stamp was received before."""
        return record[:2] in self._contents

    def add(self, record: RecordIdentity, may_forget: Callable[[int], bool]) -> None:
        """
        Remember a record, and forget the oldest beyond `MAX_REMEMBERED`.

        Parameters
        ----------
        record : identity of the record
        may_forget : whether a record of a stamp may be forgotten; waiting records may not, or
            their duplicates would be used as well

        """
        contents = self._contents.get(record[:2], ())
        if record.content not in contents:
            self._contents[record[:2]] = (*contents, record.content)
        for _ in range(min(len(self._contents) - MAX_REMEMBERED, 2)):
            oldest = next(iter(self._contents))
            contents = self._contents.pop(oldest)
            if may_forget(oldest[1]):
                self.forgotten = max(oldest[1], self.forgotten)
            else:
                self._contents[oldest] = contents

    def remove(self, record: RecordIdentity) -> None:
        """Forget a record that was not used after all."""
        contents = self._contents.get(record[:2], ())
        others = tuple(content for content in contents if content != record.content)
        if others:
            self._contents[record[:2]] = others
        else:
            self._contents.pop(record[:2], None)
