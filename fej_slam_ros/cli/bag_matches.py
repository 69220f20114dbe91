# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks of the observations without ID in a bag, for commands that need IDs."""

from contextlib import suppress
from pathlib import Path

from tqdm import tqdm

from fej_slam_ros.core.ekf.linearization import LINEARIZATIONS
from fej_slam_ros.core.matches import Matches
from fej_slam_ros.core.offline_matching import match
from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.messages import decoded_as
from fej_slam_ros.ros.messages.incoming import RejectedError
from fej_slam_ros.ros.messages.incoming_clouds import has_unknown_landmarks
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.record_collector import collect
from fej_slam_ros.ros.topic_types import CLOUD


def matches_in(bag: Path, settings: RunSettings, names: TopicNames) -> Matches | None:
    """Return what the estimator matches in a bag, None if all observations have IDs."""
    estimation = settings.estimation
    # The filter that linearises about true landmarks matches nothing.
    if LINEARIZATIONS[estimation.filter].needs_truth or (
            not _has_landmarks_without_ids(bag, estimation, names)):
        return None
    # What the bag lacks is said where it is read for the run itself.
    records = collect(bags.read(bag, names), settings, needs_ids=False).records
    with tqdm(desc='match', unit='step', disable=None) as bar:
        return match(estimation, records, prior_map(settings), bar.update)


def _has_landmarks_without_ids(bag: Path, settings: CommonSettings, names: TopicNames) -> bool:
    """Return whether a robot in a bag observed a landmark without ID."""
    for message in bags.read(bag, names, [f'{robot.name}/landmarks' for robot in settings.robots]):
        cloud = decoded_as(message, CLOUD)
        with suppress(RejectedError):
            if cloud is not None and has_unknown_landmarks(cloud):
                return True
    return False
