# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Process that counts the bytes of the frames that a host sends; requires root.

Arguments: interface, and a text that the counted frames contain. At the end of the standard input
it prints the bytes of frames with the text and of all others.
"""

import select
import socket
import sys

ALL_PROTOCOLS, OUTGOING = 3, 4


def main(interface, text):
    counted = others = 0
    with socket.socket(
            socket.AF_PACKET, socket.SOCK_RAW, socket.ntohs(ALL_PROTOCOLS)) as frames:
        frames.bind((interface, 0))
        while True:
            ready, _, _ = select.select([frames, sys.stdin], [], [])
            if frames not in ready:
                break
            frame, address = frames.recvfrom(65_536)
            if address[2] == OUTGOING:
                if text.encode() in frame:
                    counted += len(frame)
                else:
                    others += len(frame)
    sys.stdout.write(f'{counted} {others}\n')


if __name__ == '__main__':
    main(*sys.argv[1:])
