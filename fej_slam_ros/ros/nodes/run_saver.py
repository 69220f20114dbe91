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
from fej_slam_ros.ros.nodes.node_files import NodeFiles
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
        if self._files.is_saving:
            return
        if self._is_autosaving:
            self._is_autosaving = False
            self._log_autosave(period)
        begin = monotonic()
        if not period or begin < self._next_save:
            return
        self._is_autosaving = True
        try:
            self._files.begin_checkpoint(self._session().checkpoint_content())
        except UserError as error:
            self._files.note('checkpoint', str(error))
        self._next_save = max(
            begin + period, monotonic() + MIN_WORK_SHARE * (monotonic() - begin))

    def save_last(self) -> None:
        """Begin the checkpoint of the end of a run."""
        with suppress(UserError):
            self._files.begin_last_checkpoint(self._session().checkpoint_content())

    def save(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answer a request of the service ``~/save``."""
        try:
            self._files.save_checkpoint(self._session().checkpoint_content())
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
