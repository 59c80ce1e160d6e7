"""What word lengths make of the constants and initial values of a program, where little is left of them.

Stage 3. A constant of a short word, or an initial value far below the step of a fixed-point one, is
another number to the machine than was written. That is no mistake, but it must not be silent.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from hybrid.errors import Place, known_as
from hybrid.expressions import (
    Binary,
    Call,
    ExpressionError,
    LookUp,
    Node,
    Unary,
    evaluate,
    is_known,
)
from hybrid.machine import Machine
from hybrid.patch import Assignment, Program, WordSettings
from hybrid.wordlength import FLOAT64, Kind, WordLength

# Less than one part in a hundred is what short words are for.
MOST_LOST = 0.01
MOST_NAMED = 3


def word_lengths(program: Program | None, scope: Mapping[str, float]) -> dict[str, WordLength]:
    """The length of every word and state, in numbers."""
    if program is None:
        return {}
    usual = program.word.bound(scope)
    own = {word: settings.bound(scope) for word, settings in program.lengths.items()}
    return {word: own.get(word, usual) for word in program.words}


def lost_constants(machine: Machine) -> tuple[str, ...]:
    """A line for every constant and first value that its word length changes by more than MOST_LOST."""
    program, scope = machine.patch.program, machine.parameters
    if program is None or (program.word == WordSettings() and not program.lengths):
        return ()
    found = dict[str, None]()
    for word, length in word_lengths(program, scope).items():
        if length == FLOAT64:
            continue
        for value, held, place, what in _held(program, word, length, scope):
            if abs(held - value) > MOST_LOST * abs(value):
                where = f"{place}: " if str(place) else ""
                found[
                    f"{where}{what} of {known_as(word)!r} is {value:g}, which its word holds as {held:g}"
                ] = None
    return tuple(found)


def roundoff_text(machine: Machine) -> str:
    """The same for the note of a run; ''."""
    lost = lost_constants(machine)
    more = f"; and {len(lost) - MOST_NAMED} more" if len(lost) > MOST_NAMED else ""
    return "; ".join(lost[:MOST_NAMED]) + more


def _held(
    program: Program, word: str, length: WordLength, scope: Mapping[str, float]
) -> Iterator[tuple[float, float, Place, str]]:
    """What is written for a word, what it holds of it (SI), where, and what it is."""
    entry = next(entry for entry in program.written if entry.word == word)
    for expr in entry.reads:
        for value in _constants(expr, scope):
            yield value, length.constant(value), entry.place, "a constant"
        is_whole = isinstance(entry, Assignment) and is_known(expr, scope)
        if is_whole and length.kind is Kind.FIXED:
            value = evaluate(expr, scope)
            yield value, _stored(length, value), entry.place, "the value"
    firsts = {state.word: state.initial for state in program.states} | dict(program.remember)
    if word in firsts:
        value = firsts[word].number(scope)
        yield value, _stored(length, value), firsts[word].place, "the first value"


def _stored(length: WordLength, value: float) -> float:
    """A value as a word holds it; one that does not fit is told elsewhere."""
    try:
        return length.stored(value)
    except OverflowError:
        return value


def _constants(node: Node, scope: Mapping[str, float]) -> Iterator[float]:
    """What is known of an expression before the run: its largest parts of parameters alone."""
    if is_known(node, scope):
        try:
            yield evaluate(node, scope)
        except ExpressionError:  # in a branch that is not taken
            return
        return
    match node:
        case Unary(_, operand):
            yield from _constants(operand, scope)
        case Binary(op, left, right):
            if op not in ("<", "<=", ">", ">=", "==", "!="):  # which do not round
                yield from _constants(left, scope)
                yield from _constants(right, scope)
        case LookUp(_, arguments):
            for argument in arguments:
                yield from _constants(argument, scope)
        case Call(name, arguments) if name not in ("previous", "next"):
            for argument in arguments:
                yield from _constants(argument, scope)
        case _:
            return
