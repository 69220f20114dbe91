# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checkpoints of the run of a node: on request, periodically and at its end."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic

from rclpy.impl.rcutils_logger import RcutilsLogger
from std_srvs.srv import Trigger

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.nodes.node_files import NodeFiles, REQUEST_WAIT
from fej_slam_ros.ros.session.session import Session

#: Minimum ratio of the time between two periodic checkpoints to that of making one, for which
#: the node does nothing else.
MIN_WORK_SHARE = 10.0


class RunSaver:
    """Saves the session of a node."""

    def __init__(
        self, log: RcutilsLogger, files: NodeFiles, session: Callable[[], Session]
    ) -> None:
        self._log = log
        self._files = files
        self._session = session
        self._next_save = monotonic()
        self._is_autosaving = self._has_autosaved = False

    def work(self, period: float) -> None:
        """Begin a checkpoint once in a period [s] above 0; log that the last one is written."""
        writer = self._files.checkpoint
        if writer is not None and writer.is_busy:
            return
        if self._is_autosaving:
            self._is_autosaving = False
            self._log_autosave(period)
        begin = monotonic()
        if not period or begin < self._next_save:
            return
        self._is_autosaving = True
        try:
            content = self._session().checkpoint_content()
            if writer is not None:
                writer.begin(content)
        except UserError as error:
            self._files.note('checkpoint', str(error))
        self._next_save = max(
            begin + period, monotonic() + MIN_WORK_SHARE * (monotonic() - begin))

    def save_last(self) -> None:
        """Begin the checkpoint of the end of a run, after one that is being written."""
        writer = self._files.checkpoint
        with suppress(UserError):
            content = self._session().checkpoint_content()
            if writer is not None:
                error = writer.wait(REQUEST_WAIT)
                if not writer.begin(content):
                    self._files.note('checkpoint', error)

    def save(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answer a request of the service ``~/save``."""
        try:
            content = self._session().checkpoint_content()
            if self._files.checkpoint is not None:
                self._files.checkpoint.save(content, REQUEST_WAIT)
            path = Path(self._session().settings.node.checkpoint)
            self._log.info(f'checkpoint written to {path}')
            response.message = f'saved to {path}'
            response.success = True
        except UserError as error:
            response.message = str(error)
        return response

    def _log_autosave(self, period: float) -> None:
        if 'checkpoint' not in self._files.errors():
            path = self._session().settings.node.checkpoint
            # Every later one would be a line per period.
            if self._has_autosaved:
                self._log.debug(f'checkpoint written to {path}')
            else:
                self._log.info(f'checkpoint written to {path}, again every {period:g} s')
            self._has_autosaved = True
