# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long runs through all that a node does but DDS: what grows, and how long steps take."""

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
from fej_slam_ros.ros.session.diagnostics import EstimatorDiagnostics
from fej_slam_ros.ros.session.estimator_session import EstimatorSession

ROBOTS = ('r1', 'r2', 'r3', 'r4', 'r5')
ODOMETRY_RATE, SCAN_RATE = 10, 5
#: Robots at 1 m/s on loops of 160 m, which see some 16 landmarks at a time.
STEPS_PER_LOOP = 1640
WORLD = {
    'robots': ROBOTS, 'landmarks': 300, 'rate': float(ODOMETRY_RATE), 'range': 10.0,
    'steps_per_loop': STEPS_PER_LOOP, 'odometry_sigma': (0.02, 0.02, 0.005),
    'landmark_sigma': (0.1, 0.1)}
MINUTE = 60 * NS


@dataclass(frozen=True)
class Minute:
    """
    One simulated minute.

    Attributes
    ----------
    number : which minute of the run, from 1
    landmarks : how many are in ``map`` at its end
    steps : how many it had
    median, p99, longest : times of a step [s], its publications included
    memory : resident size of the process at its end [bytes]

    """

    number: int
    landmarks: int
    steps: int
    median: float
    p99: float
    longest: float
    memory: int


def soak(minutes: int) -> list[Minute]:
    """Return what became of each of so many simulated minutes of five robots, as they passed."""
    run = EstimatorSession(parameters.parse({'robots': ROBOTS}), None)
    diagnostics = EstimatorDiagnostics(run.estimator, run.inputs)
    passed: list[Minute] = []
    times: list[float] = []
    due = simulation.FIRST_STAMP + NS
    for message in tqdm(_messages(minutes), unit='msg', disable=None):
        now = message.received or 0
        run.receive(message)
        times += _step_times(run)
        if now < due:
            continue
        for _, told in [*run.outputs.maps_and_paths(lambda _: True), diagnostics.report(now, False)]:
            serialize(told)
        due += NS
        if (now - simulation.FIRST_STAMP) % MINUTE == 0:
            passed.append(_minute(len(passed) + 1, run, times))
            times.clear()
    return passed


def _messages(minutes: int) -> Iterator[RawMessage]:
    """Yield what the robots send in so many minutes, with a scan at every other odometry."""
    loops = -(-60 * minutes * ODOMETRY_RATE // STEPS_PER_LOOP)
    end = simulation.FIRST_STAMP + minutes * MINUTE
    for record in simulation.parse({**WORLD, 'loops': loops}).records():
        if record.stamp > end:
            return
        if not isinstance(record, Scan) or record.stamp % (NS // SCAN_RATE) == 0:
            topic, message = outgoing.input_message(record)
            yield RawMessage(topic, message.__msgtype__, record.stamp, serialize(message))


def _step_times(run: EstimatorSession) -> list[float]:
    """Do the step that is due, if any, and return how long that took."""
    begin = perf_counter()
    published = [serialize(message) for _, message in run.take()]
    return [perf_counter() - begin] if published else []


def _minute(number: int, run: EstimatorSession, times: list[float]) -> Minute:
    pages = int(Path('/proc/self/statm').read_text(encoding='ascii').split()[1])
    team = run.estimator.maps()[0]
    return Minute(
        number, len(team) + team.tentative, len(times), float(np.median(times)),
        float(np.percentile(times, 99)), max(times), pages * os.sysconf('SC_PAGE_SIZE'))
