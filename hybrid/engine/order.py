"""In which order the elements of a circuit are computed, and where its loops are cut.

Stage 4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from graphlib import TopologicalSorter

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from hybrid.elements import INTEGRATE, Element

# Rank of an element at which a loop cannot be cut.
FORGETS = 2


def computing_order(elements: Mapping[str, Element]) -> tuple[tuple[str, ...], tuple[int, int]]:
    """Names such that few signals are read before they are computed, and those all remember.

    Loops are cut at one integrator, or else at one lag, until none is left; then every element follows
    those it reads. Returns the order and how many elements come before and up to the end of the loops.
    """
    return ordered([(name, tuple(e.reads()), rank(e)) for name, e in elements.items()])


def ordered(
    parts: Sequence[tuple[str, Sequence[str], int]],
) -> tuple[tuple[str, ...], tuple[int, int]]:
    """The same for parts of a name, what it reads and its rank."""
    names, ranks = [name for name, _, _ in parts], [rank for _, _, rank in parts]
    place = {name: i for i, name in enumerate(names)}
    edges = {(place[r], place[name]) for name, reads, _ in parts for r in reads}
    feeds: list[set[int]] = [set() for _ in names]  # what is left of them as loops are cut
    for a, b in edges:
        feeds[a].add(b)
    loops = _loops(range(len(names)), feeds)
    looped = {i for g in loops for i in g}
    while loops:
        group = loops.pop()
        within = set(group)
        cut = min(group, key=lambda i: (ranks[i], -len(feeds[i] & within), i))
        if ranks[cut] == FORGETS:
            raise ValueError(
                f"a loop without integrator or lag: {', '.join(names[i] for i in group)}"
            )
        feeds[cut] -= within
        loops += _loops(group, feeds)
    _mend(feeds, edges)
    before, after = reach(edges, looped, 0), reach(edges, looped, 1)
    section = [0 if i not in after else 2 if i not in before else 1 for i in range(len(names))]
    readers: dict[int, list[int]] = {i: [] for i in range(len(names))}
    for a, targets in enumerate(feeds):
        for b in targets:
            readers[b].append(a)
    ordered = sorted(TopologicalSorter(readers).static_order(), key=lambda i: section[i])
    heads, cores = section.count(0), section.count(0) + section.count(1)
    return tuple(names[i] for i in ordered), (heads, cores)


def _mend(feeds: Sequence[set[int]], edges: set[tuple[int, int]]) -> None:
    """Put as many of the cut edges back as close no loop: their readers then see the new value.

    A sweep through two integrators in a ring brings them closer by the square of what it does where
    both read what the other was.
    """
    for a, b in sorted(edges):
        if b not in feeds[a] and a not in _reached(feeds, b):
            feeds[a].add(b)


def _reached(feeds: Sequence[set[int]], seed: int) -> set[int]:
    """The seed and all that depends on it."""
    found, waiting = {seed}, [seed]
    while waiting:
        more = feeds[waiting.pop()] - found
        found |= more
        waiting += more
    return found


def rank(element: Element) -> int:
    """Where a loop is cut first."""
    return 0 if element.kind == INTEGRATE else 1 if element.remembers() else FORGETS


def loops_of(count: int, edges: set[tuple[int, int]]) -> dict[int, frozenset[int]]:
    """Of each number below `count` that comes back to itself along the edges all that do so with it."""
    feeds: list[set[int]] = [set() for _ in range(count)]
    for a, b in edges:
        feeds[a].add(b)
    groups = [frozenset(group) for group in _loops(range(count), feeds)]
    return {i: group for group in groups for i in group}


def _loops(of: Sequence[int], feeds: Sequence[set[int]]) -> list[list[int]]:
    """Groups of these numbers in which each reaches each, by the edges among them."""
    place = {i: k for k, i in enumerate(of)}
    ends = [(k, place[b]) for k, a in enumerate(of) for b in feeds[a] if b in place]
    rows, columns = [a for a, _ in ends], [b for _, b in ends]
    matrix = csr_array((np.ones(len(ends)), (rows, columns)), shape=(len(of), len(of)))
    _, label = connected_components(matrix, connection="strong")
    groups: dict[int, list[int]] = {}
    for i, number in zip(of, label.tolist(), strict=True):
        groups.setdefault(number, []).append(i)
    return [g for g in groups.values() if len(g) > 1 or g[0] in feeds[g[0]]]


def reach(edges: set[tuple[int, int]], seeds: set[int], way: int) -> set[int]:
    """Seeds and all from which they can be reached (way 0) or that they reach (way 1)."""
    found = set(seeds)
    while True:
        more = {edge[way] for edge in edges if edge[1 - way] in found} - found
        if not more:
            return found
        found |= more
