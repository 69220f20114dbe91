# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Run one verb: parse its arguments, call it, turn its errors into a message and an exit status.

A verb is a module beside this one, listed in VERBS: a docstring, whose first line is its help,
``add_arguments(parser)`` and ``run(arguments)``, which returns the exit status; that of a node is
``main(ros_args)`` of its module in ros/nodes. Only the module of the requested verb is imported,
so ``replay`` works without rclpy and the help is fast.
"""

import ast
from collections.abc import Sequence
import errno
from importlib import import_module
from importlib.resources import files
import inspect
import os
from pathlib import Path
import signal
import sys

from fej_slam_ros import __version__
from fej_slam_ros.atomic_files import disk_error
from fej_slam_ros.cli.parser import Formatter, Parser
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.interrupts import handled, INTERRUPTS, postponed

#: Verbs that are ROS nodes: their arguments are ``--ros-args`` and all that follows.
NODES = ('estimator', 'simulator', 'smoother', 'detector', 'adapter')
#: How nodes are given their arguments.
NODE_ARGUMENTS = 'write --ros-args --params-file FILE, -p NAME:=VALUE or -r __ns:=/NAME'
#: How other verbs with a parameter file are given theirs.
FILE_PARAMETERS = 'parameters are no options: write them into the file of --params'
VERBS = (
    *NODES, 'simulate', 'detect', 'adapt', 'replay', 'smooth', 'evaluate', 'doctor', 'calibrate',
    'play', 'view', 'convert', 'export', 'reproduce', 'benchmark', 'demo')
#: Verbs whose work is that of a node, and those that a signal ends in the regular way.
ENDED_BY_NODE = (*NODES, 'play', 'view')
UNTIL_INTERRUPTED = (*ENDED_BY_NODE, 'demo')
#: Errors of a disk, whatever is written to it.
DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
#: What to do without modules that are not from ROS; ROS 2 has no Debian package of rosbags.
MISSING_MODULES = {
    'rosbags': (
        "run 'rosdep install --from-paths src' in the colcon workspace, or 'pip install rosbags'"),
    'foxglove': "pip install -e '.[foxglove]' in the clone",
    'matplotlib': "pip install -e '.[plot]' in the clone",
    # Since 7.1.4.
    'rclpy.experimental': 'the installed rclpy is too old: apt install ros-jazzy-rclpy',
    # Not on PyPI.
    'tf2_msgs': 'apt install ros-jazzy-tf2-msgs',
    'distributed': "pip install -e '.[dask]' in the clone"}
#: What to do without the others.
NO_ROS = "source ROS 2 Jazzy, or install it from PyPI: pip install -e '.[jazzy]' in the clone"
#: Exit status of the others after a signal, that of a shell for SIGINT.
INTERRUPTED = 130


class SignalInterrupt(KeyboardInterrupt):
    """
    SIGINT or SIGTERM has arrived.

    After a plain KeyboardInterrupt that has passed through exec(), as in the modules of rosbags,
    Python kills itself by SIGINT at its end, although it was handled.

    """


def main() -> int:
    """Run ``fej_slam VERB ...`` and return the exit status."""
    is_module = Path(sys.argv[0]).name == '__main__.py'
    command = 'python3 -m fej_slam_ros' if is_module else 'fej_slam'
    parser = Parser(prog=command, description='SLAM for a team of robots.')
    parser.add_argument('--version', action='version', version=__version__)
    verbs = parser.add_subparsers(dest='verb', metavar='VERB', required=True)
    for verb in VERBS:
        verbs.add_parser(verb, help=_summary(verb), add_help=False)
    # The verb's own parser handles the rest.
    verb = parser.parse_args(sys.argv[1:2] or ['--help']).verb
    return _run(f'{command} {verb}', verb, sys.argv[2:])


def executable() -> int:
    """Run the verb with the name of this executable and return the exit status."""
    verb = Path(sys.argv[0]).stem
    return _run(verb, verb, sys.argv[1:])


def _summary(verb: str) -> str:
    """Return the first line of a verb's docstring without the slow import of its module."""
    source = (files('fej_slam_ros.cli') / f'{verb}.py').read_text(encoding='utf-8')
    return (ast.get_docstring(ast.parse(source)) or '').partition('\n')[0]


