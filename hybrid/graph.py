"""Order and loops in a graph of names. Stage 0."""

from __future__ import annotations

import collections
from collections.abc import Iterator, Mapping, Sequence, Set


def find_loop(needs: Mapping[str, list[str]]) -> tuple[str, ...]:
    """First cycle in a graph name -> names it depends on (sorted order), or ()."""
    done: set[str] = set()
    for root in sorted(needs):
        path: dict[str, None] = {}  # in order, and quick to ask
        stack: list[tuple[str, int]] = [(root, 0)]
        while stack:
            name, at = stack.pop()
            if at == 0:
                if name in done:
                    continue
                if name in path:
                    names = list(path)
                    return tuple(names[names.index(name) :])
                path[name] = None
            successors = [n for n in needs.get(name, ()) if n in needs]
            if at < len(successors):
                stack.append((name, at + 1))
                stack.append((successors[at], 0))
            else:
                done.add(name)
                path.popitem()
    return ()


def dependency_order(needs: Mapping[str, list[str]]) -> tuple[str, ...]:
    """Names so that each follows all it depends on; ties by name. The graph has no loop."""
    waiting = {name: {n for n in needs[name] if n in needs} for name in needs}
    feeds: dict[str, list[str]] = {name: [] for name in needs}
    for name, open_needs in waiting.items():
        for need in open_needs:
            feeds[need].append(name)
    order: list[str] = []
    ready = sorted(name for name, open_needs in waiting.items() if not open_needs)
    while ready:
        order.extend(ready)
        freed = []
        for name in ready:
            for follower in feeds[name]:
                waiting[follower].discard(name)
                if not waiting[follower]:
                    freed.append(follower)
        ready = sorted(freed)
    return tuple(order)


# A graph of many layers has more paths than can be walked; a search ends after this many steps.
MOST_STEPS = 200_000


def simple_loops(follows: Mapping[str, list[str]], most: int = 100) -> list[tuple[str, ...]]:
    """Loops that pass no name twice, each once, starting at its first name; at most `most`.

    `follows` maps a name to those it feeds.
    """
    found: list[tuple[str, ...]] = []
    steps = MOST_STEPS
    for root in sorted(follows):
        # Names before the root have had their turn, so every loop is found at its first name only.
        stack: list[tuple[str, tuple[str, ...]]] = [(root, (root,))]
        while stack and len(found) < most and steps:
            steps -= 1
            name, path = stack.pop()
            for target in sorted(follows.get(name, ()), reverse=True):
                if target == root:
                    found.append(path)
                elif target > root and target not in path and target in follows:
                    stack.append((target, (*path, target)))
    return found


def loop_groups(follows: Mapping[str, Sequence[str]]) -> dict[str, int]:
    """A number for each name, the same for two that reach each other: Kosaraju's two searches."""
    before: dict[str, list[str]] = {name: [] for name in follows}
    for name, targets in follows.items():
        for target in targets:
            if target in before:
                before[target].append(name)
    finished, seen = list[str](), set[str]()
    for root in follows:
        stack = [] if root in seen else [(root, iter(follows[root]))]
        seen.add(root)
        while stack:
            new = next((t for t in stack[-1][1] if t in before and t not in seen), None)
            if new is None:
                finished.append(stack.pop()[0])
            else:
                seen.add(new)
                stack.append((new, iter(follows[new])))
    group: dict[str, int] = {}
    for number, root in enumerate(reversed(finished)):
        todo = [] if root in group else [root]
        group.setdefault(root, number)
        while todo:
            more = [name for name in before[todo.pop()] if name not in group]
            group |= dict.fromkeys(more, number)
            todo += more
    return group


def short_loops(
    follows: Mapping[str, list[str]], roots: Sequence[str], most: int
) -> tuple[list[tuple[str, ...]], bool]:
    """Loops that pass no name twice, each once, the shorter ones first, and whether they are all.

    follows: name -> those it feeds; roots: every loop wanted passes one of them, and begins there. The
    search ends with `most` loops, or after MOST_STEPS.
    """
    found: list[tuple[str, ...]] = []
    place, group = {name: i for i, name in enumerate(roots)}, loop_groups(follows)
    # What leaves a group never comes back.
    follows = {n: [t for t in follows[n] if group.get(t) == group[n]] for n in follows}
    queue = collections.deque[tuple[str, ...]]((name,) for name in roots)
    for _ in range(MOST_STEPS):
        if not queue or len(found) >= most:
            break
        path = queue.popleft()
        first = place[path[0]]
        for target in follows[path[-1]]:
            if target == path[0]:
                found.append(path)
            # Roots before it have had their turn, so every loop is found once.
            elif place.get(target, first + 1) > first and target not in path and target in follows:
                queue.append((*path, target))
    return found[:most], not queue and len(found) <= most


def grouped_order(kinds: Sequence[int], needs: Sequence[Set[int]]) -> Iterator[list[int]]:
    """Steps 0, 1, ... in groups of one kind, so that each follows all it needs; few groups.

    The next kind is that on which the longest chain of changes between kinds hangs: no order has fewer
    groups than the longest chain. The graph has no loop.
    """
    waiting = [len(needed) for needed in needs]
    feeds: list[list[int]] = [[] for _ in kinds]
    for step, needed in enumerate(needs):
        for other in needed:
            feeds[other].append(step)
    chain = _longest_chains(kinds, needs, feeds)
    ready = collections.defaultdict[int, list[int]](list)
    for step, kind in enumerate(kinds):
        if not waiting[step]:
            ready[kind].append(step)
    while ready:
        kind = max(ready, key=lambda k: (max(chain[step] for step in ready[k]), len(ready[k])))
        group = ready.pop(kind)
        for step in group:  # which grows meanwhile
            for follower in feeds[step]:
                waiting[follower] -= 1
                if not waiting[follower]:
                    at = group if kinds[follower] == kind else ready[kinds[follower]]
                    at.append(follower)
        yield group
    assert not any(waiting), "steps that wait for each other"


def _longest_chains(
    kinds: Sequence[int], needs: Sequence[Set[int]], feeds: Sequence[list[int]]
) -> list[int]:
    """How often the kind changes, at most, on the way from each step to an end."""
    chain = [0] * len(kinds)
    waiting = [len(followers) for followers in feeds]
    done = [step for step, count in enumerate(waiting) if not count]
    for step in done:  # which grows meanwhile
        for other in needs[step]:
            chain[other] = max(chain[other], chain[step] + (kinds[other] != kinds[step]))
            waiting[other] -= 1
            if not waiting[other]:
                done.append(other)
    return chain
