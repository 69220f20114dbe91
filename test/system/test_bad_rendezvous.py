# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A meeting that tells too little, or nonsense, is named and leaves the maps as they were."""

from dataclasses import replace
import json

import numpy as np
import pytest

from fej_slam_ros.core.records import NS, Observation, Odometry, RobotObservation, RobotScan, Scan
from fej_slam_ros.experiments.andersson.scenes import scene
from fej_slam_ros.ros.files import bags
from helpers.ros import run_verb, write_parameters

#: The number of x is nobody's.
IDS = {'p': 1, 'q': 2, 'x': 9}
R = 0.01 * np.eye(2)


@pytest.fixture
def smoothed(tmp_path):
    """Return a function that smooths records into a folder of a name and returns that."""
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
    """Return what two robots measured that passed each other."""
    return [*scene('map_joining', 1).records]


def told(folder, name):
    return json.loads((folder / f'{name}.json').read_text())


def alone(records):
    """Return records without any observation of a robot."""
    return [record for record in records if not isinstance(record, RobotScan)]


def assert_same_maps(folder, other, robots=('p', 'q')):
    for name in (*(f'trajectory_{robot}.csv' for robot in robots), 'landmarks.csv'):
        assert (folder / name).read_bytes() == (other / name).read_bytes()


def standing():
    """Return records of robots that stand still: p sees q, and each its own landmarks."""
    for k in range(8):
        for robot in ('p', 'q'):
            yield Odometry(robot, (k + 1) * NS, np.zeros(3), 1e-4 * np.eye(3))
            yield Scan(robot, (k + 1) * NS, tuple(
                Observation(i, np.array([3.0, i]), R) for i in range(3)))
        yield RobotScan('p', (k + 1) * NS, (RobotObservation('q', np.array([2.0, 1.0]), R),))


def test_one_observation_is_not_enough(smoothed, records):
    first = next(record for record in records if isinstance(record, RobotScan))

    folder = smoothed([r for r in records if r is first or not isinstance(r, RobotScan)], 'one')

    failed, = told(folder, 'alignment')['not_joined']
    assert failed['robots'] == ['p', 'q']
    assert failed['reason'] == 'not enough observations: 1 of the 2 that are needed'
    assert_same_maps(folder, smoothed(alone(records), 'alone'))


def test_observations_from_one_spot_to_one_spot_tell_no_heading(smoothed):
    folder = smoothed(standing(), 'standing')

    failed, = told(folder, 'alignment')['not_joined']
    assert failed['reason'].startswith('cannot align: the observed positions lie within')
    assert_same_maps(folder, smoothed(alone(standing()), 'alone'))


@pytest.mark.parametrize(('seen', 'reason'), [('p', 'self_sighting'), ('x', 'unknown_robot')])
def test_a_robot_sees_no_other_than_its_team(smoothed, records, seen, reason):
    wrong = [
        replace(record, observations=tuple(replace(s, seen=seen) for s in record.observations))
        if isinstance(record, RobotScan) and record.robot == 'p' else record
        for record in records if not (isinstance(record, RobotScan) and record.robot == 'q')]

    folder = smoothed(wrong, 'wrong')

    assert told(folder, 'summary')['counts'][reason] == 9
    assert told(folder, 'alignment')['not_joined'] == []
    assert_same_maps(folder, smoothed(alone(records), 'alone'))


def test_a_robot_without_odometry_at_the_time_was_not_met(smoothed, records):
    met = min(record.stamp for record in records if isinstance(record, RobotScan))
    gone = [r for r in records if not (r.robot == 'q' and r.stamp >= met)]

    folder = smoothed(gone, 'gone')

    assert told(folder, 'summary')['counts']['other_robot_stale'] == 9
    assert told(folder, 'alignment')['not_joined'] == []
    assert_same_maps(folder, smoothed(alone(gone), 'alone'))


def test_a_wrong_meeting_of_robots_that_met_another_time_is_told_and_left_out(
    smoothed, records, capsys,
):
    begin = min(record.stamp for record in records)
    # Both cannot be right: they tell of different distances.
    wrong = [
        RobotScan('p', begin, (RobotObservation('q', np.array([9.0, 0.0]), R),)),
        RobotScan('q', begin, (RobotObservation('p', np.array([0.0, 4.0]), R),))]

    folder = smoothed([*wrong, *records], 'wrong')

    failed, = told(folder, 'alignment')['not_joined']
    assert f'of the meetings of p and q is left out: {failed["reason"]}' in capsys.readouterr().out
    assert len(told(folder, 'alignment')['maps']) == 1


def test_a_wrong_observation_of_a_landmark_is_gated_and_told(smoothed, records):
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
    assert told(folder, 'summary')['robots']['p']['refusals'] == {'gated': 3}
    # As good as without: chi-square of 3,700 degrees of freedom has a deviation of 2.3 %.
    joint, = told(folder, 'alignment')['maps']
    assert joint['chi_square'] == pytest.approx(joint['dof'], rel=0.1)
