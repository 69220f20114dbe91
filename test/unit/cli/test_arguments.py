# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The help of parameters can be read in a terminal."""

from fej_slam_ros.cli.arguments import parameter_help
from fej_slam_ros.ros.parameters import known_parameters


def test_the_help_of_a_parameter_says_what_it_must_be():
    described = ' '.join(parameter_help(known_parameters()).split())

    assert "must be one of 'fej', 'invariant', 'standard', 'ideal'" in described


def test_no_line_is_wider_than_the_terminal(monkeypatch):
    monkeypatch.setenv('COLUMNS', '80')
    known = known_parameters()

    lines = parameter_help(known).splitlines()

    assert max(map(len, lines)) <= 80
    assert [line.split(':')[0] for line in lines[1:] if line[2] != ' '] == [
        f'  {name}' for name in known]
