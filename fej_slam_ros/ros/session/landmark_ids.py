# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""IDs of landmarks that are recognised by a name."""

from collections.abc import Mapping, Sequence
import re
from zlib import crc32

from fej_slam_ros.core.records import MAX_ID, NO_ID

#: Maximum number of names.
MAX_NAMES = 10_000
#: A number, alone or after a family of tags or another namespace.
NUMBERED = re.compile('(.*:)?([0-9]{1,10})')
#: Smallest ID of a name without number, beyond those of tags.
FIRST_HASHED = 2**30


def number_of(name: str) -> int | None:
    """Return the number that a name is, or ends with after a colon."""
    numbered = NUMBERED.fullmatch(name)
    return int(numbered[2]) if numbered else None


class LandmarkIds:
    """
    IDs by name, the same for all robots although they exchange none.

    A name with a number has this number as ID, others have a checksum of the name. Of names with
    the same ID, none has one.

    Parameters
    ----------
    given : IDs of names for which these rules do not hold

    Attributes
    ----------
    by_name : the IDs of all names so far
    conflicts : names without ID, of which there are at most as many as IDs

    """

    def __init__(self, given: Mapping[str, int]) -> None:
        self.by_name = dict(given)
        self.conflicts: set[str] = set()
        self._first_names = {id_: name for name, id_ in given.items()}
        self._given = given.keys()

    def assign(self, names: Sequence[str]) -> list[int | None]:
        """Return the ID of each name, None if it has none; that of '' is `NO_ID`."""
        for name in names:
            if name and name not in self.by_name and name not in self.conflicts:
                self._add(name)
        return [self.by_name.get(name) if name else NO_ID for name in names]

    def _add(self, name: str) -> None:
        number = number_of(name)
        id_ = FIRST_HASHED + crc32(name.encode()) % FIRST_HASHED if number is None else number
        first = self._first_names.get(id_)
        if id_ > MAX_ID or len(self.by_name) >= MAX_NAMES:
            self._refuse(name)
        elif first is None:
            self.by_name[name] = id_
            self._first_names[id_] = name
        else:
            self._refuse(name)
            if first not in self._given and first in self.by_name:
                self._refuse(first)
                del self.by_name[first]

    def _refuse(self, name: str) -> None:
        if len(self.conflicts) < MAX_NAMES:
            self.conflicts.add(name)
