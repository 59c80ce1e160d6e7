"""Patch -> Machine: bind parameters, scale to machine units, lay out states, reject what cannot work.

Stage 3. `layout` makes the analog side, `tape` the program; here are the machine's own errors, the
converters and the timing.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping

from hybrid.circuits import Elements, build_circuit, is_linear
from hybrid.errors import PatchError, RunError, did_you_mean, quoted
from hybrid.layout import build_analog
from hybrid.machine import (
    Analog,
    Holder,
    Machine,
    Operation,
    Sampler,
    StepEvent,
    Timing,
)
from hybrid.machines import PRESETS, Preset
from hybrid.memo import KeptByUse
from hybrid.modes import HOLD, IC, OP, TIMED_MODE
from hybrid.output_stages import make_of, stages_of, step_mu
from hybrid.patch import Adc, Dac, Patch
from hybrid.scale import to_seconds
from hybrid.tape import Tape
from hybrid.taping import build_tape
from hybrid.tasks import counted_ticks, task_of_adc, task_of_dac, task_timings, ticks_of
from hybrid.valueless import refuse_valueless

# A run of more cycles than this would take hours; it is refused before anything is computed.
MOST_CYCLES = 10**11
# A pipeline deeper than this is a slip of the pen, not a design.
DEEPEST_PIPELINE = 1000
# Numbers in the record, 0.8 GB.
MOST_RECORDED = 10**8
LARGEST_SERIAL = 2**63 - 1
LARGEST_TIME_SCALE = 1e9
LARGEST_POT_RESOLUTION = 0.1
# An ADC's range, as a fraction of its signal's full scale, or the inverse of it.
SMALLEST_RANGE = 1e-12


def compile_patch(
    patch: Patch,
    overrides: Mapping[str, float] | None = None,
    machine: str | None = None,
    serial: int | None = None,
    as_circuit: bool = False,
) -> Machine:
    """Compile for parameter values `overrides` (SI) on the machine preset named `machine`.

    Args: machine and serial replace what the patch asks for; as_circuit: lay out even a linear analog
    side as elements. Raises PatchError for whatever is wrong
    with the patch, RunError for an unknown preset.
    """
    # No sign of 0, so that equal numbers are the same number.
    given = tuple([(name, number + 0.0) for name, number in (overrides or {}).items()])
    return _compiled(patch, given, machine, serial, as_circuit)


# Many runs differ in their seeds alone.
@functools.lru_cache(maxsize=64)
def _compiled(
    patch: Patch,
    given: tuple[tuple[str, float], ...],
    machine: str | None,
    serial: int | None,
    as_circuit: bool,
) -> Machine:
    overrides = dict(given)
    scope = patch.bind(overrides)
    preset = find_preset(patch, machine)
    serial = patch.machine.serial if serial is None else serial
    if not 0 <= serial <= LARGEST_SERIAL:
        raise RunError(f"serial is {serial}; it must be a whole number from 0 to 2^63 - 1")
    time_scale = _time_scale(patch, scope)
    resolution = 0.0 if machine else _pot_resolution(patch, scope)
    make = make_of(scope, patch, preset.name, bool(machine), time_scale, resolution)
    stages = stages_of(make, serial)
    elements: Elements = ()
    operating, has_modes = None, patch.has_modes
    linear = is_linear(patch) and not make.saturates
    if linear and not has_modes and not as_circuit:
        analog, steps = build_analog(patch, scope, stages)
    else:
        analog, steps, elements = build_circuit(patch, scope, stages)
        operating = build_analog(patch, scope, stages)[0] if linear and has_modes else None
    operation = _operation(patch, scope)
    if operation:
        steps += _mode_changes(operation, analog.inputs.index(TIMED_MODE))
    tape = _tape(scope, patch)
    timing = _timing(scope, patch, tape, time_scale)
    samplers, holders = _converters(scope, patch, preset.name, analog, tape, timing, time_scale)
    return Machine(
        patch,
        preset.name,
        serial,
        scope,
        overrides,
        stages,
        analog,
        samplers,
        holders,
        steps,
        tape,
        timing,
        elements,
        operation,
        time_scale,
        operating,
    )


# What follows is kept for runs that look up the same figures: T changes the program only where it is
# written in it.
@KeptByUse
def _tape(scope: Mapping[str, float], patch: Patch) -> Tape:
    steps = _steps_s(patch, scope)
    refuse_valueless(patch.program, scope)
    return build_tape(patch.program, tuple(adc.name for adc in _adcs(patch)), scope, steps)


def _steps_s(patch: Patch, scope: Mapping[str, float]) -> tuple[float, ...]:
    """Step of the integration formulas of each program; 0 where there are none, so that the tape is one
    for every T."""
    return tuple(
        to_seconds(ticks_of(single.period, scope)) if single.states else 0.0
        for single in (patch.program.programs if patch.program else ())
    )


def _adcs(patch: Patch) -> list[Adc]:
    return sorted(patch.adcs, key=lambda adc: adc.name)


def find_preset(patch: Patch, machine: str | None) -> Preset:
    """The preset named by the caller or the patch; raises RunError or PatchError."""
    name = machine or patch.machine.preset
    if name not in PRESETS:
        message = f"unknown machine {quoted(name)}; {did_you_mean(name, PRESETS)}"
        raise RunError(message) if machine else PatchError(message, patch.machine.place)
    return PRESETS[name]


def _time_scale(patch: Patch, scope: Mapping[str, float]) -> float:
    """Problem seconds in a machine second."""
    if patch.time_scale is None:
        return 1.0
    found = patch.time_scale.number(scope)
    if not 1.0 / LARGEST_TIME_SCALE <= found <= LARGEST_TIME_SCALE:
        raise PatchError(
            f"time_scale is {found:g}; it must be from {1.0 / LARGEST_TIME_SCALE:g} to "
            f"{LARGEST_TIME_SCALE:g} problem seconds in a machine second",
            patch.time_scale.place,
        )
    return found


def _pot_resolution(patch: Patch, scope: Mapping[str, float]) -> float:
    """Step of the potentiometers' settings."""
    value = patch.machine.pot_resolution
    found = value.number(scope) if value else 0.0
    if value and found > LARGEST_POT_RESOLUTION:
        raise PatchError(
            f"pot_resolution is {found:g}; it is a step of settings from 0 to 1, so at most "
            f"{LARGEST_POT_RESOLUTION:g} (1e-4: dials of four digits)",
            value.place,
        )
    return found


