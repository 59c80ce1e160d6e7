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
