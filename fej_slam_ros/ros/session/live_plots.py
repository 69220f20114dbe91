# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a live view shows besides the topics themselves: plain numbers to plot, from reports."""

from collections.abc import Mapping

from fej_slam_ros.core.chi_square import chi_square_band
from fej_slam_ros.ros.messages import incoming, Message

#: NIS and NEES of all robots, in their order, with the bands that they should lie in.
CONSISTENCY = '/view/consistency'
#: Where frames that have no place in ``map`` are drawn.
FRAMES = '/view/frames'

#: NEES of a single pose is below, inside or above its band with 2.5 %, 95 % and 2.5 %.
NEES_PROBABILITY = 0.95
POSE_SIZE = 3

NUMBERS = ('nis', 'nis_low', 'nis_high', 'nees', 'nees_low', 'nees_high')
SCHEMA = {
    'title': 'fej_slam_ros.Consistency',
    'type': 'object',
    'properties': {'robots': {'type': 'array', 'items': {
        'type': 'object',
        'properties': {
            'name': {'type': 'string'}, **{name: {'type': 'number'} for name in NUMBERS}},
    }}},
}

Values = Mapping[str, str]


def robots_of(report: Message) -> dict[str, Values]:
    """Return what a report on /diagnostics tells of each robot, if it is one of ours."""
    return {
        name: values for name, values in incoming.reports(report).items()
        if 'sightings_used' in values}


def consistency(robots: Mapping[str, Values]) -> dict[str, list[dict[str, str | float]]]:
    """Return what `SCHEMA` describes; what is not known of a robot is left out."""
    return {'robots': [
        {'name': name, **_nis(values), **_nees(values)} for name, values in robots.items()]}


def _nis(values: Values) -> dict[str, float]:
    low, _, high = values.get('nis_band', '').partition('..')
    # Before the first observation there is no band.
    if not high or float(high) == 0.0:
        return {}
    return {
        'nis': float(values['nis_ratio']), 'nis_low': float(low), 'nis_high': float(high)}


def _nees(values: Values) -> dict[str, float]:
    if 'nees_latest' not in values:
        return {}
    low, high = chi_square_band(POSE_SIZE, NEES_PROBABILITY)
    return {
        'nees': float(values['nees_latest']), 'nees_low': low / POSE_SIZE,
        'nees_high': high / POSE_SIZE}
