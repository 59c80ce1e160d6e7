"""The digital program as a linear map, found by playing its tape on linear forms.

Stage 4.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hybrid.errors import NOWHERE, Place, RunError
from hybrid.machine import Floats
from hybrid.tape import Op, Tape


class NotLinear(RunError):
    """The patch has no exact linear prediction; the text says which part is not linear, and where."""

    def __init__(self, message: str, place: Place = NOWHERE) -> None:
        """Args: message (one line), place of the statement (shown before it where known)."""
        self.message, self.place = message, place
        super().__init__(f"{place}: {message}" if str(place) else message)


@dataclass(frozen=True, eq=False)
class LinearProgram:
    """words = inputs @ [ADC words, remembered values, 1], shape (words, adcs + memory + 1)."""

    rows: Floats
    adcs: int
    memory: npt.NDArray[np.int64]  # word that each remembered value takes over

    def steady(self) -> Floats:
        """Words for inputs that stay as they are, (words, adcs + 1).

        Raises NotLinear where there is no such steady answer (the program integrates).
        """
        back = self.rows[:, self.adcs : -1]
        words = np.eye(len(self.rows))
        for column, word in enumerate(self.memory):
            words[:, word] -= back[:, column]
        direct = np.delete(self.rows, np.s_[self.adcs : self.rows.shape[1] - 1], axis=1)
        if len(words) and np.linalg.cond(words) > 1e12:
            raise NotLinear("the program integrates, so it has no steady answer")
        solved: Floats = np.linalg.solve(words, direct).astype(np.float64)
        return solved


# A prediction asks for it twice: for the map, and to tell which closed form applies.
@functools.lru_cache(maxsize=8)
def linear_program(tape: Tape, adcs: int) -> LinearProgram:
    """Play the tape on linear forms instead of numbers; raises NotLinear naming the word."""
    width = adcs + len(tape.remembered) + 1
    forms = np.zeros((len(tape.registers), width))
    forms[:, -1] = tape.registers
    for adc in range(adcs):
        forms[adc] = np.eye(width)[adc]
    for column, (register, _) in enumerate(tape.memory):
        forms[register] = np.eye(width)[adcs + column]
    for (op, target, a, b), owner in zip(tape.code.tolist(), tape.owner, strict=True):
        with np.errstate(over="ignore", invalid="ignore"):
            form = _linear_operation(op, forms[a], forms[b])
        word, place = tape.words[owner], tape.places[owner]
        if form is None:
            raise NotLinear(f"word {word!r} is not linear in what the program reads", place)
        if not np.all(np.isfinite(form)):
            raise NotLinear(f"word {word!r} has a coefficient that is not finite", place)
        forms[target] = form
    word_of = {register: i for i, register in enumerate(tape.word_registers.tolist())}
    memory = np.array([word_of[r] for r in tape.memory[:, 1].tolist()], dtype=np.int64)
    return LinearProgram(forms[tape.word_registers], adcs, memory)


def _linear_operation(op: int, a: Floats, b: Floats) -> Floats | None:
    """The form that an operation gives; None where it is not linear."""
    constant_a, constant_b = not np.any(a[:-1]), not np.any(b[:-1])
    if op == Op.COPY:
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
    return None
