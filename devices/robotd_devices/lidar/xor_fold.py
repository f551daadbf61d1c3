"""The exclusive or over a packet, by which many small lidars check their bytes."""

from __future__ import annotations

import functools


def xor_fold(data: bytes, unit: int) -> int:
    """Exclusive or of all units of so many bytes, little-endian; the last one may be shorter.

    Halves one big number again and again: a few operations instead of a loop over the bytes.
    """
    rest = int.from_bytes(data, "little")
    for bits, mask in _halves(len(data), unit):
        rest = rest >> bits ^ rest & mask
    return rest


@functools.cache
def _halves(size: int, unit: int) -> tuple[tuple[int, int], ...]:
    """Bits of the lower half and their mask, for each halving."""
    steps = []
    while size > unit:
        size = -(-size // (2 * unit)) * unit
        steps.append((8 * size, (1 << 8 * size) - 1))
    return tuple(steps)
