"""The loops of a patch: those that pass the analog machine one by one, those of the program counted.

Stage 7. Through a large program there are more ways from a word to another than can be told; between an
ADC and a DAC the shortest stands for all.
"""

from __future__ import annotations

import collections
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hybrid.errors import counted, known_as
from hybrid.graph import short_loops
from hybrid.machine import Machine
from hybrid.prediction import signal_graph

MOST_LISTED = 20  # analog and sampled ones half each, where there are so many of both
MOST_FOUND = 500

Graph = Mapping[str, list[str]]


@dataclass(frozen=True, slots=True)
class Loop:
    """A loop of signals with the sum of the lags around it; `sampled` where it passes the program."""

    path: tuple[str, ...]
    lag_s: float
    sampled: bool


@dataclass(frozen=True, slots=True)
class Loops:
    """The shortest loops; how many were found that pass the analog machine, and within the program; and
    whether these are all."""

    listed: tuple[Loop, ...]
    found: int
    in_program: int
    complete: bool


def loops_of(machine: Machine) -> Loops:
    """Every loop of the patch, or the shortest of many."""
    feeds, words = signal_graph(machine.patch), set(machine.tape.words)
    adcs = sorted(sampler.name for sampler in machine.samplers)
    around, ways = _around(feeds, words, adcs)
    alone = {name: targets for name, targets in around.items() if name not in adcs}
    inside = {name: [t for t in feeds[name] if t in words] for name in sorted(words)}
    analog, all_analog = short_loops(alone, sorted(alone), MOST_FOUND)
    sampled, all_sampled = short_loops(around, adcs, MOST_FOUND)
    digital, all_digital = short_loops(inside, sorted(words), MOST_FOUND)
    most = max(MOST_LISTED // 2, MOST_LISTED - len(analog))
    chosen = [*analog[: MOST_LISTED - len(sampled[:most])], *sampled[:most]]
    if not chosen and len(digital) <= MOST_LISTED:
        chosen = digital
    return Loops(
        tuple(_loop(machine, path, ways, words) for path in chosen),
        len(analog) + len(sampled),
        len(digital),
        all_analog and all_sampled and all_digital,
    )


def loops_text(loops: Loops) -> str:
    """What the list leaves out; ''."""
    least, told = "" if loops.complete else "at least ", []
    if loops.found > len(loops.listed):
        told.append(f"{least}{loops.found} loops, of which the shortest are listed")
    if loops.in_program and (loops.found or not loops.listed):
        told.append(f"{least}{counted(loops.in_program, 'loop')} within the program")
    return "; ".join(told)


Ways = Mapping[tuple[str, str], tuple[str, ...]]


def _around(feeds: Graph, words: set[str], adcs: Sequence[str]) -> tuple[Graph, Ways]:
    """The graph without the words, each ADC joined to the DACs that depend on it, and by which words."""
    graph: dict[str, list[str]] = {}
    ways: dict[tuple[str, str], tuple[str, ...]] = {}
    for name in feeds.keys() - words:
        graph[name] = [target for target in feeds[name] if target not in words]
        for target, way in _through(name, feeds, words).items() if name in adcs else ():
            graph[name].append(target)
            ways[name, target] = way
    return graph, ways


def _through(start: str, feeds: Graph, words: set[str]) -> dict[str, tuple[str, ...]]:
    """The signals that a name reaches through words alone, and the shortest way to each."""
    way: dict[str, tuple[str, ...]] = {start: ()}
    found: dict[str, tuple[str, ...]] = {}
    queue = collections.deque([start])
    while queue:
        name = queue.popleft()
        for target in feeds[name]:
            if target in words and target not in way:
                way[target] = (*way[name], target)
                queue.append(target)
            elif target not in words and way[name]:
                found.setdefault(target, way[name])
    return found


def _pairs(loop: tuple[str, ...]) -> list[tuple[str, str]]:
    return list(zip(loop, (*loop[1:], loop[0]), strict=True))


def _loop(machine: Machine, path: tuple[str, ...], ways: Ways, words: set[str]) -> Loop:
    """A loop with the words that it passes, beginning at its first name."""
    whole = [name for pair in _pairs(path) for name in (pair[0], *ways.get(pair, ()))]
    first = whole.index(min(whole))
    turned = (*whole[first:], *whole[:first])
    lag_s = math.fsum(machine.stages[s].tau for s in turned if s in machine.stages)
    told = tuple(name for name, _ in itertools.groupby(map(known_as, turned)))
    return Loop(told, lag_s, any(s in words for s in turned))
