# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`doctor` names sensors whose observations contradict their stated pose or beams."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.calibration.sensor_pose import SensorFit
from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.detection.records import RobotLaserScan
from fej_slam_ros.ros.doctor.sensors import findings
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.sim.lidar import true_ranges
from helpers.lasers import NO_WALLS
from helpers.ros import (
    cdr, header, odometry_message, raw, run_verb, TYPES, write_bag, write_parameters)
from helpers.slow import slow

AS_GIVEN = SensorFit(500, 1.0, 1.0, np.zeros(3), True, 1.0, 0.0, 0.0, 50.0, 50.0, False)
WORLD = {'environment': 'posts', 'steps_per_loop': 700, 'loops': 1, 'beams': 360, 'seed': 4}


@pytest.mark.parametrize(
    ('changes', 'expected'),
    [
        ({}, []),
        ({'as_given': 1.9, 'moved': 1.0}, []),
        ({'as_given': 0.0, 'moved': 0.0, 'delayed': 0.0, 'mirrored': 0.0, 'still': 0.0}, []),
        ({'as_given': 1e-12, 'moved': 1e-13, 'pose': np.array([0.3, 0.0, 0.0])}, []),
        ({'as_given': 5.0, 'moved': 1.0, 'delayed': 4.0, 'pose': np.array([0.0, 0.0, 0.2])},
         [('sensor_pose', 'error', '+11.5 degrees')]),
        ({'as_given': 2.5, 'moved': 1.0, 'delayed': 2.4, 'pose': np.array([0.25, 0.0, 0.0])},
         [('sensor_pose', 'warning', '+0.25 m further ahead')]),
        ({'as_given': 5.0, 'moved': 1.0, 'delayed': 4.0, 'pose': np.array([0.3, 0.0, 0.2]),
          'is_determined': False}, [('sensor_pose', 'error', 'circles')]),
        ({'as_given': 5.0, 'moved': 4.0, 'delay': 0.1}, [('sensor_time', 'error', 's too late')]),
        ({'as_given': 5.0, 'moved': 4.0, 'delay': -0.1}, [('sensor_time', 'error', 'too early')]),
        ({'as_given': 1.7, 'moved': 1.7, 'delayed': 1.4, 'delay': 0.3, 'delay_sigmas': 5.0},
         [('sensor_time', 'warning', '0.30 s too late')]),
        ({'as_given': 1.7, 'moved': 1.7, 'delayed': 1.4, 'delay': 0.3, 'delay_sigmas': 3.0}, []),
        ({'as_given': 1.7, 'moved': 1.45, 'delayed': 1.4, 'delay': 0.3, 'delay_sigmas': 5.0}, []),
        ({'as_given': 60.0, 'moved': 50.0, 'delayed': 60.0, 'mirrored': 1.0},
         [('sensor_mirrored', 'error', 'left and right')]),
        ({'as_given': 2.24, 'moved': 2.25, 'delayed': 2.18, 'mirrored': 1.75},
         [('sensor_mirrored', 'error', 'left and right')]),
        ({'as_given': 60.0, 'moved': 50.0, 'delayed': 60.0, 'mirrored': 40.0}, []),
        ({'as_given': 5.0, 'moved': 1.0, 'delayed': 4.0, 'pose': np.array([0.01, 0.0, 0.01])}, []),
        ({'as_given': 60.0, 'moved': 50.0, 'delayed': 60.0, 'still': 1.0},
         [('does_not_move', 'error', 'stay the same')]),
        ({'as_given': 60.0, 'moved': 50.0, 'delayed': 60.0, 'still': 26.0}, []),
        ({'as_given': 60.0, 'moved': 50.0, 'delayed': 60.0, 'bearings_differ': True},
         [('bearings', 'error', 'ranges')]),
    ],
)
def test_what_explains_a_disagreement_is_named(changes, expected):
    found = findings('r1/scan', replace(AS_GIVEN, **changes))

    assert [(finding.name, finding.severity.value) for finding in found] == [
        e[:2] for e in expected]
    for finding, (_, _, part) in zip(findings('r1/scan', replace(AS_GIVEN, **changes)), expected):
        assert part in finding.what


