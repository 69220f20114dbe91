# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Logs that grow at their end only, and the knowledge of several robots about them.

A log has one author. It consists of numbered blocks of bytes that never change, so that
(author, run, number) identifies a block, and knowledge of a log is the number of its first blocks.
Two robots that have n and m of them together have max(n, m): nothing is counted twice, however
often, in any order and through any robots blocks arrive.

The digest of the first n blocks is a chain: it contains the digest of the first n - 1 of them. Two
logs with equal digests are equal; a block that does not follow the known digest is rejected.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import NamedTuple

#: Size of a digest [bytes].
DIGEST_SIZE = 8
NO_DIGEST = bytes(DIGEST_SIZE)
#: Number of blocks beyond the first missing one that are stored.
MAX_AHEAD = 256


class LogName(NamedTuple):
    """Name of a log, of which a robot has one for each purpose."""

    author: str  #: name of the robot
    #: name of the robot for which it is rendezvous information, '' for the log of measurements
    about: str = ''


#: Log, run and number of a block.
BlockKey = tuple[LogName, int, int]


def is_of_team(name: LogName, team: Collection[str]) -> bool:
    """Return whether a log is of a team, about measurements or another robot of it."""
    return name.author in team and name.author != name.about and name.about in {'', *team}


@dataclass(frozen=True, slots=True)
class Block:
    """One block of a log."""

    log: LogName
    run: int  #: number of the run of the author; a later run replaces an earlier one
    number: int  #: position in the log, from 0
    digest: bytes  #: of the blocks before it
    content: bytes


@dataclass(frozen=True, slots=True)
class Knowledge:
    """Blocks of a log that a robot has."""

    log: LogName
    run: int
    count: int  #: number of first blocks without a gap
    digest: bytes  #: of these
    ahead: frozenset[int] = frozenset()  #: numbers of stored blocks beyond the first missing one
    is_ended: bool = False  #: whether it wants no more of it


@dataclass(slots=True, eq=False)
class Log:
    """The blocks of one log that are known."""

    name: LogName
    run: int
    blocks: list[bytes] = field(default_factory=list)  #: the first blocks, without a gap
    #: digests of the first 0, 1, ... blocks
    digests: list[bytes] = field(default_factory=lambda: [NO_DIGEST])
    ahead: dict[int, Block] = field(default_factory=dict)  #: further ones by number
    is_ended: bool = False  #: whether the next block was read and cannot be used

    def append(self, content: bytes) -> Block:
        """Add the next block, as its author or as one whose digest fits."""
        block = Block(self.name, self.run, len(self.blocks), self.digests[-1], content)
        self.blocks.append(content)
        self.digests.append(chained(self.digests[-1], content))
        return block

    def block(self, number: int) -> Block:
        """Return a known block."""
        if number in self.ahead:
            return self.ahead[number]
        return Block(self.name, self.run, number, self.digests[number], self.blocks[number])

    def knowledge(self) -> Knowledge:
        """Return the knowledge of this log."""
        return Knowledge(
            self.name, self.run, len(self.blocks), self.digests[-1], frozenset(self.ahead),
            self.is_ended)

    def contains(self, number: int) -> bool:
        """Return whether a block is known."""
        return number < len(self.blocks) or number in self.ahead

    def is_prefix(self, known: Knowledge) -> bool:
        """Return whether the blocks of this run that another robot has agree with these."""
        return known.count >= len(self.digests) or self.digests[known.count] == known.digest

    def missing(self, known: Knowledge | None) -> Iterator[int]:
        """
        Yield the numbers of the known blocks that another robot does not have.

        A robot that has an earlier run of the author accepts no other block before the first one.

        """
        first, ahead, most = 0, frozenset[int](), MAX_AHEAD
        if known is not None and known.run < self.run:
            most = MAX_AHEAD if self.name.about else 1
        elif known is not None:
            if known.run > self.run or known.is_ended or not self.is_prefix(known):
                return
            first, ahead = known.count, known.ahead
        for number in [*range(first, len(self.blocks)), *self.ahead]:
            if first <= number < first + most and number not in ahead:
                yield number


def chained(digest: bytes, content: bytes) -> bytes:
    """Return the digest after a block."""
    return blake2b(digest + content, digest_size=DIGEST_SIZE).digest()
