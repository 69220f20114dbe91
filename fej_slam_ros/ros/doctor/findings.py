# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings of the checks."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import partial

from fej_slam_ros.core.records import NS


class Severity(str, Enum):
    """Effect of a finding: an error corrupts the estimate, a warning may degrade it."""

    ERROR = 'error'
    WARNING = 'warning'


@dataclass(frozen=True, slots=True)
class Finding:
    """A problem in a bag."""

    severity: Severity  #: of the problem
    name: str  #: of the problem; for rejected input, the value of its `RejectionReason`
    where: str  #: topic or robot
    what: str  #: description
    cure: str  #: what the user can do, in one sentence
    count: int = 1  #: number of affected messages, observations or intervals
    stamp: int | None = None  #: of the first of them [ns], None if the problem has no time

    def __str__(self) -> str:
        at = '' if self.stamp is None else f', first at {seconds(self.stamp)}'
        return (
            f'{self.severity.value}: {self.where}: {self.name}: {self.what}{at}\n'
            f'    cure: {self.cure}')


error = partial(Finding, Severity.ERROR)
warning = partial(Finding, Severity.WARNING)


def error_if(spoils: bool) -> Callable[..., Finding]:
    """Return `error` if a problem corrupts the estimate, `warning` otherwise."""
    return error if spoils else warning


def seconds(time: float) -> str:
    """Return a duration or stamp [ns] as text."""
    return f'{time / NS:.3f} s'


def most_frequent(counts: Mapping[str, int]) -> str:
    """Return the five most frequent names with their counts."""
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return ', '.join(f'{name!r} ({count})' for name, count in ordered[:5])
