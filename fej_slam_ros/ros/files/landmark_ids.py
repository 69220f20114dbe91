# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files with the IDs of landmarks by name, in JSON."""

from collections.abc import Callable, Mapping
import json
from pathlib import Path

from fej_slam_ros.atomic_files import write_json
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.messages.incoming import MAX_ID


def stored_ids(file: str) -> tuple[dict[str, int], Callable[[Mapping[str, int]], object]]:
    """Return the IDs in a file, and a function that writes others there; '' means no file."""
    if not file:
        return {}, lambda ids: None
    path = Path(file)
    return _read(path), lambda ids: write_json(path, dict(sorted(ids.items())))


def _read(path: Path) -> dict[str, int]:
    if not path.exists():
        return {}
    try:
        ids = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise UserError(f'cannot read the IDs of landmarks in {path}: {error}') from None
    is_mapping = isinstance(ids, dict) and all(
        type(id_) is int and 0 <= id_ <= MAX_ID for id_ in ids.values())
    if not is_mapping or len({*ids.values()}) < len(ids):
        raise UserError(
            f'{path} must be a JSON object of names and IDs, different integers from 0 to'
            f' {MAX_ID}: correct it')
    return dict(ids)