@KeptByUse
def _converters(
    scope: Mapping[str, float],
    patch: Patch,
    preset_name: str,
    analog: Analog,
    tape: Tape,
    timing: Timing,
    time_scale: float,
) -> tuple[tuple[Sampler, ...], tuple[Holder, ...]]:
    """The converters, by name."""
    preset, scales = (
        PRESETS[preset_name],
        dict(zip(analog.signals, analog.full_scale.tolist(), strict=True)),
    )
    dacs = sorted(patch.dacs, key=lambda dac: dac.name)
    return (
        tuple(
            _sampler(a, patch, analog, scales, preset, scope, timing, time_scale)
            for a in _adcs(patch)
        ),
        tuple(_holder(d, patch, analog, tape.words, scales, preset) for d in dacs),
    )


def _sampler(
    adc: Adc,
    patch: Patch,
    analog: Analog,
    scales: Mapping[str, float],
    preset: Preset,
    scope: Mapping[str, float],
    timing: Timing,
    time_scale: float,
) -> Sampler:
    assert patch.program is not None
    ranks = [task.rank for task in timing.tasks]
    task = task_of_adc(adc, patch.program, ranks) if ranks else 0
    period = timing.tasks[task].period if timing.tasks else timing.period
    full_scale = scales[adc.source]
    range_mu = adc.range.number(scope) / full_scale if adc.range else 1.0
    if adc.range and not SMALLEST_RANGE <= range_mu <= 1.0 / SMALLEST_RANGE:
        raise PatchError(
            f"{adc.range.what} is {range_mu:.3g} times the full scale of {adc.source!r}; "
            "it must be comparable",
            adc.range.place,
        )
    skew = ticks_of(patch.program.skew, scope, time_scale)
    conversion = ticks_of(adc.conversion_time, scope, time_scale)
    if adc.conversion_time and period and conversion >= period:
        raise PatchError(
            f"{adc.conversion_time.what} is {to_seconds(conversion):g} s, not shorter than the period: "
            "the ADC would still be converting when it must take its next sample",
            adc.conversion_time.place,
        )
    if period and adc.channel * skew > DEEPEST_PIPELINE * period:
        raise PatchError(
            f"ADC {adc.name!r} samples more than {DEEPEST_PIPELINE} periods late, channel times skew; "
            "lower one of them or lengthen the period",
            adc.place,
        )
    return Sampler(
        adc.name,
        analog.signals.index(adc.source),
        full_scale,
        range_mu,
        step_mu(adc.bits, range_mu, preset),
        not preset.converters_exact,
        adc.channel * skew,
        conversion,
        task,
    )


