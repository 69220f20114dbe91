# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The user pages: names exist, links and generated pages are current, commands run."""

import argparse
import ast
from dataclasses import replace
from importlib import import_module
from itertools import takewhile
import math
import os
from pathlib import Path
from pydoc import locate
import re
import runpy
import shlex
import shutil
import signal
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.io import savemat

from fej_slam_ros.cli.main import NODES, VERBS
from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.parameters.detector_settings import parse_detector
from fej_slam_ros.ros.session.detector_session import DetectorSession
from helpers.mrclam import STRAIGHT, write_set
from helpers.paths import ROOT
from helpers.processes import end_session, start_verb, until
from helpers.ros import cdr, run_verb, TYPES, write_bag, write_parameters

PAGES = [
    'README.md', 'CONTRIBUTING.md', 'bags/README.md',
    *(f'docs/{p.name}' for p in (ROOT / 'docs').glob('*.md'))]
GENERATORS = ['generate.py', 'generate_api.py']

#: First words of a block of commands that is not marked as sh.
PROGRAMS = 'colcon', 'fej_slam', 'git', 'make', 'pip', 'ros2', 'rosdep'

#: First words of commands that are not run, with the reason. Arguments of fej_slam are checked.
NOT_RUN = {
    'git clone': 'needs a network',
    'cd fej_slam_ros': 'as git clone',
    'colcon build': 'test_colcon.py builds, and runs what was built',
    'colcon test': 'as colcon build',
    'colcon test-result': 'as colcon build',
    '. install/setup.bash': 'as colcon build',
    'pip install': 'needs a network; the extras are checked',
    'apt install': 'needs a network',
    'rosdep install': 'not on PyPI; test_package_xml.py checks the names of the dependencies',
    'make': 'the target is checked; they are the gate itself, the demo and `reproduce all`',
    'python3 publisher.py': 'test_discovery.py runs it',
    'python3 recorder.py': 'as python3 publisher.py',
    'ros2 launch': 'not on PyPI; file and arguments are checked',
    'ros2 topic': 'not on PyPI; the topic is checked',
    'ros2 param': 'not on PyPI; test_team.py changes the parameter',
    'ros2 service': 'not on PyPI; test_relocalisation.py calls the service',
    'ros2 bag': 'not on PyPI; topics are checked',
    'ros2 security': 'neither sros2 nor DDS-Security is on PyPI',
    'ros2 run rmw_zenoh_cpp': 'not on PyPI',
    'ros2 run apriltag_ros': 'not on PyPI',
    'RMW_IMPLEMENTATION=rmw_zenoh_cpp': 'not on PyPI',
    'ros2 run fej_slam_ros estimator --ros-args --enclave': 'as ros2 security',
    'fastdds discovery': 'live/test_discovery.py starts a server, on this machine',
    'ip netns': 'needs root; live/test_discovery.py uses namespaces where it is root',
    'fej_slam convert victoria_park --raw --robots 2':
        'needs 19 minutes of log; converters/test_victoria_park.py converts parts',
    'fej_slam convert mrclam --input FOLDER --measure':
        'needs motion capture; converters/test_mrclam.py measures',
    'fej_slam reproduce csam': 'half a minute; test_reproduce.py runs one part of it',
    'fej_slam reproduce figures --data': 'as `reproduce tables --data`',
    'fej_slam reproduce noise': 'minutes; test_reproduce.py runs it smaller',
    'fej_slam reproduce tables --data':
        'needs the files of the authors; test_tables.py reads them',
    'fej_slam reproduce victoria_park': 'minutes; test_real_data.py runs it',
    'fej_slam reproduce mrclam': 'minutes; test_real_data.py runs it',
    'fej_slam reproduce raw_victoria_park': 'a minute; test_real_data.py runs it',
    'fej_slam convert g2o --input victoria_park.txt':
        'half a minute with the next two; converters/test_g2o.py smooths and replays it',
    'fej_slam smooth park_graph': 'as fej_slam convert g2o --input victoria_park.txt',
    'fej_slam replay park_graph': 'as fej_slam convert g2o --input victoria_park.txt',
    'fej_slam evaluate recording': 'a bag of the reader; test_evaluate.py evaluates bags',
    'fej_slam replay husky_bag': 'a bag of the reader; test_recorded_names.py renames topics',
    'fej_slam replay fleet_bag': 'as fej_slam replay husky_bag',
    'fej_slam play husky_bag': 'as fej_slam replay husky_bag',
    'fej_slam convert robot_bags':
        'bags of the reader; converters/test_robot_bags.py merges bags',
    'fej_slam doctor team': 'as fej_slam convert robot_bags',
    'fej_slam replay team': 'as fej_slam convert robot_bags',
    'fej_slam benchmark': 'minutes; test_benchmark.py runs it smaller',
}
#: A fenced block: the file name to save it as, its language, its lines.
FENCE = re.compile(
    r'(?:[Ss]ave as `([\w.]+)`:\n\n)?^```(\w*)\n(.*?)^```$', re.DOTALL | re.MULTILINE)
