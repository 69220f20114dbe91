# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Locks by which two processes never write to the same file or folder.

The kernel releases a lock with its process, whatever ends that. Its file names the process; one
that a killed process has left is taken over.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
import fcntl
import os
from pathlib import Path
import socket

from fej_slam_ros.atomic_files import make_folder, refuse_existing, writing
from fej_slam_ros.errors import UsageError, UserError

#: Longest description of a process in the file of a lock [bytes].
MAX_OWNER = 500


class InUseError(UserError):
    """Another run writes to the file or folder."""


class OutputLock:
    """
    The right to write to a file or folder, until the end of the context or of the process.

    Raises InUseError if another run has it.

    Attributes
    ----------
    earlier : the process that had the lock and was killed, '' if there was none

    """

    def __init__(self, output: Path, path: Path) -> None:
        self._path = path
        with writing(output):
            self._has_made_folder = not path.parent.exists()
        make_folder(path.parent)
        with writing(output):
            self._file = _opened(path)
            while not _is_locked(self._file, output):
                # It was deleted by its owner meanwhile.
                os.close(self._file)
                self._file = _opened(path)
            self.earlier = _owner(self._file)
        self._is_held = True
        self._sign(output)

    @classmethod
    def of_file(cls, path: Path) -> 'OutputLock':
        """Lock a file, or the folder of a bag; UsageError if the path has no name to lock."""
        if not path.name:
            raise UsageError(f"'{path}' is not the name of a file to write: give one")
        return cls(path, path.with_name(f'.{path.name}.lock'))

    @classmethod
    def of_folder(cls, folder: Path) -> 'OutputLock':
        """Lock a folder for files; UsageError if it is a file, or a rosbag2 with other files."""
        with writing(folder):
            is_file, is_bag = folder.is_file(), (folder / 'metadata.yaml').exists()
        if is_file:
            raise UsageError(f'{folder} is a file: choose a folder for the results')
        if is_bag:
            raise UsageError(f'{folder} is a rosbag2: choose another folder for the results')
        return cls(folder, folder / '.lock')

    def __enter__(self) -> 'OutputLock':
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Give the right to others."""
        if self._is_held:
            self._is_held = False
            with suppress(OSError):
                self._path.unlink(missing_ok=True)
            os.close(self._file)
            if self._has_made_folder:
                # It stays if there is anything in it.
                with suppress(OSError):
                    self._path.parent.rmdir()

    def _sign(self, output: Path) -> None:
        since = datetime.now(timezone.utc).astimezone().isoformat(' ', 'seconds')
        text = f'process {os.getpid()} on {socket.gethostname()} since {since}'
        try:
            with writing(output):
                os.ftruncate(self._file, 0)
                os.pwrite(self._file, text.encode()[:MAX_OWNER], 0)
        except UserError:
            self.release()
            raise


@contextmanager
def claimed(path: Path | None, force: bool) -> Iterator[None]:
    """Hold the right to write a file, which may only exist if forced; None is no file."""
    if path is None:
        yield
        return
    with OutputLock.of_file(path):
        refuse_existing([path], force)
        yield


def _opened(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT, 0o666)


def _is_locked(file: int, output: Path) -> bool:
    """Lock an open file; return whether it still has its name. InUseError: another one has it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        owner = _owner(file)
        os.close(file)
        raise InUseError(
            f'{output} is in use by {owner or "another process"}: choose another path, or wait for'
            ' the end of that run') from None
    return os.fstat(file).st_nlink > 0


def _owner(file: int) -> str:
    return os.pread(file, MAX_OWNER, 0).decode(errors='replace').strip()
