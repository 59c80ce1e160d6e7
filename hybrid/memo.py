"""Results that are kept, because the next run of a sweep asks for the same.

Stage 0.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")
Thing = TypeVar("Thing")

# Kept of each function; the oldest goes first.
MOST_KEPT = 64


class _Watched(dict[str, float]):
    """A scope that notes what is looked up in it."""

    def __init__(self, scope: Mapping[str, float]) -> None:
        super().__init__(scope)
        self.used: dict[str, float] = {}

    def __getitem__(self, name: str) -> float:
        value = super().__getitem__(name)
        self.used[name] = value
        return value


class KeptByUse(Generic[Result]):
    """`build(scope, *others)`, kept for all scopes that agree in what the building looked up.

    Whatever a building does depends on the figures it has looked up so far, so where all of them are
    the same the result is, too. `others` must be hashable; nobody may change a result.
    """

    def __init__(self, build: Callable[..., Result]) -> None:
        self.build = build
        self.lock = threading.Lock()  # runs of a batch may be prepared in threads
        self.kept: OrderedDict[tuple[Any, ...], tuple[dict[str, float], Result]] = OrderedDict()

    def __call__(self, scope: Mapping[str, float], *others: Any) -> Result:
        """The result that is kept, or a new one; raises what building raises."""
        found = self.kept.get(others)
        if found and all(scope.get(name) == value for name, value in found[0].items()):
            return found[1]
        watched = _Watched(scope)
        result = self.build(watched, *others)
        with self.lock:
            self.kept[others] = watched.used, result
            self.kept.move_to_end(others)
            if len(self.kept) > MOST_KEPT:
                self.kept.popitem(last=False)
        return result


class KeptLast(Generic[Key, Result]):
    """The result that was made last for each key: `build(last, key, *others)` may take parts of it over.

    What it gives must not depend on what it began with, which may be None, or of another thread: it is
    what would be built of nothing. Nobody may change a result.
    """

    def __init__(self, build: Callable[..., Result]) -> None:
        self.build = build
        self.lock = threading.Lock()
        self.kept: OrderedDict[Key, Result] = OrderedDict()

    def __call__(self, key: Key, *others: Any) -> Result:
        """The result, which is the last one itself where `build` finds that it still holds."""
        last = self.kept.get(key)
        result = self.build(last, key, *others)
        if result is not last:
            with self.lock:
                self.kept[key] = result
                self.kept.move_to_end(key)
                if len(self.kept) > MOST_KEPT:
                    self.kept.popitem(last=False)
        return result


class KeptByObject(Generic[Thing, Result]):
    """`build(thing)`, kept for the thing itself and not for its equal: nothing is compared or hashed.

    most: things of which it is kept; the oldest go first. Nobody may change a thing or a result.
    """

    def __init__(self, build: Callable[[Thing], Result], most: int) -> None:
        self.build, self.most = build, most
        self.lock = threading.Lock()
        self.kept: OrderedDict[int, tuple[Thing, Result]] = OrderedDict()  # so that things stay

    def __call__(self, thing: Thing) -> Result:
        """The result that is kept, or a new one; raises what building raises."""
        found = self.kept.get(id(thing))
        if found is not None:
            return found[1]
        result = self.build(thing)
        with self.lock:
            self.kept[id(thing)] = thing, result
            if len(self.kept) > self.most:
                self.kept.popitem(last=False)
        return result


class KeptBySize(Generic[Key, Result]):
    """Results by what they were built for, as long as they are not too large together.

    most: of what `size` counts, in all: what a result takes, and its key. The oldest go first; the last
    two stay, however large, since a prediction and a run of one machine ask for the same. Nobody may
    change a result.
    """

    def __init__(self, most: int, size: Callable[[Result], int]) -> None:
        self.most, self.size = most, size
        self.lock = threading.Lock()
        self.kept: OrderedDict[Key, Result] = OrderedDict()
        self.total = 0

    def of(
        self, keys: Sequence[Key], build: Callable[[list[Key]], Sequence[Result]]
    ) -> list[Result]:
        """The result for each key; `build` is asked once for all that are not kept."""
        found: dict[Key, Result] = {}
        for key in keys:
            result = self.kept.get(key)
            if result is not None:
                found[key] = result
        missing = [key for key in dict.fromkeys(keys) if key not in found]
        if missing:
            built = dict(zip(missing, build(missing), strict=True))
            found |= built
            self._keep(built)
        return [found[key] for key in keys]

    def _keep(self, built: Mapping[Key, Result]) -> None:
        with self.lock:
            for key, result in built.items():
                if key not in self.kept:  # another thread may have been as quick
                    self.kept[key] = result
                    self.total += self.size(result)
            while self.total > self.most and len(self.kept) > 2:
                self.total -= self.size(self.kept.popitem(last=False)[1])
