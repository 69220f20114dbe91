# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records that were received before are recognised, up to a maximum number."""

from itertools import permutations

from fej_slam_ros.core.ordering.record_memory import (
    FORGOTTEN_TOGETHER, identity, MAX_REMEMBERED, RecordMemory)
from helpers.records import MS, odometry, scan


def memory_of(records, may_forget=lambda _: True):
    memory = RecordMemory()
    for record in records:
        memory.add(identity(record), may_forget)
    return memory


def test_only_the_same_record_is_contained():
    memory = memory_of([odometry('r1', 0), scan('r1', 5)])

    assert memory.contains(identity(odometry('r1', 0)))
    assert not memory.contains(identity(odometry('r1', 0, (1.0, 0.0, 0.0))))
    assert memory.contains_stamp(identity(odometry('r1', 0, (1.0, 0.0, 0.0))))
    assert not memory.contains_stamp(identity(scan('r1', 0)))


def test_a_removed_record_is_new_again():
    memory = memory_of([scan('r1', 5, [(1, (1.0, 0.0))]), scan('r1', 5)])

    memory.remove(identity(scan('r1', 5)))

    assert not memory.contains(identity(scan('r1', 5)))
    assert memory.contains(identity(scan('r1', 5, [(1, (1.0, 0.0))])))


def test_of_many_records_at_a_stamp_any_one_can_be_removed():
    """Each is known until it is removed, whatever the order."""
    records = [scan('r1', 5, [(k, (1.0, 0.0))]) for k in range(3)]
    for order in permutations(range(3)):
        memory = memory_of(records)
        for count, k in enumerate(order, start=1):
            memory.remove(identity(records[k]))
            known = {j for j in range(3) if memory.contains(identity(records[j]))}
            assert known == {*range(3)} - {*order[:count]}
        assert not memory.contains_stamp(identity(records[0]))


def test_the_oldest_records_are_forgotten():
    others = scan('r1', 0), scan('r1', 0, [(1, (1.0, 0.0))])

    memory = memory_of([*others, *(
        odometry('r1', ms) for ms in range(1, MAX_REMEMBERED + FORGOTTEN_TOGETHER))])

    assert not any(memory.contains(identity(record)) for record in others)
    last = FORGOTTEN_TOGETHER - 1
    remembered = [memory.contains(identity(odometry('r1', ms))) for ms in (1, last, last + 1)]
    assert remembered == [False, False, True]
    assert memory.forgotten == last * MS


def test_waiting_records_are_not_forgotten():
    records = [odometry('r1', ms) for ms in range(MAX_REMEMBERED + FORGOTTEN_TOGETHER)]

    memory = memory_of(records, may_forget=lambda stamp: stamp != MS)

    assert [memory.contains(identity(record)) for record in records[:3]] == [False, True, False]
