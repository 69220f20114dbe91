# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Generate and compile the Python package of some messages, which is not on PyPI, into a folder.

Arguments: the folder, the name of the package, and a JSON object of definitions by message. It
needs the generators among ROS's wheels, empy 3.3.4 and gcc. The middleware looks for libraries by
bare names, and finds them because Python has loaded them under these names.
"""

from importlib.metadata import entry_points
import json
import os
from pathlib import Path
import subprocess
import sys
import sysconfig

import numpy as np

PREFIX = Path(sys.prefix)
PARTS = (
    'rosidl_generator_c', 'rosidl_generator_py', 'rosidl_typesupport_c',
    'rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_fastrtps_cpp',
    'rosidl_typesupport_introspection_c')
INTROSPECTION = 'rosidl_typesupport_introspection_c'
LIBRARIES = (
    *(f'{package}__{part}' for package in ('geometry_msgs', 'std_msgs') for part in PARTS),
    *PARTS[2:], 'rosidl_runtime_c', 'fastcdr', 'stdc++')


def build(folder, name, definitions):
    """Make the package in a folder."""
    package, introspection = folder / name, folder / 'introspection' / name
    (package / 'msg').mkdir(parents=True)
    for message, text in definitions.items():
        (package / 'msg' / f'{message}.msg').write_text(text)
    generate(package, package, 'type', 'c', 'cpp', 'py')
    generate(package, package, 'typesupport', 'c', 'fastrtps_c', 'fastrtps_cpp')
    generate(package, introspection, 'typesupport', 'introspection_c')
    (package / '__init__.py').touch()
    headers, of_introspection = (folder, introspection.parent), f'{name}__{INTROSPECTION}'
    compile_library(
        package / f'lib{of_introspection}.so', f'lib{of_introspection}.so', headers,
        introspection.glob('msg/**/*.c'))
    compile_library(
        package / f'{name}_s__rosidl_typesupport_c{sysconfig.get_config_var("EXT_SUFFIX")}',
        f'lib{name}__rosidl_typesupport_fastrtps_c.so', headers,
        [*package.glob('msg/**/*.c'), *package.glob('msg/**/*.cpp'),
         package / f'_{name}_s.ep.rosidl_typesupport_c.c', f'-L{package}',
         f'-l{of_introspection}'])


def generate(package, target, kind, *names):
    """Let some generators write their sources into a folder."""
    # The wheels name each of them twice, at which the command `rosidl` stumbles.
    group = f'rosidl_cli.command.generate.{kind}_extensions'
    generators = {entry.name: entry for entry in entry_points(group=group)}
    for name in names:
        generators[name].load()(name).generate(
            package.name,
            [f'{package}:msg/{definition.name}' for definition in package.glob('msg/*.msg')],
            [f'{PREFIX}/share'], target)


def compile_library(path, name, headers, sources):
    """Compile sources into a library with a name of its own."""
    folders = [
        *headers, sysconfig.get_paths()['include'], np.get_include(), PREFIX / 'include',
        *(PREFIX / 'include').iterdir()]
    subprocess.run(
        ['gcc', '-fPIC', '-shared', '-w', '-o', path, *(f'-I{folder}' for folder in folders),
         f'-Wl,-soname,{name}', '-Wl,-rpath,$ORIGIN', '-Wl,--no-as-needed',
         '-Wl,--allow-shlib-undefined', f'-L{PREFIX}/lib', *sources,
         *(f'-l{library}' for library in LIBRARIES)],
        check=True)


if __name__ == '__main__':
    # Where the generators look for the definitions of other packages.
    os.environ['AMENT_PREFIX_PATH'] = str(PREFIX)
    build(Path(sys.argv[1]), sys.argv[2], json.loads(sys.argv[3]))
