# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Files of a live run, which a thread writes: no disk can delay or end the run.

Those of `LiveFiles` are the files of `RunFiles`; poses wait in memory while the disk does not take
them.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import Any

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files.run_files import IncompleteError, RunFiles
from fej_slam_ros.ros.published_maps import MapEstimate

#: Period of writing [s]: short, so that the thread never holds the interpreter for long.
FLUSH_PERIOD = 0.1
#: Maximum number of poses that wait in memory: 50 MB, or half an hour of five robots at 10 Hz.
MAX_WAITING_POSES = 100_000
#: Time [s] after which a disk that takes nothing is an error.
SLOW_AFTER = 5.0


class LiveWriter(ABC):
    """
    Writes by a thread until the end of the run.

    Parameters
    ----------
    path : of the file, or of the folder of the files

    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._errors: dict[str, str] = {}
        self._written_at = monotonic()
        self._is_over, self._is_done = Event(), Event()
        # A process can end although a disk keeps its thread.
        Thread(target=self._work, name='files', daemon=True).start()

    @property
    def error(self) -> str:
        """Return why the files are not complete or not up to date, '' if they are."""
        errors = [*self._errors.values()]
        silence = monotonic() - self._written_at
        if not errors and silence > SLOW_AFTER and not self._is_done.is_set():
            return f'{self._path} takes no data for {silence:.0f} s'
        return '; '.join(errors)

    def wait(self, timeout: float) -> str:
        """Wait for the end of writing, at most for a timeout [s]; return what is not complete."""
        if self._is_done.wait(timeout):
            return self.error
        return f'{self._path} is not complete: it is still being written'

    @abstractmethod
    def _flush(self) -> None:
        """Write what waits, or raise a UserError."""

    @abstractmethod
    def _finish(self) -> None:
        """Complete or delete the files at the end of the run."""

    def _work(self) -> None:
        while not self._is_over.wait(FLUSH_PERIOD):
            self._try('disk', self._flush)
        self._try('disk', self._flush)
        self._try('end', self._finish)
        self._is_done.set()

    def _try(self, what: str, work: Callable[[], None]) -> None:
        """Do work; note its error, or that it has none any more."""
        try:
            work()
        except IncompleteError as error:
            is_disk_reported = 'disk' in self._errors
            self._errors[what] = error.consequence if is_disk_reported else str(error)
        except UserError as error:
            self._errors.setdefault(what, str(error))
        else:
            self._errors.pop(what, None)
            self._written_at = monotonic()


class LiveFiles(LiveWriter):
    """
    Files of a live run.

    Parameters
    ----------
    files : the same, written by the thread from now on

    Attributes
    ----------
    folder : of the files
    earlier : the process that was killed before its files in the folder were complete, or ''

    """

    def __init__(self, files: RunFiles) -> None:
        self._files = files
        self.folder, self.earlier = files.folder, files.earlier
        self._new_robots: deque[str] = deque()
        self._poses: deque[PoseEstimate] = deque()
        self._lost = 0
        self._end: Callable[[], None] = self._files.discard
        super().__init__(files.folder)

    @property
    def error(self) -> str:
        errors = [*filter(None, [super().error])]
        if errors and self._poses:
            errors.append(f'{len(self._poses)} poses wait in memory')
        if self._lost:
            errors.append(f'{self._lost} poses are missing in {self.folder}')
        return '; '.join(errors)

    def add_robots(self, robots: Iterable[str]) -> None:
        """Open the files of new robots soon; UsageError if an earlier run has them."""
        self._new_robots.extend(self._files.check_robots(robots))

    def write(self, poses: Iterable[PoseEstimate]) -> None:
        """Append poses; they are lost, and counted, while too many wait."""
        for pose in poses:
            if len(self._poses) < MAX_WAITING_POSES:
                self._poses.append(pose)
            else:
                self._lost += 1

    def discard(self) -> None:
        """Delete the files unless they are to be completed."""
        self._is_over.set()
        self._is_done.wait(SLOW_AFTER)

    def complete(
        self, poses: Iterable[PoseEstimate], maps: Iterable[MapEstimate], shared_ids: bool,
        **contents: Mapping[str, Any],
    ) -> None:
        """Begin to complete the files of an ended run, as `RunFiles.complete_possible` does."""
        self._end = partial(
            self._complete, [*poses], [*maps], shared_ids, **contents)
        self._is_over.set()

    def _finish(self) -> None:
        self._end()

    def _complete(self, poses: Iterable[PoseEstimate], *args: Any, **contents: Any) -> None:
        waiting, self._poses = self._poses, deque()
        self._files.complete_possible([*waiting, *poses], *args, **contents)
        # What the disk had refused is written now.
        self._errors.pop('disk', None)

    def _flush(self) -> None:
        self._files.flush()
        self._open_new_robots()
        while self._poses:
            # That of the next pose may have joined since, and was queued before the pose.
            self._open_new_robots()
            self._files.write([self._poses.popleft()])
        self._files.flush()

    def _open_new_robots(self) -> None:
        while self._new_robots:
            self._files.add_robots([self._new_robots[0]])
            self._new_robots.popleft()
