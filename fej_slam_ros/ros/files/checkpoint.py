# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Checkpoint files: write the state of a run, and continue the run from it.

Three lines, then the arrays. The title has the file format, the digest of the stored classes and
the version of the package; the second line is the SHA-256 of the rest; the third is JSON, in which
an array is its type, shape, memory order and offset. JSON keeps every bit of a float.

A file that is damaged, or was made by another version, by the other node or with other settings,
is refused with a UserError.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from hashlib import sha256
import json
from pathlib import Path
from typing import Any

import numpy as np

from fej_slam_ros import __version__
from fej_slam_ros.atomic_files import write_bytes, writing
from fej_slam_ros.core import snapshot as core
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import PriorMap
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.parameters import (
    deciding, estimation_of, known_parameters, NodeSettings, ParameterChange, RunSettings,
    SMOOTHER, with_values)

TITLE_START = b'fej_slam_ros checkpoint, '
#: Number of the file format: the three lines, and how JSON refers to arrays. Changes of the stored
#: classes need no new number, since the digest in the title covers them.
FILE_FORMAT = 8

#: Whose state a checkpoint has, as the key of that.
ESTIMATOR_KEY, SMOOTHER_KEY = 'estimator', 'smoother'

Values = dict[str, Any]


def content_of(
    settings: RunSettings, estimator: Estimator, inputs: Values, prior: PriorMap | None,
    changes: Sequence[ParameterChange],
) -> bytes:
    """
    Return the content of a checkpoint of an estimator and of its inputs as plain data.

    The settings are those at the start of the run, the changes those of their parameters since;
    prior is the estimator's prior map.

    """
    return _sealed({
        'settings': _deciding(settings.estimation, prior),
        'given': _deciding(settings.given(), prior), 'inputs': inputs,
        'changes': [*map(asdict, changes)],
        ESTIMATOR_KEY: core.snapshot(estimator)})


def content_of_smoother(settings: RunSettings, team: TeamSmoother, inputs: Values) -> bytes:
    """Return the content of a checkpoint of a smoother with its settings, as of `content_of`."""
    return _sealed({
        'settings': _deciding_smoother(settings.estimation),
        'given': _deciding_smoother(settings.given()), 'inputs': inputs,
        SMOOTHER_KEY: core.snapshot(team)})


def is_to_restore(node: NodeSettings) -> bool:
    """Return whether a run continues from a checkpoint."""
    # Its own checkpoint may be missing at the first start.
    is_own = node.restore == node.checkpoint
    return bool(node.restore) and (not is_own or Path(node.restore).exists())


def write(path: Path, content: bytes) -> None:
    """Write a checkpoint, or replace one, atomically."""
    with writing(path):
        is_other = path.exists() and not is_checkpoint(path)
    if is_other:
        raise UsageError(f'{path} exists and is not a checkpoint: choose another path')
    write_bytes(path, content)


@contextmanager
def refusing_malformed(path: Path) -> Iterator[None]:
    """Turn any error of reading the content of a file into a UserError."""
    try:
        yield
    except UserError:
        raise
    # The checksum is no signature, so the content may be anything.
    except Exception as error:  # noqa: BLE001
        reason = ' '.join(str(error).split()) or type(error).__name__
        raise UserError(f'{path} is damaged: {reason}; restore another checkpoint') from None


def load(
    path: Path, settings: RunSettings, prior: PriorMap | None
) -> tuple[RunSettings, Estimator, Values, list[ParameterChange]]:
    """
    Return the settings of a saved run, its estimator and inputs, and its changes of parameters.

    The given settings must be those that the run, or the process that saved it, was started with;
    the changed ones are in force. The inputs are plain data, to be read in `refusing_malformed`.

    """
    with refusing_malformed(path):
        stored = _stored(path, ESTIMATOR_KEY)
        settings = _run_settings(path, stored, settings, _deciding(settings.estimation, prior))
        changes = [ParameterChange(**change) for change in stored['changes']]
        estimator = core.restore(
            stored[ESTIMATOR_KEY], _present(settings.estimation, changes), Estimator)
        return settings, estimator, stored['inputs'], changes


def load_smoother(path: Path, settings: RunSettings) -> tuple[RunSettings, TeamSmoother, Values]:
    """Return the settings of a saved run, its smoother and its inputs, as of `load`."""
    with refusing_malformed(path):
        stored = _stored(path, SMOOTHER_KEY)
        settings = _run_settings(path, stored, settings, _deciding_smoother(settings.estimation))
        team = core.restore(stored[SMOOTHER_KEY], settings.estimation, TeamSmoother)
        return settings, team, stored['inputs']


def load_map(path: Path) -> PriorMap:
    """Return the landmarks in ``map`` of a checkpoint made with any settings."""
    with refusing_malformed(path):
        stored = _stored(path, ESTIMATOR_KEY)
        changes = [ParameterChange(**change) for change in stored['changes']]
        settings = _present(estimation_of(stored['settings']), changes)
        team = core.restore(stored[ESTIMATOR_KEY], settings, Estimator).groups.team
    if team.map().has_shared_ids():
        return team.prior_map()
    raise no_shared_ids(path)


