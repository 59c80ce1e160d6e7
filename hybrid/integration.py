"""A program with states, written out as plain assignments: what one cycle computes.

Stage 2. A step of an integration formula is arithmetic like all else, so it needs no machinery on the
tape. A cycle computes, in this order: the words that need no result of the step; the rates f(x); the
step; the words that read next(x). A Runge-Kutta formula computes the rates again at each stage, and of
the program that part which lies between states and rates; ADC words and what previous() reads stay as
they are. In the first cycles, a multistep formula lacks rates of the past: there its states are
stepped by the Runge-Kutta formula of the same order.

Formulas may be mixed. The stages of one see a state of another on the parabola through its value and
rate at the start and its value at the end of the step, or, where that end comes later, on the straight
line of its rate. So the order of the whole is the lowest among them and at most 3; 2 where Runge-Kutta
formulas of different order are mixed.

The names made here (rate(x), next(x), ...) are no names a patch can have.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from hybrid.expressions import Binary, Call, Name, Node, Number, names, next_names, renamed
from hybrid.formulas import MULTISTEP, RUNGE_KUTTA, past_rates, starter
from hybrid.patch import Program, State, Value

# Counts the cycles down in which formulas start; it is no word, and is never rounded.
TO_START = "cycles to start"
TO_START_NEXT = f"{TO_START} next"
# 1 in the first cycle of a program and 0 later, for what reads it.
FIRST = "first cycle"
FIRST_NEXT = f"{FIRST} next"


@dataclass(frozen=True, slots=True)
class Statement:
    """name = expr, as a part of computing `word`."""

    name: str
    expr: Node
    word: str


@dataclass(frozen=True, slots=True)
class Branch:
    """Statements that are computed only where the condition holds."""

    condition: Node
    statements: tuple[Statement, ...]
    word: str


@dataclass(frozen=True, slots=True)
class Kept:
    """A name that takes over another's value at the end of a cycle."""

    name: str
    source: str
    first: float
    word: str


def next_of(word: str) -> str:
    """Name of a state's value at the end of the cycle."""
    return f"next({word})"


def rate_of(word: str, ago: int = 0) -> str:
    """Name of a state's rate at the start of this cycle, or of one before."""
    return f"rate({word}, {ago})" if ago else f"rate({word})"


def stepped_of(state: State) -> str:
    """Name of what the formula gives; a reset may put something else in its place."""
    return next_of(state.word) if state.reset_when is None else f"stepped({state.word})"


def written_out(program: Program, step_s: float) -> Iterator[Statement | Branch]:
    """All that one cycle computes, in order."""
    waiting = {state.word: state for state in program.states}
    stepped = not waiting
    for assignment in program.assignments:
        read = sorted(next_names(assignment.expr))
        if read and not stepped:
            yield from _step(program, step_s)
            stepped = True
        for word in read:
            yield from _resets(word, waiting)
        yield Statement(assignment.word, assignment.expr, assignment.word)
    if not stepped:
        yield from _step(program, step_s)
    for word in sorted(waiting):
        yield from _resets(word, waiting)
    if reads_first(program):
        yield Statement(FIRST_NEXT, Number(0.0), program.words[0])


def reads_first(program: Program) -> bool:
    """Whether something depends on whether the cycle is the first."""
    return any(FIRST in names(expr) for entry in program.written for expr in entry.reads)


def past_rates_of(program: Program) -> int:
    """How many rates of earlier cycles its formulas keep."""
    return sum(past_rates(state.formula) for state in program.states)


def kept(program: Program, first_of: Callable[[str, Value], float]) -> tuple[Kept, ...]:
    """What states and formulas hand over to the next cycle, in the order in which it changes.

    first_of: what a word makes of the initial value written for it.
    """
    found = []
    longest = max((past_rates(state.formula) for state in program.states), default=0)
    for state in program.states:
        for ago in range(past_rates(state.formula), 0, -1):
            source = rate_of(state.word, ago - 1)
            found.append(Kept(rate_of(state.word, ago), source, 0.0, state.word))
    for state in program.states:
        first = first_of(state.word, state.initial)
        found.append(Kept(state.word, next_of(state.word), first, state.word))
    if longest:
        word = program.states[0].word
        found.append(Kept(TO_START, TO_START_NEXT, float(longest), word))
    if reads_first(program):
        found.append(Kept(FIRST, FIRST_NEXT, 1.0, program.words[0]))
    return tuple(found)


def _resets(word: str, waiting: dict[str, State]) -> Iterator[Statement]:
    """next(word) where something sets the state, after what that reads; once."""
    state = waiting.pop(word, None)
    if state is None or state.reset_when is None or state.reset_to is None:
        return
    for other in sorted(next_names(state.reset_when) | next_names(state.reset_to)):
        yield from _resets(other, waiting)
    choice = Call("select", (state.reset_when, state.reset_to, Name(stepped_of(state))))
    yield Statement(next_of(word), choice, word)


