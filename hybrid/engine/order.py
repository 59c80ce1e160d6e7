"""In which order the elements of a circuit are computed, and where its loops are cut.

Stage 4.
"""

from __future__ import annotations

import functools
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
    return _ordered(tuple((n, tuple(e.reads()), _rank(e)) for n, e in elements.items()))


# The runs of a batch differ in figures, not in what reads what.
@functools.lru_cache(maxsize=32)
def _ordered(
    parts: tuple[tuple[str, tuple[str, ...], int], ...],
) -> tuple[tuple[str, ...], tuple[int, int]]:
    """The same for parts of a name, what it reads and its rank."""
    names, rank = [name for name, _, _ in parts], [rank for _, _, rank in parts]
    place = {name: i for i, name in enumerate(names)}
    edges = {(place[r], place[name]) for name, reads, _ in parts for r in reads}
    loops = [g for g in _groups(len(names), edges) if len(g) > 1 or (g[0], g[0]) in edges]
    looped = {i for g in loops for i in g}
    kept = set(edges)
    while loops:
        group = loops.pop()
        cut = min(group, key=lambda i: (rank[i], -_fan(kept, i, group), i))
        if rank[cut] == FORGETS:
            raise ValueError(
                f"a loop without integrator or lag: {', '.join(names[i] for i in group)}"
            )
        kept = {(a, b) for a, b in kept if a != cut or b not in group}
        inside = {(a, b) for a, b in kept if a in group and b in group}
        loops += [g for g in _groups(len(names), inside) if len(g) > 1 or (g[0], g[0]) in inside]
    kept = _mended(kept, edges - kept)
    before, after = reach(edges, looped, 0), reach(edges, looped, 1)
    section = [0 if i not in after else 2 if i not in before else 1 for i in range(len(names))]
    readers = {i: sorted(a for a, b in kept if b == i) for i in range(len(names))}
    ordered = sorted(TopologicalSorter(readers).static_order(), key=lambda i: section[i])
    heads, cores = section.count(0), section.count(0) + section.count(1)
    return tuple(names[i] for i in ordered), (heads, cores)


def _mended(kept: set[tuple[int, int]], cut: set[tuple[int, int]]) -> set[tuple[int, int]]:
    """As many of the cut edges put back as close no loop: their readers then see the new value.

    A sweep through two integrators in a ring brings them closer by the square of what it does where
    both read what the other was.
    """
    readers: dict[int, set[int]] = {}
    for a, b in kept:
        readers.setdefault(a, set()).add(b)
    for a, b in sorted(cut):
        if a not in _reached(readers, b):
            readers.setdefault(a, set()).add(b)
    return {(a, b) for a, those in readers.items() for b in those}


def _reached(readers: Mapping[int, set[int]], seed: int) -> set[int]:
    """The seed and all that depends on it."""
    found, waiting = {seed}, [seed]
    while waiting:
        more = readers.get(waiting.pop(), set()) - found
        found |= more
        waiting += more
    return found


def _rank(element: Element) -> int:
    """Where a loop is cut first."""
    return 0 if element.kind == INTEGRATE else 1 if element.remembers() else FORGETS


def _fan(edges: set[tuple[int, int]], i: int, group: Sequence[int]) -> int:
    return sum(a == i and b in group for a, b in edges)


def _groups(n: int, edges: set[tuple[int, int]]) -> list[list[int]]:
    """Strongly connected groups of the numbers below n."""
    matrix = csr_array(
        (np.ones(len(edges)), ([a for a, _ in edges], [b for _, b in edges])), shape=(n, n)
    )
    _, label = connected_components(matrix, connection="strong")
    groups: dict[int, list[int]] = {}
    for i in range(n):
        groups.setdefault(int(label[i]), []).append(i)
    return list(groups.values())


def reach(edges: set[tuple[int, int]], seeds: set[int], way: int) -> set[int]:
    """Seeds and all from which they can be reached (way 0) or that they reach (way 1)."""
    found = set(seeds)
    while True:
        more = {edge[way] for edge in edges if edge[1 - way] in found} - found
        if not more:
            return found
        found |= more
