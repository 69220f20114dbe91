# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read and write rosbag2 files; an unreadable bag raises UserError."""

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import contextmanager, ExitStack, suppress
from dataclasses import dataclass
import errno
from pathlib import Path
import re
import shutil
import sqlite3

from rosbags.interfaces import (
    Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime)
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from tqdm import tqdm

from fej_slam_ros.atomic_files import CURES, refuse_existing, short_path, writing
from fej_slam_ros.detection.records import AnyRecord, measured_at
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.interrupts import postponed
from fej_slam_ros.output_lock import OutputLock
from fej_slam_ros.ros.files import checksums, damaged_bags
from fej_slam_ros.ros.files.topic_names import RECORDED_NAMES, TopicNames
from fej_slam_ros.ros.messages import (
    definition, is_known, Message, outgoing, RawMessage, serialize)
from fej_slam_ros.ros.messages.common import LAST_STAMP
from fej_slam_ros.ros.parameters.yaml_bounds import read_bounded

STORAGES = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}

#: Topics with durability transient local, whose last message late subscribers receive too.
LATCHED = re.compile(
    '(.+/)?((ground_truth|estimator|smoother)/landmarks|[^/]+/(map_landmarks|base_node)'
    '|landmark_ids)')

#: Maximum size of the metadata of a bag [bytes]; 1,000 topics in 1,000 files take 2 MB.
MAX_METADATA = 10_000_000


def read(
    path: Path, names: TopicNames = RECORDED_NAMES, only: Container[str] | None = None
) -> Iterator[RawMessage]:
    """
    Yield the messages of a bag, perhaps on some topics only, in the order of recording.

    The time of recording is unknown where no clock of ROS can have it.

    """
    with _opened(path) as reader:
        topics = {c.topic: names.name(c.topic) for c in reader.connections}
        wanted = [c for c in reader.connections if only is None or topics[c.topic] in only]
        for connection, logged, raw in reader.messages(wanted) if wanted else ():
            # A damaged sqlite3 file may hold a time of any type.
            time = int(logged) if 0 <= int(logged) <= LAST_STAMP else None
            yield RawMessage(topics[connection.topic], connection.msgtype, time, bytes(raw))


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic in a bag."""

    type_name: str
    messages: int  #: their number
    latched: bool  #: whether its durability is transient local
    is_known: bool = True  #: whether its messages can be read, as they are defined in the bag


def topics(path: Path, names: TopicNames = RECORDED_NAMES) -> dict[str, BagTopic]:
    """Return the topics of a bag by name."""
    with _opened(path) as reader:
        # The metadata may state other numbers.
        recorded = _recorded(reader)
        return {
            names.name(connection.topic): BagTopic(
                connection.msgtype, recorded[connection.topic, connection.msgtype],
                _is_latched(connection), _is_known(connection))
            for connection in reader.connections}


def unknown_types(found: Iterable[BagTopic]) -> str:
    """Return the line on the types of topics that cannot be copied, '' if there are none."""
    names = sorted({topic.type_name for topic in found if not topic.is_known})
    return f'not copied, of unknown types: {", ".join(names)}' if names else ''


def read_with_bar(
    path: Path, names: TopicNames, found: Mapping[str, BagTopic]
) -> Iterable[RawMessage]:
    """Return the messages of a bag whose topics are known, with a progress bar on a terminal."""
    total = sum(topic.messages for topic in found.values())
    messages: Iterable[RawMessage] = tqdm(read(path, names), total=total, unit='msg', disable=None)
    return messages


def miscounted(path: Path, names: TopicNames) -> dict[str, tuple[int, int]]:
    """Return the message counts in the metadata and in the files, by topic, where they differ."""
    with _opened(path) as reader:
        recorded = _recorded(reader)
        return {
            names.name(c.topic): (c.msgcount, recorded[c.topic, c.msgtype])
            for c in reader.connections if c.msgcount != recorded[c.topic, c.msgtype]}


def without_checksum(path: Path) -> dict[str, str]:
    """Return the parts without a checksum of each file of a bag that has any."""
    with _opened(path) as reader:
        parts = {
            storage.path.name: checksums.unprotected(storage.path)
            if storage.path.suffix == '.mcap' else 'all messages'
            for storage in damaged_bags.storages(reader)}
    return {name: unprotected for name, unprotected in parts.items() if unprotected}


class BagWriter:
    """
    Writes a rosbag2 that ``ros2 bag play`` of Jazzy can play.

    The bag is written into a temporary folder, which is renamed when the bag is complete.

    Parameters
    ----------
    path : folder of the bag
    storage : ``mcap`` or ``sqlite3``
    force : whether a bag at the path may be replaced

    """

    def __init__(self, path: Path, storage: str = 'mcap', force: bool = False) -> None:
        self._path = path = short_path(path)
        self._force = force
        self._refuse_existing()
        self._partial = path.with_name(f'.{path.name}.partial')
        self._connections: dict[str, Connection] = {}
        self._storage = STORAGES[storage]

    def __enter__(self) -> 'BagWriter':
        with ExitStack() as on_error:
            # A signal that waits is raised where what was made is still deleted.
            with postponed():
                self._lock = on_error.enter_context(OutputLock.of_file(self._path))
                on_error.callback(shutil.rmtree, self._partial, ignore_errors=True)
                # Another run may have completed it meanwhile.
                self._refuse_existing()
                shutil.rmtree(self._partial, ignore_errors=True)
                # The data file is named after its folder, which so has its final name at once.
                self._writer = Writer(
                    self._partial / self._path.name, version=9, storage_plugin=self._storage)
                with _writing(self._path):
                    self._writer.open()
            on_error.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        replaced = self._partial / 'replaced'
        try:
            if kind is None:
                self._complete(replaced)
            else:
                with suppress(sqlite3.Error, OSError):
                    self._writer.abort()
        finally:
            # After an interrupt between the two, the earlier bag comes back.
            if replaced.exists() and not self._path.exists():
                replaced.rename(self._path)
            shutil.rmtree(self._partial, ignore_errors=True)
            self._lock.release()

    def _complete(self, replaced: Path) -> None:
        with _writing(self._path):
            self._writer.close()
            for file in (self._partial / self._path.name).glob('*.mcap'):
                checksums.add(file)
            if self._path.exists():
                self._path.rename(replaced)
            (self._partial / self._path.name).rename(self._path)

    def _refuse_existing(self) -> None:
        refuse_existing([self._path], self._force)
        if self._path.exists():
            if not (self._path / 'metadata.yaml').is_file():
                raise UsageError(f'{self._path} exists and is not a rosbag2: choose another path')
            others = [file for file in sorted(self._path.iterdir()) if not _is_of_bag(file)]
            if others:
                raise UsageError(
                    f'{others[0]} is in the folder that would be replaced: move it, or choose'
                    ' another path')

    def write(self, topic: str, logged: int, message: Message) -> None:
        """Append a message, logged at a time [ns]."""
        self.copy(RawMessage(topic, message.__msgtype__, logged, serialize(message)))

    def copy(self, message: RawMessage, latched: bool | None = None) -> None:
        """Append a message of a known type as it is; by default its name says if it is latched."""
        topic = message.topic.lstrip('/')
        with _writing(self._path):
            if topic not in self._connections:
                if latched is None:
                    latched = LATCHED.fullmatch(topic) is not None
                self._connections[topic] = self._connect(topic, message.type_name, latched)
            self._writer.write(self._connections[topic], message.received or 0, message.raw)

    def _connect(self, topic: str, type_name: str, latched: bool) -> Connection:
        text, rihs01 = definition(type_name)
        return self._writer.add_connection(
            f'/{topic}', type_name, msgdef=text, rihs01=rihs01,
            offered_qos_profiles=[_qos(latched)])


def _is_of_bag(file: Path) -> bool:
    """Return whether a file in the folder of a bag is one that bags consist of."""
    return file.is_file() and (
        file.name == 'metadata.yaml' or '.mcap' in file.name or '.db3' in file.name)


def write(
    path: Path, records: Iterable[AnyRecord], storage: str = 'mcap',
    force: bool = False, robot_ids: Mapping[str, int] = outgoing.NO_IDS,
) -> None:
    """Write records as a bag of input topics, each logged when it was measured."""
    with BagWriter(path, storage, force) as bag:
        for record in records:
            topic, message = outgoing.input_message(record, robot_ids)
            bag.write(topic, measured_at(record), message)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn the errors of writing a bag into a UserError with the reason and a cure."""
    try:
        with writing(path):
            yield
    except sqlite3.Error as error:
        raise UserError(f'cannot write {path}: {error}: {CURES[errno.ENOSPC]}') from None


