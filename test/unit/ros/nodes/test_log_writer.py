# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lines are written with their severity, topics in short."""

from unittest import mock

import pytest

from fej_slam_ros.ros.session.log_lines import LogLine, LogSeverity
from helpers.optional import optional

log_writer = optional('fej_slam_ros.ros.nodes.log_writer')

pytestmark = pytest.mark.ros


def test_each_severity_has_its_method():
    logger = mock.Mock()

    log_writer.write(logger, [LogLine(severity, severity.value) for severity in LogSeverity])

    assert logger.mock_calls == [
        mock.call.debug('debug'), mock.call.info('info'), mock.call.warning('warn'),
        mock.call.error('error')]


def test_topics_of_one_namespace_are_grouped():
    topics = ['/r1/odom', '/r1/landmarks', '/r2/odom', '/clock']

    assert log_writer.grouped(topics) == '/r1/{odom,landmarks}, /r2/odom, /clock'
