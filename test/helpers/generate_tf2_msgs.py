# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Generate and compile the Python package tf2_msgs, which is not on PyPI, into a folder.

It needs the generators among ROS's wheels, empy 3.3.4 and gcc. The middleware looks for libraries
by bare names, and finds them because Python has loaded them under these names.
"""

from importlib.metadata import entry_points
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
LIBRARIES = (
    *(f'{package}__{part}' for package in ('geometry_msgs', 'std_msgs') for part in PARTS),
    *PARTS[2:], 'rosidl_runtime_c', 'fastcdr', 'stdc++')
INTROSPECTION = 'tf2_msgs__rosidl_typesupport_introspection_c'


def build(folder):
    """Make the package in a folder."""
    package, introspection = folder / 'tf2_msgs', folder / 'introspection' / 'tf2_msgs'
    message = package / 'msg' / 'TFMessage.msg'
    message.parent.mkdir(parents=True)
    message.write_text('geometry_msgs/TransformStamped[] transforms\n')
    generate(package, package, 'type', 'c', 'cpp', 'py')
    generate(package, package, 'typesupport', 'c', 'fastrtps_c', 'fastrtps_cpp')
    generate(package, introspection, 'typesupport', 'introspection_c')
    (package / '__init__.py').touch()
    headers = folder, introspection.parent
    compile_library(
        package / f'lib{INTROSPECTION}.so', f'lib{INTROSPECTION}.so', headers,
        introspection.glob('msg/**/*.c'))
    compile_library(
        package / f'tf2_msgs_s__rosidl_typesupport_c{sysconfig.get_config_var("EXT_SUFFIX")}',
        'libtf2_msgs__rosidl_typesupport_fastrtps_c.so', headers,
        [*package.glob('msg/**/*.c'), *package.glob('msg/**/*.cpp'),
         package / '_tf2_msgs_s.ep.rosidl_typesupport_c.c', f'-L{package}', f'-l{INTROSPECTION}'])


def generate(package, target, kind, *names):
    """Let some generators write their sources into a folder."""
    # The wheels name each of them twice, at which the command `rosidl` stumbles.
    group = f'rosidl_cli.command.generate.{kind}_extensions'
    generators = {entry.name: entry for entry in entry_points(group=group)}
    for name in names:
        generators[name].load()(name).generate(
            'tf2_msgs', [f'{package}:msg/TFMessage.msg'], [f'{PREFIX}/share'], target)


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
    build(Path(sys.argv[1]))
