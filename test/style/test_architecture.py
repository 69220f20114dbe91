# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The import rule: nothing points back, and mathematics and ROS do not meet."""

import ast
from collections.abc import Iterator
from pathlib import Path
import subprocess
import sys
from typing import NamedTuple

import pytest

import fej_slam_ros

PACKAGE = Path(fej_slam_ros.__file__).parent

MESSAGES = (
    'builtin_interfaces diagnostic_msgs geometry_msgs lifecycle_msgs nav_msgs rosgraph_msgs '
    'sensor_msgs std_msgs std_srvs tf2_msgs visualization_msgs'
)
CORE = 'numpy scipy fej_slam_ros.core fej_slam_ros.errors'
DETECTION = f'{CORE} fej_slam_ros.detection'
SIM = f'{DETECTION} fej_slam_ros.sim'
ROS = (
    f'{DETECTION} fej_slam_ros.ros fej_slam_ros.atomic_files fej_slam_ros.interrupts '
    'fej_slam_ros.output_lock '
    'fej_slam_ros.palette fej_slam_ros.tables fej_slam_ros.child_process '
    f'fej_slam_ros.__version__ rosbags ruamel tqdm rclpy rcl_interfaces {MESSAGES}'
)


class Rule(NamedTuple):
    """What a part may use beyond the standard library, and what it may not use all the same."""

    allowed: str
    forbidden: str = ''


#: The modules of core that all its sub-packages may use.
BASIC = (
    'numpy scipy fej_slam_ros.errors '
    + ' '.join(f'fej_slam_ros.core.{module}' for module in (
        'chi_square', 'consistency', 'definiteness', 'estimates', 'frame_names', 'gauss_newton',
        'geometry', 'ground_truth', 'join_failure', 'matches',
        'models', 'motion_models', 'parameter_kinds', 'pieces', 'point_consensus',
        'pose_evaluation', 'records', 'rejections', 'sentences', 'settings'))
)
NO_SIDE_EFFECTS = (
    'builtins.open builtins.print io logging os pathlib socket subprocess '
    'datetime time numpy.random random'
)


def in_core(*others: str) -> Rule:
    """Return the rule of a part of core that uses some other parts of it."""
    parts = ' '.join(f'fej_slam_ros.core.{other}' for other in others)
    return Rule(f'{BASIC} {parts}', NO_SIDE_EFFECTS)


