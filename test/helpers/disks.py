# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A small disk that becomes full, read-only, slow or unmounted; requires root."""

from contextlib import suppress
import os
from pathlib import Path
import shutil
import subprocess

SIZE = 4 << 20


def why_none():
    """Return the reason why disks are unavailable, None if they are available."""
    if os.geteuid() != 0 or not Path('/dev/loop-control').exists():
        return 'disks of a test need root and loop devices'
    lacking = [name for name in ('mkfs.ext4', 'fsfreeze', 'mount') if shutil.which(name) is None]
    return f'disks of a test need {lacking[0]}' if lacking else None


class Disk:
    """An ext4 file system of 4 MB in an image, mounted on a folder."""

    def __init__(self, folder):
        self.path = folder / 'disk'
        self._image = folder / 'image'
        self._filler = self.path / 'filler'
        self._frozen = False

    def __enter__(self):
        self._image.write_bytes(b'')
        os.truncate(self._image, SIZE)
        run('mkfs.ext4', '-q', '-m', '0', '-O', '^has_journal', self._image)
        self.path.mkdir()
        run('mount', '-o', 'loop,errors=remount-ro', self._image, self.path)
        self._device = Path(run('findmnt', '-n', '-o', 'SOURCE', self.path).strip()).name
        return self

    def __exit__(self, *_):
        self.thaw()
        with suppress(subprocess.CalledProcessError):
            run('umount', '--lazy', self.path)

    def fill(self):
        """Fill the disk to the last byte."""
        with self._filler.open('ab', buffering=0) as file, suppress(OSError):
            while True:
                file.write(bytes(1024))

    def free(self):
        """Free the space that `fill` took."""
        self._filler.unlink()

    def leave(self, size):
        """Free some bytes of the space that `fill` took."""
        os.truncate(self._filler, self._filler.stat().st_size - size)

    def make_read_only(self):
        """Make the disk read-only as the kernel does after an error of the device."""
        Path(f'/sys/fs/ext4/{self._device}/trigger_fs_error').write_text('test', encoding='utf-8')

    def freeze(self):
        """Let every write wait until `thaw`."""
        run('fsfreeze', '--freeze', self.path)
        self._frozen = True

    def thaw(self):
        """Let writes go on."""
        if self._frozen:
            self._frozen = False
            run('fsfreeze', '--unfreeze', self.path)

    def unmount(self):
        """Take the disk away from a folder in use."""
        run('umount', '--lazy', self.path)


def run(*words):
    """Run a command and return its output."""
    return subprocess.run(
        [*map(str, words)], capture_output=True, text=True, check=True).stdout
