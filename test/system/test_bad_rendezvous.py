# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A rendezvous that does not join maps is reported and leaves them unchanged."""

from dataclasses import replace
import json

import numpy as np
import pytest

from fej_slam_ros.core.records import NS, Observation, Odometry, RobotObservation, RobotScan, Scan
from fej_slam_ros.experiments.andersson.experiment import scene
from fej_slam_ros.ros.files import bags
from helpers.ros import run_verb, write_parameters

#: x is not in the team.
IDS = {'p': 1, 'q': 2, 'x': 9}
R = 0.01 * np.eye(2)


@pytest.fixture
def smoothed(tmp_path):
    """Return a function that smooths records into a named folder and returns the folder."""
    params = write_parameters(
        tmp_path / 'params.yaml', robots=['p', 'q'], shared_landmark_ids=False)

    def run(records, name):
        bags.write(tmp_path / f'{name}_in', records, robot_ids=IDS)
        words = '--params', params, '--output', tmp_path / name
        assert run_verb('smooth', tmp_path / f'{name}_in', *words) == 0
        return tmp_path / name

    return run


@pytest.fixture(scope='module')
def records():
    """Return the records of two robots that pass each other."""
    return [*scene('map_joining', 1).records]


def read(folder, name):
    return json.loads((folder / f'{name}.json').read_text())


def without_rendezvous(records):
    """Return records without robot-to-robot observations."""
    return [record for record in records if not isinstance(record, RobotScan)]


def assert_same_maps(folder, other):
    for name in ('trajectory_p.csv', 'trajectory_q.csv', 'landmarks.csv'):
        assert (folder / name).read_bytes() == (other / name).read_bytes()


def standing():
    """Return records of still robots: p observes q, and each its own landmarks."""
    for k in range(8):
        for robot in ('p', 'q'):
            yield Odometry(robot, (k + 1) * NS, np.zeros(3), 1e-4 * np.eye(3))
            yield Scan(robot, (k + 1) * NS, tuple(
                Observation(i, np.array([3.0, i]), R) for i in range(3)))
        yield RobotScan('p', (k + 1) * NS, (RobotObservation('q', np.array([2.0, 1.0]), R),))


def test_one_observation_is_not_enough(smoothed, records):
    first = next(record for record in records if isinstance(record, RobotScan))

    folder = smoothed([r for r in records if r is first or not isinstance(r, RobotScan)], 'one')

    failed, = read(folder, 'alignment')['not_joined']
    assert failed['robots'] == ['p', 'q']
    assert failed['reason'] == 'not enough observations: 1 of the 2 that are needed'
    assert_same_maps(folder, smoothed(without_rendezvous(records), 'alone'))


def test_observations_of_still_robots_do_not_determine_the_heading(smoothed):
    folder = smoothed(standing(), 'standing')

    failed, = read(folder, 'alignment')['not_joined']
    assert failed['reason'].startswith('cannot align: the observed positions lie within')
    assert_same_maps(folder, smoothed(without_rendezvous(standing()), 'alone'))


@pytest.mark.parametrize(('seen', 'reason'), [('p', 'self_sighting'), ('x', 'unknown_robot')])
def test_observations_of_itself_and_unknown_robots_are_rejected(smoothed, records, seen, reason):
    wrong = [
        replace(record, observations=tuple(replace(s, observed=seen) for s in record.observations))
        if isinstance(record, RobotScan) and record.robot == 'p' else record
        for record in records if not (isinstance(record, RobotScan) and record.robot == 'q')]

    folder = smoothed(wrong, 'wrong')

    assert read(folder, 'summary')['counts'][reason] == 9
    assert read(folder, 'alignment')['not_joined'] == []
    assert_same_maps(folder, smoothed(without_rendezvous(records), 'alone'))


def test_observations_of_a_robot_without_odometry_are_rejected(smoothed, records):
    met = min(record.stamp for record in records if isinstance(record, RobotScan))
    gone = [r for r in records if not (r.robot == 'q' and r.stamp >= met)]

    folder = smoothed(gone, 'gone')

    assert read(folder, 'summary')['counts']['other_robot_stale'] == 9
    assert read(folder, 'alignment')['not_joined'] == []
    assert_same_maps(folder, smoothed(without_rendezvous(gone), 'alone'))


def test_an_inconsistent_rendezvous_beside_a_consistent_one_is_reported_and_left_out(
    smoothed, records, capsys,
):
    begin = min(record.stamp for record in records)
    # The distances contradict each other.
    wrong = [
        RobotScan('p', begin, (RobotObservation('q', np.array([9.0, 0.0]), R),)),
        RobotScan('q', begin, (RobotObservation('p', np.array([0.0, 4.0]), R),))]

    folder = smoothed([*wrong, *records], 'wrong')

    failed, = read(folder, 'alignment')['not_joined']
    assert f'a rendezvous of p and q is left out: {failed["reason"]}' in (
        capsys.readouterr().out)
    assert len(read(folder, 'alignment')['maps']) == 1


def test_landmark_outliers_are_gated_and_reported(smoothed, records):
    changed = {}
    for record in records:
        if isinstance(record, Scan) and record.robot == 'p' and record.stamp % (20 * NS) == 0:
            first, *others = record.observations
            off = replace(first, z=first.z + np.array([1.0, 0.0]))
            changed[record.stamp] = replace(record, observations=(off, *others))

    folder = smoothed([
        changed.get(record.stamp, record)
        if isinstance(record, Scan) and record.robot == 'p' else record
        for record in records], 'gated')

    assert len(changed) == 3
    assert read(folder, 'summary')['robots']['p']['refusals'] == {'gated': 3}
    # Chi-square with 3,700 degrees of freedom has a standard deviation of 2.3 %.
    joint, = read(folder, 'alignment')['maps']
    assert joint['chi_square'] == pytest.approx(joint['dof'], rel=0.1)