ABOVE_FILES = 'fej_slam_ros.ros.doctor fej_slam_ros.ros.nodes fej_slam_ros.ros.session'
NO_ALGEBRA = 'numpy.dot numpy.einsum numpy.linalg numpy.matmul operator.matmul scipy'
#: The rule of a module is that of the first entry with which its path begins.
RULES = {
    'core/ordering/': in_core('ordering'),
    # The kernel is chosen once, at import, by an environment variable.
    'core/ekf/kernel.py': Rule(
        f'{BASIC} fej_slam_ros.core.ekf', NO_SIDE_EFFECTS.replace(' os ', ' ')),
    'core/ekf/': in_core('ekf'),
    'core/joining/': in_core('joining', 'ekf'),
    'core/data_association/': in_core('data_association', 'ekf'),
    'core/smoothing/': in_core('smoothing', 'ekf'),
    'core/csam/': in_core('csam', 'smoothing', 'ordering'),
    'core/peers/': in_core('peers', 'csam', 'smoothing', 'ordering'),
    'core/calibration/': in_core(
        'calibration', 'estimator', 'innovation_monitor', 'offline_matching', 'ordering', 'ekf'),
    'core/offline_matching.py': in_core('estimator', 'ordering'),
    'core/estimator.py': in_core(
        'frame_groups', 'team_joiner', 'quarantine', 'innovation_monitor', 'new_landmarks',
        'ordering', 'ekf', 'data_association'),
    'core/frame_groups.py': in_core('ekf', 'joining'),
    'core/new_landmarks.py': in_core('ekf', 'ordering'),
    'core/innovation_monitor.py': in_core('ekf', 'data_association'),
    'core/team_joiner.py': in_core(
        'frame_groups', 'quarantine', 'new_landmarks', 'ekf', 'joining', 'data_association',
        'ordering'),
    'core/quarantine.py': in_core('frame_groups', 'ordering', 'ekf', 'data_association'),
    'core/prediction.py': in_core('ordering'),
    'core/snapshot.py': in_core(
        'estimator', 'frame_groups', 'team_joiner', 'quarantine', 'innovation_monitor', 'ordering',
        'ekf', 'joining', 'data_association', 'csam', 'smoothing'),
    'core/__init__.py': Rule('fej_slam_ros.core'),
    'core/': in_core(),
    'detection/': Rule(DETECTION, NO_SIDE_EFFECTS),
    'sim/': Rule(SIM, 'numpy.random.default_rng random'),
    'datasets/': Rule(f'{CORE} fej_slam_ros.datasets fej_slam_ros.tables'),
    'experiments/common/cluster.py': Rule('fej_slam_ros.errors distributed'),
    'experiments/': Rule(
        f'{SIM} fej_slam_ros.datasets fej_slam_ros.experiments fej_slam_ros.figure_files '
        'fej_slam_ros.palette fej_slam_ros.tables fej_slam_ros.child_process '
        'fej_slam_ros.interrupts matplotlib'),
    'benchmark/isam2.py': Rule(f'{CORE} fej_slam_ros.benchmark.synthetic_drive gtsam'),
    'benchmark/gtsam_batch.py': Rule(
        f'{CORE} fej_slam_ros.benchmark.batch fej_slam_ros.benchmark.isam2 gtsam'),
    'benchmark/tables.py': Rule('fej_slam_ros'),
    'benchmark/figure.py': Rule('fej_slam_ros matplotlib'),
    'benchmark/': Rule(
        f'{ROS} {SIM} fej_slam_ros.benchmark fej_slam_ros.experiments fej_slam_ros.tables'),
    'evaluation/': Rule(
        f'{CORE} fej_slam_ros.evaluation fej_slam_ros.figure_files fej_slam_ros.palette '
        'fej_slam_ros.tables matplotlib'),
    'ros/files/run_results.py': Rule(
        f'{ROS} fej_slam_ros.evaluation.run_result', ABOVE_FILES),
    'ros/files/': Rule(ROS, ABOVE_FILES),
    'ros/messages/': Rule(ROS, ABOVE_FILES),
    'ros/parameters/': Rule(ROS, ABOVE_FILES),
    'ros/nodes/simulator.py': Rule(f'{ROS} fej_slam_ros.sim', NO_ALGEBRA),
    'ros/nodes/foxglove.py': Rule(f'{ROS} foxglove', NO_ALGEBRA),
    'ros/nodes/': Rule(ROS, NO_ALGEBRA),
    'ros/session/simulation.py': Rule(f'{ROS} fej_slam_ros.sim'),
    'ros/': Rule(ROS, 'fej_slam_ros.ros.nodes'),
    'cli/': Rule('numpy scipy matplotlib rosbags tqdm rclpy fej_slam_ros'),
    'errors.py': Rule(''),
    'interrupts.py': Rule(''),
    'child_process.py': Rule(''),
    'figure_files.py': Rule('matplotlib'),
    'palette.py': Rule(''),
    'tables.py': Rule(''),
    'atomic_files.py': Rule('fej_slam_ros.errors'),
    'output_lock.py': Rule('fej_slam_ros.atomic_files fej_slam_ros.errors'),
    '__init__.py': Rule(''),
    '__main__.py': Rule('fej_slam_ros.cli'),
}


