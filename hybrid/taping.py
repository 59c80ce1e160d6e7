"""Writes a digital program on the tape: which register holds what, and one operation after the other.

Stage 3. Registers hold, in this order: ADC words, program words, then remembered values, constants and
temporaries. Sub-expressions of parameters alone are computed here once and become constants.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from hybrid.errors import PatchError, Place, known_as
from hybrid.expressions import (
    FUNCTIONS,
    Binary,
    Call,
    ExpressionError,
    LookUp,
    Name,
    Node,
    Unary,
    evaluate,
    is_known,
    names,
    shown,
    to_text,
)
from hybrid.helpers import Helper
from hybrid.integration import (
    FIRST,
    FIRST_NEXT,
    TO_START,
    TO_START_NEXT,
    Branch,
    Kept,
    Statement,
    kept,
    next_of,
    past_rates_of,
    rate_of,
    stepped_of,
    written_out,
)
from hybrid.meshes import searches
from hybrid.patch import Program, Value
from hybrid.tables import CONTINUES, Table
from hybrid.tape import (
    BINARY_OPS,
    FUNCTION_OPS,
    Memory,
    Op,
    Site,
    Tape,
)
from hybrid.wordlength import FLOAT64, Kind, WordLength

# The longest delay, in cycles.
LONGEST_DELAY = 1_000_000


class _Builder:
    """Assigns registers and appends operations."""

    def __init__(self, program: Program | None, scope: Mapping[str, float]) -> None:
        self.scope = scope
        self.remember = program.remember if program else {}
        self.words = program.words if program else ()
        self.number = {word: i for i, word in enumerate(self.words)}
        self.values: list[float] = []
        self.place: dict[str, int] = {}
        self.fixed: set[str] = set()  # names that keep their register
        self.constants: dict[float, int] = {}
        self.delays: dict[tuple[str, int], int] = {}  # word, cycles -> register
        self.memory: list[tuple[int, int, int, int]] = []
        self.code: list[tuple[int, int, int, int]] = []
        self.owner: list[int] = []
        self.sites: dict[Site, int] = {}
        self.word = ""  # which is being compiled
        usual = program.word.bound(scope) if program else FLOAT64
        self.length = dict.fromkeys(self.words, usual)
        if program:
            self.length |= {word: own.bound(scope) for word, own in program.lengths.items()}
        self.kept: tuple[Kept, ...] = ()  # of the program that is being compiled
        self.beginning: set[int] = set()  # operations that see to the first cycles
        self.rounding = FLOAT64  # of what is being computed
        self.length_of: list[WordLength] = []

    def register(self, value: float = 0.0) -> int:
        self.values.append(value)
        return len(self.values) - 1

    def constant(self, value: float) -> int:
        value = self.rounding.constant(value)
        if value not in self.constants:
            self.constants[value] = self.register(value)
        return self.constants[value]

    def compute(self, node: Node) -> int:
        """Register that holds the node's value once the code so far has run."""
        if self.is_known(node):
            return self.constant(evaluate(node, self.scope))
        match node:
            case Call("next", (Name(id),)):
                return self.place[next_of(id)]
            case Call("select", (condition, chosen, other)) if self.is_known(condition):
                return self.compute(chosen if evaluate(condition, self.scope) else other)
            case Call("select", (Name(id), *_) as arguments) if id == FIRST:
                return self.choose_first(arguments)
            case Name(id):
                return self.place[id]
            case Call("previous", (Name(id), *rest)):
                return self.delay(id, self.cycles(node, rest[0]) if rest else 1)
            case Unary(op, operand):
                return self.emit(Op.NEG if op == "-" else Op.NOT, self.compute(operand))
            case Binary(op, left, right):
                return self.emit(BINARY_OPS[op], self.compute(left), self.compute(right))
            case LookUp(table, arguments):
                return self.look_up(table, arguments)
            case Call(function, arguments):
                helper = FUNCTIONS[function].helper
                if helper:
                    return self.call_helper(function, helper, arguments)
                return self.call(FUNCTION_OPS[function], arguments)
        raise AssertionError(f"no operation for {node!r}")

    def is_known(self, node: Node) -> bool:
        """Whether the node has a value before the run."""
        return is_known(node, self.scope)

    def call(self, op: Op, arguments: tuple[Node, ...]) -> int:
        held = [self.compute(argument) for argument in arguments]
        if op >= Op.SELECT:
            target = self.register()
            self.append(Op.COPY, target, held[0], exact=True)
            self.append(op, target, held[1], held[2])
            return target
        if op not in (Op.MIN, Op.MAX):
            return self.emit(op, *held)
        result = held[0]
        for other in held[1:]:
            result = self.emit(op, result, other)
        return result

    def choose_first(self, arguments: tuple[Node, ...]) -> int:
        """What the first cycle has in place of one before it; the choice itself sees to that alone."""
        result = self.call(Op.SELECT, arguments)
        self.beginning |= {len(self.code) - 2, len(self.code) - 1}  # COPY and SELECT
        return result

    def call_helper(self, name: str, helper: Helper, arguments: tuple[Node, ...]) -> int:
        left_out = helper.defaults[len(helper.defaults) - len(helper.takes) + len(arguments) :]
        held = [self.compute(argument) for argument in arguments]
        held += [self.constant(value) for value in left_out]
        site = 0
        if helper.valid:
            argument, dimension = helper.takes[0]
            ranges, units = (helper.valid,), (str(dimension),)
            actions, told_in = ((CONTINUES, CONTINUES),), ((units[0], 1.0),)
            site = self.site(Site(name, self.word, (argument,), ranges, units, actions, told_in))
        return self.emit_wide(FUNCTION_OPS[name], held, site)

    def look_up(self, table: Table, arguments: tuple[Node, ...]) -> int:
        held = [self.compute(argument) for argument in arguments]
        axes = searches(table)
        site = Site(
            table.name,
            self.word,
            tuple(axis.name for axis in axes),
            tuple(axis.range for axis in axes),
            tuple("" if axis.dimension.is_pure else str(axis.dimension) for axis in axes),
            tuple((axis.below, axis.above) for axis in axes),
            tuple(axis.told_in for axis in axes),
            table,
        )
        return self.emit_wide(Op.LOOK_UP, held, self.site(site))

    def site(self, site: Site) -> int:
        """Number of the place; the stages of a formula that compute a word again ask at the same one."""
        return self.sites.setdefault(site, len(self.sites))

    def emit_wide(self, op: Op, held: list[int], site: int) -> int:
        """An operation whose arguments are first copied side by side."""
        block = [self.register() for _ in held]
        for target, source in zip(block, held, strict=True):
            self.append(Op.COPY, target, source, exact=True)
        return self.emit(op, block[0], site)

    def emit(self, op: Op, a: int, b: int = 0) -> int:
        target = self.register()
        # What is true or false has nothing to round.
        self.append(op, target, a, b, exact=Op.NOT <= op <= Op.SKIP)
        return target

    def append(self, op: Op, target: int, a: int, b: int = 0, exact: bool = False) -> None:
        self.code.append((op, target, a, b))
        self.length_of.append(FLOAT64 if exact else self.rounding)

    def cycles(self, node: Node, argument: Node) -> int:
        """How many cycles ago; arithmetic such as delay/period need be whole but for rounding."""
        value = evaluate(argument, self.scope)
        whole = round(value)
        if not 1 <= whole <= LONGEST_DELAY or abs(value - whole) > 1e-9 * whole:
            raise ExpressionError(
                f"{shown(to_text(node))} asks for {value:.10g} cycles ago; "
                f"that must be a whole number from 1 to {LONGEST_DELAY}"
            )
        return whole

    def delay(self, word: str, cycles: int) -> int:
        """Register of a word's value `cycles` ago."""
        if (word, cycles) not in self.delays:
            first, ring = self.first_value(word), cycles - 1
            keeps = self.register(first)
            start = len(self.values)
            if ring:
                self.values += [0.0, *[first] * ring]
            self.memory.append((keeps, self.place[word], start if ring else 0, ring))
            self.delays[word, cycles] = keeps
        return self.delays[word, cycles]

    def first_value(self, word: str) -> float:
        """What previous(word) gives in the first cycles; of a state, its initial value."""
        if word in self.remember:
            return self.first_of(word, self.remember[word])
        return next(entry.first for entry in self.kept if entry.name == word)

    def first_of(self, word: str, first: Value) -> float:
        """A first value as the word holds it; raises PatchError where it does not fit."""
        value = first.number(self.scope)
        try:
            return self.length[word].stored(value)
        except OverflowError:
            raise PatchError(
                f"{first.what} is {value:g} in SI units, which does not fit into the word of {word!r}; "
                f"its full_scale is {self.length[word].full_scale:g}",
                first.place,
            ) from None

    def begin(self, program: Program, known: Mapping[str, int]) -> None:
        """Give a register to all that is read before it is computed, or is computed in branches.

        known: registers of the names that all programs see.
        """
        self.kept = kept(program, self.first_of)
        stepped = [stepped_of(state) for state in program.states]
        self.place = dict(known)
        for name in (*(entry.name for entry in self.kept), *stepped):
            if name not in self.place:
                self.place[name] = self.register()
        for entry in self.kept:
            self.values[self.place[entry.name]] = entry.first
        self.fixed = set(self.place)

    def step(self, part: Statement | Branch) -> None:
        """Append the operations of a statement, or of those that a condition guards."""
        before = len(self.code)
        if isinstance(part, Branch):
            self.rounding = FLOAT64
            self.emit(Op.SKIP, self.compute(part.condition))
            skip = len(self.code) - 1
            self.beginning |= set(range(before, skip + 1))
        self.owner += [self.number[part.word]] * (len(self.code) - before)
        if isinstance(part, Statement):
            self.assign(part)
            return
        for statement in part.statements:
            self.assign(statement)
        op, target, condition, _ = self.code[skip]
        self.rounding = FLOAT64
        skipped = self.constant(float(len(self.code) - skip - 1))
        self.code[skip] = (op, target, condition, skipped)

    def assign(self, part: Statement) -> None:
        """Compute a statement; into its register where it has one for good."""
        before, self.word = len(self.code), part.word
        begins = part.name in (TO_START_NEXT, FIRST_NEXT)
        self.rounding = FLOAT64 if begins else self.length[part.word]
        result = self.compute(part.expr)
        if part.name in self.fixed:
            self.append(Op.COPY, self.place[part.name], result)
        else:
            self.place[part.name] = result
        if begins:
            self.beginning |= set(range(before, len(self.code)))
        self.owner += [self.number[part.word]] * (len(self.code) - before)

    def play(self, parts: Iterable[Statement | Branch], places: Mapping[str, Place]) -> None:
        """Append one program, and what it hands over to its next cycle."""
        for part in parts:
            try:
                self.step(part)
            except ExpressionError as error:
                what = f"word {known_as(part.word)!r}"
                raise PatchError(f"{what}: {error}", places[part.word]) from None
        for entry in self.kept:
            self.memory.append((self.place[entry.name], self.place[entry.source], 0, 0))


