# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Chains of odometry, each through poses without other measurements.

Such poses are eliminated from the normal equations, see `chain_reduction`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Flags, Indices, runs, starts_of

#: Number of factors at which a part of the chains ends: arrays of more leave the cache between
#: two operations.
MAX_PART = 16_384


class PartOfChains(NamedTuple):
    """Some whole chains."""

    rows: slice  #: positions of their factors
    #: firsts, lengths: (c,) arrays, position in `rows` of the first factor of each, and how many
    firsts: Indices
    lengths: Indices


@dataclass(frozen=True, slots=True, eq=False)
class OdometryChains:
    """
    Odometry factors in chains of at least two, chain by chain.

    Chains of equal length follow each other, so that they are summed together.
    """

    rows: Indices  #: (m,) array, the factors; in a chain each begins where the one before ends
    firsts: Indices  #: (c,) array, position in `rows` of the first factor of each chain
    #: begins, ends: (m,) arrays, poses of each factor
    begins: Indices
    ends: Indices

    @classmethod
    def of(cls, begins: Indices, ends: Indices, needed: Flags) -> 'OdometryChains':
        """
        Return the chains of odometry factors.

        Parameters
        ----------
        begins, ends : (n,) arrays, poses of the factors; chains lead through successive factors
        needed : for each pose, whether it has other measurements, or stays for another reason

        """
        is_passed = ~needed
        for of_factors in (begins, ends):
            is_passed &= np.bincount(of_factors, minlength=len(needed)) == 1
        # Whether the chain of a factor continues with the next one.
        goes_on = np.append(begins[1:] == ends[:-1], False)[:len(begins)] & is_passed[ends]
        chains = cls._of_runs(begins, ends, goes_on)
        closed = chains.begins[chains.firsts] == chains.ends[chains.lasts]
        if closed.any():
            # A chain back to its begin has no other end: its first factor stays as it is.
            goes_on[chains.rows[chains.firsts[closed]]] = False
            chains = cls._of_runs(begins, ends, goes_on)
        return chains

    @classmethod
    def _of_runs(cls, begins: Indices, ends: Indices, goes_on: Flags) -> 'OdometryChains':
        """Return the chains of factors of which some go on with the next one, shortest first."""
        follows = np.append(False, goes_on)[:len(goes_on)]
        rows = np.flatnonzero(goes_on | follows)
        firsts = np.flatnonzero(~follows[rows])
        lengths = np.diff(firsts, append=len(rows))
        by_length = np.argsort(lengths, kind='stable')
        firsts, lengths = firsts[by_length], lengths[by_length]
        rows = rows[runs(firsts, lengths)]
        return cls(rows, starts_of(lengths), begins[rows], ends[rows])

    @property
    def lasts(self) -> Indices:
        """Return the position in `rows` of the last factor of each chain."""
        return self.firsts + self.lengths - 1

    @property
    def lengths(self) -> Indices:
        """Return the number of factors (c,) of each chain."""
        return np.diff(self.firsts, append=len(self.rows))

    def parts(self) -> Iterator[PartOfChains]:
        """Yield all chains, some at a time."""
        lengths = self.lengths
        groups = self.firsts // MAX_PART
        for begin, end in pairwise(
                [*np.flatnonzero(np.diff(groups, prepend=-1)).tolist(), len(groups)]):
            first, of_part = self.firsts[begin], lengths[begin:end]
            yield PartOfChains(
                slice(first, first + of_part.sum()), self.firsts[begin:end] - first, of_part)

    @property
    def nodes(self) -> tuple[Indices, Indices]:
        """Return the poses (c,) at the begin and at the end of each chain."""
        return self.begins[self.firsts], self.ends[self.lasts]

    @property
    def eliminated(self) -> Indices:
        """Return the poses (m - c,) in between."""
        return np.delete(self.ends, self.lasts)

    @property
    def inner(self) -> tuple[Indices, Indices]:
        """Return the chain and the position in `rows` of the factor to each pose in between."""
        chain = np.repeat(np.arange(len(self.firsts)), self.lengths - 1)
        return chain, np.delete(np.arange(len(self.rows)), self.lasts)
