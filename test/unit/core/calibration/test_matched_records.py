# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""IDs by the matches of an estimator, for observations without one."""

import math

import numpy as np
import pytest

from fej_slam_ros.core.calibration.from_innovations import most_likely_scales, with_scales
from fej_slam_ros.core.calibration.matched_records import are_without_ids, with_matched_ids
from fej_slam_ros.core.records import NO_ID, Odometry, PriorMap, Scan, TrueLandmarks
from fej_slam_ros.experiments.real_data.association_score import AssociationScore
from fej_slam_ros.ros.session import simulation
from helpers.records import claiming, odometry, scan, team, without_ids
from helpers.slow import slow

#: Landmarks lie farther apart than robots and observations are uncertain.
SIMULATION = {'loops': 1, 'landmarks': 30, 'seed': 3, 'landmark_sigma': [0.03, 0.03]}


def simulated(robots, **changes):
    """Return simulated measurements with IDs, without ground truth."""
    records = simulation.parse({**SIMULATION, 'robots': robots, **changes}).records()
    return [r for r in records if isinstance(r, (Odometry, Scan))]


def received(records):
    return [(record, None) for record in records]


def scans(records):
    return [record for record, _ in records if isinstance(record, Scan)]


def test_observations_of_one_landmark_have_one_id_and_their_own_noise():
    score = AssociationScore()
    stripped = received(
        score.without_ids(r) if isinstance(r, Scan) else r for r in simulated(['r1']))
    noise = {o.z.tobytes(): o.R for s in scans(stripped) for o in s.observations}

    # Scaled noise is that of the estimator alone.
    matched = with_matched_ids(with_scales(team('r1'), {'landmark': 1.5}), stripped)

    assert are_without_ids(stripped)
    assert not are_without_ids(matched.records)
    score.add(scans(matched.records))
    assert score.false() == 0
    assert score.count() > 0.9 * len(noise)
    # What is doubtful, or of a landmark that was never confirmed, is left out.
    for observation in (o for s in scans(matched.records) for o in s.observations):
        np.testing.assert_array_equal(observation.R, noise[observation.z.tobytes()])


@pytest.mark.parametrize('known', [40, 60])
def test_known_ids_are_kept_and_others_are_none_of_them(known):
    prior = PriorMap((-5, known), np.array([[3.0, 0.0], [3.0, 2.0]]), 1e-4 * np.eye(4))
    records = received([
        TrueLandmarks({50: np.zeros(2)}),
        *(record for ms in range(0, 1000, 100) for record in (
            odometry('r1', ms, (0.0, 0.0, 0.0)),
            scan('r1', ms, [
                (7, (1.0, -1.0)), (NO_ID, (3.0, 0.0)), (NO_ID, (3.0, 2.0)),
                (NO_ID, (2.0, -3.0))])))])

    matched = with_matched_ids(team('r1'), records, prior)

    for record in scans(matched.records):
        ids = {tuple(o.z): o.id for o in record.observations}
        new = ids.pop((2.0, -3.0))
        assert ids == {(1.0, -1.0): 7, (3.0, 0.0): -5, (3.0, 2.0): known}
        assert new > max(known, 50)
    assert scans(matched.records)[0].observations[-1].id == new


def test_without_observations_without_ids_nothing_is_matched():
    assert not are_without_ids(received(simulated(['r1'])))


@pytest.mark.parametrize(('of_odometry', 'of_landmarks'), [(0.5, 2.0), slow(2.0, 0.5)])
def test_repeated_matching_leads_to_the_noise_of_the_simulation(of_odometry, of_landmarks):
    records = received(without_ids(claiming(
        simulated(['r1'], loops=2), {Odometry: of_odometry, Scan: of_landmarks})))
    settings, kinds = team('r1'), ['odometry', 'landmark']

    scales = {}
    for _ in range(4):
        matched = with_matched_ids(with_scales(settings, scales), records)
        found = most_likely_scales(settings, matched.records, kinds)
        scales = {kind: noise.scale for kind, noise in found.items()}

    # Four standard errors, and the 2.3 % by which the gate of matches, of probability 0.99, cuts
    # the root mean square of two normal errors.
    for kind, true in zip(kinds, (1.0 / of_odometry, 1.0 / of_landmarks)):
        assert abs(math.log(found[kind].scale / true)) < 4.0 * found[kind].relative_error + 0.023
