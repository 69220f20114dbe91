# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The messages on one topic of a robot: their rate, gaps and rejections."""

from collections import Counter, deque
from dataclasses import dataclass, field
from statistics import median
from typing import NamedTuple

from fej_slam_ros.core.records import NS
from fej_slam_ros.core.rejections import RejectionReason

#: Number of gaps between messages that are stored per topic; their median is its usual gap.
MAX_GAPS = 50
#: Minimum number of gaps by which a topic can be called regular.
MIN_GAPS = 5
#: A topic is regular if its longest gap is at most this multiple of the usual one; lost messages
#: cause smaller ratios, detectors that only send what they detect cause larger ones.
REGULAR_RATIO = 5.0
#: A topic has stopped after this multiple of its usual gap: two lost messages are no stop.
STOPPED_RATIO = 3.0
#: Minimum silence of a topic that has stopped [ns], where `stale_after` is shorter.
MIN_SILENCE = NS // 2
#: Time [ns] that rates refer to, so that slow topics do not alternate between two rates.
RATE_WINDOW = 5 * NS
#: Minimum number of messages, and minimum time [ns], for which all must be rejected: one bad
#: message is no fault, and two reports are a second apart.
MIN_REJECTED = 3
MIN_REJECTED_TIME = NS
#: Reasons for which input that is sent again is rejected, as intended.
SENT_AGAIN = {RejectionReason.DUPLICATE, RejectionReason.BEFORE_CHECKPOINT}


class LargeScan(NamedTuple):
    """A scan that was rejected by its size."""

    points: int  #: number of points
    size: int  #: bytes of the message
    received: int | None  #: time of reception [ns]


@dataclass(slots=True)
class TopicFlow:
    """The messages on one topic of a robot."""

    received: int = 0  #: number of messages
    observations: int = 0  #: number of observations in them that are not rejected at once
    largest: LargeScan | None = None  #: the newest scan that was rejected by its size
    delay: int | None = None  #: from the stamp of the newest message to its reception [ns]
    last: int | None = None  #: time of reception of the newest message [ns]
    #: messages that were rejected since the last accepted one, by reason, and the time of the
    #: first of them [ns]
    rejected_in_a_row: Counter[RejectionReason] = field(default_factory=Counter)
    rejected_since: int = 0
    _gaps: deque[int] = field(default_factory=lambda: deque(maxlen=MAX_GAPS))
    #: times of reports [ns] in the last `RATE_WINDOW`, with the number of messages by then
    _samples: deque[tuple[int, int]] = field(default_factory=deque)

    def add(self, received: int | None) -> None:
        """Add a message with its time of reception [ns]; `settle` says whether it is used."""
        self.received += 1
        if received is not None:
            # After a clock that went back, the gap is unknown.
            if self.last is not None and received >= self.last:
                self._gaps.append(received - self.last)
            self.last = received
            self.rejected_since = min(self.rejected_since, received)

    def settle(self, received: int | None, reason: RejectionReason | None) -> None:
        """Note whether a message, which had perhaps waited, is accepted, or why it is rejected."""
        if reason is None:
            self.rejected_in_a_row.clear()
            return
        if not self.rejected_in_a_row:
            self.rejected_since = received or 0
        self.rejected_in_a_row[reason] += 1

    def are_all_rejected(self, now: int) -> bool:
        """Return whether all messages are rejected, but for scans that are too large."""
        return (
            self.rejected_in_a_row.total() >= MIN_REJECTED
            and now - self.rejected_since >= MIN_REJECTED_TIME
            and not self.rejected_in_a_row.keys() <= {RejectionReason.TOO_LARGE})

    def is_sent_again(self) -> bool:
        """Return whether all rejected messages were used before, perhaps in an earlier process."""
        return self.rejected_in_a_row.keys() <= SENT_AGAIN

    def usual_gap(self) -> int:
        """Return the median gap between messages [ns], 0 if unknown."""
        return round(median(self._gaps)) if self._gaps else 0

    def is_regular(self) -> bool:
        """Return whether the messages come at a steady rate, so that silence is a fault."""
        return (
            len(self._gaps) >= MIN_GAPS and max(self._gaps) <= REGULAR_RATIO * self.usual_gap())

    def silence(self, now: int) -> int:
        """Return the time since the newest message [ns], 0 before the first."""
        return 0 if self.last is None else max(now - self.last, 0)

    def has_stopped(self, now: int, stale_after: int) -> bool:
        """Return whether messages came before, but none for longer than usual."""
        limit = max(stale_after, MIN_SILENCE, round(STOPPED_RATIO * self.usual_gap()))
        return self.silence(now) > limit

    def sample(self, now: int) -> None:
        """Remember the number of messages at the time [ns] of a report."""
        if self._samples and now < self._samples[-1][0]:
            self._samples.clear()
        self._samples.append((now, self.received))
        while len(self._samples) > 2 and now - self._samples[1][0] >= RATE_WINDOW:
            self._samples.popleft()

    def rate(self) -> float:
        """Return the rate of the messages over the last `RATE_WINDOW` [Hz], 0 if unknown."""
        if not self._samples:
            return 0.0
        (begin, first), (end, last) = self._samples[0], self._samples[-1]
        return (last - first) / (end - begin) * NS if end > begin else 0.0
