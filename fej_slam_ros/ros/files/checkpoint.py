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
from fej_slam_ros.atomic_files import write_bytes
from fej_slam_ros.core import checkpoint as core
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import PriorMap
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.parameters import deciding, parse
from fej_slam_ros.ros.session.inputs import Inputs

#: To be raised whenever what an estimator holds changes.
FORMAT = 6
BEGINNING = b'fej_slam_ros checkpoint, '
TITLE = BEGINNING + f'format {FORMAT} of version {__version__}'.encode()


def save(
    path: Path, estimator: Estimator, inputs: Inputs, prior: PriorMap | None = None
) -> None:
    """
    Write a checkpoint, or replace one, in one go; prior is what the estimator began with.

    Raises
    ------
    UserError
        It cannot be written, or what is there is no checkpoint.

    """
    try:
        if path.exists() and not begins_like_one(path):
            raise UsageError(f'{path} exists and is no checkpoint: choose another place for one')
    except OSError as error:
        raise UserError(f'cannot write {path}: {error.strerror}') from None
    arrays = bytearray()
    told = json.dumps(
        {'settings': _deciding(estimator.settings, prior), 'inputs': inputs.snapshot(),
         'estimator': core.snapshot(estimator)},
        default=partial(_put, arrays))
    content = told.encode() + b'\n' + arrays
    checksum = sha256(content).hexdigest().encode()
    write_bytes(path, b'\n'.join([TITLE, checksum, content]))


def load(
    path: Path, settings: Settings, prior: PriorMap | None = None
) -> tuple[Estimator, Inputs]:
    """
    Return the estimator of a checkpoint and its inputs.

    Raises
    ------
    UserError
        The file cannot be read, is no checkpoint or is damaged.
    UsageError
        It was made with other settings, or another prior map.

    """
    kept = _kept(path)
    _refuse_other_settings(path, kept['settings'], _deciding(settings, prior))
    estimator = core.restore(kept['estimator'], settings)
    inputs = Inputs(estimator)
    inputs.restore(kept['inputs'])
    return estimator, inputs


def load_map(path: Path) -> PriorMap:
    """
    Return the landmarks in ``map`` of a checkpoint, made with whatever settings.

    Raises
    ------
    UserError
        The file cannot be read, is no checkpoint or is damaged, or has no such landmarks.

    """
    kept = _kept(path)
    state = core.restore(kept['estimator'], parse(kept['settings'])).team.state
    landmarks = sorted(state.confirmed_landmarks(), key=lambda landmark: landmark.key)
    if not landmarks or any(landmark.key[0] for landmark in landmarks):
        raise UserError(
            f'{path} has no landmarks in map with numbers that all robots share: give another one')
    return PriorMap(
        tuple(landmark.key[1] for landmark in landmarks),
        np.array([state.estimate(landmark) for landmark in landmarks]), state.marginal(landmarks))


def begins_like_one(path: Path) -> bool:
    """Return whether a file is, or once was, a checkpoint."""
    with path.open('rb') as file:
        return file.read(len(BEGINNING)) == BEGINNING


def _deciding(settings: Settings, prior: PriorMap | None) -> dict[str, Any]:
    """Return all that decides the result besides the input; of a prior map what is in it."""
    told = ''
    if prior is not None:
        content = repr(prior.ids).encode() + prior.points.tobytes() + prior.P.tobytes()
        told = f'{len(prior.ids)} landmarks with SHA-256 {sha256(content).hexdigest()}'
    return {**deciding(settings), 'prior_landmarks': told}


def _kept(path: Path) -> dict[str, Any]:
    told, _, arrays = _verified(path).partition(b'\n')
    kept: dict[str, Any] = json.loads(told, object_hook=partial(_take, arrays))
    return kept


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
