# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Bounds of YAML texts, checked before their content is built.

A short text can describe much: aliases of aliases (also as merge keys) multiply, an alias in the
value that it repeats has no end, and no reader follows any number of brackets. The check takes
time and memory for the text only.
"""

from contextlib import suppress
from itertools import accumulate
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, Event, NodeEvent, ScalarEvent

#: Maximum number of keys, values and containers, those that aliases repeat included; 100 robots
#: with all their parameters have 6,000.
MAX_VALUES = 10_000

#: Maximum number of open brackets; a list in a map in a map has three.
MAX_DEPTH = 20
#: Maximum size of a parameter file [bytes]; the same 100 robots take 80 kB.
MAX_PARAMETER_FILE = 250_000


class YamlBoundsError(ValueError):
    """A text is too large or nested too deeply, or its aliases make it so."""


def read_bounded(path: Path, max_size: int, is_nested: bool = False) -> bytes:
    """
    Return the content of a YAML file, or raise YamlBoundsError.

    Parameters
    ----------
    max_size : its maximum size [bytes]
    is_nested : whether texts in it may be YAML again, as the quality of service of bags

    """
    with path.open('rb') as file:
        text = file.read(max_size + 1)
    if len(text) > max_size:
        raise YamlBoundsError(f'it is larger than {max_size:,} bytes')
    _check_brackets(text)
    _check_aliases(text, is_nested)
    return text


def _check_brackets(text: bytes) -> None:
    """Refuse lists within lists, and so on, that exceed the recursion limit of the reader."""
    steps = (1 if c in b'[{' else -1 if c in b']}' else 0 for c in text)
    if max(accumulate(steps), default=0) > MAX_DEPTH:
        raise YamlBoundsError(f'it has more than {MAX_DEPTH} brackets within brackets')


def _check_aliases(text: bytes, is_nested: bool = False) -> None:
    """Refuse aliases without end, or that repeat too many values."""
    # Reading a text twice takes twice the time.
    if b'&' not in text:
        return
    counter = _ValueCounter()
    for event in YAML(typ='safe', pure=True).parse(text):
        counter.add(event)
        if is_nested and isinstance(event, ScalarEvent):
            with suppress(YAMLError):
                _check_aliases(event.value.encode())
        if counter.count > MAX_VALUES:
            raise YamlBoundsError(
                f'up to line {event.start_mark.line + 1} it has more than {MAX_VALUES:,} values,'
                ' those that aliases repeat included')


class _ValueCounter:
    """
    Counts the values that a text describes, without building them.

    Attributes
    ----------
    count : number of keys, values and containers so far

    """

    def __init__(self) -> None:
        self.count = 0
        self._sizes: dict[str, int] = {}
        # Anchor of each open container, and the count before it.
        self._containers: list[tuple[str | None, int]] = []

    def add(self, event: Event) -> None:
        """Add the next part of the text."""
        if isinstance(event, AliasEvent):
            self.count += self._size(event)
        elif isinstance(event, NodeEvent):
            self._containers.append((event.anchor, self.count))
            self.count += 1
        if isinstance(event, (ScalarEvent, CollectionEndEvent)):
            anchor, before = self._containers.pop()
            if anchor is not None:
                self._sizes[anchor] = self.count - before

    def _size(self, alias: AliasEvent) -> int:
        if alias.anchor not in self._sizes:
            raise YamlBoundsError(
                f'in line {alias.start_mark.line + 1} the alias *{alias.anchor} repeats no earlier'
                ' value')
        return self._sizes[alias.anchor]