def _holder(
    dac: Dac,
    patch: Patch,
    analog: Analog,
    words: tuple[str, ...],
    scales: Mapping[str, float],
    preset: Preset,
) -> Holder:
    program = patch.program
    return Holder(
        dac.name,
        words.index(dac.word),
        analog.inputs.index(dac.name),
        1.0 / scales[dac.name],
        step_mu(dac.bits, 1.0, preset),
        not preset.converters_exact,
        task_of_dac(dac, program) if program and program.tasks else 0,
    )


def _mode_changes(operation: Operation, held: int) -> tuple[StepEvent, ...]:
    """What time makes of the held input that is the machine's mode."""
    end, every, times = operation.reset + operation.operate, operation.length, operation.count
    changes = [(IC, 0), (OP, operation.reset)] + ([(HOLD, end)] if operation.hold else [])
    steps = [StepEvent(TIMED_MODE, held, float(mode), at, every, times) for mode, at in changes]
    if times and not operation.hold:
        last = (times - 1) * every + end
        steps.append(StepEvent(TIMED_MODE, held, float(HOLD), last))
    return tuple(steps)


def _operation(patch: Patch, scope: Mapping[str, float]) -> Operation | None:
    """What time makes of the machine's mode."""
    modes = patch.modes
    if modes is None or modes.operate is None:
        return None
    reset, operate, hold = (ticks_of(t, scope) for t in (modes.reset, modes.operate, modes.hold))
    return Operation(reset, operate, hold, modes.operations)


@KeptByUse
def _timing(scope: Mapping[str, float], patch: Patch, tape: Tape, time_scale: float) -> Timing:
    program, run = patch.program, patch.run
    period = ticks_of(program.period, scope) if program else 0
    compute = period
    tasks = task_timings(program, tape, scope, time_scale) if program else ()
    if tasks:
        period = min((t.period for t in tasks if t.period), default=0)
        compute = max(t.compute for t in tasks)
    elif program and program.counted:
        compute = counted_ticks(program, tape, 0, scope, time_scale)
    elif program and program.compute_time:
        compute = ticks_of(program.compute_time, scope, time_scale)
    every = ticks_of(run.every, scope) if run.every else period
    until = ticks_of(run.until, scope)
    timing = Timing(period, compute, every, until, tasks, program is None or program.preemptive)
    _check_timing(patch, timing)
    return timing


def _check_timing(patch: Patch, timing: Timing) -> None:
    """Refuse what would run for hours or fill the memory."""
    program, run = patch.program, patch.run
    shortest = min(t for t in (timing.period, timing.every) if t)
    if timing.until // shortest > MOST_CYCLES:
        what = run.every if run.every and timing.every == shortest else run.until
        raise PatchError(
            f"the run has {timing.until / shortest:.3g} cycles or rows; at most {MOST_CYCLES:.0e} "
            "are possible, so shorten the run or lengthen the period or the record interval",
            what.place,
        )
    if program and not timing.tasks and timing.compute > DEEPEST_PIPELINE * timing.period:
        raise PatchError(
            f"compute_time is {timing.compute / timing.period:.3g} periods; at most "
            f"{DEEPEST_PIPELINE} are possible",
            program.compute_time.place if program.compute_time else program.place,
        )
    kept = len(patch.record or patch.signals)
    rows = min(timing.until // timing.every + 1, run.max_rows)
    if rows * kept > MOST_RECORDED:
        raise PatchError(
            f"the record would hold {rows} rows of {kept} signals; at most {MOST_RECORDED:.0e} "
            "numbers are possible, so lower max_rows or name fewer signals under record:",
            run.until.place,
        )
