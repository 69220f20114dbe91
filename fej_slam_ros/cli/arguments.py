# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the arguments of several verbs have in common."""

from collections.abc import Callable
import os

from fej_slam_ros.errors import UsageError


def at_least(least: int, option: str) -> Callable[[str], int]:
    """Return what reads the value of an option: a whole number that is not too small."""
    def number(word: str) -> int:
        if not word.isdecimal() or int(word) < least:
            raise UsageError(f'{option}: {word} is not a whole number from {least} on')
        return int(word)
    return number


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0))
