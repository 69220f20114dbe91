# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables and numbers as text."""

import pytest

from fej_slam_ros.tables import finite_numbers, interval, markdown_table, number, text_table


@pytest.mark.parametrize(
    ('head', 'rows', 'text'), [
        (['a', 'b'], [], 'a  b'),
        (['name', '1'], [['x', '1000']], 'name     1\nx     1000'),
        (['', 'n'], [['robot', '12']], '        n\nrobot  12')])
def test_first_column_is_left_aligned_and_the_others_right_aligned(head, rows, text):
    assert text_table(head, rows) == text


def test_headings_of_a_wide_table_are_stacked():
    head = ['robot', *12 * ['mean error']]

    stacked, below, row = text_table(head, [['r1', *12 * ['0.1']]]).splitlines()

    assert stacked.split() == 12 * ['mean']
    assert below.split() == ['robot', *12 * ['error']]
    assert len({len(stacked), len(below), len(row)}) == 1
    assert len(row) <= 100


def test_columns_of_a_markdown_table_are_right_aligned_except_text_columns():
    assert markdown_table(['runs', 'filter', 'rmse'], [['8', 'FEJ', '0.1']], (1,)) == (
        '| runs | filter | rmse |\n'
        '| --: | --- | --: |\n'
        '| 8 | FEJ | 0.1 |')


def test_first_column_of_a_markdown_table_is_text_by_default():
    assert markdown_table(['a', 'b'], iter([])) == '| a | b |\n| --- | --: |'


def test_missing_number_is_a_dash():
    assert number(None, '.3f') == '-'
    assert number(0.12345, '.3f') == '0.123'


def test_interval_shows_both_bounds():
    assert interval((0.5, 1.25)) == '0.50 to 1.25'


@pytest.mark.parametrize('text', ['', 'x', 'nan', 'inf'])
def test_a_cell_that_is_no_finite_number_is_named(text):
    with pytest.raises(ValueError, match=r'^y is .* and not a finite number$'):
        finite_numbers({'x': '1', 'y': text}, 'xy')


def test_a_row_that_ends_early_is_named():
    with pytest.raises(ValueError, match=r'^it ends before y$'):
        finite_numbers({'x': '1', 'y': None}, 'xy')


@pytest.mark.parametrize('text', ['1e61', '-1e308'])
def test_a_cell_whose_number_has_no_finite_powers_is_named(text):
    assert finite_numbers({'x': '-1e60'}, 'x') == [-1e60]

    with pytest.raises(ValueError, match=f'^x is {text!r}, beyond 1e\\+60$'):
        finite_numbers({'x': text}, 'x')
