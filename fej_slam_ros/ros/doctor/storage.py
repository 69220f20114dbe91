# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of the files of a bag: checksums, and counts of messages."""

from collections.abc import Iterator
from pathlib import Path

from fej_slam_ros.ros.doctor.findings import Finding, warning
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.topic_names import TopicNames


def check(path: Path, names: TopicNames) -> Iterator[Finding]:
    """Yield files without checksums, and topics whose messages are not as many as listed."""
    for file, parts in bags.without_checksum(path).items():
        yield warning(
            'no_checksum', file, f'there is no checksum of {parts}: a flipped bit changes them'
            ' unnoticed',
            'record mcap files with chunks, and not with the preset fastwrite or as sqlite3')
    for topic, (listed, recorded) in bags.miscounted(path, names).items():
        yield warning(
            'message_count', topic,
            f'metadata.yaml lists {listed} messages, the files have {recorded}',
            f'copy the bag again, or run "ros2 bag reindex {path}" if messages were removed'
            ' on purpose', abs(listed - recorded))
