"""The exclusive or over a packet, by which many small lidars check their bytes."""

from __future__ import annotations


def xor_fold(data: bytes, unit: int) -> int:
    """Exclusive or of all units of so many bytes, little-endian; the last one may be shorter.

    Halves one big number again and again: a few operations instead of a loop over the bytes.
    """
    rest, size = int.from_bytes(data, "little"), len(data)
    while size > unit:
        size = -(-size // (2 * unit)) * unit
        bits = 8 * size
        rest = (rest >> bits) ^ (rest & ((1 << bits) - 1))
    return rest
