# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""NIS and NEES from diagnostics as plain numbers, which Foxglove can plot."""

from collections.abc import Mapping
from contextlib import suppress
from math import inf, isfinite

from fej_slam_ros.core.chi_square import band_per_dof
from fej_slam_ros.ros.messages import Message

#: Topic with NIS and NEES of all robots, in their order, and their probability bands.
CONSISTENCY = '/view/consistency'
#: Topic with transforms that draw frames which have not joined ``map``.
FRAMES = '/view/frames'

#: Probability that NEES of a correct pose lies in its band; half the rest lies below it.
NEES_PROBABILITY = 0.95
#: Degrees of freedom of the NEES of a pose.
POSE_DOF = 3

#: Silence [s] of the plotted node after which another one may take its place; it reports every
#: second.
MAX_SILENCE = 5.0
#: Maximum number of statuses that are read of a report; a node has one per robot and three more.
MAX_STATUSES = 1000
#: Values that the status of a robot has in all versions.
ROBOT_KEYS = {'sightings_used'}

PLOTTED = ('nis', 'nis_low', 'nis_high', 'nees', 'nees_low', 'nees_high')
SCHEMA = {
    'title': 'fej_slam_ros.Consistency',
    'type': 'object',
    'properties': {'robots': {'type': 'array', 'items': {
        'type': 'object',
        'properties': {
            'name': {'type': 'string'}, **{name: {'type': 'number'} for name in PLOTTED}},
    }}},
}

Values = Mapping[str, str]


class PlottedNode:
    """
    Chooses the node whose diagnostics are plotted, if several report on robots.

    It is the first one that reports, an estimator before a smoother, until it has been silent for
    `MAX_SILENCE`. Statuses of other nodes, and those that are not of a robot, are left out.

    Attributes
    ----------
    name : of the node, '' before its first report

    """

    def __init__(self) -> None:
        self.name = ''
        self._last = -inf
        self._has_nis = False
        self._ignored: dict[str, bool] = {}

    def robots_of(self, report: Message, now: float) -> dict[str, Values]:
        """Return the values of each robot in a report at a time [s]; empty for other nodes."""
        by_node: dict[str, dict[str, Values]] = {}
        for status in report.status[:MAX_STATUSES]:
            node, _, robot = status.name.rpartition(': ')
            values = {value.key: value.value for value in status.values}
            if node and robot == status.hardware_id and values.keys() >= ROBOT_KEYS:
                by_node.setdefault(node, {})[robot] = values
        for node, robots in by_node.items():
            has_nis = any('nis_band' in values for values in robots.values())
            if now - self._last > MAX_SILENCE or has_nis > self._has_nis:
                self.name, self._has_nis = node, has_nis
            if node == self.name:
                self._last = now
        for node in by_node.keys() - {self.name}:
            if len(self._ignored) < MAX_STATUSES:
                self._ignored.setdefault(node, True)
        return by_node.get(self.name, {})

    def take_ignored(self) -> list[str]:
        """Return the nodes that report on robots and are not plotted, each once."""
        names = [name for name, is_new in self._ignored.items() if is_new]
        self._ignored.update(dict.fromkeys(names, False))
        return names


def consistency(robots: Mapping[str, Values]) -> dict[str, list[dict[str, str | float]]]:
    """Return the content described by `SCHEMA`; unknown and invalid values are left out."""
    return {'robots': [
        {'name': name, **_nis(values), **_nees(values)} for name, values in robots.items()]}


def _nis(values: Values) -> dict[str, float]:
    low, _, high = values.get('nis_band', '').partition('..')
    found = _finite({'nis': values.get('nis_ratio', ''), 'nis_low': low, 'nis_high': high})
    # Before the first observation there is no band.
    return found if len(found) == 3 and found['nis_high'] > 0.0 else {}


def _nees(values: Values) -> dict[str, float]:
    nees = _finite({'nees': values.get('nees_latest', '')})
    if not nees:
        return {}
    low, high = band_per_dof(POSE_DOF, NEES_PROBABILITY)
    return {**nees, 'nees_low': low, 'nees_high': high}


def _finite(texts: Mapping[str, str]) -> dict[str, float]:
    """Return the values of texts that are finite numbers."""
    numbers = {}
    for name, text in texts.items():
        with suppress(ValueError):
            numbers[name] = float(text)
    return {name: number for name, number in numbers.items() if isfinite(number)}
