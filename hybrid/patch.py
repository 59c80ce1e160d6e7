"""What a patch is: frozen data, as read, with every number still an expression over parameters.

Stage 1. `patchfile` builds these values and has checked every dimension; `Patch.bind` turns the
parameters into numbers. All numbers are SI inside; `unit` and `factor` say how a signal is shown.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from hybrid.daveml import Model
from hybrid.errors import NOWHERE, PatchError, Place, did_you_mean, quoted
from hybrid.expressions import ExpressionError, Name, Node, Number, evaluate, names
from hybrid.graph import dependency_order, find_loop
from hybrid.language import DEFAULT_ROWS
from hybrid.modes import RESERVED_SIGNALS
from hybrid.units import PURE, Dimension
from hybrid.wordlength import Kind, Overflow, WordLength

# What can be set of a task from outside, as TASK.period, where the patch says it.
TASK_TIMES = ("period", "phase", "compute_time", "jitter")


@dataclass(frozen=True, slots=True)
class Value:
    """A number of the patch: the expression, where it stands and which values it may take."""

    expr: Node
    place: Place = NOWHERE
    what: str = "value"  # "full_scale of 'theta'", for messages
    positive: bool = False
    not_negative: bool = False
    unit: str = ""  # SI unit, for messages

    def number(self, scope: Mapping[str, float]) -> float:
        """The value in SI units; raises PatchError where it is not allowed."""
        try:
            value = evaluate(self.expr, scope)
        except ExpressionError as error:
            raise PatchError(f"{self.what}: {error}", self.place) from None
        if not self.allows(value):
            least = "greater than 0" if self.positive else "0 or greater"
            raise PatchError(f"{self._told(value)}; it must be {least}", self.place)
        return value

    def allows(self, value: float) -> bool:
        """Whether this may be the value, in SI units."""
        return not (self.positive and not value > 0) and not (self.not_negative and value < 0)

    def _told(self, value: float) -> str:
        # By the parameter alone that it is: what the command line sets may stand in another line.
        of_task = isinstance(self.expr, Name) and "." in self.expr.id
        named = f"{self.expr.id} = " if isinstance(self.expr, Name) and not of_task else ""
        return f"{self.what} is {named}{value:g} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class Parameter:
    """A named number that the command line may override."""

    name: str
    value: Value
    unit: str = ""
    factor: float = 1.0  # SI value of one `unit`
    dimension: Dimension = PURE
    task: str = ""  # whose time it is, where it is not declared: one of TASK_TIMES


@dataclass(frozen=True, slots=True)
class Component:
    """One analog component: `kind` is its key in the catalogue."""

    name: str
    kind: str
    terms: tuple[tuple[str, Value], ...]  # inputs with coefficients, sorted by signal
    values: Mapping[str, Value]  # the kind's own quantities
    full_scale: Value
    unit: str
    factor: float
    dimension: Dimension
    errors: Mapping[str, Value]  # overrides of tau, tolerance, offset, noise
    place: Place = NOWHERE
    signals: tuple[str, ...] = ()  # inputs without coefficients, in the order written
    control: str | None = None
    points: tuple[tuple[Value, Value], ...] = ()
    initial_signal: str | None = None  # in place of a value "initial"
    reset_when: str | None = None
    hold_when: str | None = None

    @property
    def is_switched(self) -> bool:
        """Whether an integrator has modes of its own, or follows a signal in IC."""
        return bool(self.reset_when or self.hold_when or self.initial_signal)

    @property
    def controls(self) -> tuple[str, ...]:
        """What switches it, resets it or holds it: signals, or the machine's mode."""
        return tuple(s for s in (self.control, self.reset_when, self.hold_when) if s)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Parameters that its own figures depend on, but for its errors, sorted."""
        values = [value for _, value in self.terms]
        values += [*self.values.values(), *itertools.chain.from_iterable(self.points)]
        return tuple(sorted(frozenset[str]().union(*(names(value.expr) for value in values))))

    @property
    def sources(self) -> tuple[str, ...]:
        """Every signal it reads, sorted; the machine's mode is none."""
        initial = (self.initial_signal,) if self.initial_signal else ()
        controls = set(self.controls) - RESERVED_SIGNALS
        return tuple(sorted({*(s for s, _ in self.terms), *self.signals, *initial, *controls}))


@dataclass(frozen=True, slots=True)
class Adc:
    """Analog signal to program word; `bits` None means no quantisation."""

    name: str
    source: str
    bits: int | None
    range: Value | None
    conversion_time: Value | None
    channel: int
    place: Place = NOWHERE
    task: str | None = None  # which samples it; None: the first by rank that reads it


@dataclass(frozen=True, slots=True)
class Dac:
    """Program word to held analog signal."""

    name: str
    word: str
    bits: int | None
    initial: Value
    full_scale: Value
    unit: str
    factor: float
    dimension: Dimension
    errors: Mapping[str, Value]
    place: Place = NOWHERE
    transfer: str | None = None  # the task whose end shows what was loaded; None: its own
    lead: Value | None = None  # so much later than sampled it shows the word to be
    begins_unknown: bool = False  # made for a word of which the patch does not say how it begins


