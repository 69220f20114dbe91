# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag with a progress bar, which is shown on a terminal only."""

from collections.abc import Iterable
from pathlib import Path

from tqdm import tqdm

from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import RawMessage


def team_messages(bag: Path, settings: CommonSettings) -> Iterable[RawMessage]:
    """
    Return the messages of a bag.

    Raises
    ------
    UserError
        The bag has odometry of no robot of the settings.

    """
    topics = bags.topics(bag)
    wanted = [f'{robot.name}/odom' for robot in settings.robots]
    if not any(topic in topics for topic in wanted):
        raise UserError(
            f'{bag} has none of the topics {", ".join(wanted)}: it has'
            f' {", ".join(sorted(topics)) or "none"}; name its robots in the parameter robots')
    total = sum(topic.messages for topic in topics.values())
    messages: Iterable[RawMessage] = tqdm(
        bags.read(bag), total=total, unit='msg', disable=None)
    return messages