#: Verbs that run until a signal ends them; `play` waits for subscribers, which have ended.
RUNNING = *NODES, 'play', 'view'
#: Options that make a command take seconds.
SMALLER = {'fej_slam reproduce': ['--runs', '1']}


class Block(NamedTuple):
    """A fenced block of a page: its language, the file name to save it as, and its lines."""

    page: str
    line: int
    language: str
    name: str
    text: str


def blocks(page):
    text = (ROOT / page).read_text(encoding='utf-8')
    for found in FENCE.finditer(text):
        line = text.count('\n', 0, found.start(3))
        yield Block(page, line + 1, found[2], found[1] or '', found[3])


def is_commands(block):
    first = [*block.text.split(maxsplit=1), ''][0]
    return block.language == 'sh' or (not block.language and first in PROGRAMS)


BLOCKS = [block for page in PAGES for block in blocks(page)]
SAVED = {block.name: block.text for block in BLOCKS if block.name}
COMMANDS = [block for block in BLOCKS if is_commands(block)]


def commands(block):
    """Yield the words of each command."""
    for line in block.text.splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars='&')
        lexer.whitespace_split = True
        words = []
        for word in [*lexer, '&&']:
            if word in ('&&', '&'):
                if words:
                    yield words
                words = []
            else:
                words.append(word)


def reason_not_to_run(words):
    command = ' '.join(words)
    return next((begin for begin in NOT_RUN if f'{command} '.startswith(f'{begin} ')), None)


def test_every_exception_is_of_a_command_on_a_page():
    begun = {reason_not_to_run(words) for block in COMMANDS for words in commands(block)}

    assert set(NOT_RUN) == begun - {None}


def with_reversed_ranges(message):
    """Return a scan with every range at its angle, but as if it was measured at another time."""
    if not message.topic.endswith('/scan'):
        return message
    scan = TYPES.deserialize_cdr(message.raw, message.type_name)
    return replace(message, raw=cdr(replace(
        scan, ranges=scan.ranges[::-1].copy(), angle_min=scan.angle_max,
        angle_max=scan.angle_min, angle_increment=-scan.angle_increment)))


class Shell:
    """Runs the commands of a page in a folder of its own."""

    def __init__(self, folder, data):
        self.folder = folder
        self.data = data
        self.environment = {}

    def run(self, words):
        """Check a command, and run it unless there is a reason not to."""
        why = reason_not_to_run(words)
        assignments = list(takewhile(re.compile(r'\w+=').match, words))
        own = dict(word.split('=', 1) for word in assignments)
        program, *rest = words[len(assignments):]
        if program == 'export':
            self.environment |= dict(word.split('=', 1) for word in rest)
        elif program == 'mkdir':
            (self.folder / rest[-1]).mkdir(parents=True)
        elif Path(program).name == 'fej_slam' or rest[:2] == ['run', 'fej_slam_ros']:
            self.verb(rest[2:] if program == 'ros2' else rest, why, own)
        else:
            assert why, f'neither run nor in NOT_RUN: {words}'
            CHECKS.get(' '.join(words[:2]), CHECKS.get(program, bool))(rest)

    def verb(self, words, why, environment):
        """Run a verb; a node only until it handles SIGTERM, that is, has read its arguments."""
        verb, *rest = (self.replaced(word, words) for word in words)
        assert verb in VERBS
        if verb in RUNNING:
            if not why:
                self.node(verb, rest, self.environment | environment)
        elif why:
            parser = argparse.ArgumentParser()
            import_module(f'fej_slam_ros.cli.{verb}').add_arguments(parser)
            parser.parse_args(rest)
        else:
            more = SMALLER.get(f'fej_slam {verb}', [])
            assert run_verb(verb, *rest, *more) == 0

    def node(self, verb, words, environment):
        pytest.importorskip('rclpy', reason='rclpy is not installed')
        # If security is requested and missing, the node must end by itself.
        secured = environment.get('ROS_SECURITY_ENABLE') == 'true'
        process = start_verb(verb, *words, cwd=self.folder, env={**os.environ, **environment})
        try:
            until(lambda: process.poll() is not None or (
                not secured and catches(process, signal.SIGTERM)), bool)
            process.send_signal(signal.SIGINT)
            errors = process.communicate()[1]
        finally:
            end_session(process)
        assert process.returncode == (2 if secured else 0), errors
        assert not secured or "doesn't have the security libraries" in errors

    def drive(self):
        """Return a recording of two robots with lasers, whose drivers reverse the ranges."""
        folder, world = self.folder / 'drive', self.folder / 'world'
        if not folder.exists():
            settings = write_parameters(
                self.folder / 'world.yaml', environment='posts', robots=['tb4_1', 'tb4_2'],
                loops=1, beams=360)
            assert run_verb('simulate', '--params', settings, '--output', world) == 0
            write_bag(folder, [*map(with_reversed_ranges, bags.read(world))])
        return str(folder)

    def replaced(self, word, words):
        """Return a value for a word that the reader is to replace."""
        if word == 'drive':
            return self.drive()
        if word == 'FOLDER':
            return str(self.data('raw' if '--raw' in words else words[1]))
        return {
            'BAG': 'bags/two_circles', 'FILE': 'bags/two_circles.yaml',
            'FILE.yaml': 'bags/two_circles.yaml',
        }.get(word, word)


