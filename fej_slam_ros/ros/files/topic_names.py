# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names under which recorded topics are read: remapping rules and a namespace, as in ROS 2."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
import re
from typing import Any

from fej_slam_ros.errors import UsageError

EXAMPLE = '/husky1/odometry/filtered:=/r1/odom'
#: Absolute name of a topic, or with a slash at its end of all topics below a namespace.
ABSOLUTE_NAME = re.compile(r'/([A-Za-z_]\w*(/[A-Za-z_]\w*)*/?)?', re.ASCII)


@dataclass(frozen=True, slots=True)
class TopicNames:
    """Names of the topics of a bag for its readers, by their recorded names."""

    #: new by recorded names, absolute; names that end in a slash are of all topics below
    renamed: Mapping[str, str] = field(default_factory=dict)
    #: in which the robots' topics were recorded, with leading slash, or ''
    namespace: str = ''

    def __bool__(self) -> bool:
        """Return whether any topic may have another name."""
        return bool(self.renamed or self.namespace)

    def name(self, recorded: str) -> str:
        """Return the name of a topic in the namespace; outside it has a leading slash."""
        topic = _absolute(recorded)
        old = self._rule(topic)
        if old is not None:
            return (self.renamed[old] + topic.removeprefix(old)).lstrip('/')
        if not self.namespace:
            return topic.lstrip('/')
        return topic.removeprefix(f'{self.namespace}/')

    def published(self, topic: str) -> str:
        """Return the name in an output bag, without leading slash, of a topic of the node."""
        return (topic if topic.startswith('/') else f'{self.namespace}/{topic}').lstrip('/')

    def as_dict(self) -> dict[str, Any]:
        """Return the rules as plain data, without those that change nothing."""
        entries = {
            'remap': [f'{old}:={new}' for old, new in self.renamed.items()],
            'namespace': self.namespace}
        return {name: entry for name, entry in entries.items() if entry}

    def check(self, recorded: Collection[str], bags: str, is_played: bool = False) -> None:
        """
        Raise UsageError for names that no recorded topic has, and for two topics of one new name.

        If the topics are played, ``/r1/odom`` outside the namespace has the name ``r1/odom`` too.
        """
        topics = sorted({_absolute(topic) for topic in recorded})
        for old, new in self.renamed.items():
            if not any(self._applies(old, topic) for topic in topics):
                relation = 'below' if old.endswith('/') else 'called'
                raise UsageError(
                    f'--remap {old}:={new}: no topic of {bags} is {relation} {old}'
                    + _nearest(old, topics))
        if self.namespace and not any(t.startswith(f'{self.namespace}/') for t in topics):
            spaces = sorted({t[:k] for t in topics for k in range(1, len(t)) if t[k] == '/'})
            raise UsageError(
                f'--namespace {self.namespace}: no topic of {bags} is in it'
                + _nearest(self.namespace, spaces or topics))
        self._check_distinct(topics, is_played)

    def clash(
        self, recorded: Iterable[str], is_played: bool = False
    ) -> tuple[str, str] | None:
        """Return two topics that would have one name, None if all names are distinct."""
        owners: dict[str, str] = {}
        for topic in recorded:
            name = self.name(topic)
            other = owners.setdefault(name.lstrip('/') if is_played else name, topic)
            if other != topic:
                return other, topic
        return None

    def check_new(self, expected: Collection[str]) -> None:
        """Raise UsageError for new names of a robot that are none of the expected topics."""
        owners = {topic.partition('/')[0] for topic in expected}
        for old, new in self.renamed.items():
            topic = new.lstrip('/')
            if not topic.endswith('/') and topic not in expected and (
                    topic.partition('/')[0] in owners):
                raise UsageError(
                    f'--remap {old}:={new}: {new} is not read'
                    + _nearest(new, [_absolute(name) for name in expected]))

    def _check_distinct(self, topics: Iterable[str], is_played: bool) -> None:
        clash = self.clash(topics, is_played)
        if clash is not None:
            one, other = clash
            raise UsageError(
                f'{one} and {other} would both be {_absolute(self.name(other))}: give one of them'
                f' an unused name too, such as --remap {other}:=/unused{other}')

    def _rule(self, topic: str) -> str | None:
        """Return the recorded name in the most specific rule for a topic."""
        rules = [old for old in self.renamed if self._applies(old, topic)]
        return max(rules, key=len, default=None)

    @staticmethod
    def _applies(old: str, topic: str) -> bool:
        return topic.startswith(old) if old.endswith('/') else topic == old


#: The names as they were recorded.
RECORDED_NAMES = TopicNames()


def topic_names(remaps: Iterable[str], namespace: str) -> TopicNames:
    """Return the names that rules ``OLD:=NEW`` and a namespace give."""
    renamed: dict[str, str] = {}
    for word in remaps:
        old, new = _parsed(word)
        if renamed.setdefault(old, new) != new:
            raise UsageError(
                f'--remap: {old} has two new names, {renamed[old]} and {new}: give one')
    for old, new in renamed.items():
        others = [other for other in renamed if renamed[other] == new and other != old]
        if others:
            raise UsageError(
                f'--remap: {old} and {others[0]} would both be {new}: rename one only')
    return TopicNames(renamed, absolute_namespace(namespace))


def absolute_namespace(word: str) -> str:
    """Return a namespace with leading slash, '' for none."""
    namespace = _absolute(word).rstrip('/')
    if ABSOLUTE_NAME.fullmatch(f'{namespace}/') is None:
        raise UsageError(f'--namespace {word}: give a ROS namespace, such as /fleet')
    return namespace


def checked_rule(word: str) -> str:
    """Return a rule that is valid."""
    _parsed(word)
    return word


def _parsed(word: str) -> tuple[str, str]:
    """Return the recorded and the new name of a rule, absolute."""
    old, separator, new = word.partition(':=')
    if old in {'__ns', '__namespace'}:
        raise UsageError(f'--remap {word}: give --namespace {new} instead')
    if not (separator and old and new):
        raise UsageError(
            f'--remap {word}: give OLD:=NEW, the recorded name and the expected one, such as'
            f' {EXAMPLE}')
    old, new = _absolute(old), _absolute(new)
    for name in (old, new):
        if ABSOLUTE_NAME.fullmatch(name) is None:
            raise UsageError(
                f'--remap {word}: {name} is not a ROS name, give OLD:=NEW such as {EXAMPLE}')
    if old.endswith('/') != new.endswith('/'):
        raise UsageError(
            f'--remap {word}: end both names in a slash for all topics below them, or neither')
    return old, new


def _absolute(name: str) -> str:
    return '/' + name.lstrip('/')


def _nearest(name: str, names: Collection[str]) -> str:
    longer = [other for other in names if other.startswith(name)]
    found = longer or get_close_matches(name, names, n=1, cutoff=0.0)
    return f', did you mean {found[0]}?' if found else ', it has none: leave the option out'
