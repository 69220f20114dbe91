# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Suggestions for misspelt names, and help that fits the terminal."""

import pytest

from fej_slam_ros.cli.main import VERBS
from fej_slam_ros.cli.parser import Formatter, Parser
from helpers.ros import run_verb


@pytest.fixture
def parser():
    """Return a parser with an option, and a further parser with one of its own."""
    parser = Parser(prog='survey', formatter_class=Formatter)
    parser.add_argument('--quiet', action='store_true')
    further = parser.add_subparsers().add_parser('measure')
    further.add_argument('--output', choices=['table', 'figure'])
    further.add_argument('--robots', type=int, choices=[1, 2])
    return parser


@pytest.mark.parametrize(('words', 'sentence'), [
    (['--quite'], 'there is no option --quite, did you mean --quiet?'),
    (['maesure'], 'there is no maesure, did you mean measure?'),
    (['measure', '--ouput=x'], 'there is no option --ouput, did you mean --output?'),
    (['measure', '--output', 'tabel'], 'there is no tabel, did you mean table?'),
    (['measure', '--output', 'xyz'], 'there is no xyz, choose from table, figure'),
    (['measure', '--robots', '3'], 'there is no 3, choose from 1, 2'),
    (['measure', '--frequency', '3'], 'unrecognized arguments: --frequency 3')])
def test_a_misspelt_name_is_answered_with_the_nearest(parser, capsys, words, sentence):
    with pytest.raises(SystemExit, match='2'):
        parser.parse_args(words)

    assert capsys.readouterr().err.endswith(f'{sentence}\n')


def test_a_required_option_that_is_misspelt_is_not_called_missing(capsys):
    assert run_verb('replay', 'bag', '--parms', 'a.yaml', '--output', 'out') == 2

    assert capsys.readouterr().err.endswith('no option --parms, did you mean --params?\n')


@pytest.mark.parametrize('verb', VERBS)
def test_help_fits_a_terminal_of_80_columns(monkeypatch, capsys, verb):
    monkeypatch.setenv('COLUMNS', '80')

    assert run_verb(verb, '--help') == 0

    assert max(map(len, capsys.readouterr().out.splitlines())) <= 80


def test_paragraphs_are_filled_and_tables_keep_their_columns(monkeypatch, parser):
    monkeypatch.setenv('COLUMNS', '42')
    parser.description = (
        'A paragraph of two lines that are both\nlong.\n\n'
        'one    what the first of them is and does\ntwo    short')

    assert (
        '\n\nA paragraph of two lines that are both\nlong.\n\n'
        'one    what the first of them is and\n       does\ntwo    short\n\n'
    ) in parser.format_help()
