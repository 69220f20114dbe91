# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command `fej_slam` and the executables."""

import argparse
import ast
from importlib import import_module
import inspect
import re
import signal
import subprocess
import sys
from types import ModuleType

import pytest

from fej_slam_ros.cli.main import executable, main, NODES, VERBS
from fej_slam_ros.errors import UsageError, UserError
from helpers.ros import assert_one_sentence, run_verb


@pytest.fixture
def run(monkeypatch):
    """Return a function that runs an executable with a given implementation of its verb."""
    def run_executable(words, function):
        name, *_ = words
        verb = ModuleType(f'fej_slam_ros.cli.{name}', 'Do something.')
        verb.add_arguments = lambda parser: parser.add_argument('--rate', type=float)
        verb.run = function
        node = ModuleType(f'fej_slam_ros.ros.nodes.{name}')
        node.main = function
        for module in verb, node:
            monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setattr(sys, 'argv', [f'/lib/fej_slam_ros/{name}', *words[1:]])
        return executable()
    return run_executable


def raising(error):
    def run_verb(_arguments):
        raise error
    return run_verb


@pytest.mark.parametrize(
    ('error', 'status', 'sentence'),
    [
        (UserError('The bag is empty.'), 1, 'replay: The bag is empty.\n'),
        (UsageError('The rate is negative.'), 2, 'replay: The rate is negative.\n'),
        (KeyboardInterrupt(), 130, ''),
        (PermissionError(13, 'Permission denied', 'in/landmarks.csv'), 1,
         'replay: in/landmarks.csv cannot be read: change its permissions\n'),
    ],
)
def test_a_user_error_is_one_sentence_and_a_status(run, capsys, error, status, sentence):
    assert run(['replay'], raising(error)) == status
    assert capsys.readouterr().err == sentence


@pytest.mark.parametrize(('verb', 'status'), [
    ('demo', 0), ('replay', 130), ('smooth', 130), ('simulate', 130), ('convert', 130),
    ('reproduce', 130)])
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.usefixtures('same_signals')
def test_a_signal_interrupts_a_verb_and_the_next_one_does_not_disturb_its_end(
    run, capsys, verb, status, number,
):
    ended = []

    def run_verb(_arguments):
        try:
            signal.raise_signal(number)
        finally:
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGINT)
            ended.append(verb)

    assert run([verb], run_verb) == status
    assert ended == [verb]
    assert capsys.readouterr().err == ''


@pytest.mark.parametrize(('words', 'entry', 'status'), [
    (['fej_slam', 'replay'], 'main', 130), (['fej_slam', 'estimator'], 'main', 0),
    (['lib/smooth'], 'executable', 130)])
@pytest.mark.parametrize('module', ['fej_slam_ros.cli', 'argparse', 'fej_slam_ros.interrupts'])
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_the_first_imports_ends_a_verb_without_a_traceback(
    words, entry, status, module, number,
):
    script = (
        'import signal, sys\n'
        'class Interrupting:\n'
        '    def find_spec(self, name, *_):\n'
        f'        if name == {module!r}: signal.raise_signal({int(number)})\n'
        'sys.meta_path.insert(0, Interrupting())\n'
        f'sys.argv = {words}\n'
        f'from fej_slam_ros.__main__ import {entry}\n'
        f'sys.exit({entry}())\n')

    ended = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True, check=False)

    assert (ended.returncode, ended.stdout, ended.stderr) == (status, '', '')


def test_a_signal_at_the_end_of_the_process_leaves_no_traceback():
    script = (
        'import signal, sys\n'
        'from fej_slam_ros.__main__ import main\n'
        'sys.argv = ["fej_slam", "replay", "--help"]\n'
        'try: main()\n'
        'finally: signal.raise_signal(signal.SIGINT)\n')

    ended = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True, check=False)

    assert (ended.returncode, ended.stderr) == (-signal.SIGINT, '')


@pytest.mark.usefixtures('same_signals')
def test_an_ignored_signal_stays_ignored(run):
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    assert run(['replay'], lambda _arguments: signal.raise_signal(signal.SIGINT) or 0) == 0


@pytest.mark.parametrize(('words', 'command'), [
    (['/opt/ws/lib/fej_slam_ros/replay'], 'replay'),
    (['/venv/bin/fej_slam', 'replay'], 'fej_slam replay'),
    (['/src/fej_slam_ros/__main__.py', 'replay'], 'python3 -m fej_slam_ros replay')])
def test_help_and_errors_name_the_command_that_was_typed(monkeypatch, capsys, words, command):
    entry = main if words[1:] else executable
    monkeypatch.setattr(sys, 'argv', [*words, '--help'])
    with pytest.raises(SystemExit, match='0'):
        entry()
    assert capsys.readouterr().out.startswith(f'usage: {command} ')

    monkeypatch.setattr(sys, 'argv', [*words, 'no', '--params', 'no', '--output', 'no'])
    assert entry() == 2
    assert capsys.readouterr().err.startswith(f'{command}: ')


@pytest.mark.parametrize('verb', VERBS)
def test_errors_of_a_verb_offer_only_options_that_it_has(verb):
    module = import_module(f'fej_slam_ros.cli.{verb}')
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    raised = ' '.join(
        ast.unparse(node) for node in ast.walk(ast.parse(inspect.getsource(module)))
        if isinstance(node, ast.Raise))
    offered, has = (
        set(re.findall(r'(?<![\w-])--[a-z][\w-]*', text))
        for text in (raised, parser.format_help()))
    assert offered <= has


