# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""MRPT's range-bearing EKF in C++, where its Debian package and a compiler are installed."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
import subprocess
from typing import Any

import numpy as np

from fej_slam_ros.benchmark import cpp_program
from fej_slam_ros.benchmark.cpp_program import can_build
from fej_slam_ros.benchmark.synthetic_drive import BEARING_SIGMA, RANGE_SIGMA, RobotEstimates
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import Motion, Scan
from fej_slam_ros.errors import UserError

SOURCE = Path(__file__).with_name('mrpt_ekf.cpp')
HEADERS = Path('/usr/include/mrpt')
LIBRARIES = 'mrpt-slam', 'mrpt-obs', 'mrpt-poses', 'mrpt-core'
#: The update with the joint innovation of a scan, and that of one number after the other.
METHODS = 'kfEKFNaive', 'kfEKFAlaDavison'
OBSERVATION = np.dtype([('id', '<i8'), ('range', '<f8'), ('bearing', '<f8')])
REPLY = np.dtype([
    ('nanoseconds', '<i8'), ('pose', '<f8', 3), ('P', '<f8', (3, 3)), ('landmarks', '<i8')])


def is_installed() -> bool:
    """Return whether the program can be built."""
    return can_build(HEADERS)


def built() -> AbstractContextManager[Path]:
    """Build the program; return its path as a context."""
    # Debian has no pkg-config files of MRPT.
    return cpp_program.built(SOURCE, [*HEADERS.glob('*/include')], LIBRARIES)


class Mrpt:
    """
    The EKF of one robot, in a process of its own.

    MRPT knows one covariance for all observations, of range and bearing; those of the scans are
    not used.

    """

    def __init__(self, program: Path, method: str) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - own arguments only
            [program, method, str(RANGE_SIGMA), str(BEARING_SIGMA)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.seconds = 0.0
        self.landmarks = 0  #: number of landmarks in the map

    def insert_robot(self, name: str, stamp: int, pose: Array, P: Array) -> None:
        """Start at a pose with covariance P (3, 3)."""
        self._name = name
        # The first reply comes once the libraries of the process are loaded.
        self._process_step(_gaussian(pose, P) + _gaussian(np.zeros(3), np.zeros((3, 3))), [])

    def step(self, motions: Sequence[Motion], scans: Sequence[Scan]) -> RobotEstimates:
        """Process the measurements of one stamp; return the robot's pose and covariance."""
        (motion,), (scan,) = motions, scans
        z = np.array([s.z for s in scan.observations]).reshape(-1, 2)
        ids = [s.id for s in scan.observations]
        reply = self._process_step(_gaussian(motion.u, motion.Q), [
            *zip(ids, np.hypot(*z.T).tolist(), np.arctan2(z[:, 1], z[:, 0]).tolist())])
        return {self._name: (reply['pose'].copy(), reply['P'].copy())}

    def close(self) -> None:
        """End the process."""
        self._process.communicate()

    def _process_step(
        self, before: bytes, observations: Sequence[tuple[int, float, float]]
    ) -> Any:
        """Send what comes before the observations, and these; return the reply."""
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None and stdout is not None  # noqa: S101, PT018 - both are pipes
        stdin.write(before + np.array(len(observations), '<i8').tobytes()
                    + np.array(observations, OBSERVATION).tobytes())
        stdin.flush()
        data = stdout.read(REPLY.itemsize)
        if len(data) < REPLY.itemsize:
            raise UserError(f'MRPT ended with status {self._process.wait()}')
        (reply,) = np.frombuffer(data, REPLY)
        self.seconds, self.landmarks = 1e-9 * float(reply['nanoseconds']), int(reply['landmarks'])
        return reply


def _gaussian(mean: Array, P: Array) -> bytes:
    return np.concatenate([mean, P.ravel()]).astype('<f8').tobytes()
