"""How many times real time the flights run, on one core, and JSBSim's F-16 beside them.

Processor time, so that other work of the computer does not count; everything is compiled before. A run
is of the same length and step on both sides, begins with a loaded model, and is repeated in turns with
the other side; the best of each counts.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from peers import by_jsbsim

import hybrid
from flights.flying import shipped, until
from hybrid.arguments import machine_of


@dataclass(frozen=True)
class Race:
    """A flight, its length, and the times real time that it is to reach."""

    case: str
    patch: str
    until_s: float
    goal: float
    beside_jsbsim: bool = False


RACES = (
    Race("11", "parts/f16", 30.0, 100.0, beside_jsbsim=True),
    Race("3", "tumbling_brick", 30.0, 1000.0),
)
# The goals are those of a machine with all its lags; with noise on every component it is shown beside.
MACHINES = ("lags", "nominal")
JUDGED = "lags"
REPEATS, QUICK_REPEATS = 5, 2


def row_of(race: Race, preset: str, quick: bool) -> dict[str, Any]:
    """One race on one machine; JSBSim's figure is None where it does not fly or is not installed."""
    patch = until(shipped(race.patch), race.until_s)
    machine = machine_of(patch, {}, preset, None)
    jsbsim = race.beside_jsbsim and by_jsbsim.installed()
    peer = by_jsbsim.F16(machine.cycle_s) if jsbsim else None
    hybrid.run(machine)
    ours, theirs = [], []
    for _ in range(QUICK_REPEATS if quick else REPEATS):
        begun = time.process_time()
        result = hybrid.run(machine)
        ours.append(time.process_time() - begun)
        assert result.status == "complete", result
        if peer:
            theirs.append(peer.fly(race.until_s))
    fastest = race.until_s / min(ours)
    peers = race.until_s / min(theirs) if theirs else None
    return {
        "case": race.case,
        "machine": preset,
        "step_s": machine.cycle_s,
        "until_s": race.until_s,
        "times_real_time": fastest,
        "jsbsim_times_real_time": peers,
        "goal": race.goal if preset == JUDGED else None,
        "meets_goal": bool(fastest >= race.goal) if preset == JUDGED else None,
        "as_fast_as_jsbsim": bool(fastest >= peers) if peers else None,
    }


def measure(quick: bool) -> list[dict[str, Any]]:
    """Every race on every machine."""
    return [row_of(race, preset, quick) for race in RACES for preset in MACHINES]