def _foreign(program: Program) -> frozenset[str]:
    """The names that a program reads and does not compute itself."""
    read = frozenset[str]().union(
        *(names(expr) for entry in program.written for expr in entry.reads)
    )
    return read - set(program.words)


def build_tape(
    program: Program | None,
    adcs: tuple[str, ...],
    scope: Mapping[str, float],
    steps_s: Sequence[float],
) -> Tape:
    """Compile `program` for the parameter values in `scope`; ADC words take registers 0, 1, ...

    steps_s: steps of the integration formulas, the period of each program.
    """
    build = _Builder(program, scope)
    written = {entry.word: entry.place for entry in program.written} if program else {}
    own = {name: build.register() for name in (*adcs, *build.words)}
    shared, states, starting = list[tuple[int, int]](), list[tuple[int, int]](), list[int]()
    starts = [(0, 0, 0, 0)]
    for single, step_s in zip(program.programs if program else (), steps_s, strict=True):
        foreign = sorted(_foreign(single) & own.keys() - set(adcs))
        build.begin(single, own | {name: build.register() for name in foreign})
        shared += [(build.place[name], build.words.index(name)) for name in foreign]
        for name in foreign:
            if name in build.remember:
                build.values[own[name]] = build.first_of(name, build.remember[name])
        build.play(written_out(single, step_s), written)
        states += [(build.place[s.word], build.place[rate_of(s.word)]) for s in single.states]
        starting += [build.place[name] for name in (TO_START, FIRST) if name in build.place]
        known = starts[-1][1] + len(single.words)
        starts.append((len(build.code), known, len(build.memory), len(shared)))
    return Tape(
        build.words,
        np.array(build.code, dtype=np.int32).reshape(-1, 4),
        tuple(build.owner),
        np.array(build.values, dtype=np.float64),
        np.array([own[w] for w in build.words], dtype=np.int32),
        np.array(build.memory, dtype=np.int32).reshape(-1, len(Memory)),
        tuple(written.values()),
        np.array(states, dtype=np.int32).reshape(-1, 2),
        tuple(starting),
        np.array(shared, dtype=np.int32).reshape(-1, 2),
        np.array(starts, dtype=np.int64),
        tuple(build.sites),
        *_word_lengths(build.length_of),
        {word: length for word, length in build.length.items() if length.kind is Kind.FIXED},
        frozenset(build.beginning),
        tuple(past_rates_of(single) for single in (program.programs if program else ())),
    )


def _word_lengths(
    length_of: Sequence[WordLength],
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]:
    """Which word length each operation has, and these; nothing where all are doubles."""
    distinct = list(dict.fromkeys((FLOAT64, *length_of)))
    rows = np.array([length.row for length in distinct])
    if len(distinct) == 1:
        return np.zeros(0, dtype=np.int32), rows
    return np.array([distinct.index(length) for length in length_of], dtype=np.int32), rows
