"""One machine that has a whole patch several times over.

To begin a run takes longer than to play a short one, so an ensemble is found sooner in a few runs of
many copies. They have nothing in common but the clock: noise is drawn for each component.
"""

import re

import numpy as np

# A section, and its entries, each on a line of its own.
SECTION = re.compile(r"(?m)^(analog|interface|  program):\n((?: +\w+: .*\n)+)")


def in_copies(text, count):
    """The patch `count` times over: name_0, name_1, ... in place of the name of whatever it has."""
    entries = "".join(entries for _, entries in SECTION.findall(text))
    names = re.findall(r"(?m)^ +(\w+): ", entries)
    own = re.compile(rf"\b({'|'.join(names)})\b")

    def copied(section):
        copies = [own.sub(rf"\g<1>_{k}", section[2]) for k in range(count)]
        return f"{section[1]}:\n{''.join(copies)}"

    return SECTION.sub(copied, text)


def apart(records, count):
    """Records (runs, rows, signals * count), copies side by side, as (runs * count, rows, signals)."""
    runs, rows, columns = records.shape
    copies = records.reshape(runs, rows, columns // count, count)
    return np.moveaxis(copies, 3, 1).reshape(runs * count, rows, columns // count)
