# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A line that is caused again and again does not fill the log."""

from fej_slam_ros.ros.session.log_lines import LogSeverity, RepeatableLines


def test_a_sender_cannot_fill_the_log():
    lines = RepeatableLines()

    texts = [line.text for _ in range(1000) for line in lines.lines(LogSeverity.WARN, 'again')]

    assert texts == [*['again'] * 5, *(f'again ({count} times)' for count in (10, 100, 1000))]


def test_lines_of_one_cause_are_counted_together_whatever_their_numbers():
    lines = RepeatableLines()

    texts = [
        line.text for k in range(100)
        for line in lines.lines(LogSeverity.WARN, f'late by {k} s', 'late')]

    assert texts == [
        *(f'late by {k} s' for k in range(5)),
        'late by 9 s (10 times)', 'late by 99 s (100 times)']
