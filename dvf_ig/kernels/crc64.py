"""CRC-64 of OpenIGTLink bodies: ECMA-182 polynomial, highest bit first, from zero, eight bytes a step.

Source: ECMA-182, annex B; the tables by eight are Kounavis and Berry 2005 ("slicing-by-8").
"""

from typing import Any

import numpy as np

from dvf_ig.kernels.compiled import kernel

POLYNOMIAL = 0x42F0E1EBA9EA3693
_MASK = (1 << 64) - 1


def _tables() -> Any:
    """Compute (8, 256) uint64 CRCs of a byte followed by k zero bytes."""
    tables = np.zeros((8, 256), dtype=np.uint64)
    for byte in range(256):
        value = byte << 56
        for _ in range(8):
            value = ((value << 1) ^ (POLYNOMIAL if value >> 63 else 0)) & _MASK
        tables[0, byte] = value
    for k in range(1, 8):
        before = tables[k - 1]
        tables[k] = (before << np.uint64(8)) ^ tables[0][(before >> np.uint64(56)).astype(np.int64)]
    return tables


TABLES = _tables()


def crc64_readable(data: bytes) -> int:
    """Compute the CRC a byte at a time; tests compare `crc64_of` with it."""
    crc = 0
    for byte in data:
        crc = ((crc << 8) & _MASK) ^ int(TABLES[0, (crc >> 56) ^ byte])
    return crc


@kernel
def crc64_of(data: Any, tables: Any) -> int:
    """Compute the CRC of bytes.

    Args:
        data: (n,) uint8.
        tables: TABLES.
    """
    crc = np.uint64(0)
    n = len(data)
    whole = n - n % 8
    for i in range(0, whole, 8):
        word = np.uint64(0)
        for k in range(8):
            word = (word << np.uint64(8)) | np.uint64(data[i + k])
        crc ^= word
        mixed = np.uint64(0)
        for k in range(8):
            mixed ^= tables[k, (crc >> np.uint64(8 * k)) & np.uint64(255)]
        crc = mixed
    for i in range(whole, n):
        crc = (crc << np.uint64(8)) ^ tables[0, (crc >> np.uint64(56)) ^ np.uint64(data[i])]
    return crc  # type: ignore[return-value]
