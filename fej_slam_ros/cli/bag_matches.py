# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks of the observations without ID in a bag, for what needs to know them."""

from pathlib import Path

from tqdm import tqdm

from fej_slam_ros.cli.bag_input import has_landmarks_without_ids
from fej_slam_ros.core.ekf.linearization import LINEARIZATIONS
from fej_slam_ros.core.matches import Matches
from fej_slam_ros.core.offline_matching import match
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.record_collector import collect


def matches_in(bag: Path, settings: RunSettings, names: TopicNames) -> Matches | None:
    """Return what the estimator matches in a bag, None if all observations have IDs."""
    estimation = settings.estimation
    # The filter that linearises about true landmarks matches nothing.
    if LINEARIZATIONS[estimation.filter].needs_truth or (
            not has_landmarks_without_ids(bag, estimation, names)):
        return None
    # What the bag lacks is said where it is read for the run itself.
    records = collect(bags.read(bag, names), settings, needs_ids=False).records
    with tqdm(desc='match', unit='step', disable=None) as bar:
        return match(estimation, records, prior_map(settings), bar.update)
