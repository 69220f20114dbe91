# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two hosts with a bad link between them, in network namespaces; requires root."""

from array import array
from contextlib import ExitStack
import fcntl
import os
from pathlib import Path
import shutil
import socket
import struct
import subprocess
import sys

from helpers.processes import end_session, start

RELAY = Path(__file__).with_name('network_relay.py')
HOSTS = ('one', 'two')

#: Numbers of <linux/sockios.h> and <linux/ethtool.h>.
SIOCETHTOOL, ETHTOOL_STXCSUM = 0x8946, 0x17


def why_none():
    """Return the reason why network namespaces are unavailable, None if they are available."""
    if shutil.which('ip') is None:
        return 'network namespaces need the command ip (iproute2)'
    if os.geteuid() != 0:
        return 'network namespaces need root'
    name = f'fej_slam_{os.getpid()}_probe'
    result = subprocess.run(
        ['ip', 'netns', 'add', name], capture_output=True, text=True, check=False)
    if result.returncode:
        return f'no network namespaces here: {result.stderr.strip()}'
    _ip('netns', 'delete', name)
    return None


class Network:
    """
    Hosts ``one`` and ``two`` with a relay between them.

    Its namespaces and the process of the link end with the context.

    """

    def __init__(self, seed):
        self._seed = seed
        self._names = {host: f'fej_slam_{os.getpid()}_{host}' for host in (*HOSTS, 'relay')}
        self._stack = ExitStack()

    def __enter__(self):
        with ExitStack() as stack:
            for name in self._names.values():
                _ip('netns', 'add', name)
                stack.callback(_ip, 'netns', 'delete', name)
            ends = [self._connect(host, number) for number, host in enumerate(HOSTS, start=1)]
            self._relay = start(
                *self.on('relay'), sys.executable, RELAY, *ends, self._seed,
                stdin=subprocess.PIPE)
            stack.callback(end_session, self._relay)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_):
        self._stack.close()

    def on(self, host):
        """Return the words before a command that run it on a host."""
        return 'ip', 'netns', 'exec', self._names[host]

    def lose(self, share):
        """Let the link lose a share of all frames from now on."""
        self._relay.stdin.write(f'{share}\n')
        self._relay.stdin.flush()

    def cut(self):
        """Cut the cable of host two."""
        self._set_link('down')

    def mend(self):
        """Connect host two again."""
        self._set_link('up')

    def _set_link(self, state):
        _ip('-n', self._names['two'], 'link', 'set', 'cable', state)

    def _connect(self, host, number):
        """Connect a host to the relay; return the relay's end."""
        near, far = f'fs{os.getpid()}n{number}', f'fs{os.getpid()}f{number}'
        _ip('link', 'add', near, 'type', 'veth', 'peer', 'name', far)
        # Checksums that the kernel leaves to a network card would be missing behind the relay.
        _leave_no_checksum_to_the_card(near)
        _ip('link', 'set', near, 'netns', self._names[host], 'name', 'cable')
        _ip('link', 'set', far, 'netns', self._names['relay'])
        within = '-n', self._names[host]
        _ip(*within, 'address', 'add', f'10.77.0.{number}/24', 'dev', 'cable')
        _ip(*within, 'link', 'set', 'lo', 'up')
        _ip(*within, 'link', 'set', 'cable', 'up')
        _ip('-n', self._names['relay'], 'link', 'set', far, 'up')
        return far


def _ip(*words):
    subprocess.run(['ip', *words], check=True)


def _leave_no_checksum_to_the_card(interface):
    value = array('I', [ETHTOOL_STXCSUM, 0])
    request = struct.pack('16sP', interface.encode(), value.buffer_info()[0])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, SIOCETHTOOL, request)
