# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of sentences for users."""

from collections import Counter
from enum import Enum
from typing import TypeVar

#: Kind of the reasons for which something is rejected.
ReasonT = TypeVar('ReasonT', bound=Enum)


def counted(count: int, what: str) -> str:
    """Return a number of things."""
    return f'{count} {what}' if count == 1 else f'{count} {what}s'


def reasons_in_words(counts: Counter[ReasonT]) -> str:
    """Return how often input was rejected for each reason, the most frequent first."""
    return ', '.join(f'{count} {reason.value}' for reason, count in counts.most_common())
