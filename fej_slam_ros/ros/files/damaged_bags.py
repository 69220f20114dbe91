# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of a damaged rosbag2, and how to repair it."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
import struct
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader

from fej_slam_ros.ros.files import checksums

#: Bytes of the header of an SQLite file.
SQLITE_HEADER = 100
METADATA = 'metadata.yaml'


def explanation(path: Path, error: Exception) -> str:
    """Return one sentence about a bag for which the reader raised an error."""
    if not path.exists():
        return f'{path} does not exist: give the folder of a rosbag2'
    if isinstance(error, PermissionError) or isinstance(error.__cause__, PermissionError):
        return (
            f'{path} cannot be read: permission denied: run as its owner, or change the'
            ' permissions')
    with suppress(OSError, struct.error):
        return next(_faults(path), _unknown(path, error))
    return _unknown(path, error)


def unnoticed(path: Path, reader: Reader) -> Iterator[str]:
    """Yield one sentence about each damage of an open bag that its reader does not notice."""
    for storage in storages(reader):
        damage = checksums.mismatch(storage.path) if storage.path.suffix == '.mcap' else ''
        if damage:
            yield _damaged(storage.path, damage)
        for connection in storage.connections:
            if connection.msgcount and not any(
                    _is_same(connection, listed) for listed in reader.connections):
                yield (
                    f'{path / METADATA} does not list {connection.topic} of {storage.path.name}'
                    f' with its type and quality of service, so its {connection.msgcount} messages'
                    f' would be lost: run "ros2 bag reindex {path}", which writes it again')


def storages(reader: Reader) -> list[Any]:
    """Return the readers of the files of an open bag."""
    return getattr(reader.storage, 'storages', [reader.storage])


def _is_same(connection: Connection, listed: Connection) -> bool:
    """Return whether messages of a file belong to a topic that the metadata list."""
    same_digest = connection.digest == listed.digest or not (connection.digest and listed.digest)
    return same_digest and (connection.topic, connection.msgtype, connection.ext) == (
        listed.topic, listed.msgtype, listed.ext)


def _faults(bag: Path) -> Iterator[str]:
    if bag.suffix == '.bag':
        yield (
            f'{bag} is a bag of ROS 1: convert it with "rosbags-convert --src {bag} --dst NEW'
            ' --dst-storage mcap"')
    files = sorted(_files(bag))
    if bag.is_dir() and not files and not (bag / METADATA).exists():
        inside = sorted(str(metadata.parent) for metadata in bag.glob(f'*/{METADATA}'))
        cure = f'give one of {", ".join(inside)}' if inside else 'give the folder of one'
        yield f'{bag} is no rosbag2, it has no {METADATA}: {cure}'
    for file in files:
        if _is_truncated(file):
            yield (
                f'{file} is truncated, its recording or copy was interrupted: {_cure(file)}')
    if files and bag.is_dir() and not _has_content(bag / METADATA):
        sources = ' '.join(map(str, files))
        which = 'an empty' if (bag / METADATA).exists() else 'no'
        yield (
            f'{bag} has {which} {METADATA}, its recording was interrupted: run'
            f' "ros2 bag reindex {bag}", which writes it, or without ROS "rosbags-convert --src'
            f' {sources} --dst NEW --dst-storage mcap"')
    for file in files:
        if file.suffix == '.mcap':
            damage = checksums.mismatch(file) or checksums.damaged_chunks(file)
            if damage:
                yield _damaged(file, damage)


def _damaged(file: Path, damage: str) -> str:
    return f'{file} is damaged, {damage}: {_cure(file)}'


def _unknown(path: Path, error: Exception) -> str:
    reason = ' '.join(str(error).split()) or type(error).__name__
    return f'{path} cannot be read as a rosbag2, give the folder of a complete one: {reason}'


def _files(bag: Path) -> Iterator[Path]:
    for folder_or_file in [bag] if bag.is_file() else bag.iterdir():
        if folder_or_file.suffix in {'.mcap', '.db3'}:
            yield folder_or_file


def _has_content(file: Path) -> bool:
    return file.exists() and file.stat().st_size > 0


def _is_truncated(file: Path) -> bool:
    """Return whether the end of a file is missing."""
    size = file.stat().st_size
    with file.open('rb') as content:
        if file.suffix == '.mcap':
            content.seek(max(0, size - len(checksums.MAGIC)))
            return content.read() != checksums.MAGIC
        header = content.read(SQLITE_HEADER)
    # The page size, where 1 means 65536, and the number of pages.
    page, pages = int.from_bytes(header[16:18], 'big'), int.from_bytes(header[28:32], 'big')
    return size < SQLITE_HEADER or size < (65536 if page == 1 else page) * pages


def _cure(file: Path) -> str:
    recovery = (
        f'mcap recover {file.name} -o NEW.mcap' if file.suffix == '.mcap' else
        f'sqlite3 {file.name} .recover | sqlite3 NEW.db3')
    return (
        f'copy it again, or save its complete messages with "{recovery}" in a new folder and run'
        ' "ros2 bag reindex" on that folder')
