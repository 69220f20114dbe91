# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What of a data set is wrong or not there, and what cures it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fej_slam_ros.errors import UsageError, UserError


def require_folder(folder: Path, content: str) -> None:
    """Refuse a folder that is not there; what is looked for is its content."""
    if not folder.is_dir():
        raise UsageError(f'no folder {folder}: give the one with {content}')


@contextmanager
def blaming(path: Path) -> Iterator[None]:
    """Let what is found wrong in a file be told of that file."""
    try:
        yield
    except UserError as error:
        raise UserError(f'{path}: {error}; fetch the file again') from error