@dataclass(frozen=True, slots=True)
class Assignment:
    """word: expression over ADC words, parameters, other words and previous(word)."""

    word: str
    expr: Node
    place: Place = NOWHERE
    dimension: Dimension | None = None
    hidden: bool = False  # of a model, which is not recorded

    @property
    def reads(self) -> tuple[Node, ...]:
        """All its arithmetic."""
        return (self.expr,)


@dataclass(frozen=True, slots=True)
class State:
    """A word that the program integrates: expr is its rate, as an assignment's is its value."""

    word: str
    expr: Node
    initial: Value
    formula: str  # one of `formulas.FORMULAS`
    place: Place = NOWHERE
    dimension: Dimension | None = None
    reset_when: Node | None = None  # where this is true at the end of a cycle,
    reset_to: Node | None = None  # the state takes this value

    @property
    def hidden(self) -> bool:
        """States are always recorded."""
        return False

    @property
    def reads(self) -> tuple[Node, ...]:
        """All its arithmetic."""
        return tuple(expr for expr in (self.expr, self.reset_when, self.reset_to) if expr)


@dataclass(frozen=True, slots=True)
class WordSettings:
    """A word length, its full scale still an expression over parameters."""

    kind: Kind = Kind.DOUBLE
    bits: int = 53
    cuts: bool = False
    full_scale: Value | None = None
    overflow: Overflow = Overflow.STOP
    place: Place = NOWHERE

    def bound(self, scope: Mapping[str, float]) -> WordLength:
        """The word length in numbers."""
        full_scale = self.full_scale.number(scope) if self.full_scale else 1.0
        return WordLength(self.kind, self.bits, self.cuts, full_scale, self.overflow)


@dataclass(frozen=True, slots=True)
class ProcessorSettings:
    """Operation times of the digital machine: those of a make by name, or given."""

    name: str  # '' where they are given
    times: Mapping[str, Value]
    place: Place = NOWHERE


@dataclass(frozen=True, slots=True)
class Task:
    """One of several programs on one processor: its clock, and which words it computes, in order."""

    name: str
    period: Value | None  # None: a comparator starts its cycles, see `when`
    phase: Value | None
    priority: int | None
    compute_time: Value | None  # None: counted from the operations
    overrun: str
    words: tuple[str, ...]
    place: Place = NOWHERE
    jitter: Value | None = None
    states: tuple[str, ...] = ()  # which states it integrates, by name
    when: tuple[str, str] | None = None  # a comparator, and 'rises', 'falls' or 'changes'


@dataclass(frozen=True, slots=True)
class Program:
    """The digital machine's program and its clock; assignments in the order they are computed.

    Several programs are `tasks`, by name: the assignments are those of the first, then of the second
    and so on, and `period` is that of the first that has one.
    """

    period: Value | None
    compute_time: Value | None
    skew: Value | None
    assignments: tuple[Assignment, ...]
    remember: Mapping[str, Value]
    place: Place = NOWHERE
    states: tuple[State, ...] = ()  # by name
    word: WordSettings = WordSettings()
    lengths: Mapping[str, WordSettings] = field(
        default_factory=dict
    )  # of words that have their own
    tasks: tuple[Task, ...] = ()
    preemptive: bool = True
    processor: ProcessorSettings | None = None
    counted: bool = False  # the compute time of the one program is that of its operations
    # In which words are shown, with the SI value of one, where it is given.
    units: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    @property
    def written(self) -> tuple[Assignment | State, ...]:
        """Every word with its arithmetic: of each program the assignments, then the states."""
        found: list[Assignment | State] = []
        for single in self.programs:
            found += [*single.assignments, *single.states]
        return tuple(found)

    @property
    def words(self) -> tuple[str, ...]:
        """The names of them all."""
        return tuple(entry.word for entry in self.written)

    @property
    def programs(self) -> tuple[Program, ...]:
        """Each of several programs as if it were the only one; itself where it is."""
        if not self.tasks:
            return (self,)
        by_word = {assignment.word: assignment for assignment in self.assignments}
        by_state = {state.word: state for state in self.states}
        return tuple(
            replace(
                self,
                period=task.period,
                assignments=tuple(by_word[word] for word in task.words),
                states=tuple(by_state[word] for word in task.states),
                tasks=(),
            )
            for task in self.tasks
        )

    @property
    def periods(self) -> tuple[Value, ...]:
        """The cycle times of the tasks, or of the one program."""
        of_tasks = [task.period for task in self.tasks]
        return tuple(period for period in of_tasks or [self.period] if period)


@dataclass(frozen=True, slots=True)
class ModeSettings:
    """When the machine is in which mode: by time, by logic signals, or both."""

    reset: Value | None = None
    operate: Value | None = None
    hold: Value | None = None
    operations: int | None = None  # None: to the end of the run
    reset_when: str | None = None
    hold_when: str | None = None
    place: Place = NOWHERE


@dataclass(frozen=True, slots=True)
class RunSettings:
    """Length of the run and density of its record."""

    until: Value
    every: Value | None = None
    max_rows: int = DEFAULT_ROWS
    on_overload: str = "continue"  # or "hold", "stop"