def catches(process, number):
    """Return whether a process has a handler for a signal."""
    status = Path(f'/proc/{process.pid}/status').read_text(encoding='utf-8')
    return int(re.search(r'SigCgt:\s*(\w+)', status)[1], 16) >> (number - 1) & 1


def check_target(words):
    assert f'\n{words[0]}:' in (ROOT / 'Makefile').read_text(encoding='utf-8')


def check_extras(words):
    setup = (ROOT / 'setup.py').read_text(encoding='utf-8')
    extras = re.search(r'\.\[(.*)\]', words[-1])[1].split(',')
    assert all(f"        '{extra}': [" in setup for extra in extras)


def check_launch(words):
    _, package, file, *given = words
    assert package == 'fej_slam_ros'
    source = (ROOT / 'launch' / file).read_text(encoding='utf-8')
    assert {word.partition(':=')[0] for word in given} <= set(declared_arguments(file, source))


def declared_arguments(file, source):
    """Yield the names of the arguments of a launch file in Python or YAML."""
    if file.endswith('.yaml'):
        yield from (
            action['arg']['name'] for action in YAML(typ='safe').load(source)['launch']
            if 'arg' in action)
    else:
        calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
        yield from (
            call.args[0].value for call in calls
            if ast.unparse(call.func) == 'DeclareLaunchArgument')


def check_topics(words):
    page = (ROOT / 'docs' / 'topics.md').read_text(encoding='utf-8')
    of_sensors = {*DetectorSession(parse_detector({'robots': ['r1']})).topics, 'r1/tf'}
    for topic in (word for word in words if word.startswith('/')):
        of_robot = re.sub(r'^/(r|tb4_)\d/', '<robot>/', topic)
        general = re.sub(r'^/(estimator|smoother)/', '~/', of_robot)
        assert f'| `{general}` |' in page or general.replace('<robot>', 'r1') in of_sensors, topic


CHECKS = {
    'make': check_target, 'pip': check_extras, 'ros2 launch': check_launch,
    'ros2 topic': check_topics, 'ros2 bag': check_topics}


@pytest.fixture
def data(tmp_path, raw_park):
    """Return a function that makes a small data set up and returns its folder."""
    def make(name):
        folder = tmp_path / 'data'
        if name == 'raw':
            return raw_park()
        if name == 'mrclam':
            return write_set(folder, STRAIGHT)
        folder.mkdir(exist_ok=True)
        # The two robots of the paper need 5813 poses: all of them on one circle.
        turn = math.tau / 20
        move = 2.0 * math.sin(turn), 2.0 - 2.0 * math.cos(turn), turn
        rows = [(1, k, k + 1, *move, *[0] * 6) for k in range(5812)]
        rows += [(0, k, 7, 0.0, 2.0, *[0] * 7) for k in range(5813)]
        savemat(folder / 'VicPark_clean_data.mat', {'VicPark_clean_data': np.array(rows)})
        return folder
    return make


@pytest.fixture
def shell(tmp_path, data, monkeypatch):
    """Return a shell in a folder with the bags and configuration and the files of the pages."""
    folder = tmp_path / 'copy'
    for name in ('bags', 'config', 'launch'):
        shutil.copytree(ROOT / name, folder / name)
    for name, text in SAVED.items():
        (folder / name).write_text(text, encoding='utf-8')
    monkeypatch.chdir(folder)
    return Shell(folder, data)


@pytest.mark.slow
@pytest.mark.parametrize(
    'block', COMMANDS, ids=[f'{block.page}:{block.line}' for block in COMMANDS])
