# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`simulate`: the written bag and error messages."""

import pytest

from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.session import simulation
from helpers.ros import assert_one_sentence, raw_record, run_verb, write_parameters

SMALL = {'robots': ['a', 'b'], 'loops': 1, 'steps_per_loop': 8, 'landmarks': 6}


@pytest.fixture
def params(tmp_path):
    return write_parameters(tmp_path / 'params.yaml', 'simulator', **SMALL)


@pytest.fixture
def simulate(tmp_path, params, capsys):
    """Return a function that simulates into a bag and returns status and both outputs."""

    def run(*options):
        words = '--params', params, '--output', tmp_path / 'bag', *options
        return run_verb('simulate', *words), *capsys.readouterr()

    return run


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_bag_holds_the_records_of_the_simulation(simulate, tmp_path, storage):
    status, said, error = simulate('--storage', storage)

    assert (status, said, error) == (0, f'wrote {tmp_path / "bag"}\n', '')
    expected = [raw_record(record) for record in simulation.parse(SMALL).records()]
    assert list(bags.read(tmp_path / 'bag')) == expected


def test_without_parameters_the_run_is_the_default(tmp_path):
    assert run_verb('simulate', '--output', tmp_path / 'bag') == 0

    # 5 loops of 63 steps.
    assert bags.topics(tmp_path / 'bag')['r1/odom'].messages == 5 * 63 + 1


def test_an_existing_bag_is_replaced_only_with_force(simulate, tmp_path):
    simulate()

    assert_one_sentence(simulate('--storage', 'sqlite3'), 2, 'bag exists', '--force')
    assert (tmp_path / 'bag' / 'bag.mcap').exists()
    assert simulate('--storage', 'sqlite3', '--force')[0] == 0
    assert not (tmp_path / 'bag' / 'bag.mcap').exists()


def test_a_folder_that_is_not_a_bag_is_never_replaced(simulate, tmp_path):
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'thesis.tex').write_text('precious')

    assert_one_sentence(simulate('--force'), 2, 'is not a rosbag2')
    assert (tmp_path / 'bag' / 'thesis.tex').read_text() == 'precious'


def test_an_unwritable_output_is_reported(simulate, tmp_path):
    (tmp_path / 'file').write_text('')

    assert_one_sentence(simulate('--output', tmp_path / 'file' / 'bag'), 1, 'cannot write')


def test_a_missing_parameter_file_is_reported(simulate, params):
    params.unlink()

    assert_one_sentence(simulate(), 2, f'{params}: No such file or directory')


@pytest.mark.parametrize(
    ('wrong', 'sentence'),
    [
        (
            {'landmark': 5, 'strict_parameters': True},
            "unknown parameter 'landmark': did you mean 'landmarks'?",
        ),
        ({'landmarks': 1}, '1 are too few'),
        ({'rate': -1}, "parameter 'rate' must be a number from 1e-3 to 1e6"),
    ])
def test_wrong_parameters_are_reported_and_leave_no_bag(simulate, params, wrong, sentence):
    write_parameters(params, 'simulator', **wrong)

    assert_one_sentence(simulate(), 2, sentence)
    assert not (params.parent / 'bag').exists()


def test_parameters_of_another_node_are_rejected(simulate, params):
    write_parameters(params, 'estimator', robots=['r1'])

    assert_one_sentence(simulate(), 2, "no parameters for the node 'simulator'")


@pytest.mark.parametrize('options', [['--storage', 'db3'], ['--rate', '5']])
def test_bad_arguments_end_with_status_2(simulate, options):
    assert simulate(*options)[0] == 2


def test_help_describes_every_parameter(capsys):
    assert run_verb('simulate', '--help') == 0

    # Lines are wrapped.
    text = ' '.join(capsys.readouterr().out.split())
    assert all(
        f' {name}: {described}; must be {described.kind.expected}' in text
        for name, described in simulation.PARAMETERS.items())
