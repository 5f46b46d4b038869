"""Joining sources of messages in the order of their log times, few of them open at once."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterable, Iterator

from specmap_cli.logs.readers.recording import Message


def merge_in_time(
    sources: Iterable[tuple[int, Callable[[], Iterator[Message]]]],
) -> Iterator[Message]:
    """Join iterators of messages by log time, opening each only when its start has come.

    `sources` are (start_ns, function that opens the iterator). Only those whose spans overlap are
    open together. An iterator that runs backwards in time keeps its own order.
    """
    waiting = deque(sorted(sources, key=lambda source: source[0]))
    heap: list[tuple[int, int, Message, Iterator[Message]]] = []
    opened = 0
    while waiting or heap:
        while waiting and (not heap or waiting[0][0] <= heap[0][0]):
            messages = waiting.popleft()[1]()
            first = next(messages, None)
            if first is not None:
                heapq.heappush(heap, (first.time_ns, opened, first, messages))
                opened += 1
        if not heap:
            continue
        _, number, message, messages = heap[0]
        yield message
        following = next(messages, None)
        if following is None:
            heapq.heappop(heap)
        else:
            heapq.heapreplace(heap, (following.time_ns, number, following, messages))