@dataclass(frozen=True, slots=True)
class Readout:
    """A figure of merit: `kind` of `signal`, from a part of the record."""

    name: str
    kind: str
    signal: str
    start: Value | None = None
    end: Value | None = None
    place: Place = NOWHERE


@dataclass(frozen=True, slots=True)
class MachineSettings:
    """Which machine the patch asks for; `errors` override the preset for all components."""

    preset: str = "nominal"
    serial: int = 1
    errors: Mapping[str, Value] = field(default_factory=dict)
    place: Place = NOWHERE
    pot_resolution: Value | None = None


@dataclass(frozen=True, eq=False)
class Patch:
    """A whole validated patch."""

    title: str
    description: str
    file: str
    text: str
    machine: MachineSettings
    parameters: Mapping[str, Parameter]
    components: tuple[Component, ...]
    adcs: tuple[Adc, ...]
    dacs: tuple[Dac, ...]
    program: Program | None
    run: RunSettings
    record: tuple[str, ...]  # () = all signals
    readouts: tuple[Readout, ...]
    modes: ModeSettings | None = None
    time_scale: Value | None = None
    files: Mapping[str, str] = field(default_factory=dict)  # SHA-256 of those it names
    on: Mapping[str, str] = field(default_factory=dict)  # what was put on which machine
    models: tuple[Model, ...] = ()  # whose variables the program may read

    def bind(self, overrides: Mapping[str, float] | None = None) -> dict[str, float]:
        """Every parameter as an SI number, `overrides` (SI) replacing defaults.

        Raises PatchError for an unknown name, a circular definition or a value not allowed.
        """
        given = dict(overrides or {})
        for name, number in given.items():
            self.check_settable(name)
            if not math.isfinite(number):
                raise PatchError(f"{name} is {number}; give a finite number", Place(self.file))
        numbers: dict[str, float] = {}
        for name in self.parameter_order:
            value = self.parameters[name].value
            if name in given and value.allows(given[name]):
                number = given[name]
            elif name in given:
                number = replace(value, expr=Number(given[name])).number(numbers)
            else:
                number = value.number(numbers)
            numbers[name] = number + 0.0  # no sign of 0: what is kept of one serves for the other
        return numbers

    def check_settable(self, name: str) -> None:
        """Raise PatchError for what is no parameter and no time of a task that there still is."""
        if name not in self.parameters:
            hint = did_you_mean(name, self.parameters)
            raise PatchError(f"no parameter {quoted(name)}; {hint}", Place(self.file))
        task = self.parameters[name].task
        if task and task not in [t.name for t in (self.program.tasks if self.program else ())]:
            raise PatchError(
                f"{name} cannot be set: nothing is left of task {task!r} on the digital machine (--on)",
                self.parameters[name].value.place,
            )

    @functools.cached_property
    def parameter_order(self) -> tuple[str, ...]:
        """Parameters so that each comes after those it is computed from."""
        needs = {n: sorted(names(p.value.expr)) for n, p in self.parameters.items()}
        loop = find_loop(needs)
        if loop:
            place = self.parameters[loop[0]].value.place
            raise PatchError("circular parameters: " + " -> ".join((*loop, loop[0])), place)
        return dependency_order(needs)

    @functools.cached_property
    def analog_parameters(self) -> tuple[str, ...]:
        """Parameters that the analog side depends on, sorted."""
        values = [part.full_scale for part in self.analog_parts]
        values += [dac.initial for dac in self.dacs]
        own = (component.parameters for component in self.components)
        return tuple(sorted(frozenset().union(*(names(value.expr) for value in values), *own)))

    @functools.cached_property
    def has_modes(self) -> bool:
        """Whether the machine, or an integrator by itself, may be in another mode than OP."""
        return self.leaves_op or any(c.is_switched for c in self.components)

    @property
    def leaves_op(self) -> bool:
        """Whether the machine may be in another mode than OP."""
        return self.modes is not None or self.run.on_overload == "hold"

    @property
    def analog_parts(self) -> tuple[Component | Dac, ...]:
        """Everything that drives an analog signal, by name."""
        parts: tuple[Component | Dac, ...] = (*self.components, *self.dacs)
        return tuple(sorted(parts, key=lambda part: part.name))

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of every signal and word, sorted."""
        written = self.program.written if self.program else ()
        words = [entry.word for entry in written if not entry.hidden]
        sampled = [adc.name for adc in self.adcs]
        return tuple(sorted([p.name for p in self.analog_parts] + sampled + words))

    def __repr__(self) -> str:
        word = f", {len(self.program.words)} program words" if self.program else ""
        declared = ", ".join(sorted(n for n, p in self.parameters.items() if not p.task))
        return (
            f"<Patch {self.title!r}: {len(self.components)} components, {len(self.adcs)} ADC, "
            f"{len(self.dacs)} DAC{word}; parameters: {declared}>"
        )


def literal(value: float) -> Value:
    """A Value that is a plain number."""
    return Value(Number(value))
