# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Size and shape of the code: what a reader can take in, and names that mean one thing."""

import ast
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from statistics import median, quantiles

import pytest

import fej_slam_ros

pytestmark = pytest.mark.linter

PACKAGE = Path(fej_slam_ros.__file__).parent
SOURCES = {
    '.'.join((PACKAGE.name, *path.relative_to(PACKAGE).with_suffix('').parts)):
        path.read_text(encoding='utf-8')
    for path in sorted(PACKAGE.rglob('*.py'))}
TREES = {name: ast.parse(source) for name, source in SOURCES.items()}
FUNCTION = ast.FunctionDef, ast.AsyncFunctionDef

#: Lines of a module.
MODULE = 400
#: Public methods of a class, properties included.
PUBLIC_METHODS = 15
#: Lines of a function from its `def` on, docstring included: of the median and of nine in ten.
TYPICAL, LONG = 6, 18


def nodes(kind):
    """Yield each node of a kind with the name of its module."""
    for name, tree in TREES.items():
        yield from ((name, node) for node in ast.walk(tree) if isinstance(node, kind))


def imported_modules(name):
    """Yield the modules of the package that a module imports when it is imported."""
    for node in ast.walk(ast.Module(executed(TREES[name].body), [])):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (
                f'{node.module}.{alias.name}' if f'{node.module}.{alias.name}' in TREES
                or f'{node.module}.{alias.name}.__init__' in TREES else node.module
                for alias in node.names)


def executed(body):
    """Return the statements of a module without the bodies of its functions."""
    return [node for node in body if isinstance(node, (ast.Import, ast.ImportFrom, ast.If))]


def test_no_module_is_too_long():
    lengths = {name: source.count('\n') for name, source in SOURCES.items()}

    assert not {name: length for name, length in lengths.items() if length > MODULE}


def test_no_class_has_too_many_public_methods():
    counts = {
        f'{name}.{node.name}': sum(
            isinstance(part, FUNCTION) and not part.name.startswith('_') for part in node.body)
        for name, node in nodes(ast.ClassDef)}

    assert not {name: count for name, count in counts.items() if count > PUBLIC_METHODS}


def test_functions_are_short():
    lengths = [node.end_lineno - node.lineno + 1 for _, node in nodes(FUNCTION)]

    assert median(lengths) <= TYPICAL
    assert quantiles(lengths, n=10)[-1] <= LONG


def test_no_two_classes_have_one_name():
    modules = defaultdict(list)
    for name, node in nodes(ast.ClassDef):
        modules[node.name].append(name)

    assert not {name: found for name, found in modules.items() if len(found) > 1}


def test_no_modules_import_each_other():
    graph = {name.removesuffix('.__init__'): set(imported_modules(name)) for name in TREES}

    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(' -> '.join(reversed(error.args[1])))


def test_no_test_module_skips_while_it_is_imported():
    # ROS's launch_testing imports each test module in a hook, where this skips the whole session.
    root = Path(__file__).parents[1]
    skipping = {
        path.relative_to(root).as_posix()
        for path in root.rglob('test_*.py')
        for node in ast.parse(path.read_text(encoding='utf-8')).body
        if isinstance(node, (ast.Assign, ast.Expr)) and isinstance(node.value, (
            ast.Call, ast.Attribute))
        and ast.unparse(node.value).startswith(('pytest.importorskip', 'pytest.skip('))}

    assert not skipping


def test_every_unit_test_has_a_source_module_of_the_same_path():
    unit = Path(__file__).parents[1] / 'unit'
    tests = [path.relative_to(unit) for path in unit.rglob('test_*.py')]

    assert tests
    assert not {
        path.as_posix() for path in tests
        if not (PACKAGE / path.with_name(path.name.removeprefix('test_'))).is_file()}
