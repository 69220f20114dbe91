# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long runs through all parts of a node but DDS: growth of memory, and step times."""

from collections.abc import Iterator
from dataclasses import dataclass
import os
from pathlib import Path
from time import perf_counter

import numpy as np
from tqdm import tqdm

from fej_slam_ros.core.records import NS, Scan
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.messages import outgoing, RawMessage, serialize
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.percentiles import percentiles

SOAK_ROBOTS = ('r1', 'r2', 'r3', 'r4', 'r5')
ODOMETRY_RATE, SCAN_RATE = 10, 5
#: Robots at 1 m/s on loops of 160 m, with about 16 landmarks in view.
STEPS_PER_LOOP = 1640
SOAK_WORLD = {
    'robots': SOAK_ROBOTS, 'landmarks': 300, 'rate': float(ODOMETRY_RATE), 'range': 10.0,
    'steps_per_loop': STEPS_PER_LOOP, 'odometry_sigma': (0.02, 0.02, 0.005),
    'landmark_sigma': (0.1, 0.1)}
MINUTE = 60 * NS


@dataclass(frozen=True)
class SoakMinute:
    """One simulated minute."""

    number: int  #: Minute of the run, from 1
    landmarks: int  #: Number of landmarks in ``map`` at its end
    steps: int  #: Number of its steps
    #: Times of a step [s], including its publications.
    median: float
    p99: float
    longest: float
    memory: int  #: Resident size of the process at its end [bytes]


def soak(minutes: int) -> list[SoakMinute]:
    """Run five robots for some simulated minutes and return the statistics of each minute."""
    run = EstimatorSession(parameters.parse({'robots': SOAK_ROBOTS}), None)
    finished: list[SoakMinute] = []
    times: list[float] = []
    due = simulation.FIRST_STAMP + NS
    for message in tqdm(_messages(minutes), unit='msg', disable=None):
        now = message.received or 0
        run.receive(message)
        times += _step_times(run)
        if now < due:
            continue
        maps = run.outputs.maps_and_paths()
        for _, output in [*maps, run.diagnostics.report(now, False)]:
            serialize(output)
        due += NS
        if (now - simulation.FIRST_STAMP) % MINUTE == 0:
            finished.append(_minute(len(finished) + 1, run, times))
            times.clear()
    return finished


def _messages(minutes: int) -> Iterator[RawMessage]:
    """Yield the messages of the robots, with a scan at every other odometry."""
    loops = -(-60 * minutes * ODOMETRY_RATE // STEPS_PER_LOOP)
    end = simulation.FIRST_STAMP + minutes * MINUTE
    for record in simulation.parse({**SOAK_WORLD, 'loops': loops}).records():
        if record.stamp > end:
            return
        if not isinstance(record, Scan) or record.stamp % (NS // SCAN_RATE) == 0:
            topic, message = outgoing.input_message(record)
            yield RawMessage(topic, message.__msgtype__, record.stamp, serialize(message))


def _step_times(run: EstimatorSession) -> list[float]:
    """Make the step that is due, if any, and return its time."""
    begin = perf_counter()
    published = [serialize(message) for _, message in run.take()]
    return [perf_counter() - begin] if published else []


def _minute(number: int, run: EstimatorSession, times: list[float]) -> SoakMinute:
    pages = int(Path('/proc/self/statm').read_text(encoding='ascii').split()[1])
    team = run.estimator.maps()[0]
    of_steps = percentiles(np.array(times))
    return SoakMinute(
        number, len(team) + team.tentative, len(times), of_steps.median, of_steps.p99,
        of_steps.longest, pages * os.sysconf('SC_PAGE_SIZE'))
