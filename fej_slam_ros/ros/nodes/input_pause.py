# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pauses of the input of a node, in which the steps that wait for more input are processed."""

from fej_slam_ros.core.records import NS

#: Time [ns] by which a clock that goes back is still the same one.
MAX_CLOCK_JITTER = NS // 10


class InputPause:
    """Detects that no input arrives any more."""

    def __init__(self) -> None:
        self._last: int | None = None

    @property
    def is_at_rest(self) -> bool:
        """Return whether no input has arrived yet, or none since `rest` was called."""
        return self._last is None

    def receive(self, now: int | None) -> None:
        """Add input that arrives at a time [ns]; it is None while simulated time has not begun."""
        self._last = now

    def rest(self) -> None:
        """Wait for new input, after the steps of a pause are processed or at the end of a run."""
        self._last = None

    def has_begun(self, now: int | None, stale_after: float) -> bool:
        """Return whether input has arrived, but not in the last `stale_after` seconds."""
        if now is None or self._last is None:
            return False
        # The input has also ended if the clock went back.
        return not -MAX_CLOCK_JITTER <= now - self._last <= stale_after * NS
