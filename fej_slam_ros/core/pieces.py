# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Long computations in pieces, between which a live node serves other robots.

Steps of a large map or with many observations take seconds. They are computed in pieces of about
20 ms, copies of large matrices of up to 0.1 s. Between two pieces `pause` lets the caller handle
odometry, or end the computation.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Maximum number of multiplications and additions of a piece: 20 ms at 25 GFlop/s of one core. No
#: step of a map below 490 landmarks with up to 256 observations is divided.
PIECE_FLOPS = 5e8
#: Maximum number of matrix elements that a piece copies: 8 MB, as new memory costs most.
PIECE_ELEMENTS = 1_000_000


class EndedError(Exception):
    """A computation was given up because the process ends."""


_contexts: list[tuple[Callable[[], object], Callable[[], bool]]] = []


@contextmanager
def between_pieces(
    serve: Callable[[], object], must_end: Callable[[], bool] = lambda: False
) -> Iterator[None]:
    """
    Call `serve` between the pieces of all computations of the context.

    `must_end` returns whether those that can end early are to do so, because the process ends.

    """
    _contexts.append((serve, must_end))
    try:
        yield
    finally:
        _contexts.pop()


def pause() -> bool:
    """End a piece; return whether to end the computation, if it can end early."""
    for serve, _ in _contexts[-1:]:
        serve()
    return must_end()


def must_end() -> bool:
    """Return whether to end a computation that can end early."""
    return any(must_end() for _, must_end in _contexts[-1:])


def ranges(count: int, size: float) -> Iterator[slice]:
    """Yield the slices of `count` items in pieces of a size, with a pause between them."""
    step = max(int(size), 1)
    for begin in range(0, count, step):
        if begin:
            pause()
        yield slice(begin, min(begin + step, count))