@pytest.mark.parametrize(('given', 'delay', 'expected'), [
    (0.0, 0.1, 'to 0.10'), (0.2, 0.1, 'to 0.30'), (0.0, -0.1, 'to -0.10')])
def test_the_cure_of_late_stamps_is_the_whole_delay_with_its_sign(given, delay, expected):
    fit = replace(AS_GIVEN, as_given=5.0, moved=4.0, delay=delay)

    (finding,) = findings('r1/landmarks', fit, given)

    assert f'sensor_delay of the robot {expected},' in finding.cure


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


@pytest.mark.slow
def test_a_laser_whose_beams_turn_the_other_way_is_named(recorded, tmp_path, capsys):
    def mirror(scan):
        return replace(
            scan, angle_min=-scan.angle_min, angle_max=-scan.angle_max,
            angle_increment=-scan.angle_increment)

    found = of_sensors(changed(recorded, tmp_path / 'bag', mirror), capsys)

    assert [line.split(':')[:3] for line in found] == [
        ['error', f' {robot}/scan', ' sensor_mirrored'] for robot in ('r1', 'r2')]


@pytest.mark.slow
def test_a_laser_that_is_turned_is_named(recorded, tmp_path, capsys):
    def turn(scan):
        return replace(scan, angle_min=scan.angle_min + 0.5, angle_max=scan.angle_max + 0.5)

    found = of_sensors(changed(recorded, tmp_path / 'bag', turn), capsys)

    assert [line.split(':')[2] for line in found] == [' sensor_pose', ' sensor_pose']


def of_a_turning_robot(is_reversed):
    """Return odometry and scans of a robot that turns to and fro; the last beam may be first."""
    posts = np.random.default_rng(7).uniform(-4.0, 4.0, (8, 2))
    discs = np.column_stack([posts + np.sign(posts), np.full(8, 0.1)])
    angles = -np.pi + 2.0 * np.pi / 360 * np.arange(360)
    after = 0.1 / 359 * (np.arange(360)[::-1] if is_reversed else np.arange(360))
    noise = np.random.default_rng(8)
    for ms in range(0, 40_000, 50):
        half = 0.4 * np.sin(ms * 1e-3)
        yield raw('r1/odom', odometry_message(
            ms, quaternion=(0.0, 0.0, np.sin(half), np.cos(half))), ms)
        if ms % 100 == 0:
            headings = 0.8 * np.sin(ms * 1e-3 + after)
            poses = np.column_stack([np.zeros((360, 2)), headings])
            ranges = true_ranges(poses, angles, discs, NO_WALLS) + noise.normal(0.0, 0.01, 360)
            yield raw('r1/scan', replace(
                outgoing.laser_scan(RobotLaserScan('r1', ms * 10**6, LaserScan(
                    ranges, angles[0], angles[1] - angles[0], 0.1 / 359, 0.05, 20.0))),
                header=header(ms, 'r1/base_link')), ms + 110)


@pytest.mark.parametrize('is_reversed', [False, True])
@pytest.mark.parametrize('given', [False, slow(True)])
def test_beams_in_the_reverse_order_of_time_are_named(tmp_path, capsys, is_reversed, given):
    messages = sorted(of_a_turning_robot(is_reversed), key=lambda message: message.received)
    bag = write_bag(tmp_path / 'bag', messages)
    settings = write_parameters(
        tmp_path / 'team.yaml', robots=['r1'], range_sigma=0.01, reversed_beams=given)

    run_verb('doctor', bag, '--params', settings)

    found = [line for line in capsys.readouterr().out.splitlines() if 'reversed_beams' in line]
    if is_reversed == given:
        assert found == []
    else:
        assert found[0].startswith('error: r1/scan: reversed_beams: ')
        assert found[1].endswith(f'set reversed_beams of the detector to {str(not given).lower()}')


@pytest.mark.slow
def test_radius_limits_that_fit_nothing_are_named_with_the_radii(recorded, capsys):
    found = of_sensors(recorded, capsys, min_radius=0.5, max_radius=0.8)

    assert [line.split(':')[2] for line in found] == [' radius_limits', ' radius_limits']
    assert '0.5 to 0.8 m' in found[0]
