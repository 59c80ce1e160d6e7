"""The nonlinear engine: wall time beside other integrators, of 60 components, and of batches.

  radau_ratio   SciPy's Radau (right-hand side compiled by numba) over Hybrid on Van der Pol with a lag
                of 1 us in each component, each second of machine time, at equal accuracy: the
                loosest tolerance at which Radau errs less than Hybrid, or the tightest tried
  heyoka_ratio  Hybrid over heyoka, a Taylor integrator, on Van der Pol without lags, likewise; null
                where heyoka is not installed (extra `peers`)
  machine_s_per_wall_s_60, ..._60_dac
                a patch of 60 lagged components that oscillates at 1 kHz, without and with a DAC step
                every ms: smooth (mu = 0.2), of which the figure is; beside it mild (corners of two
                function generators, eight a period) and strong (mu = 2, corners of six)
  batch_efficiency
                a batch of 1,000 runs of 200 ms, of a ms of wall time each: wall time of one run at a time
                over twice that of two. Beside it that of two processes that share nothing, which is what
                the cores give; and runs of 20 ms, all of them as quick as two processes are made

Every figure stands beside the error it was reached with: the largest difference from a tight reference
at the end of a run, of full scale. Times of Hybrid are whole calls: patch compiled, run played, rows
kept. The line at the end says whether the errors are within 1e-7, not whether a goal was met.
"""

from __future__ import annotations

import multiprocessing
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from bench import Options, Table, finish, parse_options
from peers import by_heyoka
from peers.by_scipy import RATE, plain_radau, radau

import hybrid

MOST_ERROR = 1e-7  # of full scale: a thousandth of what a component of 0.01 % errs by
SCALES = np.array([2.5, 3.0])  # of x and y
SPANS = ("200 ms", "20 ms")  # of the runs of batches
TOLERANCES = (1e-7, 1e-8, 1e-9, 1e-10)

VAN_DER_POL = """
title: Van der Pol, one row at the end
machine: lags
parameters: {start: 0.5, until: 20 ms}
analog:
  x: {integrate: {y: 1000 1/s}, initial: start, full_scale: 2.5}
  y: {integrate: {x: -1000 1/s, y: 1000 1/s, damping: -1000 1/s}, initial: 0, full_scale: 3}
  square: {multiply: [x, x], full_scale: 6.25}
  damping: {multiply: [square, y], full_scale: 5}
run: {until: until, every: until}
record: [x, y]
readouts: {last: {final: x}}
"""


