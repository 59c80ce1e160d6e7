"""How a run ended, in words: its status, and what has to be known of it.

Stage 5, for `runs` and `trial`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid.asked_before import asked_before_text
from hybrid.engine import kernel
from hybrid.engine.beyond import DAC_SUFFIX
from hybrid.engine.linear import Player
from hybrid.engine.ranges import outside
from hybrid.errors import known_as
from hybrid.expressions import sub_expressions
from hybrid.indicators import overloads_of
from hybrid.machine import Machine
from hybrid.mathml import may_be_nothing
from hybrid.record import full_scales, signal_units
from hybrid.roundoff import word_lengths
from hybrid.scale import to_seconds, to_ticks
from hybrid.tables import STOPS
from hybrid.valueless import calls_any
from hybrid.wordlength import LARGEST_SINGLE, Kind
from hybrid.workload import load_text, task_rows

# Functions asked beyond their range that the note of a run tells of.
MOST_OUTSIDE = 3
# Functions that have no value for some arguments, which is told where a word calls them.
MOD, LIMITS = frozenset({"mod"}), frozenset({"limit", "dead_zone"})


def ending(player: Player) -> tuple[str, str]:
    """Status and note of a run that has come to its end, or could not go on."""
    if player.outcome in (kernel.RUNAWAY, kernel.NOT_RESOLVED):
        return "stopped", f"stopped at {player.done_s:.6g} s: {_lost_text(player)}"
    if player.outcome == kernel.DONE and player.timeline.why_stopped:
        return "stopped", f"stopped at {player.done_s:.9g} s: {player.timeline.why_stopped}"
    if player.outcome == kernel.OVERLOADED:
        first = overloads_of(player)[0]
        return "stopped", (
            f"stopped at {first.time_s:.9g} s: {first.signal} is beyond its full scale, and run: has "
            "on_overload: stop"
        )
    if player.outcome == kernel.OVERFLOWED:
        words = [o.signal for o in player.overloads() if o.signal in player.machine.tape.words]
        return "stopped", (
            f"stopped at {player.done_s:.9g} s: {known_as(words[-1])} does not fit into its word, whose "
            "overflow is to stop the run"
        )
    if player.outcome in (kernel.CHATTERS, kernel.GATHERS):
        why = player.why_ended or (
            "a comparator or limiter chatters: give it hysteresis, or what it drives a lag"
        )
        return "stopped", f"stopped at {player.done_s:.9g} s: {why}"
    if player.outcome == kernel.OUTSIDE:
        return "stopped", f"stopped at {player.done_s:.6g} s: {_stopper(player)}"
    if player.outcome == kernel.NOT_FINITE:
        words = [
            w
            for w, v in zip(player.machine.tape.words, player.state.words.tolist(), strict=True)
            if not np.isfinite(v)
        ]
        told = ", ".join(dict.fromkeys(map(known_as, words)))
        return "stopped", (
            f"stopped at {player.done_s:.6g} s: {_cycle_text(player)} the program computed no finite "
            f"number for {told} ({_causes_text(player.machine, words)})"
        )
    machine = player.machine
    tasks = machine.timing.tasks  # one program alone leaves out nothing
    rows = task_rows(machine, player.timeline, player.done_ticks) if tasks else ()
    notes = (
        _held_note(player),
        _short_note(machine),
        _late_readouts(machine),
        load_text(machine, rows),
        _left_out(player),
        _outside_note(player),
        asked_before_text(machine),
        *player.remarks(),
    )
    return "complete", "; ".join(filter(None, notes))


def _lost_text(player: Player) -> str:
    """Which signal the run was lost by, how far it had come and why, as far as that is known."""
    machine, lost = player.machine, player.lost
    units, scales = signal_units(machine), full_scales(machine)

    def shown(name: str, value_mu: float) -> str:
        known = name.removesuffix(DAC_SUFFIX)
        if known not in scales:  # inside of a component
            return f"{value_mu:.4g}"
        return f"{value_mu * scales[known]:.4g} {units[known][0]}".rstrip()

    name = known_as(lost.signal) if lost else "a signal"
    unknown = lost is None or lost.value_mu is None
    value = "" if unknown else shown(lost.signal, lost.value_mu)  # type: ignore[union-attr,arg-type]
    through = lost.through_zero if lost else ()
    told = " and ".join(f"{read} at {shown(read, at)}" for read, at in through)
    why = ""
    if len(through) == 1:
        why = f"its divisor is {told}"
    elif through:
        why = f"its angle jumps, with {told}"
    if player.outcome == kernel.NOT_RESOLVED:
        since = f" from {value} on" if value else ""
        return f"{name} changes too fast to follow{since}" + (f": {why}" if why else "")
    far = f", to {value}" if value else ""
    return (
        f"{name} went beyond {kernel.RUNAWAY_MU:.0e} times its full scale{far}; "
        f"{why or 'the patch is unstable'}"
    )


def _late_readouts(machine: Machine) -> str:
    """Which readouts would look at more than the run has; ''."""
    until_s = to_seconds(machine.timing.until)
    ends = [(r.name, r.end.number(machine.parameters)) for r in machine.patch.readouts if r.end]
    late = [f"{name} {end_s:.6g} s" for name, end_s in ends if end_s > until_s * (1 + 1e-12)]
    told = ", ".join(late)
    return f"readouts see the run's {until_s:.6g} s only, not all until {told}" if late else ""


def _causes_text(machine: Machine, words: Sequence[str]) -> str:
    """What may leave words without a finite number."""
    program = machine.patch.program
    written = [e for e in program.written if e.word in words] if program else []
    trees = [tree for entry in written for tree in entry.reads]
    divides = "a division or mod" if any(calls_any(t, MOD) for t in trees) else "a division"
    causes = [
        f"a <piecewise> without <otherwise> of which no piece holds, in {known_as(e.word)} ({e.place})"
        for e in written
        if any(may_be_nothing(node) for tree in e.reads for node in sub_expressions(tree))
    ]
    causes += [f"a number beyond {_largest_text(machine, words)}", f"{divides} by zero"]
    if any(calls_any(tree, LIMITS) for tree in trees):
        causes.append("limits of which the low one is above the high one")
    return f"{', '.join(causes)}, or a root or logarithm of a negative number"


def _largest_text(machine: Machine, words: Sequence[str]) -> str:
    """The largest number that words may hold."""
    lengths = word_lengths(machine.patch.program, machine.parameters)
    single = f"{LARGEST_SINGLE:.2g}, the largest float32"
    found = {single if lengths[word].kind is Kind.SINGLE else "1.8e308" for word in words}
    return " or ".join(sorted(found))


def _stopper(player: Player) -> str:
    """The call that was to stop the run, and why."""
    found = next(o for o in outside(player) if o.action == STOPS)
    return f"{found}, and is declared with outside: stop"


def _outside_note(player: Player) -> str:
    """Which functions of the program were asked beyond their range; ''."""
    found = outside(player)
    more = f"; and {len(found) - MOST_OUTSIDE} more" if len(found) > MOST_OUTSIDE else ""
    return "; ".join(map(str, found[:MOST_OUTSIDE])) + more


def _held_note(player: Player) -> str:
    """Since when and why the machine is in HOLD after an overload; '' where it is not."""
    if player.held_s is None:
        return ""
    first = overloads_of(player)[0].signal
    return f"in HOLD since {player.held_s:.9g} s: {first} went beyond its full scale"


def operations_done(player: Player) -> int:
    """How many times OP has come to its end by the machine's clock; in HOLD for good none does."""
    operation, held_s = player.machine.operation, player.held_s
    if operation is None:
        return 0
    return operation.done(player.done_ticks if held_s is None else to_ticks(held_s))