@pytest.mark.parametrize(('module', 'cure'), [
    ('rclpy', 'source ROS 2 Jazzy, or'), ('rosbags', "run 'rosdep install "),
    ('rosbags.typesys', "'pip install rosbags'"), ('foxglove', "pip install -e '.[foxglove]'"),
    ('matplotlib', "pip install -e '.[plot]'"),
    ('rclpy.experimental', 'apt install ros-jazzy-rclpy')])
def test_a_missing_module_is_named_with_its_cure(run, capsys, module, cure):
    error = ModuleNotFoundError(f'No module named {module!r}', name=module)

    assert run(['play'], raising(error)) == 1
    sentence = capsys.readouterr().err
    assert sentence.startswith(f'play: the Python module {module} is missing: ')
    assert cure in sentence
    assert module == 'rclpy' or 'source ROS' not in sentence
    assert sentence.count('\n') == 1


@pytest.mark.parametrize('verb', [*NODES, 'replay'])
def test_options_of_ros_before_ros_args_are_named_with_the_way_to_give_them(verb, capsys):
    required = ['bag', '--params', 'a.yaml', '--output', 'out'] if verb == 'replay' else []

    assert run_verb(verb, *required, '--fleet', 'a') == 2

    said = capsys.readouterr().err.splitlines()[-1]
    assert 'unrecognized arguments: --fleet a' in said
    assert ('write --ros-args --params-file FILE' in said) == (verb in NODES)


@pytest.mark.parametrize(('verb', 'has_parameters'), [('simulate', True), ('view', False)])
def test_a_parameter_given_as_an_option_is_named_with_the_way_to_give_it(
    verb, has_parameters, capsys
):
    required = ['--output', 'out'] if verb == 'simulate' else []

    assert run_verb(verb, *required, '--seed', '3') == 2

    said = capsys.readouterr().err.splitlines()[-1]
    assert 'unrecognized arguments: --seed 3' in said
    assert said.endswith('write them into the file of --params') == has_parameters


def test_a_second_bag_is_not_taken_for_a_parameter(capsys):
    assert run_verb('replay', 'bag', 'other', '--params', 'a.yaml', '--output', 'out') == 2

    assert capsys.readouterr().err.endswith('unrecognized arguments: other\n')


@pytest.mark.parametrize('verb', ['doctor', 'evaluate', 'play'])
def test_a_path_that_no_file_can_have_is_one_sentence(capsys, verb):
    output = ['--output', 'out'] if verb == 'evaluate' else []

    status = run_verb(verb, 'n' * 300, *output)

    assert_one_sentence((status, *capsys.readouterr()), 2, 'n has a name that is too long')


@pytest.mark.parametrize('closed', ['>&-', '2>&-', '>&- 2>&-'])
def test_a_closed_output_changes_neither_the_work_nor_the_status(tmp_path, closed):
    """As of other commands: a script may close what it does not read."""
    words = f'"$0" -m fej_slam_ros simulate --output "$1" {closed}'
    shell = subprocess.run(
        ['sh', '-c', words, sys.executable, tmp_path / 'bag'], capture_output=True, check=False)

    assert (shell.returncode, shell.stderr) == (0, b'')
    assert (tmp_path / 'bag' / 'metadata.yaml').exists()


def test_a_defect_keeps_its_traceback(run):
    with pytest.raises(ZeroDivisionError):
        run(['replay'], lambda _arguments: 1 // 0)


def test_ros_arguments_of_a_node_are_left_to_rclpy(run):
    words = ['estimator', '--rate', '2', '--ros-args', '-p', 'rate:=3', '--params-file', 'x.yaml']
    calls = []

    run(words, calls.append)

    assert calls == [words[3:]]


@pytest.mark.parametrize('words', [['replay', '--ros-args'], ['estimator', '--rat', '2']])
def test_an_unknown_argument_is_a_usage_error(run, words):
    with pytest.raises(SystemExit, match='2'):
        run(words, lambda _arguments: 0)


@pytest.mark.parametrize('words', [[], ['--help']])
def test_help_lists_every_verb_with_its_summary(monkeypatch, capsys, words):
    monkeypatch.setattr(sys, 'argv', ['fej_slam', *words])

    with pytest.raises(SystemExit, match='0'):
        main()

    text = capsys.readouterr().out.split()
    for verb in VERBS:
        # A summary begins with a capital letter.
        assert text[text.index(verb) + 1][0].isupper()


def test_the_nearest_verb_is_named(monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['fej_slam', 'replya', 'BAG'])

    with pytest.raises(SystemExit, match='2'):
        main()

    assert capsys.readouterr().err.endswith('there is no replya, did you mean replay?\n')


def test_help_imports_neither_numpy_nor_rclpy():
    script = (
        'import sys; sys.argv = ["fej_slam", "--version"]\n'
        'from fej_slam_ros.cli.main import main\n'
        'try: main()\n'
        'finally: assert not {"numpy", "rclpy"} & set(sys.modules)'
    )

    subprocess.run([sys.executable, '-c', script], check=True)


def test_verbs_set_one_blas_thread_before_numpy_is_imported():
    script = (
        'import os, sys\n'
        'import fej_slam_ros.cli\n'
        'assert "numpy" not in sys.modules\n'
        'for library in ("OPENBLAS", "OMP", "MKL"):\n'
        '    assert os.environ[f"{library}_NUM_THREADS"] == "1"'
    )

    subprocess.run([sys.executable, '-c', script], check=True)
