# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Records for calibration in which all observations have IDs.

Calibration compares runs of different noise on the same observations of the same landmarks. Which
landmark an observation without ID is of is therefore decided once, before these runs.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from fej_slam_ros.core.calibration.from_innovations import FILTER
from fej_slam_ros.core.offline_matching import match
from fej_slam_ros.core.records import NO_ID, PriorMap, Received, Record, Scan, TrueLandmarks
from fej_slam_ros.core.settings import Settings


@dataclass(frozen=True, slots=True, eq=False)
class MatchedRecords:
    """Records in which all observations have IDs."""

    records: Sequence[Received]
    counts: Mapping[str, int] = field(default_factory=dict)  #: as in `Matches`


def are_without_ids(records: Sequence[Received]) -> bool:
    """Return whether an observation is without ID."""
    return any(NO_ID in _landmark_ids(record) for record, _ in records)


def with_matched_ids(
    settings: Settings, records: Sequence[Received], prior: PriorMap | None = None,
    on_step: Callable[[], object] = lambda: None,
) -> MatchedRecords:
    """
    Return records with the IDs of the landmarks that observations without ID match.

    The parameters are those of `match`, but that the filter is always `FILTER`.

    """
    matches = match(replace(settings, filter=FILTER), records, prior, on_step)
    # An estimator assigns IDs below all others, and their landmarks wait for further matches to
    # confirm them. Here they are confirmed: they get IDs above all others.
    prior_ids = () if prior is None else prior.ids
    lowest = min([NO_ID, *prior_ids])
    highest = max(
        [NO_ID, *prior_ids, *(id_ for record, _ in records for id_ in _landmark_ids(record))])
    matches = replace(matches, ids={
        key: id_ if id_ >= lowest else highest + lowest - id_
        for key, id_ in matches.ids.items()})
    return MatchedRecords([
        (matches.with_ids(record) if isinstance(record, Scan) else record, received)
        for record, received in records], matches.counts)


def _landmark_ids(record: Record) -> Collection[int]:
    if isinstance(record, Scan):
        return [o.id for o in record.observations]
    return record.positions if isinstance(record, TrueLandmarks) else ()
