# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""IDs for observations without one: those of the landmarks at the end of a run."""

from collections import defaultdict
from dataclasses import replace

import numpy as np

from fej_slam_ros.core.offline_matching import match
from fej_slam_ros.core.records import NO_ID, Odometry, Scan
from fej_slam_ros.experiments.real_data.association_score import AssociationScore
from fej_slam_ros.ros.session import simulation
from helpers.records import odometry, scan, team

#: Two robots, of which one has to find the map of the other by its own.
RECORDS = [
    record for record in simulation.parse({
        'loops': 2, 'landmarks': 30, 'seed': 3, 'landmark_sigma': [0.03, 0.03]}).records()
    if isinstance(record, (Odometry, Scan))]


def received(records):
    return [(record, None) for record in records]


def test_a_landmark_of_joined_maps_has_one_id_from_the_begin_of_both_runs_on():
    score = AssociationScore()
    stripped = [score.without_ids(r) if isinstance(r, Scan) else r for r in RECORDS]

    matches = match(team(), received(stripped))

    true_ids = {
        (r.robot, r.stamp, o.z.tobytes()): o.id
        for r in RECORDS if isinstance(r, Scan) for o in r.observations}
    assigned, observers = defaultdict(set), defaultdict(set)
    for (robot, stamp, z), id_ in matches.ids.items():
        true_id = true_ids[robot, stamp, z]
        assigned[true_id].add(id_)
        observers[true_id].add(robot)
    assert len(matches.ids) > 0.7 * len(true_ids)
    assert sum(len(robots) == 2 for robots in observers.values()) > 10
    assert all(len(ids) == 1 for ids in assigned.values())


def test_what_matches_no_confirmed_landmark_is_left_out_of_a_scan():
    places = [(3.0, 0.0), (3.0, 2.0), (2.0, -3.0)]
    records = [
        record for ms in range(0, 1000, 100) for record in (
            odometry('r1', ms, (0.0, 0.0, 0.0)), scan('r1', ms, [(NO_ID, z) for z in places]))]
    # Clutter that is never observed again.
    last = records[-1]
    records[-1] = replace(last, observations=(
        *last.observations, replace(last.observations[0], z=np.array([8.0, 8.0]))))

    matches = match(team('r1'), received(records))

    # Nothing but the first scan and the clutter is of a landmark that is not known.
    counted = [matches.counts[kind] for kind in ('new', 'matched', 'doubtful')]
    assert counted == [4, 27, 0]
    found = matches.with_ids(records[-1])
    assert {tuple(o.z) for o in found.observations} == {*places}
    assert all(o.id < NO_ID for o in found.observations)
    with_ids = scan('r1', 0, [(7, (1.0, 0.0))])
    assert matches.with_ids(with_ids) is with_ids


def test_observations_with_systematic_errors_that_are_corrected_keep_their_matches():
    places = [(3.0, 0.0), (3.0, 2.0), (2.0, -3.0)]
    records = [
        record for ms in range(0, 1000, 100) for record in (
            odometry('r1', ms, (0.0, 0.0, 0.0)), scan('r1', ms, [(NO_ID, z) for z in places]))]
    errors = {'observation_range_scale': 1.01, 'observation_bearing_bias': 0.02}
    settings = team('r1')

    matches = match(
        replace(settings, robots=(replace(settings.robots[0], **errors),)), received(records))

    found = matches.with_ids(records[-1])
    # The smoother and calibration correct them.
    assert {tuple(o.z) for o in found.observations} == {*places}


def test_a_robot_that_has_joined_no_other_keeps_its_matches():
    places = {'r1': [(3.0, 0.0), (3.0, 2.0)], 'r2': [(5.0, 1.0), (2.0, -3.0)]}
    records = [
        record for ms in range(0, 1000, 100) for robot in places for record in (
            odometry(robot, ms, (0.0, 0.0, 0.0)),
            scan(robot, ms, [(NO_ID, z) for z in places[robot]]))]

    matches = match(team(), received(records))

    for robot in places:
        ids = {id_ for (observer, _, _), id_ in matches.ids.items() if observer == robot}
        assert len(ids) == 2
