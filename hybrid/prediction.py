"""predict(patch): exact modes beside the closed forms, and the largest cycle time that will do.

Stage 7, the only place outside tests and benches where the closed forms of `theory` meet the exact
modes of `coupling`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid import coupling, theory
from hybrid.arguments import Parameters, Source, machine_of
from hybrid.coupling import Mode
from hybrid.errors import HybridError
from hybrid.expressions import names, next_names, previous_names
from hybrid.graph import simple_loops
from hybrid.largest_cycle import (
    damping_error_of,
    largest_cycle_s,
    what_follows,
    why_it_ends,
)
from hybrid.linearity import LinearProgram, linear_program
from hybrid.machine import Analog, Machine
from hybrid.patch import Patch
from hybrid.theory import ClosedForm
from hybrid.together import only

if TYPE_CHECKING:
    import pandas as pd

# Two figures that should be equal and differ by rounding only.
ROUNDING = 1e-9
# Two modes that are one: where they meet, rounding of 1e-16 moves both by its root.
SAME_MODE = 1e-6


@dataclass(frozen=True, eq=False)
class Prediction:
    """Exact modes of a patch on a machine, each with the closed form that applies to it or None.

    Frequencies in rad/s, times in s of problem time.
    """

    machine: Machine
    modes: tuple[Mode, ...]  # slowest first
    closed_forms: tuple[ClosedForm | None, ...]  # one a mode
    max_cycle_s: float | None = None  # None: not asked, or no T exceeds the error
    max_damping_error: float | None = None  # None: not asked
    notes: tuple[str, ...] = ()  # what does not follow T, and modes left out

    def to_dicts(self) -> list[dict[str, Any]]:
        """One dict a mode: omega, omega_damped, zeta, omega_ideal, zeta_ideal, closed_form."""
        return [
            {
                "omega": mode.omega,
                "omega_damped": mode.omega_damped,
                "zeta": mode.zeta,
                "omega_ideal": mode.omega_ideal,
                "zeta_ideal": mode.zeta_ideal,
                "closed_form": dict(vars(form)) if form else None,
            }
            for mode, form in zip(self.modes, self.closed_forms, strict=True)
        ]

    def to_pandas(self) -> pd.DataFrame:
        """One row a mode."""
        import pandas as pd

        return pd.json_normalize(self.to_dicts())

    def __repr__(self) -> str:
        lines = [f"<Prediction {self.machine.patch.title!r} on {self.machine.preset!r}>"]
        for mode, form in zip(self.modes, self.closed_forms, strict=True):
            lines.append(
                f"  omega {mode.omega:.9g} rad/s (ideal {mode.omega_ideal:.6g}), damped "
                f"{mode.omega_damped:.9g}, zeta {mode.zeta:.9g} (ideal {mode.zeta_ideal:.6g})"
            )
            if form:
                lines.append(
                    f"    Eq. {form.equation}: omega {form.omega:.9g} rad/s, zeta {form.zeta:.9g}"
                )
        if self.max_cycle_s is not None:
            lines.append(
                f"  largest T with a damping-ratio error below {self.max_damping_error:g}: "
                f"{self.max_cycle_s:.6g} s"
            )
        lines += [f"  {note}" for note in self.notes]
        return "\n".join(lines)


def predict(
    patch: Source | Machine,
    parameters: Parameters | None = None,
    *,
    machine: str | None = None,
    serial: int | None = None,
    max_damping_error: float | None = None,
) -> Prediction:
    """Exact modes of the patch, with the closed forms beside them; nothing is run.

    Args: patch: a patch, the file or shipped name of one, or a compiled machine; parameters: SI
    numbers or texts with units; machine: preset name; serial: which machine of the make;
    max_damping_error: also find the largest cycle time whose modes all keep their damping ratio within
    this of the ideal one. Modes are listed that the patch is meant to have, and of the others those
    that grow, that last from cycle to cycle or that are slower than a meant one (with NaN as the
    ideal). Sources: eigenvalues of the exact map (`coupling`), Eqs. 2.1 to 2.3 (`theory`). Raises
    PatchError for a wrong patch, and RunError where there is no prediction: a part or the program is
    not linear, or no largest cycle time can be found.
    """
    if max_damping_error is not None:
        max_damping_error = damping_error_of(max_damping_error)
    return predict_machine(machine_of(patch, parameters, machine, serial), max_damping_error)


def predict_machine(machine: Machine, max_damping_error: float | None = None) -> Prediction:
    """The same for a compiled machine."""
    found = only(predict_each([machine]))
    asked = max_damping_error is not None
    over = coupling.over_within_text(machine)
    found = replace(found, notes=(*what_follows(machine, asked), *([over] if over else [])))
    if max_damping_error is None:
        return found
    longest = largest_cycle_s(machine, max_damping_error)
    notes = (*why_it_ends(machine, longest), *found.notes)
    return replace(found, max_cycle_s=longest, max_damping_error=max_damping_error, notes=notes)


def predict_each(machines: Sequence[Machine]) -> list[Prediction | HybridError]:
    """The prediction for each of several machines, or why there is none.

    Those of a sweep, which are alike, take little longer than one, and each is what it is alone.
    """
    return [
        found
        if isinstance(found, HybridError)
        else Prediction(machine, found, _closed_forms(found, closed_form_case(machine)))
        for machine, found in zip(machines, coupling.modes_of_each(machines), strict=True)
    ]


# -- which closed form applies ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Case:
    """A closed form of the paper that fits a patch: equation, natural frequency, its figures."""

    equation: str
    omega_p: float
    period_s: float = 0.0
    lags_s: tuple[float, ...] = ()


def closed_form_case(machine: Machine) -> Case | None:
    """The paper's case that the patch is, found from its structure; None for any other patch."""
    try:
        if machine.timing.period:
            return _sampled_case(machine)
        return _analog_case(machine)
    except (HybridError, np.linalg.LinAlgError):
        return None


