"""How many operations a cycle of a program is: its tape, told as `operations` tells it.

Stage 3, between the tape and `tasks`.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Hashable, Iterator, Mapping

from hybrid.helpers import HELPERS
from hybrid.numbering import constant_registers
from hybrid.operations import (
    OPERATIONS,
    Count,
    helper_parts,
    of_operation,
    of_power,
    table_parts,
)
from hybrid.tape import CODE, FIRST_WIDE, Op, Tape


def program_operations(tape: Tape, number: int) -> dict[str, int]:
    """How many operations of each kind a cycle of a program is, once its formulas have started."""
    return dict(_operations(tape, number))


# The runs of a sweep or batch mostly share programs, and each tells how much its tasks ask for.
@functools.lru_cache(maxsize=64)
def _operations(tape: Tape, number: int) -> Mapping[str, int]:
    first, last = tape.starts[number : number + 2, CODE].tolist()
    skips = [k for k in range(first, last) if tape.code[k, 0] == Op.SKIP]
    counted = set(range(first, last)) - tape.beginning
    for k in skips[
        :-1
    ]:  # the last has the step of every later cycle, those before have the first ones
        counted -= set(range(k + 1, k + 1 + int(tape.registers[tape.code[k, 3]])))
    total = Counter(store=tape.past_rates[number])
    for count in _Rows(tape, sorted(counted)).counts():
        total.update(count)
    return {operation: total[operation] for operation in OPERATIONS}


class _Rows:
    """Rows of a tape, one after the other."""

    def __init__(self, tape: Tape, rows: list[int]) -> None:
        self.tape = tape
        self.code = [tuple(tape.code[k].tolist()) for k in rows]
        self.constant = constant_registers(tape)
        # Copies into these hand over arguments, and store no word.
        self.handed = {
            register
            for op, target, a, b in self.code
            for register in ((target,) if Op.SELECT <= op < FIRST_WIDE else self.block(op, a, b))
        }
        self.written: Counter[int] = Counter()  # how often each register has been
        self.sources: dict[int, Hashable] = {}  # what has been handed over

    def block(self, op: int, a: int, b: int) -> range:
        """Registers of the arguments of an operation that wants them side by side."""
        if op < FIRST_WIDE:
            return range(0)
        table = self.tape.sites[b].table if op == Op.LOOK_UP else None
        arguments = table.axes if table is not None else HELPERS[Op(op).name.lower()].takes
        return range(a, a + len(arguments))

    def counts(self) -> Iterator[Count]:
        """What each is; parts that several have in common come once."""
        seen: set[Hashable] = set()
        for op, target, a, b in self.code:
            if op == Op.COPY and target in self.handed:
                self.sources[target] = (a, self.written[a])
            elif op >= FIRST_WIDE:
                for key, count in self.parts(op, a, b):
                    if key not in seen:
                        yield count
                    seen.add(key)
            elif op == Op.POW and b in self.constant:
                yield of_power(float(self.tape.registers[b]))
            else:
                yield of_operation(Op(op).name.lower())
            self.written[target] += 1

    def parts(self, op: int, a: int, b: int) -> Iterator[tuple[Hashable, Count]]:
        """The parts of a look-up or a helper function."""
        arguments = tuple(self.sources[register] for register in self.block(op, a, b))
        table = self.tape.sites[b].table if op == Op.LOOK_UP else None
        if table is not None:
            return table_parts(table, arguments)
        return helper_parts(Op(op).name.lower(), arguments)
