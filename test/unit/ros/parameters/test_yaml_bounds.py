# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""YAML files that describe far more than they contain are rejected at once, with one sentence."""

from time import process_time

import pytest

from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters import load, load_values

HEAD = '/**:\n  ros__parameters:\n    robots: [r1]\n'


def of_aliases(first, repeat):
    """Return ten lines of which each repeats the one before nine times."""
    lines = [f'    a0: &a0 {first}\n']
    lines += [f'    a{k}: &a{k} {repeat(f"*a{k - 1}")}\n' for k in range(1, 11)]
    return ''.join(lines)


BOMBS = {
    'lists': HEAD + of_aliases('[1]', lambda a: '[' + ','.join([a] * 9) + ']'),
    'maps': HEAD + of_aliases(
        '{a: 1}', lambda a: '{' + ','.join(f'{key}: {a}' for key in 'abcdefghi') + '}'),
    'merge keys': HEAD + of_aliases(
        '{a: 1}', lambda a: '{<<: [' + ','.join([a] * 9) + ']}'),
    'names': '/**:\n  ros__parameters:\n' + of_aliases(
        '[r1, r2]', lambda a: '[' + ','.join([a] * 9) + ']') + '    robots: *a10\n',
}
ENDLESS = {
    'a map in itself': '/**:\n  ros__parameters: &a\n    robots: [r1]\n    x: *a\n',
    'a list in itself': '/**:\n  ros__parameters:\n    robots: &a [r1, *a]\n',
    'a file in itself': '&a\n/**: *a\n',
}
DEEP = {
    'lists': HEAD + '    x: ' + '[' * 3000 + ']' * 3000,
    'maps': HEAD + '    x: ' + '{a: ' * 3000 + '1' + '}' * 3000,
    'blocks': HEAD + ''.join(f'{" " * k}a:\n' for k in range(4, 600)) + ' ' * 600 + '1\n',
}


def rejection(tmp_path, text):
    """Return the sentence about a file, which must come within a second."""
    path = tmp_path / 'p.yaml'
    path.write_text(text, encoding='utf-8')
    begin = process_time()
    with pytest.raises(UsageError) as error:
        load(path)
    assert process_time() - begin < 1.0
    sentence = str(error.value)
    assert sentence.startswith(f'{path}: ')
    assert len(sentence.splitlines()) == 1
    return sentence


@pytest.mark.parametrize('kind', BOMBS)
def test_aliases_that_multiply_are_rejected(tmp_path, kind):
    assert 'has more than 10,000 values' in rejection(tmp_path, BOMBS[kind])


@pytest.mark.parametrize('kind', ENDLESS)
def test_an_alias_in_what_it_repeats_is_rejected(tmp_path, kind):
    assert 'the alias *a repeats no earlier value' in rejection(tmp_path, ENDLESS[kind])


@pytest.mark.parametrize('kind', DEEP)
def test_hundreds_of_levels_are_rejected(tmp_path, kind):
    assert 'give the path of a ROS parameter file' in rejection(tmp_path, DEEP[kind])


def test_a_file_of_many_megabytes_is_rejected_unread(tmp_path):
    text = HEAD + '    x: 1\n' * 1_000_000

    assert 'it is larger than 250,000 bytes' in rejection(tmp_path, text)


@pytest.mark.parametrize('text', ['a&b', '"&"', '"a & *b: c: d"', '"&a [*a]x"'])
def test_a_text_may_contain_the_signs_of_aliases(tmp_path, text):
    path = tmp_path / 'p.yaml'
    path.write_text(f'{HEAD}    output: {text}\n')

    assert load(path).node.output == text.strip('"')


def test_aliases_that_repeat_a_few_values_are_accepted(tmp_path):
    path = tmp_path / 'p.yaml'
    path.write_text(
        '/**:\n  ros__parameters:\n    robots: [r1, r2]\n'
        '    r1: &r {odometry_sigma: &s [0.1, 0.1, 0.1], landmark_sigma: [1.0, 1.0]}\n'
        '    r2: {<<: *r, odometry_sigma: *s}\n')

    values = load_values(path, ['estimator'])

    assert values['r2.odometry_sigma'] == [0.1, 0.1, 0.1]
    assert values['r2.landmark_sigma'] == [1.0, 1.0]
