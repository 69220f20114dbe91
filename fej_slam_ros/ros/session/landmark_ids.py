# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""IDs of landmarks that are recognised by a name."""

from collections.abc import Mapping, Sequence
import re
from zlib import crc32

from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.ros.messages.incoming import MAX_ID

#: Maximum number of names.
MAX_NAMES = 100_000
#: A number, alone or after a family of tags or another namespace.
NUMBERED = re.compile('(.*:)?([0-9]{1,10})')
#: Smallest ID of a name without number, beyond those of tags.
FIRST_HASHED = 2**30


class LandmarkIds:
    """
    IDs by name, the same for all robots although they exchange none.

    A name that is a number, or ends with one after a colon, has this number. Others have a
    checksum of the name. Of names with the same ID, none has one.

    Parameters
    ----------
    given : IDs of names for which these rules do not hold

    Attributes
    ----------
    by_name : the IDs of all names so far
    conflicts : names that have the ID of another
    changes : number of names added, the given ones included

    """

    def __init__(self, given: Mapping[str, int]) -> None:
        self.by_name = dict(given)
        self.conflicts: set[str] = set()
        self.changes = len(given)
        self._names = {id_: name for name, id_ in given.items()}
        self._given = given.keys()

    def find(self, names: Sequence[str]) -> list[int | None]:
        """Return the ID of each name, None if it has none; that of '' is `NO_ID`."""
        for name in names:
            if name and name not in self.by_name and name not in self.conflicts:
                self._add(name)
                self.changes += 1
        return [self.by_name.get(name) if name else NO_ID for name in names]

    def _add(self, name: str) -> None:
        number = NUMBERED.fullmatch(name)
        id_ = int(number[2]) if number else FIRST_HASHED + crc32(name.encode()) % FIRST_HASHED
        other = self._names.setdefault(id_, name)
        if id_ > MAX_ID or len(self._names) > MAX_NAMES:
            self.conflicts.add(name)
        elif other == name:
            self.by_name[name] = id_
        else:
            self.conflicts.add(name)
            if other not in self._given and other in self.by_name:
                self.conflicts.add(other)
                del self.by_name[other]
