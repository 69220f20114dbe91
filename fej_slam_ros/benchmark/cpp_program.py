# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Programs in C++ that time other libraries, built where they are needed."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
import shutil
import subprocess
from tempfile import TemporaryDirectory

from fej_slam_ros.errors import UserError

COMPILER = 'g++'
EIGEN = Path('/usr/include/eigen3')


def can_build(headers: Path) -> bool:
    """Return whether there are a compiler and the headers of a library."""
    return shutil.which(COMPILER) is not None and headers.is_dir()


@contextmanager
def built(
    source: Path, headers: Sequence[Path], libraries: Sequence[str]
) -> Iterator[Path]:
    """Build a program that includes headers from folders and links libraries; yield its path."""
    with TemporaryDirectory() as folder:
        program = Path(folder) / source.stem
        command = [COMPILER, '-std=c++17', '-O3', '-DNDEBUG']
        command += [f'-isystem{path}' for path in (*headers, EIGEN)]
        command += [str(source), '-o', str(program), *(f'-l{name}' for name in libraries)]
        compiled = subprocess.run(  # noqa: S603 - own arguments only
            command, check=False, capture_output=True, text=True)
        if compiled.returncode:
            raise UserError(f'{source.name} cannot be compiled:\n{compiled.stderr}')
        yield program
