# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small sets in the form of MRCLAM, written by tests."""

from pathlib import Path

from fej_slam_ros.datasets.mrclam.conversion_options import ConversionOptions

#: Some of the real bar codes: the codes of 8, 2 and 17 are IDs of other subjects.
BARCODES = [(1, 5), (2, 14), (3, 41), (4, 32), (5, 23), (8, 7), (14, 61), (17, 16), (18, 9)]
LANDMARKS = [(8, 2.0, 1.0, 0.0, 0.0), (17, 3.0, -1.0, 0.0, 0.0), (18, 1.0, 2.0, 0.0, 0.0)]

#: One robot drives a metre in ten seconds and sees landmark 8 at the beginning and the end.
STRAIGHT = {
    'Robot1_Odometry': [(100.0 + k, 0.1, 0.0) for k in range(11)],
    'Robot1_Measurement': [(101.0, 7, 2.0, 0.5), (110.0, 7, 1.5, 0.7)],
}

#: The motion is that of the commands, and images have no delay.
EXACT = ConversionOptions(
    motion_delay=0.0, camera_delay=0.0, odometry_scale=(1.0, 1.0), slowdown=0.0, thin=0.0,
    correlation_factor=1.0)


def write_set(folder: Path, files: dict[str, list[tuple[object, ...]]]) -> Path:
    """Write rows into the files of a set; bar codes and landmarks by default."""
    folder.mkdir(exist_ok=True)
    known = {'Barcodes': BARCODES, 'Landmark_Groundtruth': LANDMARKS}
    for name, rows in {**known, **files}.items():
        lines = ['# UTIAS Multi-Robot Cooperative Localization and Mapping Dataset']
        lines += [' \t '.join(map(str, row)) for row in rows]
        (folder / f'{name}.dat').write_text('\n'.join(lines) + '\n')
    return folder
