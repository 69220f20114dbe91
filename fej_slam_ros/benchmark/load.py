# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The load of a large team: messages of its robots, and parameters of its estimator."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from heapq import merge
import math
from operator import attrgetter

import numpy as np

from fej_slam_ros.core.records import NS, Odometry, ordered, Scan
from fej_slam_ros.ros.messages import outgoing, RawMessage, serialize
from fej_slam_ros.ros.parameters import Value
from fej_slam_ros.sim.sensors import odometry, scans, SensorSettings
from fej_slam_ros.sim.world import make_world, World, WorldSettings

LOAD_SEED = 1
#: Loops [m] of robots 1, 3, ... and 2, 4, ..., and the duration of each [s].
LOOP_LENGTHS = (164.45, 145.33)
LOOP_TIME = 60
#: Standard deviations of odometry per square root of a second [m, m, rad], of an observation [m],
#: and of a start pose [m, m, rad].
ODOMETRY_SIGMA = (0.05, 0.05, 0.02)
LANDMARK_SIGMA = (0.1, 0.1)
LOAD_START_SIGMA = [0.01, 0.01, 0.01]
#: Range of the sensors [m]: at least 17 of 500 landmarks are in view.
SENSOR_RANGE = 8.0
#: Scans of each robot per second, at stamps of its odometry, and landmarks in each, the nearest.
SCAN_RATE = SCAN_SIZE = 10


@dataclass(frozen=True)
class Load:
    """Messages of a team."""

    robots: int  #: Number of robots; no two send at the same time
    odometry_rate: int  #: Odometry messages of each robot per second
    landmarks: int = 500  #: Number of landmarks
    seconds: int = 120  #: Duration

    def parameters(self) -> dict[str, Value]:
        """Return the parameters of the estimator, with all start poses."""
        poses = self._world().true_poses
        values: dict[str, Value] = {'robots': [*poses]}
        for name in [*poses][1:]:
            values[f'{name}.start_pose'] = poses[name][0].tolist()
            values[f'{name}.start_sigma'] = LOAD_START_SIGMA
        return values

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages in the order of stamps, which are also the times to send them."""
        world, rng = self._world(), np.random.default_rng(LOAD_SEED)
        sources: list[Iterator[Odometry] | Iterator[Scan]] = []
        for k, name in enumerate(world.robots):
            delay = k * NS // (self.robots * self.odometry_rate)
            own = replace(world, stamps=tuple(stamp + delay for stamp in world.stamps))
            # The robots take turns with their scans, too.
            every = self.odometry_rate // SCAN_RATE
            sources += [
                odometry(own, name, self._sensors().odometry_sigma, rng.spawn(1)[0]),
                self._scans(_at(own, slice(k % every, None, every)), name, rng.spawn(1)[0])]
        records: Iterator[Odometry | Scan] = merge(*sources, key=attrgetter('stamp'))
        for record in records:
            topic, message = outgoing.input_message(record)
            yield RawMessage(topic, message.__msgtype__, record.stamp, serialize(message))

    def _world(self) -> World:
        names = tuple(f'r{k}' for k in range(1, self.robots + 1))
        steps = LOOP_TIME * self.odometry_rate
        world = make_world(WorldSettings(
            'circles', LOOP_LENGTHS, steps, names, self.landmarks,
            loops=-(-self.seconds // LOOP_TIME), rate=self.odometry_rate,
        ), np.random.default_rng(LOAD_SEED))
        return _at(world, slice(self.seconds * self.odometry_rate))

    def _sensors(self) -> SensorSettings:
        x, y, phi = (sigma / math.sqrt(self.odometry_rate) for sigma in ODOMETRY_SIGMA)
        return SensorSettings((x, y, phi), LANDMARK_SIGMA, SENSOR_RANGE)

    def _scans(self, world: World, name: str, rng: np.random.Generator) -> Iterator[Scan]:
        for scan in scans(world, name, self._sensors(), rng):
            nearest = sorted(scan.observations, key=lambda one: math.hypot(*one.z))
            yield replace(scan, observations=ordered(nearest[:SCAN_SIZE]))


def _at(world: World, steps: slice) -> World:
    """Return a world at some of its stamps."""
    return replace(
        world, stamps=world.stamps[steps],
        true_poses={name: poses[steps] for name, poses in world.true_poses.items()})
