# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of numbers with stamps."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, Indices, Stamps


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Rows (n, c) and their stamps (n,) [ns]; in the order of stamps unless stated otherwise."""

    stamps: Stamps
    rows: Array

    def __len__(self) -> int:
        return len(self.stamps)

    def __getitem__(self, rows: slice | Indices | Flags) -> 'Series':
        """Return some of the rows, as an array does: successive, in an order, or where true."""
        return Series(self.stamps[rows], self.rows[rows])

    def between(self, first: int, last: int) -> 'Series':
        """Return the rows from one stamp to another, both included."""
        return self[(first <= self.stamps) & (self.stamps <= last)]

    def first_in_windows(self, begin: int, period: int) -> 'Series':
        """Return the first row in each of successive windows [ns]."""
        return self[np.diff((self.stamps - begin) // period, prepend=-1) > 0]

    def in_order(self) -> 'Series':
        """Return the rows in the order of stamps; those of one stamp keep their order."""
        return self[np.argsort(self.stamps, kind='stable')]

    def shifted(self, shift: int) -> 'Series':
        """Return the rows with stamps on another clock [ns]."""
        return Series(self.stamps + shift, self.rows)


def joined(parts: Sequence[Series]) -> Series:
    """Return the rows of series, one after another."""
    return Series(
        np.concatenate([part.stamps for part in parts]), np.vstack([part.rows for part in parts]))


def drop(series: Series, unwanted: Flags, reason: str, counts: Counter[str]) -> Series:
    """Return a series without some of its rows, which are counted."""
    counts[reason] += int(unwanted.sum())
    return series[~unwanted]
