"""When the last byte of a packet came, for packets that were read together with what came behind them."""

from __future__ import annotations


class Arrivals:
    """Dates packets of one serial line back from the reads that brought them.

    byte_ns: time of a byte on the wire. Used by a parser that keeps unread bytes: `read` before it looks at a new
    chunk, `of` for each packet that it finds, `done` behind the chunk.
    """

    def __init__(self, byte_ns: float) -> None:
        self._byte_ns = byte_ns
        # bytes so far at the end of each read that is still looked at, and when it came
        self._ends: list[int] = [0]
        self._times_ns: list[int] = [0]

    def read(self, fresh: int, now_ns: int) -> None:
        """`fresh` bytes were read at `now_ns`."""
        self._ends.append(self._ends[-1] + fresh)
        self._times_ns.append(now_ns)

    def of(self, behind: int, size: int, period_ns: float) -> int:
        """When a packet of `size` bytes was complete that has `behind` bytes after it in the buffer.

        What is behind it in the same read was sent a packet every `period_ns`, with a rest between packets.
        """
        end = self._ends[-1] - behind
        index = len(self._ends) - 1
        while index > 1 and self._ends[index - 1] >= end:
            index -= 1
        packets, part = divmod(self._ends[index] - end, size)
        wire_ns = size * self._byte_ns
        period_ns = max(period_ns, wire_ns)
        back_ns = packets * period_ns + (period_ns - wire_ns + part * self._byte_ns if part else 0.0)
        return max(self._times_ns[index - 1], self._times_ns[index] - round(back_ns))

    def done(self, kept: int) -> None:
        """The chunk has been looked at; `kept` bytes stay in the buffer."""
        used = self._ends[-1] - kept
        drop = 0
        while drop < len(self._ends) - 1 and self._ends[drop + 1] <= used:
            drop += 1
        del self._ends[:drop], self._times_ns[:drop]
