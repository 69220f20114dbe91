# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
IDs for observations without one, by the matches of an estimator.

Calibration compares runs of different noise on the same observations of the same landmarks. Which
landmark an observation is of is therefore decided once, before these runs.
"""

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

from fej_slam_ros.core.calibration.from_innovations import FILTER, Received, steps
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import (
    NO_ID, Observation, ordered, PriorMap, Record, Scan, TrueLandmarks)
from fej_slam_ros.core.settings import Settings


@dataclass(frozen=True, slots=True, eq=False)
class MatchedRecords:
    """Records in which all observations have IDs."""

    records: Sequence[Received]
    #: number of observations without ID that were ``matched``, ``new`` or ``doubtful``; the last
    #: are left out
    counts: Counter[str] = field(default_factory=Counter)


def are_without_ids(records: Sequence[Received]) -> bool:
    """Return whether an observation is without ID."""
    return any(NO_ID in _ids(record) for record, _ in records)


def with_matched_ids(
    settings: Settings, records: Sequence[Received], prior: PriorMap | None = None,
    on_step: Callable[[], object] = lambda: None,
) -> MatchedRecords:
    """
    Return records with the IDs of the landmarks that observations without ID match.

    Parameters
    ----------
    settings : of the estimator that matches them, but for its filter
    records : a robot has at most one scan with observations without ID at a stamp
    prior : map known before the run
    on_step : called after each step of the estimator

    """
    estimator = Estimator(replace(settings, filter=FILTER), prior)
    # The noise of what the estimator returns is scaled: only IDs are taken from it.
    matches: dict[tuple[str, int, bytes], int] = {}
    for step in steps(estimator, records):
        on_step()
        matches |= {
            (scan.robot, scan.stamp, o.z.tobytes()): o.id
            for scan in step.associated for o in scan.observations}
    # An estimator assigns IDs below -1, whose landmarks wait for further matches to confirm them.
    # The matches are decided here: others are assigned, above all that are known.
    prior_ids = () if prior is None else prior.ids
    known = min([NO_ID, *prior_ids])
    above = max([NO_ID, *prior_ids, *(id_ for record, _ in records for id_ in _ids(record))])

    def with_id(scan: Scan, observation: Observation) -> Observation:
        if observation.id != NO_ID:
            return observation
        id_ = matches.get((scan.robot, scan.stamp, observation.z.tobytes()), NO_ID)
        return replace(observation, id=id_ if id_ >= known else above + known - id_)

    def with_ids(record: Record) -> Record:
        if NO_ID not in _ids(record) or not isinstance(record, Scan):
            return record
        observations = (with_id(record, o) for o in record.observations)
        return replace(
            record, observations=ordered(o for o in observations if o.id != NO_ID))

    counts = estimator.landmark_manager.counts.values()
    return MatchedRecords(
        [(with_ids(record), received) for record, received in records], sum(counts, Counter()))


def _ids(record: Record) -> Collection[int]:
    """Return the landmark IDs in a record."""
    if isinstance(record, Scan):
        return [o.id for o in record.observations]
    return record.positions if isinstance(record, TrueLandmarks) else ()
