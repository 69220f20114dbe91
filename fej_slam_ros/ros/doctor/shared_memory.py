# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Shared memory that Fast DDS has left behind: list it, and delete what no process uses.

A process that ends in the regular way deletes its segments and ports, a killed one does not. A
process locks a file beside each segment that it owns and each port that it reads, and the lock
ends with the process. Others may have both open: a segment without its owner has no new content
for them, but a port may get a new reader, which they would miss in a file of their own.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
import fcntl
import os
from pathlib import Path
import re

from fej_slam_ros.errors import UserError

FOLDER = Path('/dev/shm')  # noqa: S108
#: Names of the memory of a segment or port, of its locks (el, sl) and of its semaphore.
FILE_NAME = re.compile(r'(?:sem\.)?(fastrtps_(?:[0-9a-f]{16}|port\d{1,5}))(_el|_sl|_mutex)?')
LOCKS = ('_el', '_sl')


@dataclass(frozen=True, slots=True)
class SharedMemory:
    """A segment or port of Fast DDS."""

    name: str  #: of its memory
    files: tuple[Path, ...]  #: its memory, locks and semaphore
    size: int  #: of all files [bytes]
    is_own: bool  #: whether all files may be deleted by this user
    is_used: bool  #: whether a process owns the segment; reads the port or has it open

    @property
    def is_stale(self) -> bool:
        """Return whether it can be deleted."""
        return self.is_own and not self.is_used


def survey(folder: Path = FOLDER) -> list[SharedMemory]:
    """Return all segments and ports by name."""
    files: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        match = FILE_NAME.fullmatch(path.name)
        if match:
            files.setdefault(match[1], []).append(path)
    opened = {path for path in _opened(folder) if 'port' in path.name}
    return [_surveyed(name, tuple(paths), opened) for name, paths in sorted(files.items())]


def delete(stale: SharedMemory) -> None:
    """Delete the files of a stale segment or port."""
    try:
        for path in stale.files:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise UserError(f'cannot delete {error.filename}: {error.strerror}') from None


def _surveyed(name: str, files: tuple[Path, ...], opened: set[Path]) -> SharedMemory:
    size, is_own, is_used = 0, True, not opened.isdisjoint(files)
    for path in files:
        # Processes that end delete their files.
        with suppress(FileNotFoundError):
            status = path.stat()
            size += status.st_size
            is_own &= os.geteuid() in {0, status.st_uid}
            if is_own and path.name.endswith(LOCKS):
                is_used |= _is_locked(path)
    return SharedMemory(name, files, size, is_own, is_used)


def _is_locked(path: Path) -> bool:
    with path.open('rb') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _opened(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder that processes have in memory, as far as this user may know."""
    for maps in Path('/proc').glob('[0-9]*/maps'):
        with suppress(OSError):
            for line in maps.read_text(errors='replace').splitlines():
                *_, path = line.split(maxsplit=5)
                if path.startswith(f'{folder}/'):
                    yield Path(path)
