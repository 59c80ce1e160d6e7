"""check(patch): what an operator looks at before the first run.

Stage 7. Scaling by a trial run, potentiometer settings, parts, the static check (every component's value
at t = 0), the rate test, the loops, and which prediction applies. Compiling the patch is itself the full
validation.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from hybrid import coupling, shots
from hybrid.arguments import Parameters, Source, machine_of
from hybrid.asked_before import asked_before
from hybrid.components.delay import DEFAULT_ORDER, good_to
from hybrid.cycle_map import stretch_s
from hybrid.equipment import Part, count_parts
from hybrid.errors import counted, known_as
from hybrid.linearity import NeverFinite, NotLinear, brief, linear_program
from hybrid.loops import Loops, loops_of
from hybrid.loudness import short_windows
from hybrid.machine import Machine
from hybrid.patch import Patch, Value
from hybrid.played import thinning_text
from hybrid.potsheet import PotRow, pot_rows
from hybrid.prediction import Case, closed_form_case
from hybrid.ratetest import RateRow, rate_test, rate_warnings, static_check
from hybrid.record import full_scales, machine_facts, signal_units
from hybrid.roundoff import lost_constants
from hybrid.runs import check_windows, thinning
from hybrid.scale import time_scale_text, to_seconds, to_ticks
from hybrid.shots import ShotRow, check_shots
from hybrid.timeline import build_timeline, seldom_text
from hybrid.trial import Trial, Use, overflow_warnings, try_out, uses
from hybrid.wordlength import Kind
from hybrid.workload import TaskRow, ended_cycles, task_rows, to_dicts
from hybrid.workload import warnings as workload_warnings

if TYPE_CHECKING:
    import pandas as pd

# Of a delay's circuit, in rad.
PHASE_ERROR = 1e-3


@dataclass(frozen=True, slots=True)
class ScaleRow:
    """One analog signal: what it is, its full scale, its value at t = 0 and, where it integrates,
    its rate at t = 0 in machine units a second; what the trial run showed of it (see `trial.Use`)."""

    signal: str
    kind: str
    full_scale: float
    units: str
    value: float
    value_mu: float
    rate_mu: float | None
    largest: float | None = None
    used: float | None = None
    proposed: float | None = None
    remark: str = ""


@dataclass(frozen=True, slots=True)
class WordRow:
    """One fixed-point word: its length and full scale, and what the trial run showed of it."""

    word: str
    bits: int
    full_scale: float
    units: str
    overflow: str  # 'saturate', 'wrap' or 'stop'
    largest: float | None
    used: float | None
    proposed: float | None
    remark: str


@dataclass(frozen=True, slots=True)
class ConverterRow:
    """One ADC or DAC: what it converts, its word length as patched (None: none given), its range and,
    where this machine quantises, its step, both in `units`."""

    converter: str
    kind: str  # 'adc' or 'dac'
    converts: str
    bits: int | None
    range: float
    step: float | None
    units: str

    @property
    def remark(self) -> str:
        """What this machine makes of the word length."""
        if self.step is not None:
            return "quantises and clips"
        return "not rounded" if self.bits is None else "bits ignored"


@dataclass(frozen=True, slots=True)
class DelayRow:
    """One transport delay: its circuit's phase is right to PHASE_ERROR up to `good_to`, in rad/s."""

    delay: str
    time_s: float
    order: int
    good_to: float


