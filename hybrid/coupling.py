"""What the coupling does to the modes of a patch: the exact one-cycle map and its eigenvalues.

Stage 6. The map takes everything the machine remembers (analog states, held outputs, words, results
on their way) over one stretch of the timeline: a cycle, or what several tasks do until they are where
they were, a multi-rate loop; quantisation and clipping are left out, lags, gain
errors, skew and compute time are in. Its eigenvalues z give the modes s = ln(z) / H.

All figures are kept as differences from the identity: at T = 0.1 ms and 10 rad/s the damping sits
in the tenth digit of z.
"""

from __future__ import annotations

import collections
import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.clockwork import Happening
from hybrid.components import CATALOG
from hybrid.eigenvalues import Complex, eigenvalues
from hybrid.engine.propagator import propagator
from hybrid.errors import HybridError, PatchError
from hybrid.expressions import Name
from hybrid.layout import build_analog
from hybrid.linearity import NotLinear, linear_program
from hybrid.machine import Analog, Floats, Machine, OutputStage
from hybrid.patch import Patch, RunSettings, WordSettings, literal
from hybrid.scale import to_seconds
from hybrid.tape import MEMORY, WORDS, Memory, build_tape
from hybrid.timeline import Segment, Timeline, build_timeline

# In how many stretches tasks must have settled; the layout of their events ends long before.
MOST_STRETCHES = 10**6


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


# -- the one-cycle map ------------------------------------------------------------------------------


def exact_modes(machine: Machine) -> Complex:
    """Every mode s of the patch as the machine plays it, in rad/s (complex); forgotten ones left out."""
    machine = in_operation(machine)
    analog = machine.analog
    for task in machine.timing.tasks:
        if task.when:
            what = (
                f"task {task.name!r} begins when {task.when[0]} switches, so there is no exact map"
            )
            raise NotLinear(what, task.place)
    if machine.elements:
        raise not_linear(machine)
    if not machine.timing.period:
        return eigenvalues(_without(analog.a, analog.sources))
    change, length_ticks = cycle_map(machine)
    shift = eigenvalues(change, shifted=True)
    shift = shift[shift != -1.0]  # polished to z = 0 itself, it is a result passing through
    modes: Complex = _log_one_plus(shift) / to_seconds(length_ticks)
    return modes


def in_operation(machine: Machine) -> Machine:
    """The machine; of a linear patch with modes, it in OP."""
    if machine.operating is None:
        return machine
    return replace(machine, analog=machine.operating, elements=(), operating=None)


def not_linear(machine: Machine) -> NotLinear:
    """Which component stands in the way of an exact prediction."""
    for component in sorted(machine.patch.components, key=lambda c: c.place.line):
        if not CATALOG[component.kind].linear_with(component.values):
            what = f"component {component.name!r} ({component.kind}) is not linear"
            return NotLinear(what, component.place)
    return NotLinear("its outputs saturate")


def _log_one_plus(shift: Complex) -> Complex:
    """ln(1 + shift), keeping the small real part of a slow mode; elsewhere the plain logarithm."""
    slow = np.abs(shift) < 0.5
    near = np.where(slow, shift, 0.0)
    real = 0.5 * np.log1p(near.real * (2.0 + near.real) + near.imag**2)
    far = np.log(np.abs(np.where(slow, 1.0, 1.0 + shift)))
    logarithm: Complex = real + far + 1j * np.angle(1.0 + shift)
    return logarithm


def cycle_map(machine: Machine) -> tuple[Floats, int]:
    """(M - I, length in ticks): the map of one repeated stretch, constants and sources left out."""
    timeline = _repeating(machine)
    stretch = next(s for s in timeline.segments if s.start > 0 and s.length > 0)
    before = [(kind, i) for tick, kind, i in timeline.segments[0].events if tick < stretch.start]
    in_flight = [
        before.count((Happening.START, i)) - before.count((Happening.END, i))
        for i in range(len(machine.tape.starts) - 1)
    ]
    tracker = _Tracker(machine, stretch, in_flight)
    with np.errstate(over="ignore", invalid="ignore"):  # `eigenvalues` refuses what overflows
        for offset, kind, index in stretch.events:
            tracker.play(offset, Happening(kind), index)
    return tracker.change(), stretch.length


def stretch_s(machine: Machine) -> float:
    """What repeats takes so long: a cycle, or until all tasks are where they were."""
    segments = _repeating(in_operation(machine)).segments
    return to_seconds(next(s.length for s in segments if s.start > 0 and s.length > 0))


