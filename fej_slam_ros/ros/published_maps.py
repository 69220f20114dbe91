# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps as they are published and written: each landmark with one ID, whoever has observed it."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import LandmarkKey


@dataclass(frozen=True, slots=True, eq=False)
class MapEstimate:
    """The landmarks of one frame."""

    frame: str  #: its name
    ids: list[int]  #: published ID of each landmark, counted unless robots share them
    #: robots and their IDs for each landmark; with shared IDs the robot is ''
    keys: list[tuple[LandmarkKey, ...]]
    points: Array  #: (n, 2) array, positions [m]
    P: Array  #: (n, 2, 2) array, their covariances [m^2]


def estimator_maps(estimator: Estimator) -> Iterator[MapEstimate]:
    """Yield the map of each frame, ``map`` first."""
    own_ids = count(1)
    shared = estimator.settings.shared_landmark_ids
    for of_frame in estimator.maps():
        ids = [id_ if shared else next(own_ids) for _, id_ in of_frame.keys]
        yield MapEstimate(
            of_frame.frame, ids, [(key,) for key in of_frame.keys], of_frame.points, of_frame.P)


def smoother_maps(team: TeamSmoother) -> Iterator[MapEstimate]:
    """Yield the map of each frame in the solution of a smoother."""
    own_ids = count(1)
    shared = team.settings.shared_landmark_ids
    for solved in team.solution.maps:
        keys = [tuple(sorted(names, key=_by_id)) for names in solved.landmarks]
        order = sorted(range(len(keys)), key=lambda k: _by_id(keys[k][0]))
        ids = [keys[k][0][1] if shared else next(own_ids) for k in order]
        yield MapEstimate(
            solved.frame, ids, [keys[k] for k in order], solved.points[order], solved.P[order])


def _by_id(key: LandmarkKey) -> tuple[int, str]:
    return key[1], key[0]
