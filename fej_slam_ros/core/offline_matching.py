# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Matching of the observations without ID of a whole run, for the smoother and for calibration.

The associations at the end of the run count: a landmark that was mapped twice and then merged has
one ID, and observations of a landmark that was deleted have none.
"""

from collections import Counter
from collections.abc import Callable, Iterable

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.matches import Matches, observation_key, ObservationKey
from fej_slam_ros.core.ordering.corrected_observations import without_observation_errors
from fej_slam_ros.core.records import PriorMap, Received, Record, Scan
from fej_slam_ros.core.settings import Settings


def match(
    settings: Settings, records: Iterable[Received], prior: PriorMap | None = None,
    on_step: Callable[[], object] = lambda: None,
) -> Matches:
    """
    Return the landmarks of the observations without ID in some records.

    A robot has at most one scan with such observations at a stamp. `on_step` is called after each
    step of the estimator.

    """
    estimator = Estimator(settings, prior)
    robots = {robot.name: robot for robot in settings.robots}
    received: dict[ObservationKey, ObservationKey] = {}
    ids: dict[ObservationKey, int] = {}

    def noted(record: Record) -> Record:
        """Note which observations become which ones by the correction of systematic errors."""
        if isinstance(record, Scan):
            corrected = without_observation_errors(record, robots[record.robot])
            received.update(
                (observation_key(record, after), observation_key(record, before))
                for before, after in zip(record.observations, corrected.observations))
        return record

    for step in estimator.run_received((noted(record), at) for record, at in records):
        on_step()
        ids |= {
            received[observation_key(scan, o)]: o.id
            for scan in step.associated for o in scan.observations}
    manager = estimator.landmark_manager
    confirmed = {id_ for frame_map in estimator.maps() for _, id_ in frame_map.keys}
    return Matches(
        {key: present for key, id_ in ids.items()
         if (present := manager.present_id(id_)) in confirmed},
        sum(manager.counts.values(), Counter()))