def _repeating(machine: Machine) -> Timeline:
    """A timeline whose second segment repeats; raises NotLinear where there is none."""
    try:
        timeline = build_timeline(_short(machine))
    except PatchError as error:
        if not machine.timing.tasks:
            raise
        what = "the periods of the tasks have no short common multiple, so there is no exact map"
        raise NotLinear(what, machine.timing.tasks[0].place) from error
    if timeline.later:
        raise NotLinear("the clock of a task jitters, so there is no exact map")
    if len(timeline.segments) < 2:
        raise NotLinear("the tasks do not come back to where they were, so there is no exact map")
    return timeline


def _short(machine: Machine) -> Machine:
    """The same machine without steps, run just long enough for one stretch to repeat."""
    timing = machine.timing
    if _is_plain(machine):
        return machine
    # The record does not belong to the loop: let it follow the cycle.
    every, until = timing.period, 5 * timing.period + 2 * machine.latency_ticks
    tasks = tuple(
        replace(t, overrun="skip" if t.overrun == "stop" else t.overrun) for t in timing.tasks
    )
    if tasks:
        every = math.lcm(*(task.period for task in tasks))
        until = MOST_STRETCHES * every
    timing = replace(timing, every=every, until=until, tasks=tasks)
    return replace(machine, steps=(), operation=None, timing=timing)


def _is_plain(machine: Machine) -> bool:
    """Whether the run itself is a cycle, with a row, again and again: then it is laid out but once."""
    timing = machine.timing
    steady = not (machine.steps or machine.operation or timing.tasks)
    enough = timing.until >= 5 * timing.period + 2 * machine.latency_ticks
    return steady and enough and timing.every == timing.period


class _Tracker:
    """Follows every remembered figure as a linear form of its values at the start of the stretch.

    Layout of a form: n states, m inputs, ADC samples, ADC words, remembered values, visible words,
    then the queue of results of each program, oldest first.
    """

    def __init__(self, machine: Machine, stretch: Segment, in_flight: list[int]) -> None:
        analog, tape = machine.analog, machine.tape
        self.machine = machine
        self.program = linear_program(tape, len(machine.samplers))
        self.in_flight = in_flight  # results on their way at the start
        starts = collections.Counter(i for _, kind, i in stretch.events if kind == Happening.START)
        n, m, words = len(analog.states), len(analog.inputs), len(tape.words)
        adcs, memory = len(machine.samplers), len(self.program.keep)
        queues = [
            (on_their_way + starts[i]) * int(tape.starts[i + 1, 1] - tape.starts[i, 1])
            for i, on_their_way in enumerate(in_flight)
        ]
        sizes = [n, m, adcs, adcs, memory, words, *queues]
        edges = np.concatenate([[0], np.cumsum(sizes)]).tolist()
        parts = [slice(a, b) for a, b in itertools.pairwise(edges)]
        self.x, self.u, self.sample, self.adc, self.memory, self.words = parts[:6]
        self.queues = parts[6:]
        self.start = np.eye(edges[-1])
        self.moved = np.zeros((edges[-1], edges[-1]))  # now - start
        self.now_ticks = 0

    def value(self, part: slice) -> Floats:
        """Forms of one part, now."""
        now: Floats = self.start[part] + self.moved[part]
        return now

    def set(self, part: slice, forms: Floats) -> None:
        """Give one part new forms."""
        self.moved[part] = forms - self.start[part]

    def play(self, offset: int, kind: Happening, index: int) -> None:
        """Advance to the event, then do to the forms what the kernel does to the figures."""
        if offset > self.now_ticks:
            both = slice(self.x.start, self.u.stop)
            self.moved[self.x] += self._change(offset - self.now_ticks) @ self.value(both)
            self.now_ticks = offset
        if kind is Happening.SAMPLE:
            sampler = self.machine.samplers[index]
            row = self.machine.analog.c[sampler.signal] * sampler.to_si
            at = slice(self.sample.start + index, self.sample.start + index + 1)
            self.set(at, (row @ self.value(slice(self.x.start, self.u.stop)))[None])
        elif kind is Happening.CONVERT:
            at = slice(self.adc.start + index, self.adc.start + index + 1)
            self.set(at, self.value(self.sample)[index : index + 1])
        elif kind is Happening.START:
            self._start_program(index)
        elif kind is Happening.END:
            self._end_program(index)
        elif kind is Happening.LATCH:
            holder = self.machine.holders[index]
            at = slice(self.u.start + holder.input, self.u.start + holder.input + 1)
            self.set(at, holder.to_mu * self.value(self.words)[holder.word : holder.word + 1])

    def _change(self, ticks: int) -> Floats:
        return propagator(self.machine.analog, to_seconds(ticks)).change

    def _own(self, program: int, column: int) -> tuple[int, int]:
        """First and last row of what belongs to one program, among its words or its memory."""
        first, last = self.machine.tape.starts[program : program + 2, column].tolist()
        return first, last

    def _start_program(self, program: int) -> None:
        one, shared = self.value(self.u)[:1], self.value(self.words)[self.program.shared]
        inputs = np.vstack([self.value(self.adc), self.value(self.memory), shared, one])
        first, last = self._own(program, WORDS)
        results = self.program.rows[first:last] @ inputs
        at = self.queues[program].start + self.in_flight[program] * len(results)
        self.set(slice(at, at + len(results)), results)
        self.in_flight[program] += 1
        # Each delay has as many columns as cycles.
        lengths = self.machine.tape.memory[:, Memory.LENGTH] + 1
        first, last = (int(np.sum(lengths[:row])) for row in self._own(program, MEMORY))
        keep = slice(self.memory.start + first, self.memory.start + last)
        self.set(keep, self.program.keep[first:last] @ inputs)

    def _end_program(self, program: int) -> None:
        first, last = self._own(program, WORDS)
        words, queue = last - first, self.value(self.queues[program])
        self.set(slice(self.words.start + first, self.words.start + last), queue[:words])
        rest = np.vstack([queue[words:], np.zeros((words, queue.shape[1]))])
        self.set(self.queues[program], rest)
        self.in_flight[program] -= 1

    def change(self) -> Floats:
        """M - I without the constant 1, the step inputs and the sine sources, which only drive."""
        analog = self.machine.analog
        driven = {self.u.start + holder.input for holder in self.machine.holders}
        drop = [self.x.start + i for i in analog.sources]
        drop += [i for i in range(self.u.start, self.u.stop) if i not in driven]
        return _lasting(_without(self.moved, drop))