def no_shared_ids(path: Path) -> UserError:
    """Return the error on a file that is no prior map."""
    return UserError(
        f'{path} has no landmarks in map with IDs that all robots share: give another one')


def is_checkpoint(path: Path) -> bool:
    """Return whether a file begins like a checkpoint of any version."""
    with path.open('rb') as file:
        return file.read(len(TITLE_START)) == TITLE_START


def _title() -> bytes:
    digest = core.schema_digest()[:16]
    return TITLE_START + f'format {FILE_FORMAT}, schema {digest}, version {__version__}'.encode()


def _deciding(settings: Settings, prior: PriorMap | None) -> Values:
    """Return the parameters that decide the result, the prior map as a digest of its content."""
    digest = ''
    if prior is not None:
        content = repr(prior.ids).encode() + prior.points.tobytes() + prior.P.tobytes()
        digest = f'{len(prior.ids)} landmarks with SHA-256 {sha256(content).hexdigest()}'
    return {**deciding(settings), 'prior_landmarks': digest}


def _deciding_smoother(settings: Settings) -> Values:
    """Return the parameters that decide the result of a smoother."""
    known = known_parameters([robot.name for robot in settings.robots], SMOOTHER)
    return {name: value for name, value in deciding(settings).items() if name in known}


def _present(settings: Settings, changes: Sequence[ParameterChange]) -> Settings:
    """Return the settings of the start of a run with its later changes."""
    known = known_parameters([robot.name for robot in settings.robots])
    return with_values(settings, [
        (change.parameter, known[change.parameter].kind.read(change.after))
        # The team, and the settings of its new robots, are in the snapshot.
        for change in changes if change.parameter in known.keys() - {'robots'}])


def _sealed(values: Values) -> bytes:
    """Return the content of a file with some values."""
    arrays = bytearray()
    text = json.dumps(values, default=partial(_append_array, arrays))
    content = text.encode() + b'\n' + arrays
    checksum = sha256(content).hexdigest().encode()
    return b'\n'.join([_title(), checksum, content])


def _stored(path: Path, key: str) -> Values:
    """Return the values in a checkpoint of an estimator or of a smoother, as the key says."""
    text, _, arrays = _verified(path).partition(b'\n')
    stored: Values = json.loads(text, object_hook=partial(_take_array, arrays))
    for other in {ESTIMATOR_KEY, SMOOTHER_KEY} - {key}:
        if key not in stored and other in stored:
            raise UsageError(
                f'{path} is a checkpoint of the {other}, not of the {key}: give one that the {key}'
                ' has written')
    return stored


def _verified(path: Path) -> bytes:
    """Return the content below the checksum line."""
    try:
        title, _, rest = path.read_bytes().partition(b'\n')
    except OSError as error:
        raise UserError(
            f'cannot read the checkpoint {path}: {error.strerror}; leave out the parameter'
            " 'restore' to start a new run") from None
    if not title.startswith(TITLE_START):
        raise UserError(f'{path} is not a checkpoint: give a file that ~/save has written')
    expected = _title()
    if title != expected:
        file_version, own_version = (text[len(TITLE_START):].decode(errors='replace') for text in (
            title, expected))
        raise UserError(
            f'{path} is a checkpoint made by another version of the data in it: {file_version};'
            f' this is {own_version}: restore it with the version that wrote it')
    checksum, _, content = rest.partition(b'\n')
    if checksum != sha256(content).hexdigest().encode():
        raise UserError(
            f'{path} is damaged: its checksum does not match; restore another checkpoint')
    return content


def _run_settings(path: Path, stored: Values, settings: RunSettings, given: Values) -> RunSettings:
    """
    Return the settings of a saved run for those that are given, whose deciding values are `given`.

    A process that ended by itself is started again as before, also if its parameters were changed
    and a later run had begun with the changed ones.

    """
    if given == stored['settings']:
        return settings
    _refuse_other_settings(path, stored['given'], given)
    # Parameters of the other node are as they are given.
    values = deciding(settings.estimation) | stored['settings']
    return settings.followed_by(estimation_of(values), settings.node)


def _refuse_other_settings(path: Path, saved: Values, given: Values) -> None:
    for name in {**given, **saved}:
        if saved.get(name) != given.get(name):
            raise UsageError(
                f'{path} was made with {name} = {saved.get(name)!r}, not {given.get(name)!r}: '
                'restore a run with the parameters that it was started with')


def _append_array(arrays: bytearray, array: Any) -> dict[str, Any]:
    """Append an array and return the JSON entry that refers to it."""
    # The memory order of an array decides how BLAS rounds.
    order = 'F' if array.flags.f_contiguous and not array.flags.c_contiguous else 'C'
    offset = len(arrays)
    arrays += array.tobytes(order)
    return {'array': [array.dtype.str, array.shape, order, offset]}


def _take_array(arrays: bytes, entry: dict[str, Any]) -> Any:
    """Return the array that an entry refers to, or the entry itself if it is no reference."""
    if [*entry] != ['array']:
        return entry
    dtype, shape, order, offset = entry['array']
    flat = np.frombuffer(arrays, dtype, int(np.prod(shape)), offset)
    return flat.reshape(shape, order=order).copy('K')
