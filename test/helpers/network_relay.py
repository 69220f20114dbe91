# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A bad link: frames from one network interface to another and back, some of them lost.

Arguments: both interfaces and the seed of the losses. Each line that it reads is the share of the
frames to lose from then on, 0 at first.
"""

from contextlib import suppress
import select
import socket
import sys

import numpy as np

ALL_PROTOCOLS = socket.htons(3)


def opened(interface):
    link = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, ALL_PROTOCOLS)
    link.bind((interface, 0))
    return link


def passed_on(link, opposite, is_lost):
    frame, (_, _, kind, *_) = link.recvfrom(65536)
    if kind != socket.PACKET_OUTGOING and not is_lost:
        opposite.send(frame)


def main(one, other, seed):
    rng = np.random.default_rng(int(seed))
    share = 0.0
    links = opened(one), opened(other)
    while True:
        ready, _, _ = select.select([sys.stdin, *links], [], [])
        if sys.stdin in ready:
            line = sys.stdin.readline()
            if not line:
                return
            share = float(line)
        for link, opposite in links, links[::-1]:
            if link in ready:
                with suppress(OSError):  # the other side is cut off
                    passed_on(link, opposite, is_lost=rng.random() < share)


if __name__ == '__main__':
    main(*sys.argv[1:])
