# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of the runs of a node: no disk delays or ends a run, and what fails is logged."""

from collections.abc import Callable, Iterable, Sequence
from concurrent import futures
from itertools import count
from pathlib import Path
from threading import Thread
from time import monotonic

from rclpy.impl.rcutils_logger import RcutilsLogger

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files.checkpoint_writer import CheckpointWriter
from fej_slam_ros.ros.files.exchange_file import ExchangeFile, LiveExchangeFile
from fej_slam_ros.ros.files.live_files import LiveFiles
from fej_slam_ros.ros.files.run_files import RunFiles

#: Longest wait [s] for the files of a run that is reset, and for a checkpoint on request: for
#: that time nothing is published.
REQUEST_WAIT = 1.0
#: Longest wait [s] for files at the end of a run that no other follows.
END_WAIT = 20.0


class NodeFiles:
    """
    Files of the parameters ``output``, ``checkpoint`` and ``exchange_file``.

    Attributes
    ----------
    checkpoint : writes checkpoints, None if there is no file for them
    has_failed : whether files of any run are not complete

    """

    def __init__(self, log: RcutilsLogger) -> None:
        self._log = log
        self._run: LiveFiles | None = None
        self._ended: list[LiveFiles] = []
        self._is_first = True
        self._notes: dict[str, str] = {}
        self._logged: set[str] = set()
        self.checkpoint: CheckpointWriter | None = None
        self._exchange: LiveExchangeFile | None = None
        self.has_failed = False

    def open(
        self, folder: Path, robots: Iterable[str], force: bool | None,
        others: Sequence[str] = (),
    ) -> LiveFiles | None:
        """Open the files of a run; None if a run after a reset must do without."""
        names = [*robots]

        def make() -> LiveFiles:
            return LiveFiles(RunFiles(folder, names, force, others))

        if self._is_first:
            self._run = make()
        else:
            try:
                self._run = _made_in_time(make, folder)
            except UserError as error:
                self.has_failed = True
                self.note('output', str(error))
                return None
        if self._run.earlier:
            self._log.info(
                f'the incomplete files in {folder}, of {self._run.earlier}, are replaced')
        return self._run

    def open_checkpoint(self, path: str) -> None:
        """Lock the file for checkpoints, unless its name is empty."""
        self.checkpoint = CheckpointWriter(Path(path)) if path else None

    def open_exchange(self, path: Path, robot: str) -> LiveExchangeFile:
        """Open the file of the exchange of a robot; a run after a reset continues it."""
        if self._exchange is None:
            file = ExchangeFile(path, robot)
            if file.blocks:
                size = sum(len(block.content) for block in file.blocks)
                self._log.info(f'processing {size / 1e6:.1f} MB of measurements in {path}')
            self._exchange = LiveExchangeFile(file)
        return self._exchange

    @property
    def _writers(self) -> dict[str, CheckpointWriter | LiveExchangeFile]:
        """Return what writes the files other than those of the output, by parameter."""
        found = {'checkpoint': self.checkpoint, 'exchange_file': self._exchange}
        return {name: writer for name, writer in found.items() if writer is not None}

    def begin(self, is_first: bool) -> None:
        """Begin a run, before its files are opened; only the first run cannot do without them."""
        self._notes.clear()
        self._is_first = is_first

    def note(self, name: str, error: str) -> None:
        """Note why the file of a parameter cannot be written in this run."""
        self._notes[name] = error

    def end(self, timeout: float) -> None:
        """Wait for the files of the run, which end; remember them if they are not complete."""
        if self._run is not None and self._run.wait(timeout):
            self._ended.append(self._run)
        self._run = None

    def close(self) -> None:
        """End the last run; its files were completed or discarded."""
        self.end(REQUEST_WAIT)
        if self.checkpoint is not None:
            self.checkpoint.close()
        self.checkpoint = None
        if self._exchange is not None:
            self._exchange.finish()
            self._exchange.wait(REQUEST_WAIT)
        self._exchange = None
        self._ended.clear()

    def errors(self) -> dict[str, str]:
        """Return what is not complete or not up to date, by parameter."""
        output = [files.wait(0.0) for files in self._ended]
        if self._run is not None:
            output.append(self._run.error)
        of_writers = {name: [writer.error] for name, writer in self._writers.items()}
        found = {
            name: '; '.join(filter(None, dict.fromkeys([*errors, self._notes.get(name)])))
            for name, errors in {'output': output, 'checkpoint': [], **of_writers}.items()}
        return {name: error for name, error in found.items() if error}

    def check(self) -> dict[str, str]:
        """Log new errors, and those that are over; return the present ones."""
        errors = self.errors()
        for name in sorted(errors.keys() - self._logged):
            self._log.error(f'{errors[name]}; the run goes on')
        for name in sorted(self._logged - errors.keys()):
            self._log.info(f'the files of {name!r} are written again')
        self._logged = {*errors}
        return errors

    def finish(self) -> bool:
        """Wait for all files at the end; log what is not complete; return whether all is."""
        deadline = monotonic() + END_WAIT
        if self._exchange is not None:
            self._exchange.finish()
        self.end(END_WAIT)
        for files in self._ended:
            files.wait(max(0.0, deadline - monotonic()))
        waited = {
            name: writer.wait(max(0.0, deadline - monotonic()))
            for name, writer in self._writers.items()}
        errors = {name: error for name, error in (waited | self.errors()).items() if error}
        self.has_failed |= bool(errors)
        for error in errors.values():
            self._log.error(f'files are not complete: {error}')
        return not errors


def next_folder(output: str) -> str:
    """Return a new folder for the files of a further run with an output, '' for no files."""
    folders = (f'{output}_{number}' for number in count(2))
    return output and next(filter(_is_free, folders))


def _is_free(folder: str) -> bool:
    try:
        return not Path(folder).exists()
    except OSError:
        # The reason is reported where its files are opened.
        return True


def _made_in_time(make: Callable[[], LiveFiles], folder: Path) -> LiveFiles:
    """Return the files that a thread makes; UserError if it fails or the disk keeps it waiting."""
    made: futures.Future[LiveFiles] = futures.Future()

    def work() -> None:
        try:
            made.set_result(make())
        except UserError as error:
            made.set_exception(error)

    Thread(target=work, name='opening', daemon=True).start()
    try:
        return made.result(REQUEST_WAIT)
    except futures.TimeoutError:
        made.add_done_callback(_discard)
        raise UserError(
            f'cannot write to {folder}: its disk takes no data: choose a path on another disk'
        ) from None


def _discard(made: futures.Future[LiveFiles]) -> None:
    """Discard files that were made too late."""
    if not made.exception():
        made.result().discard()