def _run(command: str, verb: str, words: list[str]) -> int:
    """Run a verb, which was called by a command."""
    _open_closed_streams()
    # A shell ignores SIGINT in the commands that it runs in the background.
    heeded = [n for n in INTERRUPTS if signal.getsignal(n) is not signal.SIG_IGN]
    try:
        with handled(_end if verb in ENDED_BY_NODE else _interrupt, numbers=heeded):
            # The entry point has blocked them.
            signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTS)
            status = _call(command, verb, words)
            sys.stdout.flush()
            return status
    except BrokenPipeError:
        # Whoever reads the output, such as `head`, has ended.
        _discard_output()
        return 1
    except KeyboardInterrupt:
        return 0 if verb in UNTIL_INTERRUPTED else INTERRUPTED
    except (UserError, OSError, ModuleNotFoundError) as error:
        sentence, status = _explained(error)
        print(f'{command}: {sentence}', file=sys.stderr)
        if isinstance(error, OSError) and error.filename is None:
            _discard_output()
        return status


def _discard_output() -> None:
    """Discard the output that cannot be written, which Python would write once more at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _open_closed_streams() -> None:
    """Discard what is written to standard streams that the caller has closed, as by ``>&-``."""
    for name in 'stdout', 'stderr':
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), 'w'))


def _explained(error: UserError | OSError | ModuleNotFoundError) -> tuple[str, int]:
    """Return the sentence and the exit status of an error; raise one without a known cure."""
    if isinstance(error, UserError):
        return str(error), 2 if isinstance(error, UsageError) else 1
    if isinstance(error, ModuleNotFoundError):
        name = error.name or ''
        cure = MISSING_MODULES.get(name, MISSING_MODULES.get(name.partition('.')[0], NO_ROS))
        return f'the Python module {error.name} is missing: {cure}', 1
    if error.errno == errno.ENAMETOOLONG:
        return f'{error.filename} has a name that is too long: give a shorter path', 2
    if isinstance(error, PermissionError) and error.filename:
        return f'{error.filename} cannot be read: change its permissions', 1
    # Every other file is written by functions that name it.
    if error.errno not in DISK_ERRORS:
        raise error
    where = error.filename or 'to the standard output or a temporary file'
    return str(disk_error(where, error)), 1


def _end() -> None:
    # The node, which handles signals itself, does not exist yet. An exception could get lost among
    # the modules of compiled code that are being imported.
    os._exit(0)


def _interrupt() -> None:
    # Files that are not complete are deleted on the way out.
    raise SignalInterrupt


def _call(command: str, verb: str, words: list[str]) -> int:
    with postponed():
        module = import_module(f'fej_slam_ros.cli.{verb}')
    parser = Parser(
        prog=command, description=inspect.getdoc(module), allow_abbrev=False,
        formatter_class=Formatter)
    module.add_arguments(parser)
    ros = words.index('--ros-args') if verb in NODES and '--ros-args' in words else len(words)
    arguments, unknown = parser.parse_known_args(words[:ros])
    if unknown:
        parser.error(
            f'unrecognized arguments: {" ".join(unknown)}{_cure(verb, parser, unknown)}')
    status: int = (
        import_module(f'fej_slam_ros.ros.nodes.{verb}').main(words[ros:]) if verb in NODES
        else module.run(arguments))
    return status


def _cure(verb: str, parser: Parser, unknown: Sequence[str]) -> str:
    """Return how parameters are given, if unknown arguments may be some."""
    if verb in NODES:
        return f': {NODE_ARGUMENTS}'
    may_be_parameters = any(word.startswith('-') or ':=' in word for word in unknown)
    has_file = '--params' in parser.format_usage()
    return f': {FILE_PARAMETERS}' if may_be_parameters and has_file else ''