def test_commands_of_a_block_run_in_order(block, shell):
    for words in commands(block):
        shell.run(words)


@pytest.mark.parametrize('page', PAGES)
def test_link_targets_exist(page):
    text = (ROOT / page).read_text(encoding='utf-8')
    for link, anchor in re.findall(r'\]\((?!https?:)([^)#]*)(?:#([^)]*))?\)', text):
        target = ((ROOT / page).parent / link) if link else ROOT / page
        assert target.exists(), link
        if anchor:
            headings = re.findall(r'^#+ (.*)$', target.read_text(encoding='utf-8'), re.MULTILINE)
            assert anchor in [re.sub(r'[^\w -]', '', h).lower().replace(' ', '-')
                              for h in headings]


@pytest.mark.parametrize('generator', GENERATORS)
def test_generated_pages_are_current(generator):
    if generator == 'generate.py':
        pytest.importorskip('rclpy', reason='rclpy is not installed')
    pages = runpy.run_path(str(ROOT / 'docs' / generator))['pages']()

    for name, text in pages.items():
        assert (ROOT / 'docs' / name).read_text(encoding='utf-8') == text, 'run make docs'


def test_every_page_is_in_the_index():
    index = (ROOT / 'docs' / 'README.md').read_text(encoding='utf-8')

    assert {path.name for path in (ROOT / 'docs').glob('*.md')} == {
        'README.md', *re.findall(r'\]\((\w+\.md)\)', index)}


@pytest.mark.parametrize('page', ['docs/theory.md'])
def test_every_name_of_the_core_on_a_page_exists(page):
    text = (ROOT / page).read_text(encoding='utf-8')
    names = re.findall(r'`(core(?:\.\w+)+)`', text)

    assert names
    for name in names:
        assert locate(f'fej_slam_ros.{name}') is not None, name


# test_contributing.py checks the paths of CONTRIBUTING.md.
@pytest.mark.parametrize('page', [page for page in PAGES if page != 'CONTRIBUTING.md'])
def test_every_source_file_named_on_a_page_exists(page):
    text = (ROOT / page).read_text(encoding='utf-8')
    for name in re.findall(r'`((?:test|benchmark|core)/[\w/]*\.py)`', text):
        assert (ROOT / name).exists() or (ROOT / 'fej_slam_ros' / name).exists(), name


def test_the_bandwidth_in_scale_is_that_of_the_generated_page():
    topics, scale = (
        ' '.join((ROOT / 'docs' / page).read_text(encoding='utf-8').split())
        for page in ('topics.md', 'scale.md'))

    assert re.search(r'sends ([\d.]+ kB/s), or', topics)[1] in scale


def test_reserved_names_are_among_the_limits():
    limits = (ROOT / 'docs' / 'limits.md').read_text(encoding='utf-8')

    assert all(f'`{name}`' in limits.partition('No robot can')[2]
               for name in parameters.RESERVED_NAMES)


@pytest.mark.parametrize('text', [b.text for b in BLOCKS if b.language == 'yaml'], ids=len)
def test_parameters_on_a_page_are_accepted(text, tmp_path):
    (tmp_path / 'given.yaml').write_text(text, encoding='utf-8')

    parameters.load(tmp_path / 'given.yaml')


@pytest.mark.parametrize(
    'program', [b.text for b in BLOCKS if b.language == 'python' and not b.name], ids=len)
def test_a_program_on_a_page_runs(program):
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=False)

    assert done.returncode == 0, done.stderr
    assert done.stdout


def tutorial(name):
    """Return what is in a program of the tutorial."""
    pytest.importorskip('rclpy', reason='rclpy is not installed')
    space = {'__name__': name}
    exec(compile(SAVED[f'{name}.py'], f'{name}.py', 'exec'), space)  # noqa: S102
    return argparse.Namespace(**space)


@pytest.mark.parametrize(
    'name', [name for name, text in SAVED.items() if 'rclpy.spin(' in text])
def test_a_node_of_the_tutorial_ends_cleanly_at_a_signal(name):
    assert 'except (KeyboardInterrupt, ExternalShutdownException):' in SAVED[name]


def test_the_polar_observation_of_the_tutorial_is_that_of_the_package():
    publisher = tutorial('publisher')

    x, y, var_x, cov_xy, var_y = publisher.polar(5.0, 0.7, 0.05, 0.02)

    z, R = polar(5.0, 0.7, 0.05, 0.02)
    np.testing.assert_allclose((x, y), z, rtol=1e-12)
    np.testing.assert_allclose([[var_x, cov_xy], [cov_xy, var_y]], R, rtol=1e-12)
