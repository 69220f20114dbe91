# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognition of records that were received before."""

from collections.abc import Callable
from itertools import islice
import sys
from typing import NamedTuple

from fej_slam_ros.core.records import (
    AnyScan, fingerprint, Odometry, PosePrior, RobotScan, Scan)

#: Maximum number of stamps and kinds whose records are remembered, per robot: at 100 messages per
#: second the last 100 s. Beyond them a repeated record is late, not a duplicate.
MAX_REMEMBERED = 10_000
#: Number of the oldest that are forgotten at once: finding the first key of a dict takes the
#: longer, the more keys were deleted before it.
FORGOTTEN_TOGETHER = 1_000

KINDS = (Odometry, Scan, RobotScan, PosePrior)


class RecordIdentity(NamedTuple):
    """Stamp and kind of a record as one number, and fingerprint of the content."""

    key: int
    content: int


def identity(record: Odometry | AnyScan | PosePrior) -> RecordIdentity:
    """Return the identity of a record; equal exactly for duplicates."""
    kind = KINDS.index(type(record))
    return RecordIdentity(record.stamp * len(KINDS) + kind, fingerprint(record))


def stamp_of(key: int) -> int:
    """Return the stamp [ns] in the key of an identity."""
    return key // len(KINDS)


class RecordMemory:
    """The newest records of one robot, by their identities."""

    def __init__(self) -> None:
        self.forgotten = -sys.maxsize  #: newest stamp of a record that was forgotten [ns]
        # The content of each key, the oldest first, and the further ones of a few keys: tens of
        # thousands of containers would fragment the memory at each checkpoint.
        self._contents: dict[int, int] = {}
        self._further: dict[int, tuple[int, ...]] = {}

    def contains(self, record: RecordIdentity) -> bool:
        """Return whether the same record was received before."""
        key, content = record
        return self._contents.get(key) == content or content in self._further.get(key, ())

    def contains_stamp(self, record: RecordIdentity) -> bool:
        """Return whether a record of the same kind and stamp was received before."""
        return record.key in self._contents

    def add(
        self, record: RecordIdentity, may_forget: Callable[[int], bool] = lambda _: True
    ) -> None:
        """
        Remember a new record, and forget the oldest well beyond `MAX_REMEMBERED`.

        `may_forget` returns whether records of a stamp may be forgotten; waiting ones may not, or
        their duplicates would be used as well.

        """
        key, content = record
        if self._contents.setdefault(key, content) != content:
            self._further[key] = (*self._further.get(key, ()), content)
        if len(self._contents) < MAX_REMEMBERED + FORGOTTEN_TOGETHER:
            return
        for oldest in [*islice(self._contents, FORGOTTEN_TOGETHER)]:
            stamp, content = stamp_of(oldest), self._contents.pop(oldest)
            if may_forget(stamp):
                self._further.pop(oldest, None)
                self.forgotten = max(stamp, self.forgotten)
            else:
                self._contents[oldest] = content

    def remove(self, record: RecordIdentity) -> None:
        """Forget a record that was not used after all."""
        key, content = record
        known = [self._contents[key]] if key in self._contents else []
        others = [other for other in (*known, *self._further.pop(key, ())) if other != content]
        if others:
            self._contents[key], *further = others
            self._further |= {key: tuple(further)} if further else {}
        else:
            self._contents.pop(key, None)
