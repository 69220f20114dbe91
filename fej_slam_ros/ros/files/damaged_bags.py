# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a rosbag2 that cannot be read, and how to repair it."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

MCAP_MAGIC = b'\x89MCAP0\r\n'
#: Bytes of the header of an SQLite file.
SQLITE_HEADER = 100
METADATA = 'metadata.yaml'


def explanation(path: Path, error: Exception) -> str:
    """Return one sentence about a bag for which the reader raised an error."""
    if not path.exists():
        return f'{path} does not exist: give the folder of a rosbag2'
    with suppress(OSError):
        return next(_faults(path), _unknown(path, error))
    return _unknown(path, error)


def _faults(bag: Path) -> Iterator[str]:
    files = sorted(_files(bag))
    for file in files:
        if _is_truncated(file):
            yield (
                f'{file} is truncated, its recording or copy was interrupted: copy it again, or'
                f' save its complete messages with {_recovery(file)} in a new folder and run'
                ' "ros2 bag reindex" on that folder')
    if files and bag.is_dir() and not (bag / METADATA).exists():
        yield (
            f'{bag} has no {METADATA}, its recording was interrupted: run'
            f' "ros2 bag reindex {bag}", which writes it')


def _unknown(path: Path, error: Exception) -> str:
    reason = ' '.join(str(error).split()) or type(error).__name__
    return f'{path} cannot be read as a rosbag2, give the folder of a complete one: {reason}'


def _files(bag: Path) -> Iterator[Path]:
    for folder_or_file in [bag] if bag.is_file() else bag.iterdir():
        if folder_or_file.suffix in {'.mcap', '.db3'}:
            yield folder_or_file


def _is_truncated(file: Path) -> bool:
    """Return whether the end of a file is missing."""
    size = file.stat().st_size
    with file.open('rb') as content:
        if file.suffix == '.mcap':
            content.seek(max(0, size - len(MCAP_MAGIC)))
            return content.read() != MCAP_MAGIC
        header = content.read(SQLITE_HEADER)
    # The page size, where 1 means 65536, and the number of pages.
    page, pages = int.from_bytes(header[16:18], 'big'), int.from_bytes(header[28:32], 'big')
    return size < SQLITE_HEADER or size < (65536 if page == 1 else page) * pages


def _recovery(file: Path) -> str:
    if file.suffix == '.mcap':
        return f'"mcap recover {file.name} -o NEW.mcap"'
    return f'"sqlite3 {file.name} .recover | sqlite3 NEW.db3"'