def _sampled_case(machine: Machine) -> Case | None:
    """Eqs. 2.1 and 2.2: one ADC, one DAC, one cycle of computing, and in between c / s^2 or
    c (1 + 1.5 T s) / s^2."""
    timing = machine.timing
    if (
        timing.tasks
        or len(machine.samplers) != 1
        or len(machine.holders) != 1
        or timing.compute != timing.period
    ):
        return None
    if machine.samplers[0].delay_ticks or machine.samplers[0].conversion_ticks:
        return None
    program = linear_program(machine.tape, 1)
    remembered = slice(1, 1 + len(program.keep))  # its columns, after that of the one ADC
    if np.any(program.rows[machine.holders[0].word, remembered]):
        return None  # the loop remembers; what stands beside it may
    analog = coupling.ideal_analog(machine.patch, machine.parameters)
    if not len(analog.a):
        return None
    direct, first, second, *rest = _impulse_response(machine.patch, analog, program)
    if second >= 0 or abs(direct) > ROUNDING:
        return None
    omega_p, period_s = math.sqrt(-second), machine.cycle_s
    if any(abs(h) > ROUNDING * omega_p ** (k + 3) for k, h in enumerate(rest)):
        return None
    lead = first / second / period_s
    if abs(lead) < ROUNDING:
        return Case("2.1", omega_p, period_s)
    if abs(lead - 1.5) < ROUNDING:
        return Case("2.2", omega_p, period_s)
    return None


# The same at every point of a sweep of T.
@functools.lru_cache(maxsize=8)
def _impulse_response(patch: Patch, analog: Analog, program: LinearProgram) -> tuple[float, ...]:
    """Once round from the ADC to itself: the gain without delay, then the Markov parameters."""
    b, c, d = coupling.converter_paths(patch, analog)
    gain = program.rows[:, :1]
    b, d = b @ gain, d @ gain
    powers = range(len(analog.a) + 1)
    markov = [(c @ np.linalg.matrix_power(analog.a, k) @ b).item() for k in powers]
    return (d.item(), *markov)


def _analog_case(machine: Machine) -> Case | None:
    """Eq. 2.3: one loop, of two integrators and elements that only weigh, with s^2 + omega_p^2."""
    loops = simple_loops(signal_graph(machine.patch))
    if len(loops) != 1:
        return None
    analog = coupling.ideal_analog(machine.patch, machine.parameters)
    own = [i for i, state in enumerate(analog.states) if state in loops[0]]
    if len(own) != 2:
        return None
    (leak, forth), (back, other_leak) = analog.a[np.ix_(own, own)].tolist()
    if leak or other_leak or forth * back >= 0:
        return None
    lags = tuple(machine.stages[name].tau for name in loops[0])
    return Case("2.3", math.sqrt(-forth * back), lags_s=tuple(tau for tau in lags if tau > 0))


def signal_graph(patch: Patch) -> dict[str, list[str]]:
    """Which signals each signal feeds, through components, converters and the program."""
    # Words: those of models, too, and what a DAC shows ahead, which is not recorded.
    words = patch.program.words if patch.program else ()
    known = {*patch.signals, *words, *(dac.word for dac in patch.dacs)}
    feeds: dict[str, set[str]] = {name: set() for name in sorted(known)}
    for component in patch.components:
        for source in component.sources:
            feeds[source].add(component.name)
    for adc in patch.adcs:
        feeds[adc.source].add(adc.name)
    for entry in patch.program.written if patch.program else ():
        for expr in entry.reads:
            for source in (names(expr) | previous_names(expr) | next_names(expr)) & feeds.keys():
                feeds[source].add(entry.word)
    for dac in patch.dacs:
        feeds[dac.word].add(dac.name)
    return {name: sorted(targets) for name, targets in feeds.items()}


def _closed_forms(modes: tuple[Mode, ...], case: Case | None) -> tuple[ClosedForm | None, ...]:
    """The case's form beside the one mode that is it; None beside all others.

    That is the only mode meant to be s = i omega_p; and of all modes the form is nearest to it, as
    otherwise the ideal mode may have been paired with another's exact one.
    """
    form = _closed_form(case) if case else None
    if case is None or form is None or form.omega_damped is None:
        return (None,) * len(modes)
    meant = [
        mode
        for mode in modes
        if abs(mode.omega_ideal / case.omega_p - 1.0) < SAME_MODE
        and abs(mode.zeta_ideal) < SAME_MODE
    ]
    s = complex(-form.zeta * form.omega, form.omega_damped)
    moving = [mode for mode in modes if mode.omega > 0]
    nearest = min(moving, key=lambda mode: abs(mode.s - s), default=None)
    return tuple(form if meant == [mode] and mode is nearest else None for mode in modes)


def _closed_form(case: Case) -> ClosedForm | None:
    try:
        if case.equation == "2.1":
            return theory.uncompensated(case.omega_p, case.period_s)
        if case.equation == "2.2":
            return theory.lead_compensated(case.omega_p, case.period_s)
        return theory.all_analog(case.omega_p, case.lags_s)
    except ValueError:  # beyond the range of the series
        return None
