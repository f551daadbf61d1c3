"""When the last byte of a packet came, for packets that were read together with what came behind them."""

from __future__ import annotations


class Arrivals:
    """Dates packets of one serial line back from the reads that brought them.

    byte_ns: time of a byte on the wire. Used by a parser that keeps unread bytes: `read` before it looks at a new
    chunk, `of` for each packet that it finds, `done` behind the chunk.
    """

    def __init__(self, byte_ns: float) -> None:
        self._byte_ns = byte_ns
        self._fresh = 0
        self._now_ns = 0
        self._before_ns = 0

    def read(self, fresh: int, now_ns: int) -> None:
        """`fresh` bytes were read at `now_ns`."""
        self._fresh, self._now_ns = fresh, now_ns

    def of(self, behind: int, size: int, period_ns: float) -> int:
        """When a packet of `size` bytes was complete that has `behind` bytes after it in the buffer.

        Whole packets behind it are a backlog: they were sent one every `period_ns`, not back to back.
        """
        now_ns, earliest_ns = self._now_ns, self._before_ns
        if behind >= self._fresh:
            # it was complete already with the read before this one
            behind, now_ns, earliest_ns = behind - self._fresh, self._before_ns, 0
        packets, rest = divmod(behind, size)
        back_ns = packets * max(period_ns, size * self._byte_ns) + rest * self._byte_ns
        return max(earliest_ns, now_ns - round(back_ns))

    def done(self) -> None:
        """The chunk has been looked at."""
        self._before_ns = self._now_ns
