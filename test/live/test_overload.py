# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A robot that sends too much does not stop the poses of the others, nor the end of the process.

Two robots drive side by side for some seconds at 50 Hz; r1 sends excessive scans at 10 Hz. Seen
from outside are the predicted poses of r2, the memory of the process and the time of its end.
"""

from pathlib import Path
import re
import signal
from time import monotonic, time

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.pieces import pause
from helpers.optional import optional
from helpers.processes import until
from helpers.records import odometry, scan
from helpers.ros import cloud, meeting, raw, raw_record, write_parameters

live_helpers = optional('helpers.live')
qos = optional('fej_slam_ros.ros.nodes.qos')

pytestmark = pytest.mark.ros

PERIOD_MS = 20
#: Messages of one topic a second that are too many, but which the test can send on a busy machine.
FLOOD = 2000
#: Promised age of a pose [s], beyond which one in twenty may be where others share the machine;
#: poses are due every 0.02 s.
MAX_AGE = 0.2

RNG = np.random.default_rng(1)
POINTS = RNG.uniform(-40.0, 40.0, (5000, 2))


def with_ids(count, first=0):
    """Return a function that makes scans of landmarks with IDs."""
    def message(ms, x):
        z = (POINTS[first:first + count] - [x, 0.0] + RNG.normal(0.0, 0.1, (count, 2))).T
        ids = np.arange(first, first + count)
        return raw('r1/landmarks', cloud(
            {'x': ('f8', z[0]), 'y': ('f8', z[1]), 'id': ('i4', ids)}, ms))
    return message


def without_ids(count):
    """Return a function that makes scans of points without IDs, as a lidar does."""
    def message(ms, _x):
        xy = RNG.uniform(-40.0, 40.0, (2, count))
        return raw('r1/landmarks', cloud({'x': ('f4', xy[0]), 'y': ('f4', xy[1])}, ms))
    return message


def known_and_new(ms, x):
    """Return a scan at the limit, which goes through a map at its limit."""
    first = 500 * (round(x * 10.0) % 5)
    return with_ids(500, first)(ms, x)


def flood(kind):
    """Return a function that makes more messages of r1 within a period, `FLOOD` a second."""
    count = FLOOD * PERIOD_MS // 1000

    def messages(ms, x):
        for k in range(1, count):
            part = k / count - 1.0
            at, seen = ms + part * PERIOD_MS, x + part * PERIOD_MS / 1000.0
            yield raw_record(
                odometry('r1', at, [seen, 0.0, 0.0]) if kind == 'odom'
                else scan('r1', at, [(9000, (20.0 - seen, 0.0))]))
    return messages


class Drive:
    """Two robots that drive in real time, and what is seen of r2."""

    def __init__(self, domain, folder, **values):
        path = write_parameters(
            folder / 'team.yaml', robots=['r1', 'r2'], **{'r2.start_pose': [0.0, -3.0, 0.0]},
            **values)
        self.process = domain.start('estimator', '--ros-args', '--params-file', path)
        self._domain = domain
        self.arrivals = []
        domain.node.create_subscription(
            live_helpers.message_class(live_helpers.POSE), 'r2/predicted_pose', self._arrived,
            qos.best_effort(1000))
        self.reports = []
        domain.node.create_subscription(
            live_helpers.message_class(live_helpers.DIAGNOSTICS), '/diagnostics',
            self.reports.append, qos.best_effort(100))
        domain.until(lambda: self.reports)

    def go(self, make_scan, seconds, make_flood=lambda _ms, _x: ()):
        """Drive, with a scan and more messages of r1 made of the time [ms] and its x."""
        begin = time() * 1000.0
        end = 0
        while end < 1000 * seconds:
            end += PERIOD_MS
            self._domain.until(lambda: time() * 1000.0 >= begin + end)  # noqa: B023
            ms, x = round(begin) + end, end / 1000.0
            self._domain.send(*make_flood(ms, x))
            self._domain.send(*(
                raw_record(odometry(robot, ms, [x, 0.0, 0.0])) for robot in ('r1', 'r2')))
            if end % 100 == 0:
                self._domain.send(raw_record(scan('r2', ms, [(9000, (20.0 - x, 3.0))])))
                self._domain.send(make_scan(ms, x))

    def ages(self):
        """Return the age [s] of the pose of r2 at all times: the longest between two arrivals."""
        arrived, stamps = np.array(self.arrivals).T
        return arrived[1:] - stamps[:-1]

    def memory(self):
        """Return the largest memory of the process so far [MB]."""
        status = Path(f'/proc/{self.process.pid}/status').read_text(encoding='utf-8')
        return int(re.search(r'VmHWM:\s+(\d+)', status)[1]) / 1024.0

    def end_time(self):
        """Interrupt the process; return how long it takes to end [s]."""
        begin = monotonic()
        status, errors = self._domain.finish(self.process, signal.SIGINT)
        assert (status, 'Traceback' in errors) == (0, False), errors
        return monotonic() - begin

    def errors(self, robot='r1'):
        """Return the messages in the diagnostics of a robot at level ERROR."""
        return {
            status.message for report in self.reports for status in report.status
            if status.name.endswith(f': {robot}') and status.level in (2, b'\x02')}

    def values(self, robot='r1'):
        """Return the latest values in the diagnostics of a robot."""
        status = next(s for s in self.reports[-1].status if s.name.endswith(f': {robot}'))
        return {value.key: value.value for value in status.values}

    def _arrived(self, message):
        stamp = message.header.stamp
        self.arrivals.append((time(), stamp.sec + stamp.nanosec * 1e-9))


def test_a_raw_cloud_of_one_robot_is_reported_and_the_poses_of_the_other_go_on(domain):
    domain.estimate(robots=['r1', 'r2'])
    predicted = domain.listen('r2/predicted_pose', live_helpers.POSE)
    reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)

    domain.send(*map(raw_record, meeting()))
    for ms in range(420, 600, 20):
        domain.send(
            *(raw_record(odometry(robot, ms)) for robot in ('r1', 'r2')),
            without_ids(20_000)(ms, 0.0))

    domain.until(lambda: predicted and predicted[-1].header.stamp.nanosec == 580_000_000)
    domain.until(lambda: any(
        'r1 publishes 20,000 points a scan' in status.message
        for report in reports for status in report.status))


def test_odometry_is_handled_in_the_middle_of_a_step(domain, monkeypatch):
    estimator = domain.estimate(robots=['r1', 'r2'])
    predicted = domain.listen('r2/predicted_pose', live_helpers.POSE)
    domain.send(*map(raw_record, meeting()))
    domain.until(lambda: predicted)
    seen = []

    def long_step(self, step):
        """Pause until odometry that is sent during the step has been handled."""
        before = estimator.received
        domain.send(raw_record(odometry('r2', 460)))
        until(lambda: estimator.received > before, pause)
        seen.append(step.stamp)
        return step_of(self, step)

    step_of = Estimator._checked_step  # noqa: SLF001
    monkeypatch.setattr(Estimator, '_checked_step', long_step)
    domain.send(*(raw_record(odometry(robot, 440)) for robot in ('r1', 'r2')))
    domain.until(lambda: seen)

    domain.until(lambda: predicted[-1].header.stamp.nanosec == 460_000_000)


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['odom', 'landmarks'])
def test_a_flood_of_messages_of_one_robot_delays_no_pose_of_another(domain, tmp_path, kind):
    drive = Drive(domain, tmp_path)

    drive.go(with_ids(20), 8, flood(kind))
    ages, memory, errors, end_time = drive.ages(), drive.memory(), drive.errors(), drive.end_time()

    print(  # noqa: T201
        f'{len(ages)} poses, age {np.median(ages):.3f} s, p99'
        f' {np.quantile(ages, 0.99):.3f} s, max {ages.max():.3f} s; {memory:.0f} MB;'
        f' end {end_time:.2f} s; {errors}')
    assert np.quantile(ages, 0.95) < MAX_AGE
    assert memory < 200
    assert end_time < 2.0
    assert any('messages a second on' in message for message in errors)


@pytest.mark.slow
@pytest.mark.parametrize(('make_scan', 'reason', 'sentence', 'max_memory', 'max_end_time'), [
    (with_ids(20), None, '', 200, 2.0),
    (with_ids(5000), 'too_large', 'r1 publishes 5,000 points a scan', 200, 2.0),
    (without_ids(20_000), 'too_large', 'is this a raw cloud?', 200, 2.0),
    (without_ids(500), 'too_many_new', 'without ID matched no landmark', 250, 2.0),
    (with_ids(500), None, '', 250, 2.0),
    (known_and_new, 'overload', 'take longer to process', 900, 2.0)],
    ids=['20', '5000', '20000 without IDs', '500 without IDs', '500', '500 of 2500'])
def test_excessive_scans_of_one_robot_delay_no_pose_of_another(
    domain, tmp_path, make_scan, reason, sentence, max_memory, max_end_time,
):
    drive = Drive(domain, tmp_path)

    drive.go(make_scan, seconds=10)
    ages, memory, errors, values = drive.ages(), drive.memory(), drive.errors(), drive.values()
    end_time = drive.end_time()

    print(  # noqa: T201
        f'{len(ages)} poses, age {np.median(ages):.3f} s, p99'
        f' {np.quantile(ages, 0.99):.3f} s, max {ages.max():.3f} s; {memory:.0f} MB;'
        f' end {end_time:.2f} s; {values}; {errors}')
    assert len(ages) > 450
    assert np.quantile(ages, 0.95) < MAX_AGE
    assert memory < max_memory
    assert end_time < max_end_time
    assert reason is None or int(values[reason]) > 0
    assert any(sentence in message for message in errors) or not sentence
