# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is wrong with the times of scans is found from many of them, and no longer than it is."""

import math

import numpy as np
import pytest

from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.ros.session.scan_timing import ScanTiming

MS = 1_000_000


def scan(duration, degrees=360.0, beams=400):
    """Return a scan that takes a time [ms] from the first beam to the one after the last."""
    return LaserScan(
        np.ones(beams), 0.0, math.radians(degrees) / beams, duration * 1e-3 / beams, 0.1, 10.0)


def of_delays(duration, scan_delays, odometry_delays):
    """Return the timing of scans of a duration, after delays of scans and odometry [ms]."""
    timing = ScanTiming()
    for delay in odometry_delays:
        timing.add_odometry(delay * MS)
    for delay in scan_delays:
        timing.add_delay(delay * MS, duration * MS)
    return timing


#: Duration of scans, delays of scans and of odometry [ms], and whether the stamps are named.
STAMPS = {
    'last beams': (100, [5] * 20, [4] * 20, True),
    'last beams, and odometry comes late': (100, [5] * 20, [24] * 20, True),
    'last beams, and odometry without delay': (100, [5] * 20, [0] * 20, True),
    'half of a scan is a delay of odometry': (100, [55] * 20, [4] * 20, False),
    'as short as other delays': (15, [5] * 20, [4] * 20, False),
    'few scans': (100, [5] * 9, [4] * 20, False),
    'little odometry': (100, [5] * 20, [4] * 9, False),
    'a scan that came late': (100, [105] * 12 + [5] * 3, [4] * 20, False)}


@pytest.mark.parametrize('case', STAMPS)
def test_stamps_of_last_beams_are_named(case):
    *delays, is_named = STAMPS[case]

    timing = of_delays(*delays)

    assert ('the stamps of their last beams' in timing.stamp_fault) == is_named
    assert timing.clock_fault == ''


def test_stamps_are_no_longer_named_when_most_of_the_latest_50_scans_are_right():
    wrong, odometry = [5] * 60, [4] * 60

    assert of_delays(100, wrong + [105] * 20, odometry).stamp_fault
    assert not of_delays(100, wrong + [105] * 40, odometry).stamp_fault


def timed(*scans, scan_time=0.0):
    """Return the timing after scans, each with the time to the next [ms]."""
    timing, stamp = ScanTiming(), 0
    for content, interval in scans:
        timing.add('laser', stamp * MS, content, scan_time)
        stamp += interval
    return timing


#: Scans, the time between them [ms], and whether their duration is named.
DURATIONS = {
    'right': (scan(100), 100, False), 'half a turn': (scan(50, degrees=180.0), 100, False),
    'half a turn, and three times too long': (scan(150, degrees=180.0), 100, True),
    'half of the scans are lost': (scan(100), 200, False),
    'five times too long': (scan(500), 100, True),
    'five times too short': (scan(20), 100, True),
    'clockwise and too short': (scan(20, degrees=-360.0), 100, True),
    'a camera, of one moment': (scan(1, degrees=60.0), 100, False)}


@pytest.mark.parametrize('case', DURATIONS)
def test_durations_that_are_not_those_of_the_turn_are_named(case):
    content, interval, is_named = DURATIONS[case]

    assert bool(timed(*[(content, interval)] * 12).fault) == is_named


@pytest.mark.parametrize('duration', [0, 100])
def test_a_duration_is_no_longer_named_when_it_is_right_or_not_stated(duration):
    wrong = [(scan(20), 100)] * 12

    assert timed(*wrong).fault
    assert not timed(*wrong, (scan(duration), 100)).fault


def test_times_between_scans_are_those_of_one_laser():
    timing = ScanTiming()

    for stamp in range(0, 4000, 100):
        for laser, offset in ('front', 0), ('left', 20), ('right', 40):
            timing.add(laser, (stamp + offset) * MS, scan(100), 0.0)
            assert timing.fault == ''


def test_a_pause_of_the_laser_is_not_its_time_of_a_turn():
    assert not timed(*[(scan(100), 100)] * 8, (scan(100), 60_000), *[(scan(100), 100)] * 8).fault
