# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A line that is caused again and again does not fill the log."""

from fej_slam_ros.ros.session.log_lines import LogSeverity, RepeatableLines


def test_a_sender_cannot_fill_the_log():
    lines = RepeatableLines()

    texts = [line.text for _ in range(1000) for line in lines.lines(LogSeverity.WARN, 'again')]

    assert texts == [*['again'] * 5, *(f'again ({count} times)' for count in (10, 100, 1000))]
