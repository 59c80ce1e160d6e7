"""Patch files: text -> validated `Patch`; every complaint has file, line and what would be valid.

Stage 2. `fields` reads single values; here are the sections, one module each, and what crosses them:
names are unique, every cord ends somewhere, every dimension fits.
"""

from hybrid.patchfile.outside import parse_duration, parse_override, place_of
from hybrid.patchfile.placing import told_from_texts
from hybrid.patchfile.reading import parse_patch, read_patch

__all__ = [
    "parse_duration",
    "parse_override",
    "parse_patch",
    "place_of",
    "read_patch",
    "told_from_texts",
]
