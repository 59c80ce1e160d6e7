"""The compiled machine: plain arrays in machine units, ready to be played.

Stage 3. Nothing here changes during a run; the run owns the state vector. The analog side is
x' = A x + B u + G (unit white noise), signals y = C [x; u], with u the held inputs: the constant 1,
the outputs of the DACs, and the step sources.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from hybrid.elements import Element
from hybrid.errors import NOWHERE, Place
from hybrid.modes import MODE_ELEMENT, ON_OVERLOAD
from hybrid.patch import Patch
from hybrid.scale import to_seconds
from hybrid.tape import Tape

Floats = npt.NDArray[np.float64]

# A signal this close to its saturation level would have gone further.
AT_SATURATION = 1.0 - 1e-6


@dataclass(frozen=True, eq=False)
class Analog:
    """Linear analog side in machine units (1 = full scale); n states, m held inputs, r noises."""

    signals: tuple[str, ...]  # sorted; rows of C
    states: tuple[str, ...]
    inputs: tuple[str, ...]  # the constant 1, then DACs and steps, sorted
    a: Floats  # (n, n), 1/s
    b: Floats  # (n, m), 1/s
    noise: Floats  # (n, r), 1/sqrt(s)
    c: Floats  # (signals, n + m)
    x0: Floats  # (n,)
    u0: Floats  # (m,)
    full_scale: Floats  # (signals,), SI
    static_value: Floats  # (signals,), machine units, at t = 0
    sources: tuple[int, ...]  # states that belong to sine sources


@dataclass(frozen=True, slots=True)
class OutputStage:
    """The errors of one component, drawn and ready, in machine units."""

    tau: float = 0.0  # s, of problem time
    gain: float = 1.0  # 1 + gain error
    offset: float = 0.0
    noise: float = 0.0  # rms
    saturation: float = math.inf  # the output stays within
    step_mu: float = 0.0  # one code of a DAC; 0: not quantised
    pot_resolution: float = 0.0  # step of the settings of its potentiometers; 0: any setting
    tolerance: float = 0.0  # the gain was drawn within 1 +- this
    offset_limit: float = 0.0  # and the offset within this, beside what is given
    leak: float = 0.0  # 1/s, of an integrator or a store, beside what is given
    leak_limit: float = 0.0  # up to which it was drawn


@dataclass(frozen=True, slots=True)
class Sampler:
    """One ADC: where it reads, how it rounds, when it samples."""

    name: str
    signal: int  # row of C
    to_si: float  # SI per machine unit of the signal
    range_mu: float  # largest magnitude converted, machine units
    step_mu: float  # one code, machine units; 0 = not quantised
    clips: bool
    delay_ticks: int  # sample, after the start of the cycle
    conversion_ticks: int
    task: int = 0  # which samples it


@dataclass(frozen=True, slots=True)
class Holder:
    """One DAC: the word it converts, how it rounds, the held input it drives."""

    name: str
    word: int  # index among the program's words
    input: int  # index in u
    to_mu: float  # machine units per SI
    step_mu: float
    clips: bool
    task: int = 0  # whose results it shows


@dataclass(frozen=True, slots=True)
class StepEvent:
    """A held input that takes a value, once or again and again."""

    name: str
    input: int
    value: float
    at_ticks: int
    every_ticks: int = 0  # 0: once
    times: int | None = None  # how often, of what comes again and again; None: without end


@dataclass(frozen=True, slots=True)
class Operation:
    """What the machine does again and again: IC, OP, HOLD, in ticks."""

    reset: int
    operate: int
    hold: int
    count: int | None  # operations, after which the machine stays in HOLD; None: no end

    @property
    def length(self) -> int:
        """From one IC to the next."""
        return self.reset + self.operate + self.hold

    def done(self, ticks: int) -> int:
        """How many times OP has ended by then."""
        ended = max(0, (ticks - self.reset - self.operate) // self.length + 1)
        return ended if self.count is None else min(ended, self.count)


@dataclass(frozen=True, slots=True)
class TaskTiming:
    """One of several tasks on one processor, in ticks.

    Its clock starts a cycle every `period`; or a comparator does, where `when` names one and how it must
    switch ('rises', 'falls' or 'changes'), and the period is 0.
    """

    name: str
    period: int
    phase: int
    compute: int
    rank: int  # 0 goes first
    overrun: str = "skip"
    place: Place = NOWHERE
    jitter: int = 0  # its clock is late by up to this
    when: tuple[str, str] | None = None


def utilisation(tasks: tuple[TaskTiming, ...]) -> float:
    """The share of its time that the processor is asked for by tasks that have a clock."""
    return sum(task.compute / task.period for task in tasks if task.period)


@dataclass(frozen=True, slots=True)
class Timing:
    """All durations in ticks; `period` 0 where there is no digital machine, or none with a clock.

    Of several tasks `period` is the shortest and `compute` the longest: each has its own in `tasks`,
    which stand in the order of the programs on the tape, by name.
    """

    period: int
    compute: int
    every: int
    until: int
    tasks: tuple[TaskTiming, ...] = ()
    preemptive: bool = True


@dataclass(frozen=True, slots=True)
class Pen:
    """One recorded signal: kind 'analog', 'dac', 'adc', 'word' or 'mode' (of the machine), index, factor
    to problem units."""

    name: str
    kind: str
    index: int
    factor: float


@dataclass(frozen=True, eq=False)
class Machine:
    """A patch compiled for one set of parameters and one make of machine."""

    patch: Patch
    preset: str
    serial: int
    parameters: dict[str, float]  # all, SI
    overrides: dict[str, float]  # those given from outside
    stages: dict[str, OutputStage]  # by component and DAC
    analog: Analog
    samplers: tuple[Sampler, ...]
    holders: tuple[Holder, ...]
    steps: tuple[StepEvent, ...]
    tape: Tape
    timing: Timing
    elements: tuple[tuple[str, Element], ...] = ()  # where the analog side is not linear
    operation: Operation | None = None  # where time sets the machine's mode
    time_scale: float = 1.0  # problem seconds in a machine second
    operating: Analog | None = None  # where elements play a linear patch for its modes: it in OP

    @property
    def cycle_s(self) -> float:
        """Digital cycle time in s, NaN where there is no digital machine."""
        return to_seconds(self.timing.period) if self.timing.period else float("nan")

    @property
    def on_overload(self) -> int:
        """What the first overload does: one of those in `modes`."""
        return ON_OVERLOAD[self.patch.run.on_overload]

    @cached_property
    def logic(self) -> frozenset[str]:
        """Comparators whose levels lie within their full scale: no overload indicator watches them.

        What they give is a logic level; that it is off by tolerance and noise overloads nothing.
        """
        comparators = [c for c in self.patch.components if c.kind == "compare"]
        if not comparators:
            return frozenset()
        scope, scales = (
            self.parameters,
            dict(zip(self.analog.signals, self.analog.full_scale, strict=True)),
        )
        return frozenset(
            c.name
            for c in comparators
            if all(
                abs(c.values[level].number(scope)) <= scales[c.name] * (1.0 + 1e-12)
                for level in ("high", "low")
                if level in c.values
            )
        )

    @property
    def has_modes(self) -> bool:
        """Whether the machine may leave OP."""
        return any(name == MODE_ELEMENT for name, _ in self.elements)

    @property
    def latency_ticks(self) -> int:
        """Longest time from the start of a cycle to its last event, its results at the DACs, where it
        need not wait for the processor."""
        conversion = max((s.delay_ticks + s.conversion_ticks for s in self.samplers), default=0)
        return conversion + self.timing.compute

    def __repr__(self) -> str:
        a = self.analog
        return (
            f"<Machine {self.patch.title!r} on {self.preset!r}: {len(a.states)} states, "
            f"{len(self.samplers)} ADC, {len(self.holders)} DAC, {len(self.tape.code)} operations>"
        )