def timed(call: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Median wall time after one call to warm up (of that one, without repeats), and what it gave."""
    times, found = [], None
    for _ in range(repeats + 1):
        began = time.perf_counter()
        found = call()
        times.append(time.perf_counter() - began)
    return statistics.median(times[1:] or times), found


# -- beside other integrators -----------------------------------------------------------------------


def van_der_pol(machine: str) -> Callable[[float], np.ndarray]:
    """until_s -> x and y; the patch is read once, so that calls are runs only, as with the peers.

    Only the first row and the last are kept.
    """
    patch = hybrid.parse_patch(VAN_DER_POL)
    return lambda until_s: hybrid.run(patch, {"until": until_s}, machine=machine).rows[-1]


def peer_rows(options: Options) -> list[dict[str, Any]]:
    """Wall seconds for a machine second, error and ratio, of each integrator."""
    until_s = 4e-3 if options.quick else 20e-3
    exact = radau(until_s, 1e-12)
    plays = {f"Radau {t:.0e}": (lambda u, t=t: radau(u, t)) for t in TOLERANCES}
    if not options.quick:
        plays["Radau 1e-08, not compiled"] = lambda u: plain_radau(u, 1e-8)
    rows = compared("with lags", "lags", exact, until_s, plays, options)
    if by_heyoka.installed():
        taylors = {f"heyoka {t:.0e}": by_heyoka.taylor(t) for t in (1e-6, *TOLERANCES, 1e-12)}
        exact = by_heyoka.taylor(1e-16)(until_s)
        rows += compared("without lags", "ideal", exact, until_s, taylors, options)
    return rows


def compared(
    what: str,
    machine: str,
    exact: np.ndarray,
    until_s: float,
    peers: dict[str, Callable[[float], np.ndarray]],
    options: Options,
) -> list[dict[str, Any]]:
    """Hybrid first. Its runs are longer, so that what a run costs once is a small part."""
    long_s = until_s if options.quick else 1.0
    ours = van_der_pol(machine)
    error = off(ours(until_s), exact)
    taken, _ = timed(lambda: ours(long_s), 1 if options.quick else 3)
    rows = [row(what, "Hybrid", taken / long_s, error, 1.0)]
    played_s, repeats = (until_s, 0 if options.quick else 1) if what == "with lags" else (long_s, 3)
    for name, play in peers.items():
        taken, ends = timed(lambda play=play: play(played_s), repeats)
        if played_s != until_s:
            ends = play(until_s)
        wall_s = taken / played_s
        rows.append(row(what, name, wall_s, off(ends, exact), wall_s / rows[0]["wall_s"]))
    return rows


def off(ends: np.ndarray, exact: np.ndarray) -> float:
    return float(np.max(np.abs(ends - exact) / SCALES))


def row(what: str, name: str, wall_s: float, error: float, ratio: float) -> dict[str, Any]:
    agrees = bool(error <= MOST_ERROR) if name == "Hybrid" else None
    facts = {"case": what, "program": name, "wall_s": wall_s, "error": error, "over_hybrid": ratio}
    return facts | ({"agrees": agrees} if agrees is not None else {})


def at_equal_accuracy(rows: list[dict[str, Any]], peer: str) -> dict[str, Any] | None:
    """The loosest tolerance at which the peer errs no more than Hybrid, or else its tightest."""
    found = [r for r in rows if r["program"].startswith(peer) and "not" not in r["program"]]
    if not found:
        return None
    own = next(r for r in rows if r["program"] == "Hybrid" and r["case"] == found[0]["case"])
    return next((r for r in found if r["error"] <= own["error"]), found[-1])


# -- 60 components ----------------------------------------------------------------------------------


def sixty(mu: float, generators: int, dac: bool) -> str:
    """A 1 kHz oscillator of Van der Pol's kind, in full scales of 1, with groups that hang on it."""
    lines = [
        "x: {integrate: {v_out: w}, initial: 0.5, full_scale: 1}",
        "v: {integrate: {x_out: -w, drive: w, mixed: 1e-3*w}, initial: 0, full_scale: 2}",
        "x_out: {sum: {x: 1}, full_scale: 1}",
        "v_out: {sum: {v: 1}, full_scale: 2}",
        "square: {multiply: [x, x], full_scale: 1}",
        "bracket: {sum: {one: 1, square: -8}, full_scale: 8}",
        "drive: {multiply: [bracket, slow], full_scale: 8}",
        "one: {constant: 1, full_scale: 1}",
        "slow: {coefficient: {v_out: mu}, full_scale: 4}",
    ]
    mixed = {}
    if dac:
        mixed["step"] = "20"
    for group in range((60 - len(lines)) // 5):
        lines += list(group_of(group, group < generators))
        mixed[f"mean_{group}"] = str((-1) ** group)
    while len(lines) < 59:
        lines.append(f"spare_{len(lines)}: {{invert: x, full_scale: 1}}")
    terms = ", ".join(f"{name}: {gain}" for name, gain in mixed.items())
    lines.append(f"mixed: {{sum: {{{terms}}}, full_scale: 20}}")
    return SIXTY.format(mu=mu, body="\n  ".join(lines), machine=MACHINE if dac else "")


def group_of(group: int, bent: bool) -> Iterator[str]:
    """An integrator that tracks the oscillation, a product, a sum, a pot, and a function or inverter."""
    share = 0.3 + 0.05 * group
    yield f"p_{group}: {{multiply: [x, v_out], full_scale: 1}}"
    yield f"s_{group}: {{sum: {{p_{group}: 0.5, x_out: {share}}}, full_scale: 1}}"
    if bent:
        points = f"{{-1: -0.8, {-share / 2}: -0.2, {share / 2}: 0.3, 1: 0.7}}"
        yield f"f_{group}: {{function: s_{group}, points: {points}, full_scale: 1}}"
    else:
        yield f"f_{group}: {{invert: s_{group}, full_scale: 1}}"
    yield f"c_{group}: {{coefficient: {{f_{group}: 0.7}}, full_scale: 1}}"
    yield (
        f"mean_{group}: {{integrate: {{c_{group}: 0.2*w}}, leak: 0.2*w, initial: 0.05, full_scale: 1}}"
    )


SIXTY = """
title: Sixty lagged components
machine: lags
parameters: {{w: 6283.185307179586 1/s, mu: {mu}, until: 100 ms, rows: 1 ms, cycle: 1 ms}}
analog:
  {body}
{machine}
run: {{until: until, every: rows}}
record: [x, v]
"""
MACHINE = """
interface:
  sample: {adc: x, bits: 14}
  step: {dac: word, bits: 14, full_scale: 1, initial: 0}
digital:
  period: cycle
  remember: {phase: 0}
  program: {phase: previous(phase) + 0.7, word: 0.3*sin(phase)}
"""


def sixty_rows(options: Options) -> list[dict[str, Any]]:
    rows = []
    cases = (("smooth", 0.2, 0), ("mild", 0.2, 2), ("strong", 2.0, 6))
    for what, mu, generators in cases[:1] if options.quick else cases:
        for dac in (False, True):
            rows.append(sixty_row(what, sixty(mu, generators, dac), dac, options))
    return rows


def sixty_row(what: str, text: str, dac: bool, options: Options) -> dict[str, Any]:
    patch = hybrid.parse_patch(text)
    until_s = 10e-3 if options.quick else 200e-3
    taken, _ = timed(lambda: hybrid.run(patch, {"until": until_s}), 1 if options.quick else 3)
    cycle_s = 0.1e-3 if options.quick else 1e-3
    short_s = 1.01 * cycle_s if dac else 0.1e-3 if options.quick else 0.3e-3  # beyond a step
    figures = {"until": short_s, "rows": short_s} | ({"cycle": cycle_s} if dac else {})
    ends = [
        hybrid.run(patch, figures, engine=engine).rows[-1] for engine in ("nonlinear", "reference")
    ]
    error = float(np.max(np.abs(ends[0] - ends[1])))
    return {
        "case": what,
        "dac": dac,
        "machine_s_per_wall_s": until_s / taken,
        "goal": None if options.quick else 2.0 if dac else 5.0,
        "error": error,
        "agrees": error <= MOST_ERROR,
    }


# -- batches ----------------------------------------------------------------------------------------


def batch_rows(options: Options) -> list[dict[str, Any]]:
    return [batch_row(options, until) for until in (["2 ms"] if options.quick else SPANS)]


def batch_row(options: Options, until: str) -> dict[str, Any]:
    """1,000 runs, one at a time and two by turns; both must give the same figures.

    Beside them two copies of this process that play half of the runs each, one at a time, and have
    nothing to do with each other: what the two cores give at that moment. Efficiencies are medians over
    the turns, as a machine may be twice as fast from one second to the next.
    """
    patch = hybrid.parse_patch(VAN_DER_POL)
    count, turns = (20, 1) if options.quick else (1000, 9)
    starts = np.linspace(0.1, 2.0, count).tolist()

    def play(some: list[float], jobs: int) -> np.ndarray:
        found = hybrid.batch(patch, {"start": some, "until": until}, jobs=jobs)
        return found.figures()["last"][0]

    play(starts[:4], 1)  # kernels loaded
    times: dict[str, list[float]] = {"one": [], "two": [], "apart": []}
    for _ in range(turns):
        values = []
        for jobs, name in ((1, "one"), (2, "two")):
            began = time.perf_counter()
            values.append(play(starts, jobs))
            times[name].append(time.perf_counter() - began)
        times["apart"].append(apart([lambda k=k: play(starts[k::2], 1) for k in range(2)]))
    one, two, host = (np.array(times[name]) for name in ("one", "two", "apart"))
    return {
        "case": f"{count} runs of {until}",
        "one_s": float(np.median(one)),
        "two_s": float(np.median(two)),
        "efficiency": float(np.median(one / (2 * two))),
        "apart": float(np.median(one / (2 * host))),
        "goal": None if options.quick else 0.8,
        "error": float(np.max(np.abs(values[0] - values[1]))),
        "agrees": bool(np.array_equal(values[0], values[1])),
    }


def apart(calls: list[Callable[[], Any]]) -> float:
    """Seconds until the last of these is done, each in a copy of this process."""
    context = multiprocessing.get_context("fork")
    began = time.perf_counter()
    copies = [context.Process(target=call) for call in calls]
    for copy in copies:
        copy.start()
    for copy in copies:
        copy.join()
    return time.perf_counter() - began


# -- report -----------------------------------------------------------------------------------------


def main() -> int:
    options = parse_options(__doc__ or "")
    peers, big, batches = peer_rows(options), sixty_rows(options), batch_rows(options)
    facts = figures(peers, big, batches)
    good = all(r.get("agrees", True) for r in [*peers, *big, *batches])
    told = ", ".join(f"{k} {'-' if v is None else format(v, '.3g')}" for k, v in facts.items())
    tables = (peers_table(peers), sixty_table(big), batch_table(batches))
    word = "are" if good else "are NOT"
    return finish(__file__, options, tables, good, f"errors {word} within bounds; {told}", **facts)


def figures(peers: list[Any], big: list[Any], batches: list[Any]) -> dict[str, float | None]:
    beside_radau, beside_heyoka = (at_equal_accuracy(peers, p) for p in ("Radau", "heyoka"))
    smooth = {r["dac"]: r["machine_s_per_wall_s"] for r in big if r["case"] == "smooth"}
    return {
        "radau_ratio": None if beside_radau is None else beside_radau["over_hybrid"],
        "heyoka_ratio": None if beside_heyoka is None else 1 / beside_heyoka["over_hybrid"],
        "machine_s_per_wall_s_60": smooth[False],
        "machine_s_per_wall_s_60_dac": smooth[True],
        "batch_efficiency": batches[0]["efficiency"],
    }


def peers_table(rows: list[dict[str, Any]]) -> Table:
    columns = {
        "case": ("case", ""),
        "program": ("program", ""),
        "wall s / machine s": ("wall_s", ".4g"),
        "error": ("error", ".0e"),
        "over Hybrid": ("over_hybrid", ".3g"),
        "": ("agrees", ""),
    }
    notes = "" if by_heyoka.installed() else "heyoka is not installed: no figures beside it"
    return Table("peers", f"Van der Pol at {RATE:.0f} rad/s", columns, rows, notes)


def sixty_table(rows: list[dict[str, Any]]) -> Table:
    columns = {
        "case": ("case", ""),
        "DAC steps": ("dac", ""),
        "machine s / wall s": ("machine_s_per_wall_s", ".3g"),
        "goal": ("goal", "g"),
        "error": ("error", ".0e"),
        "": ("agrees", ""),
    }
    shown = [r | {"dac": "every ms" if r["dac"] else "none"} for r in rows]
    return Table("sixty", "60 lagged components at 1 kHz", columns, shown)


def batch_table(rows: list[dict[str, Any]]) -> Table:
    columns = {
        "case": ("case", ""),
        "one at a time, s": ("one_s", ".2f"),
        "two, s": ("two_s", ".2f"),
        "efficiency": ("efficiency", ".2f"),
        "of two apart": ("apart", ".2f"),
        "goal": ("goal", "g"),
        "": ("agrees", ""),
    }
    return Table("batches", "Batches", columns, rows)


if __name__ == "__main__":
    sys.exit(main())
