"""A trial run: how far analog signals and fixed-point words go, and which full scales would hold them.

Stage 6, for `checks`. It is a run of the machine as it is compiled, but without the components' own
noise, which needs no range and would hide a rate, and on through overloads. Noise sources are signals of
the patch, and play as in a run of SEED. Nothing is written. It is cut where it takes longer than an
operator would wait, and says so.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid.endings import ending
from hybrid.engine import kernel
from hybrid.engine.beyond import DAC_SUFFIX
from hybrid.engine.linear import Player
from hybrid.engines import player_of
from hybrid.machine import AT_SATURATION, Floats, Machine, Pen
from hybrid.record import full_scales, signal_units
from hybrid.scale import to_seconds
from hybrid.timeline import build_timeline
from hybrid.wordlength import Overflow
from hybrid.workload import TaskRow, task_rows

SEED = 0
# Wall time after which a trial run is cut; what the kernels take to compile is not counted.
LONGEST_WALL_S = 5.0
# Numbers kept of it at a time, 3 MB.
MOST_KEPT = 400_000
# A signal that stays below this share of its full scale loses a digit of a four-digit machine.
LITTLE = 0.1
# Above this share nothing is left for tolerance and noise, 0.01 % each of a machine of 1964: a precision
# part's tolerance and nine standard deviations of its noise.
NO_HEADROOM = 0.999
# Full scales that read well on a meter, and what rounding may add to a signal that just fills one.
ROUND = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
SLACK = 1e-9
DOES = {Overflow.SATURATE: "saturates", Overflow.WRAP: "wraps", Overflow.STOP: "stops the run"}
# What an operator leaves above the largest value: twice the widest tolerance of `machines`, 2.1 %, and
# some for its noise.
HEADROOM = 0.05


@dataclass(frozen=True, slots=True)
class Trial:
    """What the trial run showed. `rates_mu`: mean rate of every signal over the first `interval_s`,
    machine units a second."""

    played_s: float
    of_s: float
    status: str  # 'complete', 'cut' or 'stopped'
    note: str
    largest_mu: dict[
        str, float
    ]  # largest magnitude, of fixed-point words in their full scales, too
    held_back: frozenset[
        str
    ]  # signals that a saturation, converter or word kept from going further
    overflown: tuple[str, ...]  # fixed-point words that went beyond their range
    interval_s: float
    rates_mu: dict[str, float]
    tasks: tuple[TaskRow, ...]  # how the digital machine did in it
    tells: bool  # whether the magnitudes mean anything: not those of a run that ran away

    def to_dict(self) -> dict[str, Any]:
        """How it went, as plain data; the figures stand with their signals."""
        return {
            "played_s": self.played_s,
            "of_s": self.of_s,
            "status": self.status,
            "note": self.note,
            "interval_s": self.interval_s,
        }


def try_out(machine: Machine, longest_wall_s: float | None = None) -> Trial:
    """Play the machine to its end, or for `longest_wall_s`, and see how far its signals go."""
    limit_s = LONGEST_WALL_S if longest_wall_s is None else longest_wall_s
    machine = _without_own_noise(machine)
    signals = machine.analog.signals
    pens = tuple(Pen(name, "analog", i, 1.0) for i, name in enumerate(signals)) + _of_words(machine)
    most_cues = max(MOST_KEPT // max(len(pens), 1), 2)
    player = player_of(machine)(machine, build_timeline(machine), pens, SEED, sys.maxsize)
    # Every row is looked at and forgotten, so that no length of run fills the memory.
    player.rows, player.keep_every = np.empty((most_cues, len(pens))), 1
    head, largest = np.zeros((0, len(pens))), np.zeros(len(pens))
    began: float | None = None
    while player.outcome == kernel.PAUSED:
        if began is not None and time.monotonic() - began >= limit_s:
            note = f"cut at {player.done_s:.6g} s, after {limit_s:g} s of computing"
            return _seen(machine, player, ("cut", note), largest, head)
        player.play_cues(most_cues)
        largest = np.maximum(largest, np.max(np.abs(player.record), axis=0, initial=0.0))
        head = np.vstack([head, player.record[:2]])[:2]
        player.state.counts[kernel.ROWS] = 0
        began = began or time.monotonic()
    return _seen(machine, player, ending(player), largest, head)


def _of_words(machine: Machine) -> tuple[Pen, ...]:
    """The fixed-point words of the program, each in its full scale."""
    words, fixed = machine.tape.words, machine.tape.fixed
    return tuple(Pen(w, "word", words.index(w), 1.0 / fixed[w].full_scale) for w in sorted(fixed))


def _without_own_noise(machine: Machine) -> Machine:
    """Nor does it end at an overload: how far a signal would go is what is asked."""
    sources = {c.name for c in machine.patch.components if c.kind == "noise_source"}
    quiet = {name: replace(stage, noise=0.0) for name, stage in machine.stages.items()}
    analog = machine.analog
    # What generates a noise source is a state of its own, before the output lag where it has one.
    generators = {f"{s}:core" if f"{s}:core" in analog.states else s for s in sources}
    own = [i for i, state in enumerate(analog.states) if state not in generators]
    noise = analog.noise.copy()
    noise[own] = 0.0
    analog = replace(analog, noise=noise[:, np.any(noise != 0.0, axis=0)])
    # Of elements, only generators are loud.
    elements = tuple((name, e if e.loud else replace(e, noise=0.0)) for name, e in machine.elements)
    run = replace(machine.patch.run, on_overload="continue")
    patch = replace(machine.patch, run=run)
    return replace(machine, patch=patch, analog=analog, stages=quiet, elements=elements)


def _seen(
    machine: Machine, player: Player, end: tuple[str, str], peaks: Floats, head: Floats
) -> Trial:
    """head: the first rows."""
    signals, words = machine.analog.signals, machine.tape.fixed.keys()
    largest = _by_name((*signals, *sorted(words)), peaks)
    held_back = set()
    overflown = [o.signal for o in player.overloads() if o.signal in words]
    for overload in player.overloads():
        name = overload.signal.removesuffix(DAC_SUFFIX)
        if name not in largest:
            continue  # an ADC's range is a share of the full scale of what it samples
        if name != overload.signal and any(h.name == name and h.clips for h in machine.holders):
            held_back.add(name)
        largest[name] = max(largest[name], abs(overload.worst_mu))
    for holder in machine.holders:
        if machine.tape.words[holder.word] in overflown:
            held_back.add(holder.name)
    for name in machine.logic:  # levels: what tolerance adds to them needs no range
        largest[name] = min(largest[name], 1.0)
    for name in signals:
        if largest[name] >= AT_SATURATION * machine.stages[name].saturation:
            held_back.add(name)
    interval_s = to_seconds(machine.timing.every)
    rates = (head[1] - head[0]) / interval_s if len(head) > 1 else np.full(len(peaks), math.nan)
    return Trial(
        player.done_s,
        to_seconds(machine.timing.until),
        *end,
        largest,
        frozenset(held_back | set(overflown)),
        tuple(sorted(overflown)),
        interval_s,
        _by_name(signals, rates[: len(signals)]),
        task_rows(machine, player.timeline, player.done_ticks),
        player.outcome != kernel.RUNAWAY,
    )


def _by_name(signals: tuple[str, ...], values: Floats) -> dict[str, float]:
    return dict(zip(signals, values.tolist(), strict=True))


def round_above(value: float, headroom: float = HEADROOM) -> float:
    """A round full scale for a largest magnitude: the next of 1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8 times a
    power of ten that leaves `headroom`, a share of the value, so with any never the value itself."""
    least = value * (1.0 + headroom)
    power = math.floor(math.log10(least))
    for digit in ROUND:
        found = float(f"{digit:g}e{power}")
        if found >= least * (1.0 - SLACK):
            return found
    return float(f"1e{power + 1}")


@dataclass(frozen=True, slots=True)
class Use:
    """How much of its range a signal uses: largest magnitude and the full scale proposed, in the unit
    it is shown in; remark: '', or what is wrong with the full scale it has."""

    largest: float | None = None
    used: float | None = None  # share of full scale
    proposed: float | None = None
    remark: str = ""


def uses(machine: Machine, trial: Trial | None) -> dict[str, Use]:
    """The use of every analog signal and fixed-point word; nothing is known of it without a trial run,
    or after one that ran away."""
    signals, scales = (*machine.analog.signals, *machine.tape.fixed), full_scales(machine)
    if trial is None or not trial.tells:
        return dict.fromkeys(signals, Use())
    return {name: _use(trial, name, scales[name], name in machine.logic) for name in signals}


def overflow_warnings(machine: Machine, trial: Trial | None) -> list[str]:
    """Fixed-point words that went beyond their range, with what becomes of them there."""
    if trial is None or not trial.tells:
        return []
    units, scales = signal_units(machine), full_scales(machine)
    found = []
    for word in trial.overflown:
        does = DOES[machine.tape.fixed[word].overflow]
        unit = units[word][0]
        went = f"{trial.largest_mu[word] * scales[word]:.5g} {unit}".strip()
        found.append(
            f"fixed-point word {word!r} would go to {went} in the trial run, beyond its full_scale of "
            f"{scales[word]:.6g} {unit}".rstrip()
            + f", and {does}: what follows from it, and the full scales proposed for that, are not what "
            "they would be"
        )
    return found


def _use(trial: Trial, name: str, full_scale: float, is_level: bool) -> Use:
    """is_level: of a comparator, whose high and low need no headroom, as nothing watches them."""
    used = trial.largest_mu[name]
    found = Use(used * full_scale, used)
    if name in trial.held_back:
        return replace(found, remark="held back, so it needs more than that")
    if used == 0.0:
        return replace(found, remark="stays at zero")
    headroom = 0.0 if is_level else HEADROOM
    found = replace(found, proposed=round_above(used * full_scale, headroom))
    if used > 1.0 + SLACK:
        return replace(found, remark="beyond its range")
    if used > NO_HEADROOM and not is_level:
        return replace(found, remark="no headroom")
    return replace(found, remark="below 10 %") if used < LITTLE else found
