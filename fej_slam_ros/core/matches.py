# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks of observations without ID, as an estimator matched them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from fej_slam_ros.core.records import NO_ID, Observation, ordered, Scan

#: Robot, stamp [ns] and z, as bytes, of an observation without ID.
ObservationKey = tuple[str, int, bytes]


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Landmarks of observations without ID."""

    ids: Mapping[ObservationKey, int]  #: the IDs of confirmed landmarks
    #: number of observations without ID that were ``matched``, ``new`` and ``doubtful``
    counts: Mapping[str, int]

    def with_ids(self, scan: Scan) -> Scan:
        """Return a scan in which all observations have IDs; those without a match are left out."""
        if all(o.id != NO_ID for o in scan.observations):
            return scan
        observations = (
            o if o.id != NO_ID else replace(o, id=self.ids.get(observation_key(scan, o), NO_ID))
            for o in scan.observations)
        return replace(scan, observations=ordered(o for o in observations if o.id != NO_ID))


def observation_key(scan: Scan, observation: Observation) -> ObservationKey:
    """Return the key of an observation of a scan."""
    return scan.robot, scan.stamp, observation.z.tobytes()
