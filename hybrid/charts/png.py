"""A picture as a PNG file (W3C, Portable Network Graphics Specification, third edition).

Matplotlib's own way keeps a transparency that no chart has and tries five filters on every row, in
more than twice the time. Paper with thin lines packs best as it is.
"""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_BITS, _RGB, _DEFLATE, _FILTERS, _NOT_INTERLACED = 8, 2, 0, 0, 0
_FAST = 1  # of zlib's levels; the highest takes ten times as long for a file smaller by a quarter


def png(colors: NDArray[np.uint8], per_inch: float) -> bytes:
    """The file's contents: of (rows, columns, 3) red, green and blue, at so many pixels an inch."""
    rows, columns, _ = colors.shape
    unfiltered = np.zeros((rows, 1 + 3 * columns), np.uint8)  # a row begins with its filter: none
    unfiltered[:, 1:] = colors.reshape(rows, -1)
    about = (columns, rows, _BITS, _RGB, _DEFLATE, _FILTERS, _NOT_INTERLACED)
    per_metre = round(per_inch / 0.0254)
    return b"".join(
        (
            _SIGNATURE,
            _chunk(b"IHDR", struct.pack(">IIBBBBB", *about)),
            _chunk(b"pHYs", struct.pack(">IIB", per_metre, per_metre, 1)),
            _chunk(b"IDAT", zlib.compress(unfiltered.data, _FAST)),
            _chunk(b"IEND", b""),
        )
    )


def _chunk(kind: bytes, contents: bytes) -> bytes:
    check = zlib.crc32(kind + contents)
    return b"".join((struct.pack(">I", len(contents)), kind, contents, struct.pack(">I", check)))