def used_names(source: str) -> Iterator[str]:
    """Yield the full names of what a module imports, reaches through an import, or has anyway."""
    nodes = list(ast.walk(ast.parse(source)))
    imported = {}
    for node in nodes:
        if isinstance(node, ast.Import):
            imported |= {alias.asname or alias.name: alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = '.' * node.level + (node.module or '')
            imported |= {a.asname or a.name: f'{module}.{a.name}' for a in node.names}
    yield from imported.values()
    for node in nodes:
        if isinstance(node, ast.Attribute):
            root, _, rest = ast.unparse(node).partition('.')
            if root in imported:
                yield f'{imported[root]}.{rest}'
        elif isinstance(node, ast.Name) and node.id in {'open', 'print'}:
            yield f'builtins.{node.id}'
        elif isinstance(node, ast.MatMult):
            yield 'operator.matmul'


def is_in(name: str, parts: str) -> bool:
    return any(f'{name}.'.startswith(f'{part}.') for part in parts.split())


def violations(path: str, source: str) -> list[str]:
    """Return the names that the module at a path in the package must not use."""
    rule = next(rule for start, rule in RULES.items() if path.startswith(start))
    return [
        name for name in used_names(source)
        if is_in(name, rule.forbidden)
        or not (is_in(name, rule.allowed) or name.partition('.')[0] in sys.stdlib_module_names)
    ]


def built_messages(source: str) -> list[str]:
    """Return the message classes that a module imports and calls."""
    nodes = list(ast.walk(ast.parse(source)))
    classes = {
        alias.asname or alias.name
        for node in nodes
        if isinstance(node, ast.ImportFrom)
        and is_in(node.module or '', f'{MESSAGES} rosbags.typesys.stores')
        for alias in node.names
    }
    calls = {ast.unparse(node.func) for node in nodes if isinstance(node, ast.Call)}
    return sorted(classes & calls)


MODULES = {
    path.relative_to(PACKAGE).as_posix(): path.read_text(encoding='utf-8')
    for path in sorted(PACKAGE.rglob('*.py'))}


@pytest.mark.linter
def test_each_module_uses_only_what_its_part_may_use():
    found = {path: violations(path, source) for path, source in MODULES.items()}

    assert not {path: names for path, names in found.items() if names}


@pytest.mark.linter
def test_messages_are_built_in_one_package_only():
    found = {
        path: built_messages(source) for path, source in MODULES.items()
        if not path.startswith('ros/messages/')}

    assert not {path: names for path, names in found.items() if names}


@pytest.mark.parametrize(
    ('path', 'source', 'name'),
    [
        ('core/ekf/filter.py', 'import rclpy', 'rclpy'),
        ('core/ekf/filter.py', 'import time', 'time'),
        ('core/ekf/filter.py', 'def f():\n    from os import path', 'os.path'),
        ('core/ekf/filter.py', 'import numpy as np\nnp.random.rand()', 'numpy.random.rand'),
        ('core/ekf/filter.py', 'open("log")', 'builtins.open'),
        ('core/ekf/filter.py', 'from . import geometry', '..geometry'),
        ('sim/world.py', 'from fej_slam_ros.ros.files import bags', 'fej_slam_ros.ros.files.bags'),
        ('sim/world.py', 'from numpy.random import default_rng', 'numpy.random.default_rng'),
        ('datasets/mrclam/files.py', 'import fej_slam_ros.sim', 'fej_slam_ros.sim'),
        ('experiments/liu/tables.py', 'import fej_slam_ros.cli', 'fej_slam_ros.cli'),
        ('ros/files/bags.py', 'import fej_slam_ros.sim', 'fej_slam_ros.sim'),
        ('ros/nodes/estimator.py', 'import numpy as np\nnp.linalg.inv(P)', 'numpy.linalg.inv'),
        ('ros/nodes/estimator.py', 'P = F @ P', 'operator.matmul'),
        ('cli/replay.py', 'from nav_msgs.msg import Odometry', 'nav_msgs.msg.Odometry'),
    ],
)
def test_a_forbidden_use_is_found(path, source, name):
    assert name in violations(path, source)


def test_a_message_that_is_built_elsewhere_is_found():
    source = 'from nav_msgs.msg import Odometry\nmessage = Odometry()'

    assert built_messages(source) == ['Odometry']


def test_the_verbs_without_topics_run_where_there_is_no_ros():
    verbs = (
        'simulate', 'replay', 'smooth', 'evaluate', 'doctor', 'calibrate', 'convert', 'benchmark')
    without_ros = f'import sys; sys.modules.update(dict.fromkeys({["rclpy", *MESSAGES.split()]}))'
    imports = '; '.join(f'import fej_slam_ros.cli.{verb}' for verb in verbs)

    subprocess.run([sys.executable, '-c', f'{without_ros}; {imports}'], check=True)
