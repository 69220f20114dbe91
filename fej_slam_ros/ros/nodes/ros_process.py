# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start and end of a process with a node."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
import re
from time import monotonic

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from fej_slam_ros.core.pieces import EndedError
from fej_slam_ros.errors import UsageError
from fej_slam_ros.interrupts import handled
from fej_slam_ros.ros.parameters.yaml_bounds import MAX_PARAMETER_FILE
from fej_slam_ros.ros.parameters.yaml_files import check_for_ros, fault_for

#: Duration [s] after the request of the end for which waiting steps are processed, so that the
#: process ends within two seconds.
MAX_LAST_STEPS_TIME = 0.5
#: Duration [s] after it for which a state hash and maps to publish may be computed.
MAX_FINAL_TIME = 0.8

#: Rules in the arguments of ROS, in whose errors it names the token that its parser misses.
RULE = re.compile(r"Couldn't parse (remap|parameter override) rule: '(.*)'\. Error: ")
RULE_FORMS = {
    'remap': '-r OLD:=NEW, -r __node:=NAME or -r __ns:=/NAME',
    'parameter override': (
        '-p NAME:=VALUE with a value in YAML, in which no list mixes integers and floats')}


class Stop:
    """A request to end the process, which a signal handler may set."""

    def __init__(self) -> None:
        self._set_at: float | None = None
        self._is_urgent = False

    def is_set(self) -> bool:
        """Return whether the end is requested."""
        return self._set_at is not None

    def set(self) -> None:
        """Request the end."""
        if self._set_at is None:
            self._set_at = monotonic()

    def is_overdue(self) -> bool:
        """Return whether no further step is to be processed before the end."""
        return self._lasts_longer_than(MAX_LAST_STEPS_TIME)

    def check_time(self) -> None:
        """Raise EndedError if nothing more is to be computed before the end."""
        if self._lasts_longer_than(MAX_FINAL_TIME):
            raise EndedError

    def is_urgent(self) -> bool:
        """Return whether the end is requested without waiting for other processes."""
        return self._is_urgent

    def set_urgent(self) -> None:
        """Request the end without waiting for other processes."""
        self._is_urgent = True
        self.set()

    def _lasts_longer_than(self, duration: float) -> bool:
        return self._set_at is not None and monotonic() - self._set_at > duration


@contextmanager
def ros(ros_args: Sequence[str]) -> Iterator[Stop]:
    """
    Initialise ROS for the duration of the context; yield the stop request of SIGINT and SIGTERM.

    The handlers of rclpy would shut down at once, before the last steps are published.

    """
    _check_parameter_files(ros_args)
    try:
        rclpy.init(args=list(ros_args), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        # ROS names the line of a file, but neither the parameter nor a cure.
        for path in _parameter_files(ros_args):
            check_for_ros(path)
        raise UsageError(f'ROS does not accept {_refused_argument(error)}') from None
    stopped = Stop()
    with handled(stopped.set, stopped.set_urgent):
        try:
            yield stopped
        finally:
            try_shutdown()


def warn_of_parameter_files(ros_args: Sequence[str], node: Node) -> None:
    """Warn of what is wrong with parameter files, such as that none of it is for a node."""
    for path in _parameter_files(ros_args):
        if fault := fault_for(path, node.get_fully_qualified_name()):
            node.get_logger().warning(fault)


def first_line(error: Exception) -> str:
    """Return the text of an error of ROS, without the places in its sources."""
    return str(error).strip().splitlines()[0].partition(', at /')[0].rstrip(':')


def _check_parameter_files(ros_args: Sequence[str]) -> None:
    # The error of rcl is several lines long.
    for path in _parameter_files(ros_args):
        if not path.is_file():
            fault = 'is a folder' if path.is_dir() else 'does not exist'
            raise UsageError(f'{path} {fault}: give the path of a ROS parameter file')
        # rcl would read it for minutes.
        if path.stat().st_size > MAX_PARAMETER_FILE:
            raise UsageError(
                f'{path} is larger than {MAX_PARAMETER_FILE:,} bytes: give the path of a ROS'
                ' parameter file')


def _parameter_files(ros_args: Sequence[str]) -> list[Path]:
    return [Path(path) for option, path in pairwise(ros_args) if option == '--params-file']


def _refused_argument(error: Exception) -> str:
    """Return the argument that ROS refuses, and its form or the reason."""
    text = first_line(error)
    rule = RULE.search(text)
    return f'{rule[2]!r}: write {RULE_FORMS[rule[1]]}' if rule else f'its arguments: {text}'
