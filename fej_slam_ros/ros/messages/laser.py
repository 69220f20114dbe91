# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of planar lasers to scans; bad ones are rejected."""

from enum import Enum
import math

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__LaserScan as LaserScanMessage

from fej_slam_ros.core.records import NS
from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.ros.messages.common import from_time, MAX_SECONDS

#: Maximum number of beams of a scan; lasers have at most 6,000.
MAX_BEAMS = 20_000
#: Smallest angle between beams [rad], a tenth of that of any laser.
MIN_INCREMENT = 1e-5
#: Longest scan [s].
MAX_DURATION = 10.0
#: Share of a turn by which a scan may exceed it, and by which its last angle may be off.
ANGLE_TOLERANCE = 0.05


class ScanFault(Enum):
    """Why a scan is rejected."""

    BAD_MESSAGE = 'bad_message'  #: of another type, or not to be decoded
    BAD_STAMP = 'bad_stamp'  #: nanoseconds of a second or more, or close to the last stamp
    NO_BEAMS = 'no_beams'  #: an empty list of ranges
    TOO_MANY_BEAMS = 'too_many_beams'  #: more than `MAX_BEAMS`
    BAD_ANGLES = 'bad_angles'  #: not finite, no increment, or not from angle_min to angle_max
    BAD_TIMES = 'bad_times'  #: a negative time between beams, or longer than `MAX_DURATION`
    BAD_LIMITS = 'bad_limits'  #: range_min or range_max are impossible
    NO_INTENSITIES = 'no_intensities'  #: reflectors are wanted, the scan has no intensities
    TILTED = 'tilted'  #: the laser is neither upright nor upside down
    LATE = 'late'  #: not newer than the scan before


#: What scans with a fault need, in one phrase.
CURES = {
    ScanFault.BAD_MESSAGE:
        'publish sensor_msgs/msg/LaserScan; pointcloud_to_laserscan makes it from the cloud of a'
        ' laser with several layers',
    ScanFault.BAD_STAMP: 'stamp scans with the time of their first beams',
    ScanFault.NO_BEAMS: 'look at the driver of the laser',
    ScanFault.TOO_MANY_BEAMS: f'publish at most {MAX_BEAMS:,} beams',
    ScanFault.BAD_ANGLES:
        'angle_min + angle_increment * (number of beams - 1) must be angle_max, in radians, with a'
        ' negative angle_increment if the laser turns clockwise',
    ScanFault.BAD_TIMES:
        f'give time_increment in seconds, at least 0 and at most {MAX_DURATION:g} s for all beams,'
        ' or set scan_duration of the detector',
    ScanFault.BAD_LIMITS: 'give range_min and a larger range_max, in metres',
    ScanFault.NO_INTENSITIES:
        'switch intensities on in the driver, or set intensity_threshold to 0 to find posts',
    ScanFault.TILTED:
        'correct the static transform of the laser, which must be upright or upside down within'
        ' 0.2 rad',
    ScanFault.LATE:
        'stamp each scan with the time of its first beam; several lasers on one topic need frames'
        ' of their own'}


class ScanFaultError(Exception):
    """A scan is rejected, for a fault."""

    def __init__(self, fault: ScanFault) -> None:
        super().__init__(fault.value)
        self.fault = fault


def laser_scan(message: LaserScanMessage, duration: float) -> tuple[int, LaserScan]:
    """
    Return the stamp [ns] and the content of a message.

    A duration of all beams [s] above 0 replaces that by the time between beams.

    """
    if message.header.stamp.nanosec >= NS or message.header.stamp.sec > MAX_SECONDS:
        raise ScanFaultError(ScanFault.BAD_STAMP)
    ranges, intensities = message.ranges, message.intensities
    if not len(ranges):
        raise ScanFaultError(ScanFault.NO_BEAMS)
    if len(ranges) > MAX_BEAMS:
        raise ScanFaultError(ScanFault.TOO_MANY_BEAMS)
    begin, end, step = message.angle_min, message.angle_max, message.angle_increment
    span, tolerance = step * (len(ranges) - 1), ANGLE_TOLERANCE * 2.0 * math.pi + 2.0 * abs(step)
    # Comparisons with NaN are false.
    if not (abs(step) > MIN_INCREMENT and abs(begin) < 1e3
            and abs(span) < 2.0 * math.pi + tolerance and abs(begin + span - end) < tolerance):
        raise ScanFaultError(ScanFault.BAD_ANGLES)
    time_increment = duration / len(ranges) if duration > 0.0 else float(message.time_increment)
    if not 0.0 <= time_increment * len(ranges) <= MAX_DURATION:
        raise ScanFaultError(ScanFault.BAD_TIMES)
    if not 0.0 <= message.range_min < message.range_max:
        raise ScanFaultError(ScanFault.BAD_LIMITS)
    # Some bits of a NaN count as invalid in a conversion.
    with np.errstate(invalid='ignore'):
        return from_time(message.header.stamp), LaserScan(
            np.asarray(ranges, np.float64), float(begin), float(step),
            time_increment, float(message.range_min), float(message.range_max),
            np.asarray(intensities, np.float64) if len(intensities) == len(ranges) else None)