@contextmanager
def _opened(path: Path) -> Iterator[Reader]:
    metadata = path / damaged_bags.METADATA
    try:
        if metadata.is_file():
            read_bounded(metadata, MAX_METADATA, is_nested=True)
        with Reader(path) as reader:
            damage = next(damaged_bags.unnoticed(path, reader), None)
            if damage is not None:
                raise UserError(damage)
            yield reader
    except UserError:
        raise
    # The reader raises errors of many types for a damaged bag.
    except Exception as error:  # noqa: BLE001
        raise UserError(damaged_bags.explanation(path, error)) from None


def _recorded(reader: Reader) -> Counter[tuple[str, str]]:
    """Return the number of messages in the files of a bag, by recorded topic and type."""
    recorded: Counter[tuple[str, str]] = Counter()
    for storage in damaged_bags.storages(reader):
        for connection in storage.connections:
            recorded[connection.topic, connection.msgtype] += connection.msgcount
    return recorded


def _is_known(connection: Connection) -> bool:
    name = connection.msgtype
    return is_known(name) and connection.digest in {'', definition(name)[1]}


def _is_latched(connection: Connection) -> bool:
    offered = getattr(connection.ext, 'offered_qos_profiles', ())
    return any(qos.durability is QosDurability.TRANSIENT_LOCAL for qos in offered)


def _qos(latched: bool) -> Qos:
    unlimited = QosTime(sec=9_223_372_036, nsec=854_775_807)  # as rosbag2 writes "infinite"
    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    return Qos(
        QosHistory.KEEP_LAST, 1 if latched else 100, QosReliability.RELIABLE, durability,
        unlimited, unlimited, QosLiveliness.AUTOMATIC, unlimited, False)
