# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files with the IDs of landmarks by name, in JSON."""

from collections.abc import Mapping
from contextlib import ExitStack
import json
from pathlib import Path

from fej_slam_ros.atomic_files import write_json
from fej_slam_ros.core.records import MAX_ID
from fej_slam_ros.errors import UserError
from fej_slam_ros.output_lock import OutputLock


class IdsFile:
    """
    A file of IDs that only one process completes, until it is closed.

    Parameters
    ----------
    file : its path, which is written at once so that an error shows early; '' for no file

    Attributes
    ----------
    ids : the IDs by name that it had

    """

    def __init__(self, file: str) -> None:
        self._path = Path(file) if file else None
        self.ids: dict[str, int] = {}
        with ExitStack() as on_error:
            if self._path is not None:
                on_error.enter_context(OutputLock.of_file(self._path))
                self.ids = _read(self._path)
                self.save(self.ids)
            self._lock = on_error.pop_all()

    def close(self) -> None:
        """Let other processes have the file."""
        self._lock.close()

    def save(self, ids: Mapping[str, int]) -> None:
        """Replace the content."""
        if self._path is not None:
            write_json(self._path, dict(sorted(ids.items())))


def _read(path: Path) -> dict[str, int]:
    if not path.exists():
        return {}
    try:
        ids = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(
            f'cannot read the IDs of landmarks in {path}: {error}; give a JSON object of names and'
            ' IDs, or the path of a new file') from None
    is_mapping = isinstance(ids, dict) and all(
        type(id_) is int and 0 <= id_ <= MAX_ID for id_ in ids.values())
    if not is_mapping or len({*ids.values()}) < len(ids):
        raise UserError(
            f'{path} must be a JSON object of names and IDs, different integers from 0 to'
            f' {MAX_ID}: correct it')
    return dict(ids)
