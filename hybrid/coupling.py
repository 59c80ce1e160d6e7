"""What the coupling does to the modes of a patch: eigenvalues z of the exact map of one stretch, a cycle
or what several tasks do until they are where they were, give the modes s = ln(z) / H.

Stage 6. Beside each stands the ideal: no lag, no errors, no converters, T -> 0.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.components import CATALOG
from hybrid.cycle_map import CycleMap, cycle_maps, in_operation, stretch_s, without
from hybrid.eigenvalues import FORGOTTEN, Complex, eigenvalues
from hybrid.errors import HybridError, counted
from hybrid.expressions import Name
from hybrid.layout import build_analog
from hybrid.linearity import NotLinear, linear_program
from hybrid.machine import Analog, Floats, Machine, OutputStage
from hybrid.memo import KeptByUse
from hybrid.patch import Patch, RunSettings, WordSettings, literal
from hybrid.scale import to_seconds
from hybrid.taping import build_tape
from hybrid.together import attempt, only, passed_on

MOST_NAMED = 3  # of modes that are over within a stretch


@dataclass(frozen=True, slots=True)
class Mode:
    """One mode s: undamped |s|, damped |Im s| in rad/s, zeta = -Re s / |s|; the ideal beside it."""

    omega: float
    omega_damped: float
    zeta: float
    omega_ideal: float
    zeta_ideal: float

    @property
    def s(self) -> complex:
        """The mode itself, upper half plane."""
        return complex(-self.zeta * self.omega, self.omega_damped)


# -- the exact modes --------------------------------------------------------------------------------


def exact_modes(machine: Machine) -> Complex:
    """Every mode s of the patch as the machine plays it, in rad/s (complex); forgotten ones left out."""
    return only(exact_modes_of_each([machine]))


def exact_modes_of_each(machines: Sequence[Machine]) -> list[Complex | HybridError]:
    """The same of each machine, or why there is no exact prediction; alike ones at once."""
    return passed_on([attempt(_predictable, machine) for machine in machines], _exact_modes)


def _predictable(machine: Machine) -> Machine:
    """The machine in operation; raises NotLinear where it is not linear there."""
    machine = in_operation(machine)
    for task in machine.timing.tasks:
        if task.when:
            what = (
                f"task {task.name!r} begins when {task.when[0]} switches, so there is no exact map"
            )
            raise NotLinear(what, task.place)
    if machine.elements:
        raise not_linear(machine)
    return machine


def _exact_modes(machines: list[Machine]) -> list[Complex | HybridError]:
    analog = [m.analog for m in machines if not m.timing.period]
    of_analog = iter(eigenvalues([without(a.a, a.sources) for a in analog]))
    maps = cycle_maps([machine for machine in machines if machine.timing.period])
    of_maps = iter(passed_on(maps, _modes_of_maps))
    return [next(of_maps if machine.timing.period else of_analog) for machine in machines]


def _modes_of_maps(maps: list[CycleMap]) -> list[Complex | HybridError]:
    """s = ln(z) / H of each map over a stretch of length H."""
    found = eigenvalues([change for change, _ in maps], shifted=True)
    # What is polished to z = 0 itself is a result passing through.
    shifts = [s if isinstance(s, HybridError) else s[s != -1.0] for s in found]
    return [
        s if isinstance(s, HybridError) else s / to_seconds(ticks)
        for s, (_, ticks) in zip(passed_on(shifts, _log_one_plus), maps, strict=True)
    ]


def _log_one_plus(shifts: list[Complex]) -> list[Complex]:
    """ln(1 + shift), keeping the small real part of a slow mode; elsewhere the plain logarithm."""
    shift = np.concatenate([np.zeros(0, dtype=complex), *shifts])
    slow = np.abs(shift) < 0.5
    near = np.where(slow, shift, 0.0)
    real = 0.5 * np.log1p(near.real * (2.0 + near.real) + near.imag**2)
    far = np.log(np.abs(np.where(slow, 1.0, 1.0 + shift)))
    logarithm: Complex = real + far + 1j * np.angle(1.0 + shift)
    edges = itertools.pairwise(itertools.accumulate(map(len, shifts), initial=0))
    return [logarithm[a:b] for a, b in edges]


def not_linear(machine: Machine) -> NotLinear:
    """Which component stands in the way of an exact prediction."""
    for component in sorted(machine.patch.components, key=lambda c: c.place.line):
        if not CATALOG[component.kind].linear_with(component.values):
            what = f"component {component.name!r} ({component.kind}) is not linear"
            return NotLinear(what, component.place)
    return NotLinear("its outputs saturate")


# -- the ideal patch ------------------------------------------------------------------------------


def ideal_modes(patch: Patch, overrides: Mapping[str, float]) -> Complex:
    """Modes with no lag, no errors, no converters and T -> 0: what the patch is meant to do.

    A parameter that is a period is set to 0, so that a lead of 1.5 T vanishes with T.
    Raises NotLinear where there is no such limit.
    """
    periods = patch.program.periods if patch.program else ()
    vanish = {period.expr.id: 0.0 for period in periods if isinstance(period.expr, Name)}
    if vanish:
        try:
            return _ideal(patch, patch.bind({**overrides, **vanish}))
        except HybridError:  # something is divided by the period: keep it as it is
            pass
    return _ideal(patch, patch.bind(overrides))


def ideal_analog(patch: Patch, scope: Mapping[str, float]) -> Analog:
    """The analog side alone, every component perfect."""
    return _ideal_analog(scope, patch)


def _all_perfect(scope: Mapping[str, float], patch: Patch) -> Analog:
    perfect = {part.name: OutputStage() for part in patch.analog_parts}
    return build_analog(patch, scope, perfect)[0]


# T has no part in it.
_ideal_analog = KeptByUse(_all_perfect)


def _ideal(patch: Patch, scope: Mapping[str, float]) -> Complex:
    return _ideal_once(patch, tuple(sorted(scope.items())))


# The ideal does not change with T, so a sweep of T asks for the same one again and again.
@functools.lru_cache(maxsize=64)
def _ideal_once(patch: Patch, bound: tuple[tuple[str, float], ...]) -> Complex:
    scope = dict(bound)
    analog = ideal_analog(patch, scope)
    a = analog.a
    if patch.program:
        b, c, d = converter_paths(patch, analog)
        adcs = tuple(sorted(adc.name for adc in patch.adcs))
        perfect = replace(patch.program, word=WordSettings(), lengths={})
        steps_s = [0.0] * len(perfect.programs)
        program = linear_program(build_tape(perfect, adcs, scope, steps_s), len(adcs))
        words, rates = program.steady()
        sampled, integrated = np.s_[: len(adcs)], np.s_[len(adcs) : -1]
        loop = np.eye(len(words)) - words[:, sampled] @ d
        if len(loop) and np.linalg.cond(loop) > 1e12:
            raise NotLinear("the ideal loop has no delay and a gain of exactly 1")
        # Words from [analog states, the program's states], with what the ADCs read put in.
        drive = np.linalg.solve(loop, np.hstack([words[:, sampled] @ c, words[:, integrated]]))
        reading = np.hstack([c, np.zeros((len(c), len(rates)))]) + d @ drive
        change = rates[:, sampled] @ reading
        change[:, len(a) :] += rates[:, integrated]
        a = np.vstack([np.hstack([a, np.zeros((len(a), len(rates)))]) + b @ drive, change])
    return only(eigenvalues([without(a, analog.sources)]))


def converter_paths(patch: Patch, analog: Analog) -> tuple[Floats, Floats, Floats]:
    """(B, C, D) from program words to states, states to ADC words, words to ADC words; SI figures."""
    n = len(analog.states)
    words = list(patch.program.words) if patch.program else []
    scale = dict(zip(analog.signals, analog.full_scale.tolist(), strict=True))
    drive = np.zeros((len(analog.inputs), len(words)))
    for dac in patch.dacs:
        drive[analog.inputs.index(dac.name), words.index(dac.word)] = 1.0 / scale[dac.name]
    adcs = sorted(patch.adcs, key=lambda adc: adc.name)
    rows = [analog.c[analog.signals.index(adc.source)] * scale[adc.source] for adc in adcs]
    read = np.array(rows).reshape(len(adcs), n + len(analog.inputs))
    return analog.b @ drive, read[:, :n], read[:, n:] @ drive


# -- modes beside their ideals ----------------------------------------------------------------------


def modes(machine: Machine) -> tuple[Mode, ...]:
    """The modes that the patch is meant to have, as the machine plays them, slowest first.

    Those that are over within a stretch, a sensor's lag of 1 us beside T = 1 ms, have left no trace in
    the map and are not among them; `over_within_text` tells of them.
    Where the patch has no ideal limit, every mode is listed and the ideal figures are NaN.
    """
    return only(modes_of_each([machine]))


def modes_of_each(machines: Sequence[Machine]) -> list[tuple[Mode, ...] | HybridError]:
    """The same of each machine, or why there is no exact prediction."""
    return [
        exact if isinstance(exact, HybridError) else _beside_ideal(machine, exact.tolist())
        for machine, exact in zip(machines, exact_modes_of_each(machines), strict=True)
    ]


def _beside_ideal(machine: Machine, exact: list[complex]) -> tuple[Mode, ...]:
    try:
        ideal = ideal_modes(machine.patch, machine.overrides)
    except HybridError:  # no limit, or a loop that only lags make possible
        pairs = [(s, complex(np.nan, np.nan)) for s in exact]
    else:
        within_s = _stretch_s(machine)
        pairs = _pair(exact, [s for s in ideal.tolist() if not _is_over(s, within_s)])
        pairs += _unmeant(exact, pairs, math.log(2.0) / within_s if within_s else 0.0)
    found = [_mode(s, i) for s, i in pairs if s.imag >= 0]
    return tuple(sorted(found, key=lambda m: (m.omega, m.zeta)))


def over_within_text(machine: Machine) -> str:
    """Which meant modes are not listed as they are over within a stretch; ''."""
    within_s = _stretch_s(in_operation(machine))
    try:
        ideal = ideal_modes(machine.patch, machine.overrides).tolist()
    except HybridError:
        return ""
    over = sorted(abs(s) for s in ideal if s.imag >= 0 and _is_over(s, within_s))
    if not over:
        return ""
    shown = ", ".join(f"{omega:.6g}" for omega in over[:MOST_NAMED])
    shown += f" and {len(over) - MOST_NAMED} more" if len(over) > MOST_NAMED else ""
    until = "after which all tasks are where they were" if machine.timing.tasks else "of a cycle"
    return (
        f"{counted(len(over), 'mode')} of the ideal with omega {shown} rad/s left out: less than "
        f"{FORGOTTEN:g} of it is left of a motion after the {within_s:.6g} s {until}, so the exact map "
        "has no trace of it"
    )


def _is_over(s: complex, within_s: float) -> bool:
    """Whether a mode leaves no trace in the map of a stretch of this length."""
    return -s.real * within_s >= -math.log(FORGOTTEN)


def _stretch_s(machine: Machine) -> float:
    """What repeats takes so long; 0 without a digital machine."""
    timing = machine.timing
    if not timing.period:
        return 0.0
    return stretch_s(machine) if timing.tasks else to_seconds(timing.period)


def _unmeant(
    exact: list[complex], pairs: list[tuple[complex, complex]], lasting: float
) -> list[tuple[complex, complex]]:
    """Modes that nobody meant and that matter: those that grow, that last from stretch to stretch, or
    are slower than a meant one. lasting: the rate, 1/s, at which a mode falls to half in a stretch; what
    is slower belongs to what the program remembers, what is faster to results that pass through."""
    taken = {mode for mode, _ in pairs}
    fastest = max((abs(ideal) for _, ideal in pairs), default=0.0)
    nothing = complex(np.nan, np.nan)
    left = [s for s in exact if s not in taken]
    return [(s, nothing) for s in left if s.real > -lasting or abs(s) < fastest]


def _pair(exact: list[complex], ideal: list[complex]) -> list[tuple[complex, complex]]:
    """Each ideal mode with the nearest exact one that no other has taken."""
    free = list(range(len(exact)))
    pairs = []
    for wanted in sorted(ideal, key=abs):
        if not free:
            break
        best = min(free, key=lambda i: abs(exact[i] - wanted))
        free.remove(best)
        pairs.append((exact[best], wanted))
    return pairs


def _mode(s: complex, ideal: complex) -> Mode:
    return Mode(abs(s), abs(s.imag), _zeta(s), abs(ideal), _zeta(ideal))


def _zeta(s: complex) -> float:
    """Damping ratio; NaN for a mode that stays where it is (s = 0)."""
    return -s.real / abs(s) + 0.0 if abs(s) > 0 else float("nan")


def with_period(
    patch: Patch, overrides: Mapping[str, float], period_s: float
) -> tuple[Patch, dict[str, float]]:
    """The same patch with another cycle time: through its parameter where it is one."""
    assert patch.program is not None
    # Nothing is run: only the clockwork of a few cycles is wanted, however long the patch's run is.
    program, run = patch.program, RunSettings(literal(100.0 * period_s))
    assert program.period is not None
    expr = program.period.expr
    if isinstance(expr, Name):
        return replace(patch, run=run), {**overrides, expr.id: period_s}
    program = replace(program, period=replace(literal(period_s), positive=True))
    return replace(patch, program=program, run=run), dict(overrides)
