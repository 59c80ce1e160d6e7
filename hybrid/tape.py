"""The digital program as a flat tape: operations on numbered registers, played by one kernel.

Stage 3. `taping` writes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from hybrid.errors import Place
from hybrid.expressions import (
    FUNCTIONS,
)
from hybrid.tables import Table
from hybrid.wordlength import WordLength


class Op(IntEnum):
    """Operation codes: target = f(a, b), unary ones of a alone; those from SELECT on = f(target, a, b),
    with what the target held before as their first argument. Where a is 0, SKIP leaves out the next b
    operations."""

    COPY = 0
    ADD = 1
    SUB = 2
    MUL = 3
    DIV = 4
    POW = 5
    NEG = 6
    MIN = 7
    MAX = 8
    ABS = 9
    SQRT = 10
    SIN = 11
    COS = 12
    TAN = 13
    ASIN = 14
    ACOS = 15
    ATAN = 16
    ATAN2 = 17
    EXP = 18
    LOG = 19
    SIGN = 20
    SINH = 21
    COSH = 22
    TANH = 23
    ASINH = 24
    ACOSH = 25
    ATANH = 26
    LOG10 = 27
    HYPOT = 28
    FLOOR = 29
    CEIL = 30
    ROUND = 31
    MOD = 32
    NOT = 33
    AND = 34
    OR = 35
    LT = 36
    LE = 37
    GT = 38
    GE = 39
    EQ = 40
    NE = 41
    SKIP = 42
    SELECT = 43
    LIMIT = 44
    DEAD_ZONE = 45
    # From here on an operation's arguments stand in registers side by side: the first operand is the
    # first of these, the second is the operation's row among the tape's `sites`.
    TEMPERATURE_US76 = 100
    PRESSURE_US76 = 101
    DENSITY_US76 = 102
    SOUND_SPEED_US76 = 103
    DENSITY_EXPONENTIAL = 104
    GRAVITY_SPHERE = 105
    GRAVITY_X_J2 = 106
    GRAVITY_Y_J2 = 107
    GRAVITY_Z_J2 = 108
    GRAVITY_DOWN_J2 = 109
    GRAVITY_NORTH_J2 = 110
    LATITUDE_WGS84 = 111
    LONGITUDE_WGS84 = 112
    HEIGHT_WGS84 = 113
    X_WGS84 = 114
    Y_WGS84 = 115
    Z_WGS84 = 116
    LOOK_UP = 117


BINARY_OPS = {
    "+": Op.ADD,
    "-": Op.SUB,
    "*": Op.MUL,
    "/": Op.DIV,
    "**": Op.POW,
    "<": Op.LT,
    "<=": Op.LE,
    ">": Op.GT,
    ">=": Op.GE,
    "==": Op.EQ,
    "!=": Op.NE,
    "and": Op.AND,
    "or": Op.OR,
}
FUNCTION_OPS = {op.name.lower(): op for op in Op if op.name.lower() in FUNCTIONS}
FIRST_WIDE = Op.TEMPERATURE_US76


class Memory(IntEnum):
    """Columns of `Tape.memory`. At the end of a cycle KEEPS takes over what SOURCE holds: at once where
    LENGTH is 0, else LENGTH cycles later. Until then that is in a ring of LENGTH registers from RING + 1
    on; RING itself holds which of them is the oldest."""

    KEEPS = 0
    SOURCE = 1
    RING = 2
    LENGTH = 3


# Columns of `Tape.starts`.
CODE, WORDS, MEMORY, SHARED = range(4)


@dataclass(frozen=True, slots=True)
class Site:
    """A place in the program that asks a function which has a range, in SI units."""

    function: str
    word: str
    arguments: tuple[str, ...]
    ranges: tuple[tuple[float, float], ...]
    units: tuple[str, ...]  # SI
    actions: tuple[tuple[int, int], ...]  # below, above
    told_in: tuple[tuple[str, float], ...]  # units for people, and their SI values
    table: Table | None = field(default=None, compare=False)  # which its name says, too


@dataclass(frozen=True, eq=False)
class Tape:
    """All programs, one after the other: `code` rows are (operation, destination, operand, operand)."""

    words: tuple[str, ...]
    code: npt.NDArray[np.int32]  # (operations, 4)
    owner: tuple[int, ...]  # which word each operation helps to compute
    registers: npt.NDArray[np.float64]  # first values
    word_registers: npt.NDArray[np.int32]
    memory: npt.NDArray[np.int32]  # (remembered, 4), see Memory; in the order in which they change
    places: tuple[Place, ...]  # of the words in the patch file
    states: npt.NDArray[np.int32]  # (states, 2): register of the state, of its rate
    starting: tuple[int, ...]  # registers that are not 0 in the first cycles only
    shared: npt.NDArray[np.int32]  # (words read of other programs, 2): register, word
    # (programs + 1, 4): first row of code, words, memory and shared of each program, and of the next
    starts: npt.NDArray[np.int64]
    sites: tuple[Site, ...]
    length_of: npt.NDArray[np.int32]  # (operations,): row of `lengths`; () where all are doubles
    lengths: npt.NDArray[np.float64]  # (word lengths, figures)
    fixed: Mapping[str, WordLength]  # of the words in fixed point
    beginning: frozenset[int]  # rows of code that only see to the first cycles
    past_rates: tuple[int, ...]  # of each program: rates that its formulas keep for later cycles