@dataclass(frozen=True, eq=False)
class Check:
    """The findings, tuples of rows, in the order in which they are shown.

    machine: as it was compiled; trial: the trial run, None where there was none. scaling: a ScaleRow for
        each analog signal, full scale and value at t = 0 in its `units`, `..._mu` in machine units (a
        second for rates). rates: what the rate test found, in machine units a second. parts: how many
        of each kind. pots: settings from 0 to 1 with a gain. converters: range and step in `units`.
    loops: paths of signals; prediction, events: in words. tasks: times in s. delays: time_s in s,
        good_to in rad/s. shots: published values of models, in the file's units. warnings: what is
        valid but hardly meant, a line each.
    """

    machine: Machine
    trial: Trial | None
    scaling: tuple[ScaleRow, ...]
    rates: tuple[RateRow, ...]
    parts: tuple[Part, ...]
    pots: tuple[PotRow, ...]
    converters: tuple[ConverterRow, ...]
    loops: Loops
    prediction: str
    events: str
    warnings: tuple[str, ...] = ()
    tasks: tuple[TaskRow, ...] = ()  # the work of the digital machine
    delays: tuple[DelayRow, ...] = ()
    shots: tuple[ShotRow, ...] = ()  # published values of models, and what is found
    words: tuple[WordRow, ...] = ()  # of the program, in fixed point

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        return {
            **machine_facts(self.machine),
            "trial": self.trial.to_dict() if self.trial else None,
            "scaling": [asdict(row) for row in self.scaling],
            "words": [asdict(row) for row in self.words],
            "rate_test": [asdict(row) for row in self.rates],
            "parts": [asdict(part) for part in self.parts],
            "potentiometers": [asdict(row) for row in self.pots],
            "delays": [asdict(row) for row in self.delays],
            "converters": [{**asdict(row), "remark": row.remark} for row in self.converters],
            "loops": [asdict(loop) for loop in self.loops.listed],
            "loops_found": self.loops.found,
            "loops_in_program": self.loops.in_program,
            "loops_complete": self.loops.complete,
            "prediction": self.prediction,
            "events": self.events,
            "tasks": to_dicts(self.tasks),
            "shots": shots.to_dicts(self.shots),
            "warnings": list(self.warnings),
        }

    def to_pandas(self) -> pd.DataFrame:
        """The scaling table and static check, one row a signal."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self.scaling]).set_index("signal")

    def __repr__(self) -> str:
        lines = [
            f"<Check {self.machine.patch.title!r} on {self.machine.preset!r}: valid, {self.events}>"
        ]
        lines += [
            f"  {row.signal} ({row.kind}): full scale {row.full_scale:.6g} {row.units}".rstrip()
            + f"; {row.value + 0.0:.6g} {row.units}".rstrip()
            + " at t = 0"
            + (f"; {row.remark}" if row.remark else "")
            + (f"; {row.proposed:g} would do" if row.remark and row.proposed else "")
            for row in self.scaling
        ]
        lines += [f"  {row.converter} ({row.kind}): {row.remark}" for row in self.converters]
        lines += [f"  loop: {' -> '.join(loop.path)}" for loop in self.loops.listed]
        lines += [f"  {told}" for told in shots.columns(self.shots)[2]]
        lines += [f"  warning: {warning}" for warning in self.warnings]
        return "\n".join([*lines, f"  prediction: {self.prediction}"])


def check(
    patch: Source | Machine,
    parameters: Parameters | None = None,
    *,
    machine: str | None = None,
    serial: int | None = None,
    trial: bool = True,
) -> Check:
    """Compile the patch, try it out, and report what an operator checks.

    Args: patch: a patch, the file or shipped name of one, or a compiled machine; parameters: SI
    numbers or texts with units; trial: make a trial run, of some seconds at most. Returns a
    Check: tuples of rows, in the units that stand beside their figures. Raises PatchError and RunError
    for what is wrong.
    """
    compiled = machine_of(patch, parameters, machine, serial)
    check_windows(compiled)
    timeline = build_timeline(compiled)
    laid_out = task_rows(compiled, timeline)
    # Where clocks jitter, only the first stretches are laid out here.
    number = timeline.cycles if timeline.later else ended_cycles(compiled, laid_out)
    cycles = f"{counted(number, 'cycle')}, " if compiled.tape.words else ""
    events = f"{cycles}{counted(timeline.rows, 'row')} of the record"
    if compiled.operation:
        number = compiled.operation.done(compiled.timing.until)
        operate_s = to_seconds(compiled.operation.operate)
        events += f", {counted(number, 'operation')} of {operate_s:g} s"
    if compiled.time_scale != 1.0:
        events += f", {time_scale_text(compiled.time_scale)}"
    thinned = thinning_text(thinning(compiled, timeline.rows))
    tried = try_out(compiled) if trial else None
    values, rates = static_check(compiled)
    tested = rate_test(compiled, rates, tried)
    pots, rows = pot_rows(compiled), laid_out
    if tried and any(task.when for task in compiled.timing.tasks):
        rows = tried.tasks
    compared, disagreeing = check_shots(compiled.patch)
    used = uses(compiled, tried)
    return Check(
        compiled,
        tried,
        _scaling(compiled, values, rates, used),
        tested,
        count_parts(compiled, pots),
        pots,
        _converters(compiled),
        loops_of(compiled),
        _which_prediction(compiled),
        f"{events}, {thinned}" if thinned else events,
        (
            *_warnings(compiled),
            *_left_open(compiled.patch),
            *_never_finite(compiled),
            *overflow_warnings(compiled, tried),
            *rate_warnings(tested),
            *lost_constants(compiled),
            *asked_before(compiled),
            *workload_warnings(compiled, rows),
            *filter(None, [short_windows(compiled), seldom_text(compiled)]),
            *disagreeing,
        ),
        rows,
        _delays(compiled),
        tuple(compared),
        _words(compiled, used),
    )


def _left_open(patch: Patch) -> list[str]:
    """Inputs of models that nothing is connected to, and that have their initial values."""
    given = {
        (variable.place.file, variable.place.line): variable
        for model in patch.models
        for variable in model.inputs
    }
    found = []
    for entry in patch.program.assignments if patch.program else ():
        if not entry.hidden or ":" not in entry.word:  # the word as the program reads it
            continue
        variable = given.get((entry.place.file, entry.place.line))
        if variable is not None and variable.initial is not None:
            has = f"{variable.initial:g} {variable.units}"
            found.append(
                f"{entry.place}: input {known_as(entry.word)!r} is not connected; it has its "
                f"initialValue, {has}"
            )
    return found


def _delays(machine: Machine) -> tuple[DelayRow, ...]:
    """The transport delays, by name."""
    rows = []
    for component in sorted(machine.patch.components, key=lambda c: c.name):
        if component.kind == "delay":
            values = {k: v.number(machine.parameters) for k, v in component.values.items()}
            order, time_s = int(values.get("order", DEFAULT_ORDER)), values["time"]
            row = DelayRow(component.name, time_s, order, good_to(order, time_s, PHASE_ERROR))
            rows.append(row)
    return tuple(rows)


def _warnings(machine: Machine) -> tuple[str, ...]:
    """What is valid but hardly meant: a run or a window of which little or nothing is left."""
    timing, scope, patch = machine.timing, machine.parameters, machine.patch
    until_s = to_seconds(timing.until)
    found = []

    def warn(value: Value, what: str) -> None:
        found.append(f"{value.place}: {what}" if str(value.place) else what)

    if timing.until < timing.period:
        what = f"the run of {until_s:g} s is shorter than one cycle of {machine.cycle_s:g} s"
        warn(patch.run.until, what)
    if patch.run.every and timing.every > timing.until:
        every_s = to_seconds(timing.every)
        what = (
            f"every is {every_s:g} s, longer than the run of {until_s:g} s: the record has one row"
        )
        warn(patch.run.every, what)
    for dac in patch.dacs:
        if dac.begins_unknown:
            what = f"DAC {dac.name!r} is made for {dac.word!r}, whose value at t = 0 shows in a run only"
            found.append(
                f"{dac.place}: {what}, and begins at 0; add it to interface: with its initial"
            )
    for readout in patch.readouts:
        for edge, told in ((readout.start, "no row is read"), (readout.end, "it is read to there")):
            if edge and to_ticks(edge.number(scope)) > timing.until:
                what = f"{edge.what} is {edge.number(scope):g} s, after the end of the run"
                warn(edge, f"{what} at {until_s:g} s: {told}")
                break
    return (*found, *_coarse_products(machine), *_unscaled(machine))


def _coarse_products(machine: Machine) -> list[str]:
    """Products by diode squarers that err by more of their full scale than their segments say."""
    found = []
    scale = dict(zip(machine.analog.signals, machine.analog.full_scale.tolist(), strict=True))
    for component in machine.patch.components:
        if "quarter_square" not in component.values:
            continue
        values = {k: v.number(machine.parameters) for k, v in component.values.items()}
        a, b = component.signals
        most = abs(values.get("gain", 1.0)) * scale[a] * scale[b] / scale[component.name]
        if most > 1.0 + 1e-9:
            n = int(values["quarter_square"])
            found.append(
                f"{component.place}: {component.name!r} errs by up to {most / (4 * n * n):.2g} of its "
                f"full scale, not by 1/(4 n^2): its inputs at full scale make {most:.4g} of it"
            )
    return found


def _never_finite(machine: Machine) -> list[str]:
    """The first word that divides by 0 in every cycle, say, unless words before it are not linear."""
    try:
        linear_program(machine.tape, len(machine.samplers))
    except NeverFinite as reason:
        return [str(reason)]
    except NotLinear:
        pass
    return []


def _unscaled(machine: Machine) -> list[str]:
    """Fixed-point word lengths without a full scale, which few words fit into."""
    program = machine.patch.program
    given = [program.word, *program.lengths.values()] if program else []
    found = dict.fromkeys(w for w in given if w.kind is Kind.FIXED and w.full_scale is None)
    return [
        f"{w.place}: fixed: {w.bits} has no full_scale, so it is 1 in SI units; give one"
        for w in found
    ]


def _scaling(
    machine: Machine, values: list[float], rates: dict[str, float], used: dict[str, Use]
) -> tuple[ScaleRow, ...]:
    units, scales = signal_units(machine), full_scales(machine)
    kinds = {c.name: c.kind for c in machine.patch.components}
    return tuple(
        ScaleRow(
            name,
            kinds.get(name, "dac"),
            scales[name],
            units[name][0],
            value * scales[name],
            value,
            rates[name] if kinds.get(name) == "integrate" else None,
            used[name].largest,
            used[name].used,
            used[name].proposed,
            used[name].remark,
        )
        for name, value in zip(machine.analog.signals, values, strict=True)
    )


def _words(machine: Machine, used: dict[str, Use]) -> tuple[WordRow, ...]:
    """The fixed-point words of the program, by name."""
    units, scales = signal_units(machine), full_scales(machine)
    return tuple(
        WordRow(
            word,
            length.bits,
            scales[word],
            units[word][0],
            length.overflow.name.lower(),
            used[word].largest,
            used[word].used,
            used[word].proposed,
            used[word].remark,
        )
        for word, length in sorted(machine.tape.fixed.items())
    )


def _converters(machine: Machine) -> tuple[ConverterRow, ...]:
    units, scales = signal_units(machine), full_scales(machine)
    bits = {adc.name: adc.bits for adc in machine.patch.adcs}
    bits |= {dac.name: dac.bits for dac in machine.patch.dacs}
    signals, words = machine.analog.signals, machine.tape.words
    rows = [
        (s.name, "adc", signals[s.signal], s.step_mu / s.range_mu, s.clips)
        for s in machine.samplers
    ]
    rows += [(h.name, "dac", words[h.word], h.step_mu, h.clips) for h in machine.holders]
    return tuple(
        ConverterRow(
            name,
            kind,
            converts,
            bits[name],
            scales[name],
            step * scales[name] if step or clips else None,
            units[name][0],
        )
        for name, kind, converts, step, clips in rows
    )


def _which_prediction(machine: Machine) -> str:
    """In words: which exact and which closed-form prediction the patch has."""
    try:
        modes = coupling.modes(machine)
    except NotLinear as reason:
        return f"no exact prediction: {brief(reason)}"
    kind = "the exact one-cycle matrix" if machine.timing.period else "the exact analog matrix"
    if machine.timing.tasks:
        length_s = stretch_s(machine)
        kind = f"the exact matrix over {length_s:g} s, after which all tasks are where they were"
    case: Case | None = closed_form_case(machine)
    closed = (
        f"; closed form: Eq. {case.equation}" if case else "; no closed form of the paper applies"
    )
    real = sum(mode.omega_damped == 0 for mode in modes)
    parts = {"oscillating pair": len(modes) - real, "real pole": real}
    told = ", ".join(counted(number, what) for what, number in parts.items() if number)
    return f"{kind} ({counted(len(modes), 'mode')}{': ' + told if told else ''}){closed}"