def _step(program: Program, step_s: float) -> Iterator[Statement | Branch]:
    """Rates at the start, then the step: in the first cycles another one than later."""
    states = program.states
    for state in states:
        yield Statement(rate_of(state.word), state.expr, state.word)
    pasts = {past_rates(state.formula) for state in states}
    longest, word = max(pasts), states[0].word
    left = Name(TO_START)
    starts = (0, *sorted(pasts - {0}))
    for start, end in zip(starts, (*starts[1:], None), strict=True):
        formulas = {
            s.word: s.formula if past_rates(s.formula) <= start else starter(s.formula)
            for s in states
        }
        statements = tuple(_stepped_by(formulas, program, step_s))
        if not longest:
            yield from statements
            continue
        condition: Node = Binary("<=", left, Number(float(longest - start)))
        if end is not None:
            condition = Binary("and", condition, Binary(">", left, Number(float(longest - end))))
        yield Branch(condition, statements, word)
    if longest:
        one_less = Call("max", (Binary("-", left, Number(1.0)), Number(0.0)))
        yield Statement(TO_START_NEXT, one_less, word)


def _stepped_by(
    formulas: Mapping[str, str], program: Program, step_s: float
) -> Iterator[Statement]:
    """The step of every state by the formula named for it: multistep ones, then rk2, rk3, rk4."""
    done: set[str] = set()
    for state in program.states:
        formula = formulas[state.word]
        if formula in MULTISTEP:
            rates = [rate_of(state.word, ago) for ago in range(len(MULTISTEP[formula]))]
            terms = zip(MULTISTEP[formula], rates, strict=True)
            yield _advanced(stepped_of(state), state, terms, step_s)
            done.add(state.word)
    for formula in RUNGE_KUTTA:
        own = [state for state in program.states if formulas[state.word] == formula]
        if own:
            yield from _runge_kutta(formula, own, program, step_s, frozenset(done))
            done |= {state.word for state in own}


def _runge_kutta(
    formula: str, own: Sequence[State], program: Program, step_s: float, done: frozenset[str]
) -> Iterator[Statement]:
    """The states `own` at each stage, what depends on them there, and their step."""
    tableau = RUNGE_KUTTA[formula]
    changing = changing_words(program, own)
    rates = {state.word: [rate_of(state.word)] for state in own}
    for number, weights in enumerate(tableau.stages, start=2):

        def at_stage(name: str, number: int = number) -> str:
            return f"{name} at {number}"

        for state in program.states:
            if state.word in rates:
                terms = list(zip(weights, rates[state.word], strict=True))
                yield _advanced(at_stage(state.word), state, terms, step_s)
            elif state.word in done:
                yield _between(at_stage(state.word), state, sum(weights), step_s)
            else:
                straight = [(sum(weights), rate_of(state.word))]
                yield _advanced(at_stage(state.word), state, straight, step_s)
        moved = {name: at_stage(name) for name in (*changing, *(s.word for s in program.states))}
        for assignment in program.assignments:
            if assignment.word in changing:
                expr = renamed(assignment.expr, moved)
                yield Statement(at_stage(assignment.word), expr, assignment.word)
        for state in own:
            if names(state.expr) & moved.keys():
                rate = at_stage(rate_of(state.word))
                yield Statement(rate, renamed(state.expr, moved), state.word)
                rates[state.word].append(rate)
            else:
                rates[state.word].append(rate_of(state.word))
    for state in own:
        terms = list(zip(tableau.weights, rates[state.word], strict=True))
        yield _advanced(stepped_of(state), state, terms, step_s)


def changing_words(program: Program, states: Sequence[State]) -> frozenset[str]:
    """Words between states and the rates of these: computed again at every stage."""
    moving = {state.word for state in program.states}
    for assignment in program.assignments:  # in the order in which they depend on each other
        if names(assignment.expr) & moving:
            moving.add(assignment.word)
    needed = set[str]().union(*(names(state.expr) for state in states))
    for assignment in reversed(program.assignments):
        if assignment.word in needed:
            needed |= names(assignment.expr)
    return frozenset(a.word for a in program.assignments if a.word in needed & moving)


def _advanced(
    name: str,
    state: State,
    terms: Iterator[tuple[float, str]] | list[tuple[float, str]],
    step_s: float,
) -> Statement:
    """name = state + sum of step * weight * rate; the sum first, as it is the smaller part."""
    total: Node | None = None
    for weight, rate in terms:
        if weight * step_s:
            term = Binary("*", Number(weight * step_s), Name(rate))
            total = Binary("+", total, term) if total else term
    expr = Binary("+", Name(state.word), total) if total else Name(state.word)
    return Statement(name, expr, state.word)


def _between(name: str, state: State, part: float, step_s: float) -> Statement:
    """The state after a part of its step, on the parabola: x + c (1 - c) h f + c^2 (next - x)."""
    word, rate = Name(state.word), Name(rate_of(state.word))
    whole = Binary("*", Number(part**2), Binary("-", Name(stepped_of(state)), word))
    start = Binary("*", Number(part * (1.0 - part) * step_s), rate)
    moved = whole if part == 1.0 else Binary("+", start, whole)
    return Statement(name, Binary("+", word, moved), state.word)
