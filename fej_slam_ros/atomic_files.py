# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Writers of text, CSV, JSON and figures: a file appears complete or not at all.

They raise UserError, with the path, the reason and a cure, if a file cannot be written.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack, suppress
import csv
import errno
from io import BytesIO, StringIO
import json
import os
from pathlib import Path
from typing import Any

from fej_slam_ros.errors import UsageError, UserError

#: Size of the buffered text [bytes] at which a writer of rows flushes.
BUFFER_SIZE = 1 << 16
#: What to do about errors of file systems, by number.
CURES = {
    errno.ENOSPC: 'free space there, or choose a path on another disk',
    errno.EDQUOT: 'free space there, or choose a path on another disk',
    errno.EROFS: 'choose a path on a disk that can be written',
    errno.EFBIG: 'raise the limit of file sizes (ulimit -f), or choose another path',
    errno.ENOENT: 'its folder was removed or unmounted: choose another path'}
OTHER_CURE = 'choose a path that can be written'


def short_path(path: Path) -> Path:
    """Return an absolute path, or one relative to the current folder if it is below that."""
    absolute, here = path.resolve(), Path.cwd()
    return absolute.relative_to(here) if here in absolute.parents else absolute


def refuse_existing(paths: Iterable[Path], force: bool | None) -> None:
    """Raise UsageError if a file or folder exists, unless forced; None: there is no --force."""
    for path in paths:
        refuse_special(path)
        with writing(path):
            exists = path.exists()
        if exists and not force:
            other = ', or remove it' if force is None else ', or --force to replace it'
            raise UsageError(f'{path} exists: choose another path{other}')


def refuse_special(path: Path) -> None:
    """Raise UsageError for a device, pipe or socket, which a file would replace."""
    with writing(path):
        is_special = path.exists() and not path.is_file() and not path.is_dir()
    if is_special:
        raise UsageError(f'{path} is a device, pipe or socket: choose the path of a file')


def make_folder(path: Path) -> None:
    """Create a folder and its parents if they do not exist."""
    with writing(f'to {path}'):
        path.mkdir(parents=True, exist_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write or replace a text file."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write or replace a file."""
    with PartFile(path) as part:
        part.write(content)
        part.keep()


def write_all(contents: Mapping[Path, bytes]) -> None:
    """
    Write or replace some files, all or none: those of two runs would contradict each other.

    The caller postpones signals.
    """
    made = [folder for folder in {path.parent for path in contents} if not folder.exists()]
    try:
        with ExitStack() as stack:
            parts = [stack.enter_context(PartFile(path)) for path in contents]
            for part, content in zip(parts, contents.values()):
                part.write(content)
                part.flush()
            for part in parts:
                part.keep()
    finally:
        for folder in made:
            # It stays if there is anything in it.
            with suppress(OSError):
                folder.rmdir()


def csv_bytes(rows: Iterable[Sequence[object]]) -> bytes:
    """Return the content of a CSV file of rows of cells."""
    text = StringIO()
    csv.writer(text, lineterminator='\n').writerows(rows)
    return text.getvalue().encode()


def json_bytes(content: Any) -> bytes:
    """Return the content of a JSON file."""
    return f'{json.dumps(content, indent=2)}\n'.encode()


def write_csv(path: Path, rows: Iterable[Sequence[object]]) -> None:
    """Write or replace a CSV file of rows of cells."""
    write_bytes(path, csv_bytes(rows))


def write_json(path: Path, content: Any) -> None:
    """Write or replace a JSON file."""
    write_bytes(path, json_bytes(content))


def write_figure(path: Path, draw: Callable[..., None], *content: Any) -> None:
    """Write or replace a picture, drawn by a function of a binary file and the content."""
    write_bytes(path, figure(draw, *content))


def figure(draw: Callable[..., None], *content: Any) -> bytes:
    """Return a picture, drawn by a function of a binary file and the content."""
    picture = BytesIO()
    draw(picture, *content)
    return picture.getvalue()


class PartFile:
    """
    A file that gets its name when it is complete; until then it is ``NAME.part``.

    What is written waits in memory until `flush`. If that fails nothing is lost: the next `flush`
    continues where it ended. Leaving the context without `keep` discards the file.

    Attributes
    ----------
    path : the file when it is complete

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._part = path.with_name(f'{path.name}.part')
        self._waiting = bytearray()
        self._size = 0
        refuse_special(path)
        make_folder(path.parent)
        with writing(path):
            self._file = self._part.open('wb', buffering=0)

    def __enter__(self) -> 'PartFile':
        return self

    def __exit__(self, *_: object) -> None:
        # The error of a disk is raised where it is written to.
        with suppress(OSError):
            self._file.close()
        with suppress(OSError):
            self._part.unlink(missing_ok=True)

    def write(self, content: bytes) -> int:
        """Append content, which waits in memory; return its size with all that waits."""
        self._waiting += content
        return len(self._waiting)

    def flush(self) -> None:
        """Write what waits."""
        with writing(self.path):
            # A file in a folder that was removed or unmounted could still be written.
            self._part.stat()
            if self._size == 0:
                self._file.truncate(0)
            while self._waiting:
                written = os.pwrite(self._file.fileno(), self._waiting, self._size)
                self._size += written
                del self._waiting[:written]

    def clear(self) -> None:
        """Delete the content, in the file at the next `flush`."""
        self._waiting.clear()
        self._size = 0

    def keep(self) -> None:
        """Sync the file to disk, then rename it: a crash leaves the old file or the new one."""
        self.flush()
        with writing(self.path):
            os.fsync(self._file.fileno())
            self._file.close()
            self._part.replace(self.path)

    def close(self) -> None:
        """Close the file, whose incomplete content stays in ``NAME.part``."""
        with suppress(OSError):
            self._file.close()


@contextmanager
def writing(what: object) -> Iterator[None]:
    """Turn the errors of writing something into a UserError with the reason and a cure."""
    try:
        yield
    except OSError as error:
        raise disk_error(what, error) from None


def disk_error(what: object, error: OSError) -> UserError:
    """Return the error for users of a file or folder that cannot be written."""
    cure = CURES.get(error.errno or 0, OTHER_CURE)
    return UserError(f'cannot write {what}: {error.strerror}: {cure}')
