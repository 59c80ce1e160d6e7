"""The largest cycle time whose modes all keep their damping within a given error.

Stage 7.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from hybrid import coupling
from hybrid.arguments import finite_number
from hybrid.compiler import compile_patch
from hybrid.coupling import Mode
from hybrid.errors import RunError, shown
from hybrid.expressions import Name, names, to_text
from hybrid.machine import Machine
from hybrid.scale import to_seconds

# The search starts where a compute time in seconds is this many cycles.
DEEPEST_SEARCHED = 20
# ... and goes up by this factor, so that it takes some eighty steps to the longest one.
STEP = 1.2
# T is compared with far less of a mode's time: what it moves there by less than MOVED it never moves.
LITTLE = 1e-2
MOVED = 1e-8
# The damping ratio of what neither grows nor falls is rounding.
NO_GROWTH = 1e-9


def damping_error_of(value: float) -> float:
    """A permitted error of the damping ratio; raises RunError for what is none."""
    error = finite_number(value)
    if error is None or error <= 0:
        raise RunError(f"the damping-ratio error must be above 0 and finite, not {shown(value)}")
    return error


def largest_cycle_s(machine: Machine, max_damping_error: float) -> float | None:
    """The first T found beyond which a damping ratio is off by more than the given error.

    Steps up by a fifth from a T far below any mode until the error is exceeded, then bisects to 1e-12
    of T. So the error is kept at the T given and at every step below it, and exceeded just above.
    Between two steps it is not looked at: an excursion that has come back within a fifth of T would be
    missed. A mode counts as long as there are two samples in its ideal's period, 2 pi / omega: one
    that is faster is over between two samples, and then counts by what it grows. One that grows without
    being nearest to an ideal one is an error without bound. None where no step exceeds the error as
    long as a mode counts that T moves. Raises RunError where the patch has no digital machine or no
    ideal oscillation to compare with, or where lags alone exceed the error.
    """
    max_damping_error = damping_error_of(max_damping_error)
    if not machine.timing.period:
        raise RunError("the patch has no digital machine, so no cycle time to find")
    if machine.timing.tasks:
        periods = [f"{task.name}.period" for task in machine.timing.tasks if task.period]
        raise RunError(
            "the patch has tasks, each with a period of its own, so there is no one T to find; sweep "
            f"one instead: --over NAME=START:STOP:COUNT with {' or '.join(periods)}"
        )
    fastest = max(
        (m.omega_ideal for m in coupling.modes(machine) if m.omega_ideal > 0), default=0.0
    )
    if not fastest > 0:
        raise RunError("the patch has no ideal mode to compare the damping ratio with")
    error, shortest = _damping_error(machine), _shortest_cycle_s(machine, 1e-6 / fastest)
    if math.isinf(error(shortest)):
        raise RunError(
            f"even at T = {shortest:.3g} s a mode grows that is not meant, say of what the program "
            "remembers; no cycle time and no larger error cure that"
        )
    if error(shortest) > max_damping_error:
        raise RunError(
            f"even at T = {shortest:.3g} s the damping-ratio error is {error(shortest):.3g}"
            f"{_why_not_less(machine, shortest, fastest)}"
        )
    longest = math.pi / _slowest_moved(machine, shortest)
    low = shortest
    while error(low * STEP) <= max_damping_error:
        low *= STEP
        if low > longest:
            return None
    return _bisected(error, max_damping_error, low, low * STEP)


def why_it_ends(machine: Machine, longest_s: float | None) -> tuple[str, ...]:
    """That just above the largest T a mode grows that is not meant, if one does."""
    if longest_s is None or not math.isinf(_damping_error(machine)(longest_s * (1.0 + 1e-6))):
        return ()
    return ("beyond this T a mode grows that is not meant, whatever error is allowed",)


def what_follows(machine: Machine, asked: bool) -> tuple[str, ...]:
    """What a reader of the ideal, and where `asked` of the largest T, has to know of what does not
    follow T with the period."""
    program, notes = machine.patch.program, []
    if program is None or program.period is None or program.tasks:
        return ()
    expr = program.period.expr
    if not isinstance(expr, Name) and (asked or names(expr)):
        notes.append(
            f"the period is {to_text(expr)}, so the ideal and other T change it alone: what is to "
            "follow T (a lead, a compute time) does so where the period is a parameter, as in period: "
            "cycle, and that is used"
        )
    if asked and program.compute_time and not program.counted:
        doubled = coupling.with_period(machine.patch, machine.overrides, 2.0 * machine.cycle_s)
        scopes = machine.parameters, doubled[0].bind(doubled[1])
        before_s, after_s = (program.compute_time.number(scope) for scope in scopes)
        if before_s == after_s > 0.0:
            notes.append(f"the compute time stays {before_s:.6g} s at every T")
    return tuple(notes)


def _bisected(error: Callable[[float], float], most: float, low: float, high: float) -> float:
    """The T between two at which the error passes `most`, to 1e-12."""
    while high / low - 1.0 > 1e-12:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if error(middle) <= most else (low, middle)
        if middle in (low, high) and high / low - 1.0 < 4e-16:
            break
    return low


def _slowest_moved(machine: Machine, shortest_s: float) -> float:
    """The lowest ideal frequency of the modes that T moves; of all, where it moves none."""
    before = _by_ideal(_modes_at(machine, shortest_s))
    moved = []
    for i, mode in enumerate(before):
        at = _modes_at(machine, max(LITTLE / mode.omega_ideal, 2.0 * shortest_s))
        after = _by_ideal(at)
        if i >= len(after) or abs(after[i].s - mode.s) > MOVED * mode.omega_ideal:
            moved.append(mode.omega_ideal)
    return min(moved or [mode.omega_ideal for mode in before])


def _by_ideal(modes: tuple[Mode, ...]) -> list[Mode]:
    """Those with an ideal to compare with, the slowest first."""
    meant = [mode for mode in modes if mode.omega_ideal > 0]
    return sorted(meant, key=lambda m: (m.omega_ideal, m.zeta_ideal, m.omega, m.zeta))


def _damping_error(machine: Machine) -> Callable[[float], float]:
    """The error as a function of T, see `largest_cycle_s`."""

    def error(period_s: float) -> float:
        try:
            found = _modes_at(machine, period_s)
        except RunError:
            return math.inf
        if any(math.isnan(m.omega_ideal) and m.zeta < -NO_GROWTH for m in found):
            return math.inf  # a mode grows that nobody meant
        errors = [_error_of(mode, period_s) for mode in found if mode.omega_ideal > 0]
        return max(errors, default=math.inf)

    return error


def _error_of(mode: Mode, period_s: float) -> float:
    if mode.omega_ideal * period_s <= math.pi:
        return abs(mode.zeta - mode.zeta_ideal)
    meant = max(-mode.zeta_ideal * mode.omega_ideal, 0.0)
    return max(mode.s.real - meant, 0.0) / mode.omega_ideal


def _modes_at(machine: Machine, period_s: float) -> tuple[Mode, ...]:
    patch, overrides = coupling.with_period(machine.patch, machine.overrides, period_s)
    return coupling.modes(compile_patch(patch, overrides, machine.preset, machine.serial))


def _why_not_less(machine: Machine, shortest_s: float, fastest: float) -> str:
    """What keeps the damping-ratio error of the shortest cycle from vanishing."""
    stages = machine.stages.values()
    if (
        any(stage.tau > 0 or stage.gain != 1.0 for stage in stages)
        or shortest_s * fastest > 1.001e-6
    ):
        return ": lags, gain errors, and compute and conversion times in seconds alone exceed it"
    return "; shorter ones are not tried, as rounding comes to rule there; ask for a larger error"


def _shortest_cycle_s(machine: Machine, period_s: float) -> float:
    """`period_s`, or more where compute and conversion times in seconds do not shrink with it."""
    patch, overrides = coupling.with_period(machine.patch, machine.overrides, period_s)
    scope, possible_s = patch.bind(overrides), [period_s]
    if patch.program and patch.program.compute_time:
        compute_s = patch.program.compute_time.number(scope) * machine.time_scale
        possible_s.append(compute_s / DEEPEST_SEARCHED)
    if patch.program and patch.program.counted:
        possible_s.append(to_seconds(machine.timing.compute) / DEEPEST_SEARCHED)
    for adc in patch.adcs:
        conversion_s = adc.conversion_time.number(scope) if adc.conversion_time else 0.0
        conversion_s *= machine.time_scale
        if conversion_s >= period_s:  # an ADC must be done before its next sample
            possible_s.append(1.01 * conversion_s)
    return max(possible_s)
