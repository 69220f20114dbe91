# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""NIS and NEES from diagnostics as plain numbers, which Foxglove can plot."""

from collections.abc import Mapping

from fej_slam_ros.core.chi_square import chi_square_band
from fej_slam_ros.ros.messages import incoming, Message

#: Topic with NIS and NEES of all robots, in their order, and their probability bands.
CONSISTENCY = '/view/consistency'
#: Topic with transforms that draw frames which have not joined ``map``.
FRAMES = '/view/frames'

#: Probability that NEES of a correct pose lies in its band; half the rest lies below it.
NEES_PROBABILITY = 0.95
#: Degrees of freedom of the NEES of a pose.
POSE_DOF = 3

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


def robots_of(report: Message) -> dict[str, Values]:
    """Return the diagnostics values of each robot; empty for reports of other nodes."""
    return {
        name: values for name, values in incoming.reports(report).items()
        if 'sightings_used' in values}


def consistency(robots: Mapping[str, Values]) -> dict[str, list[dict[str, str | float]]]:
    """Return the content described by `SCHEMA`; unknown values are left out."""
    return {'robots': [
        {'name': name, **_nis(values), **_nees(values)} for name, values in robots.items()]}


def _nis(values: Values) -> dict[str, float]:
    low, _, high = values.get('nis_band', '').partition('..')
    # Before the first observation there is no band.
    if not high or float(high) == 0.0:
        return {}
    return {'nis': float(values['nis_ratio']), 'nis_low': float(low), 'nis_high': float(high)}


def _nees(values: Values) -> dict[str, float]:
    if 'nees_latest' not in values:
        return {}
    low, high = chi_square_band(POSE_DOF, NEES_PROBABILITY)
    nees = float(values['nees_latest'])
    return {'nees': nees, 'nees_low': low / POSE_DOF, 'nees_high': high / POSE_DOF}
