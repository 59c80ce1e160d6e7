"""The digital program as a linear map, found by playing its tape on linear forms.

Stage 4.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hybrid.errors import NOWHERE, Place, RunError, known_as
from hybrid.expressions import FUNCTIONS, OPERATORS
from hybrid.machine import Floats
from hybrid.memo import KeptBySize
from hybrid.tape import BINARY_OPS, FIRST_WIDE, FUNCTION_OPS, Memory, Op, Tape


class NotLinear(RunError):
    """The patch has no exact linear prediction; the text says which part is not linear, and where."""

    def __init__(self, message: str, place: Place = NOWHERE) -> None:
        """Args: message (one line), place of the statement (shown before it where known)."""
        self.message, self.place = message, place
        super().__init__(f"{place}: {message}" if str(place) else message)


def brief(reason: RunError) -> str:
    """Why there is no prediction, for a remark: files of patches without their folders."""
    place = getattr(reason, "place", NOWHERE)
    if not (isinstance(reason, NotLinear) and str(place)):
        return str(reason)
    return f"{place.brief}: {reason.message}"


class NeverFinite(NotLinear):
    """A word has no finite value, whatever the program reads."""


COMPUTE: dict[Op, Callable[..., float]] = {
    op: OPERATORS[symbol] for symbol, op in BINARY_OPS.items()
}
COMPUTE |= {op: FUNCTIONS[name].compute for name, op in FUNCTION_OPS.items()}
COMPUTE[Op.NOT] = operator.not_
ARGUMENTS = dict.fromkeys(BINARY_OPS.values(), 2) | {Op.NOT: 1}
ARGUMENTS |= {op: FUNCTIONS[name].fewest for name, op in FUNCTION_OPS.items()}
# A delay of more cycles would make matrices that take minutes.
MOST_REMEMBERED = 1000
# Numbers of the programs that are kept (8 MB), and what each takes with its tape.
MOST_KEPT, KEPT_BESIDE = 10**6, 500
SUMS = (Op.ADD, Op.SUB, Op.MUL)  # which have no finite value only where numbers end
CHANGE = "change the parameters or constants that make it so"


@dataclass(frozen=True, eq=False)
class LinearProgram:
    """One cycle as matrices over inputs = [ADC words, remembered values, words of other programs, 1]."""

    rows: Floats  # (words, inputs): the words
    keep: Floats  # (remembered, inputs): what is remembered for the next cycle
    adcs: int
    takes_over: npt.NDArray[
        np.int64
    ]  # (remembered,): the word whose value it is, sooner or later, or -1
    states: npt.NDArray[np.int64]  # (states,): which of what is remembered they are
    rates: Floats  # (states, inputs)
    shared: npt.NDArray[
        np.int32
    ]  # (shared,): the word of another program that each further input is

    def steady(self) -> tuple[Floats, Floats]:
        """Words, and the rates of the states, for inputs that stay as they are.

        Arrays (words, free) and (states, free) over free = [ADC words, states, 1]. Rates of the past
        have no part in them: this is for a program whose step is 0.

        Raises NotLinear where there is no such steady answer (the program integrates by itself).
        """
        first, last = self.adcs, self.rows.shape[1] - 1
        free = [*range(first), *(first + self.states), last]
        taken = np.concatenate([self.takes_over, self.shared])
        delayed = np.flatnonzero(taken >= 0)
        back, words = self.rows[:, first + delayed], np.eye(len(self.rows))
        taken = taken[delayed]
        for column, word in enumerate(taken):
            words[:, word] -= back[:, column]
        if len(words) and np.linalg.cond(words) > 1e12:
            raise NotLinear("the program integrates, so it has no steady answer")
        solved: Floats = np.linalg.solve(words, self.rows[:, free]).astype(np.float64)
        return solved, self.rates[:, free] + self.rates[:, first + delayed] @ solved[taken]


def linear_program(tape: Tape, adcs: int) -> LinearProgram:
    """Play the tape on linear forms instead of numbers; raises NotLinear naming the word."""
    return _kept.of([(tape, adcs)], lambda _: [_played(tape, adcs)])[0]


# A prediction asks for it twice: for the map, and to tell which closed form applies.
_kept: KeptBySize[tuple[Tape, int], LinearProgram] = KeptBySize(
    MOST_KEPT, lambda program: program.rows.size + program.keep.size + KEPT_BESIDE
)


def _played(tape: Tape, adcs: int) -> LinearProgram:
    lengths = tape.memory[:, Memory.LENGTH].astype(np.int64)
    remembered = int(np.sum(lengths + 1))
    if remembered > MOST_REMEMBERED:
        raise NotLinear(
            f"the program remembers {remembered} values; an exact prediction takes at most "
            f"{MOST_REMEMBERED}"
        )
    width = adcs + remembered + len(tape.shared) + 1
    unit = np.eye(width)
    forms = np.zeros((len(tape.registers), width))
    forms[:, -1] = tape.registers
    forms[:adcs] = unit[:adcs]
    # Each delay has columns of its own, in the order in which their values come out.
    firsts = adcs + np.cumsum(lengths + 1) - (lengths + 1)
    forms[tape.memory[:, Memory.KEEPS]] = unit[firsts]
    forms[tape.shared[:, 0]] = unit[adcs + remembered : -1]
    forms[list(tape.starting)] = 0.0  # after the first cycles
    _play(tape, forms)
    word_of = {register: i for i, register in enumerate(tape.word_registers.tolist())}
    keep = np.eye(remembered, width, k=adcs + 1)  # each takes over the next one of its delay
    keep[firsts + lengths - adcs] = forms[tape.memory[:, Memory.SOURCE]]
    sources = [word_of.get(register, -1) for register in tape.memory[:, Memory.SOURCE].tolist()]
    takes_over = np.repeat(np.array(sources, dtype=np.int64), lengths + 1)
    column_of = dict(
        zip(tape.memory[:, Memory.KEEPS].tolist(), (firsts - adcs).tolist(), strict=True)
    )
    states = np.array(
        [column_of[register] for register in tape.states[:, 0].tolist()], dtype=np.int64
    )
    rates, shared = forms[tape.states[:, 1]], tape.shared[:, 1]
    return LinearProgram(forms[tape.word_registers], keep, adcs, takes_over, states, rates, shared)


def _play(tape: Tape, forms: Floats) -> None:
    """Do the operations of a cycle on the forms of the registers."""
    code, at = tape.code.tolist(), 0
    while at < len(code):
        op, target, a, b = code[at]
        with np.errstate(over="ignore", invalid="ignore"):
            form = _operation(op, forms[target], forms[a], forms[b])
        word, place = known_as(tape.words[tape.owner[at]]), tape.places[tape.owner[at]]
        if form is None:
            kind, why = _why_not(op, forms[b])
            raise kind(f"word {word!r} {why}", place)
        if not np.all(np.isfinite(form)):
            kind, why = _why_not_finite(op, forms[a], forms[b])
            raise kind(f"word {word!r} {why}", place)
        forms[target] = form
        at += 1 + (int(forms[b, -1]) if op == Op.SKIP and form[-1] == 0.0 else 0)


def _operation(op: int, held: Floats, a: Floats, b: Floats) -> Floats | None:
    """The form that an operation gives; None where it is not linear."""
    constant_a, constant_b = not np.any(a[:-1]), not np.any(b[:-1])
    if op == Op.COPY or (op == Op.SKIP and constant_a):
        return a
    if op == Op.NEG:
        return -a
    if op == Op.ADD:
        return a + b
    if op == Op.SUB:
        return a - b
    if op == Op.MUL and (constant_a or constant_b):
        product: Floats = a * b[-1] if constant_b else b * a[-1]
        return product
    if op == Op.DIV and constant_b and b[-1] != 0.0:
        quotient: Floats = a / b[-1]
        return quotient
    if op == Op.POW and constant_b and b[-1] == 1.0:
        return a
    if op == Op.SELECT and not np.any(held[:-1]):
        return a if held[-1] != 0.0 else b
    if op >= FIRST_WIDE:
        return None
    operands = (held, a, b) if op >= Op.SELECT else (a, b)[: ARGUMENTS[Op(op)]]
    if not any(np.any(operand[:-1]) for operand in operands):
        return _constant(Op(op), [operand[-1].item() for operand in operands], len(a))
    return None


def _is_zero(form: Floats) -> bool:
    return not np.any(form)


def _why_not(op: int, b: Floats) -> tuple[type[NotLinear], str]:
    """Why an operation has no form."""
    if op == Op.DIV and _is_zero(b):
        return NeverFinite, f"divides by 0 in every cycle; {CHANGE}"
    return NotLinear, "is not linear in what the program reads"


def _why_not_finite(op: int, a: Floats, b: Floats) -> tuple[type[NotLinear], str]:
    """Why the form of an operation is not finite: what it was given, or that it is too large."""
    if op == Op.DIV and _is_zero(b):
        return NeverFinite, f"divides by 0 in every cycle; {CHANGE}"
    operands = (a, b)[: ARGUMENTS.get(Op(op), 0)]
    if operands and op not in SUMS and not any(np.any(form[:-1]) for form in operands):
        listed = ", ".join(f"{form[-1]:g}" for form in operands)
        told = f"has no finite value in any cycle: {Op(op).name.lower()}({listed}); {CHANGE}"
        return NeverFinite, told
    return NotLinear, f"has a coefficient that is not finite; {CHANGE}"


def _constant(op: Op, operands: list[float], width: int) -> Floats:
    """The form of a constant that is computed from others."""
    form = np.zeros(width)
    try:
        form[-1] = COMPUTE[op](*operands)
    except (ArithmeticError, ValueError):
        form[-1] = np.nan
    return form