def one_row_text(player: Player) -> str:
    """That the record shows the beginning only; '' where it has more rows, or none."""
    if len(player.record) != 1:
        return ""
    timing = player.machine.timing
    every_s, until_s = (to_seconds(ticks) for ticks in (timing.every, timing.until))
    if timing.every > timing.until:
        why = f"a row every {every_s:g} s in a run of {until_s:g} s"
    else:
        why = "max_rows in run: leaves no room for another"
    return f"{why}: the record has one row, at 0 s"


def _left_out(player: Player) -> str:
    """What the engine does not play of this machine; ''."""
    machine = player.machine
    if player.plays_noise:
        return ""
    sources = {c.name for c in machine.patch.components if c.kind == "noise_source"}
    noisy = sorted(n for n, stage in machine.stages.items() if stage.noise > 0.0 or n in sources)
    if not noisy:
        return ""
    return (
        "noise left out: the reference engine plays none "
        f"({', '.join(noisy[:3])}{' ...' if len(noisy) > 3 else ''})"
    )


def _short_note(machine: Machine) -> str:
    """What a run that ends before its digital machine has had a say does not show; '' otherwise."""
    timing, notes = machine.timing, []
    if not timing.period:
        return ""
    if timing.until < timing.period:
        notes.append(f"the first cycle of {to_seconds(timing.period):.6g} s is over")
    if timing.until < machine.latency_ticks and not timing.tasks:
        reached_s = to_seconds(machine.latency_ticks)
        notes.append(f"the program's first results reach the DACs at {reached_s:.6g} s")
    before = " and ".join(notes)
    return f"the run ends at {to_seconds(timing.until):.6g} s, before {before}" if notes else ""


def _cycle_text(player: Player) -> str:
    """The cycle, counted from 1, whose result a run has just met."""
    if player.machine.timing.tasks:
        return "in a cycle that ended then,"
    period = player.machine.timing.period
    before = (player.done_ticks - player.machine.latency_ticks) // period
    return f"in cycle {before + 1}, which began at {to_seconds(before * period):.6g} s,"
