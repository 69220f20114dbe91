# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A scan survives the way through a message; a bad message is rejected for its fault."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.detection.records import RobotLaserScan
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.messages.laser import laser_scan, MAX_BEAMS, ScanFault, ScanFaultError
from helpers.lasers import scan_of
from helpers.ros import through_cdr

SCAN = replace(scan_of([2.0, 0.0, 0.2], beams=90), time_increment=0.001)
GOOD = outgoing.laser_scan(RobotLaserScan('r1', 1_500_000_000, SCAN))


def test_a_scan_survives_the_round_trip_through_a_message():
    with_intensities = replace(SCAN, intensities=np.arange(90.0))
    sent = outgoing.laser_scan(RobotLaserScan('r1', 1_500_000_000, with_intensities))

    stamp, scan = laser_scan(through_cdr(sent), 0.0)

    assert stamp == 1_500_000_000
    # Fields of LaserScan are in float32.
    np.testing.assert_allclose(scan.ranges, SCAN.ranges, rtol=1e-7)
    np.testing.assert_array_equal(scan.intensities, np.arange(90.0))
    assert (scan.angle_min, scan.angle_increment, scan.time_increment) == pytest.approx(
        (SCAN.angle_min, SCAN.angle_increment, 0.001), rel=1e-6)


@pytest.mark.parametrize(
    ('changes', 'fault'),
    [
        ({'ranges': np.empty(0, np.float32)}, ScanFault.NO_BEAMS),
        ({'ranges': np.zeros(MAX_BEAMS + 1, np.float32)}, ScanFault.TOO_MANY_BEAMS),
        ({'angle_increment': 0.0}, ScanFault.BAD_ANGLES),
        ({'angle_increment': float('nan')}, ScanFault.BAD_ANGLES),
        # From angle_min towards angle_max the angles increase.
        ({'angle_increment': -GOOD.angle_increment}, ScanFault.BAD_ANGLES),
        ({'angle_increment': 10.0 * GOOD.angle_increment}, ScanFault.BAD_ANGLES),
        ({'angle_min': float('inf')}, ScanFault.BAD_ANGLES),
        # Two turns, all beams at one angle, and an angle that float32 does not resolve.
        ({'angle_increment': 2.0 * GOOD.angle_increment,
          'angle_max': GOOD.angle_min + 2.0 * (GOOD.angle_max - GOOD.angle_min)},
         ScanFault.BAD_ANGLES),
        ({'ranges': np.ones(3, np.float32), 'angle_increment': 0.0, 'angle_max': GOOD.angle_min},
         ScanFault.BAD_ANGLES),
        ({'angle_min': 1e7, 'angle_max': 1e7 + GOOD.angle_max - GOOD.angle_min},
         ScanFault.BAD_ANGLES),
        ({'time_increment': -0.001}, ScanFault.BAD_TIMES),
        ({'time_increment': 1.0}, ScanFault.BAD_TIMES),
        ({'range_max': 0.0}, ScanFault.BAD_LIMITS),
        ({'range_min': float('nan')}, ScanFault.BAD_LIMITS),
        ({'range_min': -0.1}, ScanFault.BAD_LIMITS),
        ({'range_min': GOOD.range_max}, ScanFault.BAD_LIMITS),
    ],
)
def test_a_bad_scan_is_rejected_for_its_fault(changes, fault):
    with pytest.raises(ScanFaultError) as error:
        laser_scan(replace(GOOD, **changes), 0.0)

    assert error.value.fault is fault


@pytest.mark.parametrize(('sec', 'nanosec', 'accepted'), [
    (2**31 - 61, 999_999_999, True), (2**31 - 60, 0, False), (0, 1_000_000_000, False)])
def test_a_stamp_is_a_minute_before_the_last_one_that_a_message_can_carry(sec, nanosec, accepted):
    stamp = replace(GOOD.header.stamp, sec=sec, nanosec=nanosec)
    message = replace(GOOD, header=replace(GOOD.header, stamp=stamp))

    if accepted:
        assert laser_scan(message, 0.0)[0] == sec * 10**9 + nanosec
    else:
        with pytest.raises(ScanFaultError, match='bad_stamp'):
            laser_scan(message, 0.0)


def test_intensities_of_another_number_than_the_ranges_are_none():
    _, scan = laser_scan(replace(GOOD, intensities=np.ones(3, np.float32)), 0.0)

    assert scan.intensities is None


def test_a_clockwise_laser_is_accepted():
    turned = replace(
        GOOD, angle_min=GOOD.angle_max, angle_max=GOOD.angle_min,
        angle_increment=-GOOD.angle_increment)

    assert laser_scan(turned, 0.0)[1].angle_increment < 0.0


@pytest.mark.parametrize('beams', [12, 360, MAX_BEAMS])
def test_an_angle_max_of_one_beam_more_than_the_scan_has_is_accepted(beams):
    step = 2.0 * np.pi / beams

    _, scan = laser_scan(replace(
        GOOD, ranges=np.ones(beams, np.float32), angle_min=0.0, angle_max=2.0 * np.pi,
        angle_increment=step, time_increment=0.0), 0.0)

    assert len(scan.ranges) == beams


def test_scans_of_a_laser_that_turns_follow_each_other_without_a_gap_for_a_given_duration():
    # At 10 Hz, of 90 beams.
    _, scan = laser_scan(GOOD, 0.1)

    assert scan.duration * 1e-9 + scan.time_increment == pytest.approx(0.1)


@pytest.mark.filterwarnings('error')
def test_a_range_that_is_a_signaling_nan_is_no_number_and_gives_no_warning():
    ranges = GOOD.ranges.copy()
    ranges.view(np.uint32)[3] = 0x7F800001

    _, scan = laser_scan(replace(GOOD, ranges=ranges), 0.0)

    assert np.flatnonzero(np.isnan(scan.ranges)).tolist() == [3]
