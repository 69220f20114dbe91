# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which file of a data set is wrong, and what cures it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fej_slam_ros.errors import UserError


@contextmanager
def blaming(path: Path) -> Iterator[None]:
    """Let what is found wrong in a file be told of that file."""
    try:
        yield
    except UserError as error:
        raise UserError(f'{path}: {error}; fetch the file again') from error
