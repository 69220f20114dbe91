# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Python packages of messages that are not on PyPI, generated where they are not installed."""

from contextlib import contextmanager
from importlib.util import find_spec
import json
import os
import shutil
import subprocess
import sys

import pytest

from helpers.paths import ROOT

GENERATOR = ROOT / 'test' / 'helpers' / 'generate_messages.py'


@contextmanager
def provided(folder, packages):
    """Provide packages {name: {message: definition}} to this process and its children."""
    with pytest.MonkeyPatch.context() as patch:
        missing = {
            name: messages for name, messages in packages.items() if find_spec(name) is None}
        if missing:
            _generate(folder, missing)
            patch.syspath_prepend(folder)
            patch.setenv('PYTHONPATH', str(folder), prepend=os.pathsep)
        yield
    for name in [name for name in sys.modules if name.partition('.')[0] in packages]:
        del sys.modules[name]


def _generate(folder, packages):
    if shutil.which('gcc') is None:
        pytest.skip('generating messages needs gcc')
    tools = folder / 'tools'
    pip = [sys.executable, '-m', 'pip', 'install', '--quiet', '--target', tools, 'empy==3.3.4']
    if subprocess.run(pip, check=False).returncode != 0:
        pytest.skip('generating messages needs empy 3.3.4, which cannot be installed')
    environment = {**os.environ, 'PYTHONPATH': str(tools)}
    for name, definitions in packages.items():
        subprocess.run(
            [sys.executable, GENERATOR, folder, name, json.dumps(definitions)], check=True,
            env=environment)
