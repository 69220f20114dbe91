# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots in child processes that run `robot_process.py`."""

from collections import Counter
from pathlib import Path
import select
import subprocess
import sys

from helpers.processes import start, until

ROBOTS = Path(__file__).with_name('robot_process.py')


class Robots:
    """
    Robots in one process, which publish their messages of a bag.

    Attributes
    ----------
    process : the process
    log : file with a line for each sent message

    """

    def __init__(self, bag, rate, log, *names, on=(), **options):
        self.process = start(
            *on, sys.executable, ROBOTS, bag, rate, log, *names, stdin=subprocess.PIPE, **options)
        self.log = log

    def await_listeners(self):
        """Wait until all their topics have subscribers."""
        until(lambda: select.select([self.process.stdout], [], [], 0.05)[0], lambda: None)
        assert self.process.stdout.readline() == 'ready\n', self.process.communicate()[1]

    def begin(self, at):
        """Start to publish, at the position in a bag that began at a time [s since 1970]."""
        self.process.stdin.write(f'{at!r}\n')
        self.process.stdin.flush()

    def end(self):
        """Wait until all messages are sent."""
        _, errors = self.process.communicate()
        assert self.process.returncode == 0, errors


def sent(*logs):
    """Return the stamps [ns] of the messages sent on each topic."""
    stamps = {}
    for log in logs:
        for line in log.read_text(encoding='utf-8').splitlines():
            topic, stamp = line.split()
            stamps.setdefault(topic, []).append(int(stamp))
    return stamps


def number_sent(*logs):
    """Return how many messages each robot has sent."""
    numbers = Counter()
    for topic, stamps in sent(*logs).items():
        numbers[topic.partition('/')[0]] += len(stamps)
    return numbers
