"""What the programs of a tape compute, each thing once: value numbering, as compilers do it.

Stage 3. A value is named by the register that holds it first. A copy gives no new value, nor does an
operation that was done before on the same values. So nothing is copied from one register to another only
to be read there, and of several equal operations one is left. An argument of tables is sought among
breakpoints once for all tables that have these, and what comes of one formula is computed together.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from hybrid.expressions import FUNCTIONS
from hybrid.helpers import HELPERS
from hybrid.meshes import searches
from hybrid.tables import Axis, Table
from hybrid.tape import BINARY_OPS, CODE, FIRST_WIDE, FUNCTION_OPS, Memory, Op, Tape


class Burst(IntEnum):
    """What only a tight tape has, beside the operations of `Op`.

    MULTIPLY_ADD is a product and a sum, each rounded. FIND seeks an argument among breakpoints; LINE and
    PLANE read a linear table of one and of two arguments that were found, LOOK_UP any other table. The
    rest give up to three results at once.
    """

    MULTIPLY_ADD = 199
    FIND = 200
    LINE = 201
    PLANE = 202
    SIN_COS = 203
    GRAVITY_J2 = 204
    GRAVITY_POLAR_J2 = 205
    GEODETIC_WGS84 = 206
    EARTH_FIXED_WGS84 = 207


# Operations that are one of several results of a formula: which formula, which result.
JOINT: Mapping[int, tuple[Burst, int]] = {
    Op.SIN: (Burst.SIN_COS, 0),
    Op.COS: (Burst.SIN_COS, 1),
    Op.GRAVITY_X_J2: (Burst.GRAVITY_J2, 0),
    Op.GRAVITY_Y_J2: (Burst.GRAVITY_J2, 1),
    Op.GRAVITY_Z_J2: (Burst.GRAVITY_J2, 2),
    Op.GRAVITY_DOWN_J2: (Burst.GRAVITY_POLAR_J2, 0),
    Op.GRAVITY_NORTH_J2: (Burst.GRAVITY_POLAR_J2, 1),
    Op.LATITUDE_WGS84: (Burst.GEODETIC_WGS84, 0),
    Op.LONGITUDE_WGS84: (Burst.GEODETIC_WGS84, 1),
    Op.HEIGHT_WGS84: (Burst.GEODETIC_WGS84, 2),
    Op.X_WGS84: (Burst.EARTH_FIXED_WGS84, 0),
    Op.Y_WGS84: (Burst.EARTH_FIXED_WGS84, 1),
    Op.Z_WGS84: (Burst.EARTH_FIXED_WGS84, 2),
}
RESULTS = 3  # of a formula, at most
UNREAD = -1  # in place of a result that nothing reads
SQUARE = 2.0
# How many arguments an operation has; those with arguments side by side are in `HELPERS`.
ARGUMENTS = {Op.COPY: 1, Op.NEG: 1, **dict.fromkeys(BINARY_OPS.values(), 2), Op.NOT: 1}
ARGUMENTS |= {op: FUNCTIONS[name].fewest for name, op in FUNCTION_OPS.items() if op < FIRST_WIDE}


@dataclass(slots=True, eq=False)
class Step:
    """An operation on values."""

    op: int
    takes: tuple[int, ...]
    gives: tuple[int, ...] = ()
    detail: int = 0  # the site, or the number of a search or of a table read
    block: int | None = (
        None  # first of the registers in which the arguments are wanted side by side
    )
    finds: tuple[int, ...] = ()  # searches it needs
    stores: bool = False  # what it gives is a register, no value


@dataclass(slots=True, eq=False)
class Part:
    """A stretch of a program without branches; it is left out where the value `guard` is 0."""

    guard: int | None = None
    steps: list[Step] = field(default_factory=list)
    ends: dict[int, int] = field(
        default_factory=dict
    )  # values that registers are to hold at its end


class Numbering:
    """Every program of a tape in parts.

    constant: registers that never change; read: those read for what they held before a part; finds: the
    argument of each search; looks: each table read, and its searches; asks: of each program, every
    argument of a table that it asks, in its order: (search, site, number of the argument).
    """

    def __init__(self, tape: Tape) -> None:
        self._tape, self._code = tape, tape.code.tolist()
        self.programs: list[list[Part]] = []
        self.read: set[int] = set()
        self.finds: list[Axis] = []
        self.looks: list[tuple[Table, tuple[int, ...]]] = []
        self.asks: list[list[tuple[int, int, int]]] = []
        self.constant = constant_registers(tape)
        for first, end in itertools.pairwise(tape.starts[:, CODE].tolist()):
            self.asks.append([])
            self.programs.append([])
            self._held: dict[int, int] = {}  # by register
            self._known: dict[tuple[object, ...], int] = {}  # what has been computed
            self._program(first, end)

    def _program(self, first: int, end: int) -> None:
        while first < end:
            skip = next((k for k in range(first, end) if self._code[k][0] == Op.SKIP), end)
            self._part(None, first, skip)
            first = skip
            if skip < end:
                _, _, condition, skipped = self._code[skip]
                first += 1 + int(self._tape.registers[skipped])
                self._branch(self._value(condition), skip + 1, first)

    def _branch(self, guard: int, first: int, end: int) -> None:
        """A part that may be left out: what it computes is known in it only."""
        held, known = self._held, self._known
        self._held, self._known = dict(held), {}
        self._part(guard, first, end)
        for register in self.programs[-1][-1].ends:
            held.pop(register, None)
        self._held, self._known = held, known

    def _part(self, guard: int | None, first: int, end: int) -> None:
        part = Part(guard)
        self.programs[-1].append(part)
        for op, target, a, b in self._code[first:end]:
            assert op != Op.SKIP
            if op == Op.COPY:
                value = self._value(a)
            elif op == Op.LOOK_UP:
                value = self._look_up(part, target, a, b)
            else:
                value = self._operation(part, op, target, a, b)
            part.ends[target] = self._held[target] = value

    def _value(self, register: int) -> int:
        """The value that a register holds."""
        if register not in self._held:
            self.read.add(register)
        return self._held.get(register, register)

    def _operation(self, part: Part, op: int, target: int, a: int, b: int) -> int:
        """The value of an operation: an earlier one where there is one that is equal."""
        block, site = None, 0
        if op == Op.POW and b in self.constant and self._tape.registers[b] == SQUARE:
            op, b = Op.MUL, a  # rounded once, and far sooner
        if op >= FIRST_WIDE:
            block, site = a, b
            places = range(a, a + len(HELPERS[Op(op).name.lower()].takes))
            takes = tuple(map(self._value, places))
        else:
            registers = (a, b, target) if op >= Op.SELECT else (a, b)[: ARGUMENTS[Op(op)]]
            takes = tuple(map(self._value, registers))
        key = (op, takes, site)
        if key not in self._known:
            self._known[key] = target
            if op in JOINT:
                self._one_of(part, *JOINT[op], Step(op, takes, (target,), site, block))
            else:
                part.steps.append(Step(op, takes, (target,), site, block))
        return self._known[key]

    def _one_of(self, part: Part, formula: Burst, number: int, step: Step) -> None:
        """Add a result of a formula to the step that has another one, if there is one."""
        found = [s for s in part.steps if s.op == formula and s.takes == step.takes]
        if not found:
            found = [Step(formula, step.takes, (UNREAD,) * RESULTS, step.detail, step.block)]
            part.steps += found
        gives = found[0].gives
        found[0].gives = (*gives[:number], *step.gives, *gives[number + 1 :])

    def _look_up(self, part: Part, target: int, a: int, site: int) -> int:
        table = self._tape.sites[site].table
        assert table is not None
        finds = tuple(
            self._find(part, self._value(a + i), axis) for i, axis in enumerate(table.axes)
        )
        self.asks[-1] += [(find, site, number) for number, find in enumerate(finds)]
        key = (Op.LOOK_UP, id(table), finds)
        if key not in self._known:
            self._known[key] = target
            flat = table.method == "linear" and len(finds) <= 2
            op = (Burst.LINE, Burst.PLANE)[len(finds) - 1] if flat else Op.LOOK_UP
            part.steps.append(Step(op, (), (target,), len(self.looks), finds=finds))
            beyond = searches(table)[len(finds) :]
            count = len(self.finds)
            self.looks.append((table, (*finds, *range(count, count + len(beyond)))))
            self.finds += beyond
        if table.mesh is not None:
            sought = next(f for known, f in self.looks if known is table and f[:-1] == finds)
            self.asks[-1].append((sought[-1], site, len(finds)))
        return self._known[key]

    def _find(self, part: Part, value: int, axis: Axis) -> int:
        """Number of the search for a value among breakpoints."""
        key = (Burst.FIND, value, axis.points.tobytes(), axis.range, axis.below, axis.above)
        if key not in self._known:
            self._known[key] = len(self.finds)
            part.steps.append(Step(Burst.FIND, (value,), detail=len(self.finds)))
            self.finds.append(axis)
        return self._known[key]


def constant_registers(tape: Tape) -> set[int]:
    """Registers that no program writes to, nor what programs are given."""
    adcs = range(min(tape.word_registers.tolist(), default=0))
    written = (tape.code[:, 1], tape.memory[:, Memory.KEEPS], tape.shared[:, 0])
    return set(range(len(tape.registers))) - set(np.concatenate(written).tolist()) - set(adcs)