def _lasting(change: Floats) -> Floats:
    """M - I without what is overwritten before anybody reads it: samples, words, what DACs held.

    Nothing depends on such a figure, so its column of M is zero, and so is its eigenvalue. Without it
    others may be such.
    """
    while len(change):
        read = (change + np.eye(len(change))).any(axis=0)
        if read.all():
            break
        change = change[read][:, read]
    return change


def _without(matrix: Floats, dropped: Sequence[int]) -> Floats:
    """A square matrix without these rows and columns."""
    keep = np.ones(len(matrix), dtype=bool)
    keep[list(dropped)] = False
    kept: Floats = matrix[keep][:, keep]
    return kept


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
    perfect = {part.name: OutputStage() for part in patch.analog_parts}
    return build_analog(patch, scope, perfect)[0]


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
    return eigenvalues(_without(a, analog.sources))


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

    Where the patch has no ideal limit, every mode is listed and the ideal figures are NaN.
    """
    exact = exact_modes(machine)
    try:
        ideal = ideal_modes(machine.patch, machine.overrides)
    except HybridError:  # no limit, or a loop that only lags make possible
        ideal = np.zeros(0, dtype=complex)
        pairs = [(s, complex(np.nan, np.nan)) for s in exact]
    else:
        pairs = _pair(exact, ideal)
        pairs += _unmeant(exact, pairs)
    found = [_mode(s, i) for s, i in pairs if s.imag >= 0]
    return tuple(sorted(found, key=lambda m: (m.omega, m.zeta)))


def _unmeant(exact: Complex, pairs: list[tuple[complex, complex]]) -> list[tuple[complex, complex]]:
    """Modes that nobody meant and that matter: those that grow, or are slower than a meant one."""
    taken = {mode for mode, _ in pairs}
    slowest = max((abs(ideal) for _, ideal in pairs), default=0.0)
    nothing = complex(np.nan, np.nan)
    left = [complex(s) for s in exact if complex(s) not in taken]
    return [(s, nothing) for s in left if s.real > 0.0 or abs(s) < slowest]


def _pair(exact: Complex, ideal: Complex) -> list[tuple[complex, complex]]:
    """Each ideal mode with the nearest exact one that no other has taken."""
    free = list(range(len(exact)))
    pairs = []
    for wanted in sorted(ideal.tolist(), key=abs):
        if not free:
            break
        best = min(free, key=lambda i: abs(exact[i] - wanted))
        free.remove(best)
        pairs.append((complex(exact[best]), complex(wanted)))
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
