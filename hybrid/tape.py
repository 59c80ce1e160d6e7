"""The digital program as a flat tape: operations on numbered registers, played by one kernel.

Stage 3. Registers hold, in this order: ADC words, program words, remembered values, constants,
temporaries. Sub-expressions of parameters alone are computed here once and become constants.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from hybrid.errors import PatchError, Place
from hybrid.expressions import (
    Binary,
    Call,
    ExpressionError,
    Name,
    Node,
    Unary,
    evaluate,
    names,
    previous_names,
)
from hybrid.patch import Program


class Op(IntEnum):
    """Operation codes; unary ones ignore their second operand."""

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


BINARY_OPS = {"+": Op.ADD, "-": Op.SUB, "*": Op.MUL, "/": Op.DIV, "**": Op.POW}
FUNCTION_OPS = {op.name.lower(): op for op in Op if op >= Op.MIN}


@dataclass(frozen=True, eq=False)
class Tape:
    """One program: `code` rows are (operation, destination, operand, operand)."""

    words: tuple[str, ...]
    remembered: tuple[str, ...]
    code: npt.NDArray[np.int32]  # (operations, 4)
    owner: tuple[int, ...]  # which word each operation helps to compute
    registers: npt.NDArray[np.float64]  # first values
    word_registers: npt.NDArray[np.int32]
    memory: npt.NDArray[np.int32]  # (remembered, 2): memory register, word register
    places: tuple[Place, ...]  # of the words in the patch file


class _Builder:
    """Assigns registers and appends operations."""

    def __init__(self, scope: Mapping[str, float]) -> None:
        self.scope = scope
        self.values: list[float] = []
        self.place: dict[str, int] = {}
        self.memory: dict[str, int] = {}
        self.constants: dict[float, int] = {}
        self.code: list[tuple[int, int, int, int]] = []
        self.owner: list[int] = []

    def register(self, value: float = 0.0) -> int:
        self.values.append(value)
        return len(self.values) - 1

    def constant(self, value: float) -> int:
        if value not in self.constants:
            self.constants[value] = self.register(value)
        return self.constants[value]

    def compute(self, node: Node) -> int:
        """Register that holds the node's value once the code so far has run."""
        if not (names(node) - self.scope.keys()) and not previous_names(node):
            return self.constant(evaluate(node, self.scope))
        match node:
            case Name(id):
                return self.place[id]
            case Call("previous", (Name(id),)):
                return self.memory[id]
            case Unary(_, operand):
                return self.emit(Op.NEG, self.compute(operand))
            case Binary(op, left, right):
                return self.emit(BINARY_OPS[op], self.compute(left), self.compute(right))
            case Call(function, arguments):
                return self.call(FUNCTION_OPS[function], arguments)
        raise AssertionError(f"no operation for {node!r}")

    def call(self, op: Op, arguments: tuple[Node, ...]) -> int:
        held = [self.compute(argument) for argument in arguments]
        if op not in (Op.MIN, Op.MAX):
            return self.emit(op, *held)
        result = held[0]
        for other in held[1:]:
            result = self.emit(op, result, other)
        return result

    def emit(self, op: Op, a: int, b: int = 0) -> int:
        target = self.register()
        self.code.append((op, target, a, b))
        return target


def build_tape(program: Program | None, adcs: tuple[str, ...], scope: Mapping[str, float]) -> Tape:
    """Compile `program` for the parameter values in `scope`; ADC words take registers 0, 1, ..."""
    build = _Builder(scope)
    for name in adcs:
        build.place[name] = build.register()
    assignments = program.assignments if program else ()
    for assignment in assignments:
        build.place[assignment.word] = build.register()
    remembered = tuple(sorted(program.remember)) if program else ()
    for name in remembered:
        assert program is not None
        build.memory[name] = build.register(program.remember[name].number(scope))
    for index, assignment in enumerate(assignments):
        before = len(build.code)
        try:
            result = build.compute(assignment.expr)
        except ExpressionError as error:
            raise PatchError(f"word {assignment.word!r}: {error}", assignment.place) from None
        build.code.append((Op.COPY, build.place[assignment.word], result, 0))
        build.owner.extend([index] * (len(build.code) - before))
    words = tuple(assignment.word for assignment in assignments)
    return Tape(
        words,
        remembered,
        np.array(build.code, dtype=np.int32).reshape(-1, 4),
        tuple(build.owner),
        np.array(build.values, dtype=np.float64),
        np.array([build.place[w] for w in words], dtype=np.int32),
        np.array([(build.memory[n], build.place[n]) for n in remembered], np.int32).reshape(-1, 2),
        tuple(assignment.place for assignment in assignments),
    )
