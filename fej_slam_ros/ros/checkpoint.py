# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The file from which a run goes on.

Three lines and then arrays: what the file is, which version of the package wrote it and in which
format; the SHA-256 of all that follows; the rest as JSON, in which an array is its type, shape,
order and place. JSON tells floats to the last bit, too.
"""

from functools import partial
from hashlib import sha256
import json
from pathlib import Path
from typing import Any

import numpy as np

from fej_slam_ros import __version__
from fej_slam_ros.core import checkpoint as core
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.inputs import Inputs
from fej_slam_ros.ros.parameters import deciding
from fej_slam_ros.writing import write_bytes

#: To be raised whenever what an estimator holds changes.
FORMAT = 1
BEGINNING = b'fej_slam_ros checkpoint, '
TITLE = BEGINNING + f'format {FORMAT} of version {__version__}'.encode()


def save(path: Path, estimator: Estimator, inputs: Inputs) -> None:
    """
    Write a checkpoint, or replace one, in one go.

    Raises
    ------
    UserError
        It cannot be written, or what is there is no checkpoint.

    """
    if path.exists() and not _begins_like_one(path):
        raise UsageError(f'{path} exists and is no checkpoint: choose another place for one')
    arrays = bytearray()
    told = json.dumps(
        {'settings': deciding(estimator.settings), 'inputs': inputs.snapshot(),
         'estimator': core.snapshot(estimator)},
        default=partial(_put, arrays))
    content = told.encode() + b'\n' + arrays
    checksum = sha256(content).hexdigest().encode()
    write_bytes(path, b'\n'.join([TITLE, checksum, content]))


def load(path: Path, settings: Settings) -> tuple[Estimator, Inputs]:
    """
    Return the estimator of a checkpoint and its inputs.

    Raises
    ------
    UserError
        The file cannot be read, is no checkpoint or is damaged.
    UsageError
        It was made with other settings.

    """
    told, _, arrays = _verified(path).partition(b'\n')
    kept = json.loads(told, object_hook=partial(_take, arrays))
    _refuse_other_settings(path, kept['settings'], deciding(settings))
    estimator = core.restore(kept['estimator'], settings)
    inputs = Inputs(estimator)
    inputs.restore(kept['inputs'])
    return estimator, inputs


def _begins_like_one(path: Path) -> bool:
    try:
        with path.open('rb') as file:
            return file.read(len(BEGINNING)) == BEGINNING
    except OSError as error:
        raise UserError(f'cannot write {path}: {error.strerror}') from None


def _verified(path: Path) -> bytes:
    """Return what follows the checksum, if it is what was written."""
    try:
        title, _, rest = path.read_bytes().partition(b'\n')
    except OSError as error:
        raise UserError(
            f'cannot read the checkpoint {path}: {error.strerror}; without the parameter'
            " 'restore' a run begins anew") from None
    if not title.startswith(BEGINNING):
        raise UserError(f'{path} is not a checkpoint: give a file that ~/save has written')
    if title != TITLE:
        raise UserError(
            f'{path} is a checkpoint of {title[len(BEGINNING):].decode(errors="replace")}, not of'
            f' {TITLE[len(BEGINNING):].decode()}: restore it with the version that wrote it')
    checksum, _, content = rest.partition(b'\n')
    if checksum != sha256(content).hexdigest().encode():
        raise UserError(f'{path} is damaged: its checksum does not fit, restore another one')
    return content


def _refuse_other_settings(path: Path, made: dict[str, Any], given: dict[str, Any]) -> None:
    for name in {**given, **made}:
        if made.get(name) != given.get(name):
            raise UsageError(
                f'{path} was made with {name} = {made.get(name)!r}, not {given.get(name)!r}: a'
                ' run goes on under the parameters that it began with')


def _put(arrays: bytearray, array: Any) -> dict[str, Any]:
    """Append an array and return what takes its place in JSON."""
    # How an array lies in memory decides how BLAS rounds.
    order = 'F' if array.flags.f_contiguous and not array.flags.c_contiguous else 'C'
    place = len(arrays)
    arrays += array.tobytes(order)
    return {'array': [array.dtype.str, array.shape, order, place]}


def _take(arrays: bytes, entry: dict[str, Any]) -> Any:
    """Return the array that an entry stands for, else the entry itself."""
    if [*entry] != ['array']:
        return entry
    dtype, shape, order, place = entry['array']
    flat = np.frombuffer(arrays, dtype, int(np.prod(shape)), place)
    return flat.reshape(shape, order=order).copy('K')
