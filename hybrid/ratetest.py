"""The static check and the rate test of the integrators, as operators made them.

Stage 6, for `checks`. Operators checked a patch with the machine in its initial condition, where every
output and every integrator's rate must be what was calculated by hand, and the integrators by
themselves: all fed the same reference for a given time, after which all must stand at the same value.
See R. D. McCoy, "Method and apparatus for checking electronic analog computers", US patent 2,967,997,
and B. D. Conger, "Integrator rate test system for an analog computer", US patent 3,476,924.

By hand means: with parts that have no errors. The machine is then played for a moment, its rates are
carried back to t = 0, and both are compared. They may differ by

- what tolerances, offsets and dials make, each at its limit and all in one direction (of first order in
  each; products of them are less than that times the sum of the tolerances);
- the lags. A part of lag tau has tau y' = core - y, so that its output is off by -tau y': that is an
  offset, and acts on rates as one, from everywhere in a loop. The rate that is read is itself that of an
  output, so that its integrator's lag counts twice where the output comes back to it. While the lags
  settle, a chain of them of sum L moves what follows by h f' at most, h <= L^2, and its rate by h f''.
  An integrator with feedback, s (1 + tau s) + r = 0, shows -r x0 / sqrt(1 - 4 r tau) by its slow pole,
  -r x0 (1 + 2 r tau + 6 (r tau)^2 + ...), where 5 of the 6 come with the rates as they are shown;
- what carrying it back leaves: a cubic through four intervals errs by no more than it differs from the
  parabola through three, value and slope. Where that is as large as the rate, something runs away
  within some tens of lags, which explains nothing.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hybrid.circuits import build_circuit
from hybrid.components import CATALOG
from hybrid.elements import INTEGRATE
from hybrid.engine.rates import Start, first_rates
from hybrid.errors import PatchError
from hybrid.influence import changes, changes_of_rates
from hybrid.layout import build_analog
from hybrid.machine import Floats, Machine, OutputStage
from hybrid.patch import Component
from hybrid.scale import to_seconds
from hybrid.trial import Trial

# Layers after the start die out in so many of the longest lag: exp(-20) is 2e-9.
WAIT_LAGS = 20.0
INTERVALS = 4
# Where a part switches or passes a corner meanwhile, intervals so much shorter may end before it does.
SHORTER = 20.0
# Where nothing lags an interval lets the fastest signal move by so much, in machine units, ...
LITTLE_MU = 1e-4
# ... and where nothing moves it is this share of the run.
SHARE_OF_RUN = 1e-3
# How exactly signals are known at the ends of windows, in machine units.
EXACT_MU = 1e-11
# A rate that can be carried back leaves no more than this share of it.
MOST_LEFT = 0.1
# Kinds whose outputs do not follow their inputs within lags: what is before them shows later.
KEEPERS = frozenset({"integrate", "lag", "delay", "noise_source", "backlash", "track"})

# Kinds whose output jumps, and those whose slope does.
JUMPING = frozenset({"compare", "switch", "track", "atan2"})
CORNERED = frozenset({"function", "absolute", "limit", "dead_zone", "backlash", "square_root"})

# Of the inputs of an integrator that cancel, what rounding of coefficients and sums may leave.
ROUNDED = 16 * sys.float_info.epsilon


@dataclass(frozen=True, slots=True)
class RateRow:
    """The rate test of one integrator, in machine units a second, or as a fraction (`gain_error`).

    rate_mu: what its inputs give at t = 0, by calculation with this machine's errors; first_mu: its mean
    rate over the trial run's first interval; gain_error: by how much it is too fast when it is fed a
    known input, with the inputs of the patch taken off; drift_mu: its rate with no input at all;
    expected_mu: what its inputs give by hand, with parts that have no errors; shown_mu: what the machine
    shows; allowed_mu: by how much they may differ; remark: why shown_mu is missing, or ''.
    """

    integrator: str
    rate_mu: float
    first_mu: float | None
    gain_error: float
    drift_mu: float
    expected_mu: float
    shown_mu: float | None
    allowed_mu: float | None
    remark: str

    @property
    def fails(self) -> bool:
        """Whether the machine shows what no tolerance and no lag of it explains."""
        if self.shown_mu is None or self.allowed_mu is None:
            return False
        return not abs(self.shown_mu - self.expected_mu) <= self.allowed_mu


def static_check(machine: Machine) -> tuple[list[float], dict[str, float]]:
    """Every signal at t = 0 in order, and the rates of the integrators by name; machine units."""
    analog = machine.analog
    if machine.elements:
        from hybrid.engine.windows import settled  # takes long to load

        values, drives = settled(machine)
        shown = dict(zip(analog.signals, values, strict=True))
        for name, element in machine.elements:
            if element.kind == INTEGRATE and name in drives:  # its leak is no input
                begins = shown[name] if element.second else element.initial
                drives[name] += element.figures[0] * begins
        return values, _without_debris(machine, values, drives)
    found = (analog.a @ analog.x0 + analog.b @ analog.u0).tolist()
    rates = dict(zip(analog.states, found, strict=True))
    cores = {s.removesuffix(":core"): rate for s, rate in rates.items() if s.endswith(":core")}
    at_start = analog.static_value.tolist()
    return at_start, _without_debris(machine, at_start, {**rates, **cores})


def _without_debris(
    machine: Machine, values: list[float], rates: dict[str, float]
) -> dict[str, float]:
    """The rates, those being 0 that inputs leave by rounding only where they cancel."""
    analog, found = machine.analog, dict(rates)
    scales = dict(zip(analog.signals, analog.full_scale.tolist(), strict=True))
    at = dict(zip(analog.signals, values, strict=True))
    for part in machine.patch.components:
        if part.kind == "integrate" and part.name in found:
            inputs = [g.number(machine.parameters) * at[s] * scales[s] for s, g in part.terms]
            size = sum(abs(each) for each in inputs) / scales[part.name]
            if abs(found[part.name]) <= ROUNDED * size:
                found[part.name] = 0.0
    return found


def rate_test(
    machine: Machine, rates_mu: dict[str, float], trial: Trial | None
) -> tuple[RateRow, ...]:
    """One row for each integrator; `rates_mu`: their rates at t = 0, by calculation.

    What is shown is without noise. Without a trial run no window need be compiled for it.
    """
    names = sorted(c.name for c in machine.patch.components if c.kind == "integrate")
    if not names:
        return ()
    given = np.array([rates_mu[name] for name in names])
    start, step_s, wait_s = _first_moments(machine, given, trial is None)
    try:
        expected, allowed = _by_hand(machine, names)
    except PatchError:  # 0/0, which errors turn into a figure
        expected, allowed = given, np.full(len(names), math.inf)
    place = {signal: i for i, signal in enumerate(machine.analog.signals)}
    columns = [place[name] for name in names]
    shown = _carried_back(start.rates_mu, wait_s, step_s)
    most_mu = np.max(np.abs(start.rates_mu), axis=0)
    with np.errstate(all="ignore"):  # of what runs away
        late = _by_lags(machine, names, shown, most_mu)
    rows, switches = [], _switches_text(machine)
    for i, name in enumerate(names):
        stage = machine.stages[name]
        why_not = start.why_not.get(name) or (switches if start.switched else "")
        why_not = why_not or ("" if math.isfinite(allowed[i]) else "no value without errors")
        off, column = allowed[i] + shown.digits, columns[i]
        if shown.left[column] <= MOST_LEFT * most_mu[column]:
            off += late[i] + shown.left[column]
        # A machine that begins in IC moves later.
        first = trial.rates_mu[name] if trial and not machine.operation else None
        rows.append(
            RateRow(
                name,
                rates_mu[name],
                first,
                stage.gain - 1.0,
                stage.offset,
                float(expected[i]),
                None if why_not else float(shown.rates[column]),
                None if why_not else float(off),
                why_not,
            )
        )
    return tuple(rows)


def rate_warnings(rows: tuple[RateRow, ...]) -> tuple[str, ...]:
    """What the machine shows that neither tolerances nor lags explain."""
    return tuple(
        f"rate test: {row.integrator} should begin with {row.expected_mu:.6g} machine units a second "
        f"and shows {row.shown_mu:.6g}, where tolerances and lags explain {row.allowed_mu:.2g}: "
        "something saturates, or a loop of lagged parts does not rest at t = 0"
        for row in rows
        if row.fails
    )


def _by_hand(machine: Machine, names: list[str]) -> tuple[Floats, Floats]:
    """Rates at t = 0 on parts without errors, and by how much errors within their limits change them."""
    exact = _exact_stages(machine)

    def rates(stages: dict[str, OutputStage]) -> Floats:
        found = static_check(_with_stages(machine, stages))[1]
        return np.array([found[name] for name in names])

    expected = rates(exact)
    allowed, tolerances, errors = np.zeros(len(names)), 0.0, []
    for name, stage in machine.stages.items():
        offset = abs(stage.offset) + stage.offset_limit
        limits = [replace(exact[name], gain=1.0 + stage.tolerance)] * (stage.tolerance != 0.0)
        limits += [replace(exact[name], offset=offset)] * (offset != 0.0)
        limits += [replace(exact[name], leak=stage.leak_limit)] * (stage.leak_limit != 0.0)
        tolerances += abs(stage.tolerance)
        errors += [(name, limit) for limit in limits]
    for change in changes_of_rates(_with_stages(machine, exact), names, errors):
        allowed += np.abs(change)
    dials = {
        n: replace(s, pot_resolution=machine.stages[n].pot_resolution) for n, s in exact.items()
    }
    if dials != exact:
        allowed += np.abs(rates(dials) - expected)
    return expected, allowed * (1.0 + tolerances)


def _by_lags(machine: Machine, names: list[str], shown: _AtStart, most_mu: Floats) -> Floats:
    """How much lags make of the rates that are shown, all in one direction."""
    place = {signal: i for i, signal in enumerate(machine.analog.signals)}
    columns = [place[name] for name in names]
    late = np.array([machine.stages[name].tau for name in names]) * shown.changes[columns]
    speeds = np.maximum(np.abs(shown.rates), most_mu) + shown.left
    exact, errors = _exact_stages(machine), list[tuple[str, OutputStage | float]]()
    for name, stage in exact.items():
        off_mu = stage.tau * float(speeds[place[name]])
        if off_mu > 0.0 and math.isfinite(off_mu):
            errors.append((name, off_mu))
    for part in machine.patch.components:
        if part.kind == "amplify":  # it is late at its summing point
            offset = float(speeds[place[part.name]]) / _loop_rate(machine, part)
            errors.append((part.name, replace(exact[part.name], offset=offset)))
    lags_s = {name: stage.tau for name, stage in exact.items()}
    found = changes(_with_stages(machine, exact), names, errors)
    for (name, error), (change, moved) in zip(errors, found, strict=True):
        late += np.abs(change)
        if not isinstance(error, OutputStage):  # in a loop without integrators it counts more often
            lags_s[name] *= max(1.0, (abs(moved) - EXACT_MU) / error)
    sums_s = _sums_of_lags_s(machine, names, lags_s)
    return np.asarray(late + sums_s**2 * shown.bends[columns])


def _exact_stages(machine: Machine) -> dict[str, OutputStage]:
    """Every output stage without errors."""
    return {name: _without_errors(stage) for name, stage in machine.stages.items()}


def _without_errors(stage: OutputStage) -> OutputStage:
    """The same lag and word length, and nothing else that is not as it should be."""
    return replace(
        stage, gain=1.0, offset=0.0, leak=0.0, noise=0.0, saturation=math.inf, pot_resolution=0.0
    )


def _with_stages(machine: Machine, stages: dict[str, OutputStage]) -> Machine:
    """The machine with other errors."""
    patch, scope = machine.patch, machine.parameters
    if machine.elements:
        analog, _, elements = build_circuit(patch, scope, stages)
        return replace(machine, stages=stages, analog=analog, elements=elements)
    analog, _ = build_analog(patch, scope, stages)
    return replace(machine, stages=stages, analog=analog)


def _first_moments(machine: Machine, rates_mu: Floats, plainly: bool) -> tuple[Start, float, float]:
    """The machine in its first moments; length of an interval, and wait before the first, in s."""
    wait_s = WAIT_LAGS * max((stage.tau for stage in machine.stages.values()), default=0.0)
    fastest = float(np.max(np.abs(rates_mu), initial=0.0))
    step_s = wait_s or (
        LITTLE_MU / fastest if fastest > 0.0 else SHARE_OF_RUN * to_seconds(machine.timing.until)
    )
    # What noise spreads is half the work, and not asked for.
    analog = replace(machine.analog, noise=np.zeros((len(machine.analog.states), 0)))
    quiet = replace(machine, analog=analog)
    start = first_rates(quiet, wait_s, step_s, INTERVALS, plainly)
    if start.switched:
        step_s /= SHORTER
        start = first_rates(quiet, wait_s, step_s, INTERVALS, plainly)
    return start, step_s, wait_s


def _switches_text(machine: Machine) -> str:
    """What parts of this machine do at which no rate can be carried back to the start."""
    jumping, cornered = [], []
    for part in machine.patch.components:
        squares = "quarter_square" in part.values
        jumping += [part.name] if part.kind in JUMPING else []
        cornered += [part.name] if part.kind in CORNERED or squares else []
    saturates = any(math.isfinite(stage.saturation) for stage in machine.stages.values())
    alone = [*jumping, *cornered] if not saturates else []
    told = ["switches"] if jumping else []
    told += ["passes a corner"] if cornered or saturates or not jumping else []
    return f"{alone[0] if len(alone) == 1 else 'a part'} {' or '.join(told)}"


@dataclass(frozen=True, slots=True)
class _AtStart:
    """Rates carried back to t = 0, what that leaves of each, and how fast they change and bend.

    digits: what the signals' last digits make of any rate.
    """

    digits: float
    rates: Floats
    left: Floats
    changes: Floats
    bends: Floats


def _carried_back(rates_mu: Floats, wait_s: float, step_s: float) -> _AtStart:
    """From means over intervals, (intervals, columns)."""
    ends: Floats = wait_s / step_s + np.arange(len(rates_mu) + 1.0)
    cubic, parabola = (_at_start(ends[: n + 1], rates_mu[:n]) for n in (INTERVALS, INTERVALS - 1))
    sizes, left = np.maximum(np.abs(cubic), np.abs(parabola)), np.abs(cubic - parabola)
    seen = np.max(np.abs(np.diff(rates_mu, axis=0)), axis=0)
    changes = np.maximum(seen, sizes[1]) + left[1]
    weights = _at_start(ends, np.eye(INTERVALS))[0]
    digits = 2.0 * EXACT_MU / step_s * float(np.sum(np.abs(weights)))
    bends = 2.0 * (sizes[2] + left[2]) / step_s**2
    return _AtStart(digits, cubic[0], left[0], changes / step_s, bends)


def _at_start(ends: Floats, means: Floats) -> Floats:
    """First three coefficients, (3, columns), of the polynomials of these means, (intervals, columns),
    between these ends, (intervals + 1,)."""
    powers = np.arange(1, len(ends))
    integrals = ends[:, None] ** powers / powers
    return np.asarray(np.linalg.solve(np.diff(integrals, axis=0), means)[:3], dtype=np.float64)


def _sums_of_lags_s(machine: Machine, names: list[str], lags_s: Mapping[str, float]) -> Floats:
    """The sums of the lags of integrators and of all that follows their inputs at once.

    Each part on the way once, and an integrator twice where its output comes back to it.
    """
    sources = {c.name: (*c.sources, *c.controls) for c in machine.patch.components}
    kinds = {c.name: c.kind for c in machine.patch.components}
    extra_s = {
        c.name: 1.0 / _loop_rate(machine, c)
        for c in machine.patch.components
        if c.kind == "amplify"
    }

    def sum_s(name: str) -> float:
        found, todo = set[str](), list(sources[name])
        while todo:
            signal = todo.pop()
            if signal in found:
                continue
            found.add(signal)
            if kinds.get(signal, "integrate") not in KEEPERS:
                todo += sources[signal]
        return math.fsum(lags_s.get(s, 0.0) + extra_s.get(s, 0.0) for s in (name, *found))

    return np.array([sum_s(name) for name in names])


def _loop_rate(machine: Machine, component: Component) -> float:
    """How fast an open amplifier settles in a loop of gain 1 elsewhere, in 1/s."""
    values = {k: v.number(machine.parameters) for k, v in component.values.items()}
    return CATALOG["amplify"].core(values, {}).loop_rate
