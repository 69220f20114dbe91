# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`doctor` names sensors that are not where, or as, what they see says."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.calibration.sensor_pose import SensorFit
from fej_slam_ros.ros.doctor.sensors import findings
from fej_slam_ros.ros.files import bags
from helpers.ros import cdr, run_verb, TYPES, write_bag, write_parameters

AS_GIVEN = SensorFit(500, 1.0, 1.0, np.zeros(3), True, 1.0, 0.0, 50.0)
WORLD = {'environment': 'posts', 'steps_per_loop': 700, 'loops': 1, 'beams': 360, 'seed': 4}


@pytest.mark.parametrize(
    ('changes', 'expected'),
    [
        ({}, []),
        ({'as_given': 1.9, 'moved': 1.0}, []),
        ({'as_given': 5.0, 'moved': 1.0, 'delayed': 4.0, 'pose': np.array([0.0, 0.0, 0.2])},
         [('sensor_pose', 'error', '+11.5 degrees')]),
        ({'as_given': 2.5, 'moved': 1.0, 'delayed': 2.4, 'pose': np.array([0.25, 0.0, 0.0])},
         [('sensor_pose', 'warning', '+0.25 m further ahead')]),
        ({'as_given': 5.0, 'moved': 1.0, 'delayed': 4.0, 'pose': np.array([0.3, 0.0, 0.2]),
          'is_determined': False}, [('sensor_pose', 'error', 'circles')]),
        ({'as_given': 5.0, 'moved': 4.0, 'delay': 0.1}, [('sensor_time', 'error', 's too late')]),
        ({'as_given': 5.0, 'moved': 4.0, 'delay': -0.1}, [('sensor_time', 'error', 'too early')]),
        ({'as_given': 60.0, 'moved': 50.0, 'delayed': 60.0, 'mirrored': 1.0},
         [('sensor_mirrored', 'error', 'left and right')]),
        ({'as_given': 5.0, 'moved': 1.0, 'delayed': 4.0, 'pose': np.array([0.01, 0.0, 0.01])}, []),
    ],
)
def test_what_explains_a_disagreement_is_named(changes, expected):
    found = findings('r1/scan', replace(AS_GIVEN, **changes))

    assert [(finding.name, finding.severity.value) for finding in found] == [
        e[:2] for e in expected]
    for finding, (_, _, part) in zip(findings('r1/scan', replace(AS_GIVEN, **changes)), expected):
        assert part in finding.what


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Return a simulated bag of lasers."""
    folder = tmp_path_factory.mktemp('lasers')
    world = write_parameters(folder / 'world.yaml', **WORLD)
    assert run_verb('simulate', '--params', world, '--output', folder / 'bag') == 0
    return folder / 'bag'


def changed(bag, copy, change):
    """Return a copy of a bag with other scans."""
    def changed_message(message):
        if not message.topic.endswith('/scan'):
            return message
        scan = change(TYPES.deserialize_cdr(message.raw, message.type_name))
        return replace(message, raw=cdr(scan))

    return write_bag(copy, [*map(changed_message, bags.read(bag))])


def of_sensors(bag, capsys, **values):
    """Return the lines of the findings about the sensors of a bag."""
    settings = write_parameters(bag.parent / 'team.yaml', robots=['r1', 'r2'], **values)
    run_verb('doctor', bag, '--params', settings)
    return [line for line in capsys.readouterr().out.splitlines()
            if 'sensor_' in line or 'radius_limits' in line]


def test_scans_of_a_correct_laser_have_no_finding(recorded, capsys):
    assert of_sensors(recorded, capsys) == []


def test_a_laser_whose_beams_turn_the_other_way_is_named(recorded, tmp_path, capsys):
    def mirror(scan):
        return replace(
            scan, angle_min=-scan.angle_min, angle_max=-scan.angle_max,
            angle_increment=-scan.angle_increment)

    found = of_sensors(changed(recorded, tmp_path / 'bag', mirror), capsys)

    assert [line.split(':')[:3] for line in found] == [
        ['error', f' {robot}/scan', ' sensor_mirrored'] for robot in ('r1', 'r2')]


def test_a_laser_that_is_turned_is_named(recorded, tmp_path, capsys):
    def turn(scan):
        return replace(scan, angle_min=scan.angle_min + 0.5, angle_max=scan.angle_max + 0.5)

    found = of_sensors(changed(recorded, tmp_path / 'bag', turn), capsys)

    assert [line.split(':')[2] for line in found] == [' sensor_pose', ' sensor_pose']


def test_radius_limits_that_fit_nothing_are_named_with_the_radii(recorded, capsys):
    found = of_sensors(recorded, capsys, min_radius=0.5, max_radius=0.8)

    assert [line.split(':')[2] for line in found] == [' radius_limits', ' radius_limits']
    assert '0.5 to 0.8 m' in found[0]
