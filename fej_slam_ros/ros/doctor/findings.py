# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a check tells."""

from collections.abc import Mapping
from dataclasses import dataclass

from fej_slam_ros.core.records import NS

#: It would spoil the estimate, or may.
ERROR, WARNING = 'error', 'warning'


@dataclass(frozen=True, slots=True)
class Finding:
    """
    Something that is wrong with a bag.

    Attributes
    ----------
    severity : `ERROR` or `WARNING`
    name : what it is, of refusals the name that users see
    where : the topic, or the robot
    what : what was found
    cure : what to do, in one sentence
    count : of how many messages, observations or places it was found
    stamp : of the first of them [ns], None where there is no such

    """

    severity: str
    name: str
    where: str
    what: str
    cure: str
    count: int = 1
    stamp: int | None = None

    def __str__(self) -> str:
        at = '' if self.stamp is None else f', first at {seconds(self.stamp)}'
        return (
            f'{self.severity}: {self.where}: {self.name}: {self.what}{at}\n'
            f'    cure: {self.cure}')


def seconds(time: float) -> str:
    """Return a time or stamp [ns] for the user."""
    return f'{time / NS:.3f} s'


def counted(number: int, noun: str) -> str:
    """Return how many there are of something, for the user."""
    return f'{number or "no"} {noun}{"" if number == 1 else "s"}'


def most_often(names: Mapping[str, int]) -> str:
    """Return names with how often there are, the most frequent first."""
    ordered = sorted(names.items(), key=lambda item: -item[1])
    return ', '.join(f'{name!r} ({count})' for name, count in ordered[:5])
