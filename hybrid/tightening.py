"""The programs' tape made tight: the same results of fewer operations, in bursts of equal ones.

Stage 3, between the tape and the engine, for programs of doubles; where words round, every operation
stays as it is written. No bit of a result is changed. Beside what `numbering` leaves out, operations are
ordered so that equal ones follow each other, as far as what they need allows ("list scheduling"): the
engine finds out what to do once for a burst, not for every operation. Sums, differences and products are
all written as a product and a sum, so that most of a program is of one kind.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hybrid.graph import grouped_order
from hybrid.helpers import HELPERS
from hybrid.numbering import RESULTS, SQUARE, UNREAD, Burst, Numbering, Part, Step
from hybrid.tables import Axis, Table
from hybrid.tape import Memory, Op, Tape

# Registers that a tight tape has beside those of its tape: 1, -1, -0, and one for what nothing reads.
MORE = (1.0, -1.0, -0.0, 0.0)
NOTING = frozenset(Op[name.upper()] for name, helper in HELPERS.items() if helper.valid)


@dataclass(frozen=True, eq=False)
class TightTape:
    """Programs one after the other, each so many rows of `bursts`: (operation, first row of steps, end).

    A row of `steps`, by operation: (result, operand, operand, operand), where that of a choice is last;
    with arguments side by side (result, first of them, site); FIND (search, argument); LINE (result,
    search, table); PLANE and LOOK_UP (result, table); with several results (argument or first of them,
    result, result, result). The burst (SKIP, register, n) leaves out n bursts where that holds 0.
    """

    bursts: npt.NDArray[np.int32]  # (bursts, 3)
    steps: npt.NDArray[np.uint32]  # (steps, 4)
    registers: npt.NDArray[np.float64]  # first values
    finds: tuple[Axis, ...]  # the argument of each search
    looks: tuple[tuple[Table, tuple[int, ...]], ...]  # each table read, and its searches
    asks: npt.NDArray[np.int32]  # (asks, 3), see `Numbering`
    starts: npt.NDArray[np.int64]  # (programs + 1, 2): first row of bursts and of asks
    filled: npt.NDArray[
        np.int64
    ]  # (registers filled with a constant before the run, 2): which, with which


def tighten(tape: Tape) -> TightTape:
    """The same programs, tight; the tape must be of doubles."""
    tight = _tight(_Structure(tape))
    registers = np.append(tape.registers, MORE)
    registers[tight.filled[:, 0]] = registers[tight.filled[:, 1]]
    return replace(tight, registers=registers)


class _Structure:
    """A tape, equal to others that differ in the values of constants alone, as those of a sweep do."""

    def __init__(self, tape: Tape) -> None:
        self.tape = tape
        arrays = (tape.code, tape.word_registers, tape.memory, tape.shared, tape.starts)
        skips = tape.registers[tape.code[tape.code[:, 0] == Op.SKIP, 3]]
        squares = tape.registers[tape.code[tape.code[:, 0] == Op.POW, 3]] == SQUARE
        tables = tuple(id(site.table) for site in tape.sites)
        self.key = (
            *(array.tobytes() for array in (*arrays, skips, squares)),
            tables,
            len(tape.registers),
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Structure) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


@functools.lru_cache(maxsize=16)
def _tight(structure: _Structure) -> TightTape:
    """Tight but for the values of its registers."""
    numbering = Numbering(structure.tape)
    registers = _Registers(structure.tape, numbering)
    bursts, rows = list[tuple[int, int, int]](), list[tuple[int, ...]]()
    asks, starts = list[tuple[int, int, int]](), [(0, 0)]
    for parts, asked in zip(numbering.programs, numbering.asks, strict=True):
        for part in parts:
            steps = registers.settle(part)
            own = []
            for burst in grouped_order([step.op for step in steps], needs_of(steps)):
                own.append((steps[burst[0]].op, len(rows), len(rows) + len(burst)))
                rows += [registers.row(steps[k]) for k in burst]
            if part.guard is not None:
                bursts.append((Op.SKIP, registers.place(part.guard), len(own)))
            bursts += own
        asks += asked
        starts.append((len(bursts), len(asks)))
    return TightTape(
        np.array(bursts, dtype=np.int32).reshape(-1, 3),
        np.array(rows, dtype=np.uint32).reshape(-1, 4),
        np.zeros(0),
        tuple(numbering.finds),
        tuple(numbering.looks),
        np.array(asks, dtype=np.int32).reshape(-1, 3),
        np.array(starts, dtype=np.int64),
        np.array(registers.filled, dtype=np.int64).reshape(-1, 2),
    )


class _Registers:
    """Which register each value is kept in; at first that which it is named by."""

    def __init__(self, tape: Tape, numbering: Numbering) -> None:
        parts = [part for program in numbering.programs for part in program]
        count = len(tape.registers)
        self.one, self.minus_one, self.minus_zero, self.nowhere = range(count, count + len(MORE))
        self.read = numbering.read
        self.wanted = self.read | {*tape.word_registers.tolist()}
        self.wanted |= {*tape.memory[:, Memory.SOURCE].tolist()}
        self.times = Counter(register for part in parts for register in part.ends)
        self.constant = numbering.constant
        self.uses = Counter(value for part in parts for step in part.steps for value in step.takes)
        self.uses.update(part.guard for part in parts if part.guard is not None)
        self.uses.update(v for part in parts for r, v in part.ends.items() if r in self.wanted)
        self.filled: list[tuple[int, int]] = []
        self._place: dict[int, int] = {}

    def place(self, value: int) -> int:
        """The register that a value is kept in."""
        return self._place.get(value, value)

    def settle(self, part: Part) -> list[Step]:
        """The steps of a part with the copies that they still need."""
        ends = {r: v for r, v in part.ends.items() if r in self.wanted}
        free = {value for step in part.steps for value in step.gives} - self.read - ends.keys()
        free.discard(UNREAD)
        for register, value in ends.items():
            if value in free and register not in self.read and self.times[register] == 1:
                self._move(value, register, free)
        copies = list[Step]()
        for step in part.steps:
            if step.block is not None:
                copies += self._side_by_side(step, step.block, free)
        copies += [_copy(v, r) for r, v in ends.items() if self.place(v) != r]
        return self._sums([*part.steps, *copies])

    def _move(self, value: int, register: int, free: set[int]) -> None:
        self._place[value] = register
        free.remove(value)

    def _side_by_side(self, step: Step, block: int, free: set[int]) -> list[Step]:
        """Keep the arguments of a step where it wants them; copies of those that are kept elsewhere."""
        copies = []
        for slot, value in enumerate(step.takes, start=block):
            if value in self.constant:
                self.filled.append((slot, value))
            elif value in free:
                self._move(value, slot, free)
            elif self.place(value) != slot:
                copies.append(_copy(value, slot))
        return copies

    def _sums(self, steps: Sequence[Step]) -> list[Step]:
        """With products and sums as MULTIPLY_ADD: a product that only a sum needs becomes part of it."""
        steps = [self._as_sum(step) for step in steps]
        sums = {s.gives[0]: s for s in steps if s.op == Burst.MULTIPLY_ADD and not s.stores}
        products = {
            v for v, s in sums.items() if s.takes[2] == self.minus_zero and self.uses[v] == 1
        }
        for step in steps:
            if step.op == Burst.MULTIPLY_ADD and step.takes[1] == self.one:
                a, _, b = step.takes
                for term, other in ((a, b), (b, a)):
                    if term in products:
                        step.takes = (*sums[term].takes[:2], other)
                        products.remove(term)
                        sums[term].op = Op.COPY  # done with
                        break
        return [step for step in steps if step.op != Op.COPY]

    def _as_sum(self, step: Step) -> Step:
        """A step as MULTIPLY_ADD where that gives the same bits: x 1 + -0 is x, and x -1 is -x."""
        a, b = (*step.takes, 0, 0)[:2]
        as_sum = {
            Op.COPY: (a, self.one, self.minus_zero),
            Op.NEG: (a, self.minus_one, self.minus_zero),
            Op.MUL: (a, b, self.minus_zero),
            Op.ADD: (b, self.one, a),
            Op.SUB: (b, self.minus_one, a),
        }
        if step.op in as_sum:
            return replace(step, op=Burst.MULTIPLY_ADD, takes=as_sum[Op(step.op)])
        if step.op == Burst.SIN_COS and UNREAD in step.gives[:2]:  # one of them alone
            op = Op.COS if step.gives[0] == UNREAD else Op.SIN
            return replace(step, op=op, gives=(max(step.gives),))
        return step

    def row(self, step: Step) -> tuple[int, ...]:
        """A step as the engine reads it, see `TightTape`."""
        takes = [self.place(value) for value in step.takes]
        gives = [self.nowhere if value == UNREAD else self.place(value) for value in step.gives]
        if step.op == Burst.FIND:
            row = [step.detail, *takes]
        elif step.op == Burst.LINE:
            row = [*gives, *step.finds, step.detail]
        elif step.op in (Burst.PLANE, Op.LOOK_UP):
            row = [*gives, step.detail]
        elif len(gives) == RESULTS:
            row = [takes[0] if step.block is None else step.block, *gives]
        elif step.block is not None:
            row = [*gives, step.block, step.detail]
        else:
            row = [*gives, *takes]
        return (*row, 0, 0, 0)[:4]


def _copy(value: int, register: int) -> Step:
    return Step(Op.COPY, (value,), (register,), stores=True)


def needs_of(steps: Sequence[Step]) -> list[set[int]]:
    """For each step, which others must be done before it."""
    made = {v: k for k, step in enumerate(steps) for v in step.gives if not step.stores}
    stored = {step.gives[0]: k for k, step in enumerate(steps) if step.stores}
    found = {step.detail: k for k, step in enumerate(steps) if step.op == Burst.FIND}
    noted: dict[int, int] = {}
    needs = []
    for k, step in enumerate(steps):
        needed = {made[value] for value in step.takes if value in made}
        needed |= {found[find] for find in step.finds if find in found}
        if step.block is not None:
            slots = range(step.block, step.block + len(step.takes))
            needed |= {stored[slot] for slot in slots if slot in stored}
        if step.op in NOTING:  # what is out of range is noted in the order of the program
            needed |= {noted[step.detail]} if step.detail in noted else set()
            noted[step.detail] = k
        needs.append(needed)
    # What a register held before the part must be read before something else is stored there.
    for k, step in enumerate(steps):
        for value in step.takes:
            if value in stored and value not in made and stored[value] != k:
                needs[stored[value]].add(k)
    return needs
