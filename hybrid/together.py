"""Many things at once: what is alike is computed in stacks, and each has an answer or error of its own.

Stage 0. An answer does not depend on what it was computed together with: a stack holds matrices of one
shape, and whatever is done is done to each of them alone, to the last bit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from typing import TypeVar

from hybrid.errors import HybridError

Item = TypeVar("Item")
Result = TypeVar("Result")

# Numbers in one stack (16 MB): more would leave the cache, and larger machines gain little by it.
STACKED = 2 * 10**6


def in_stacks(
    items: Sequence[Item],
    kind: Callable[[Item], Hashable],
    numbers: Callable[[Item], int],
    compute: Callable[[list[Item]], Sequence[Result]],
) -> list[Result]:
    """What `compute` makes of lists of items of one kind, in the order of the items.

    numbers: how many an item takes while it is computed, so that lists are not too long.
    """
    alike: dict[Hashable, list[int]] = defaultdict(list)
    for place, item in enumerate(items):
        alike[kind(item)].append(place)
    found: dict[int, Result] = {}
    for places in alike.values():
        most = max(1, STACKED // max(numbers(items[places[0]]), 1))
        for first in range(0, len(places), most):
            some = places[first : first + most]
            found.update(zip(some, compute([items[place] for place in some]), strict=True))
    return [found[place] for place in range(len(items))]


def attempt(function: Callable[[Item], Result], item: Item) -> Result | HybridError:
    """What the function gives, or the user's mistake that it raises."""
    try:
        return function(item)
    except HybridError as error:
        return error


def passed_on(
    answers: Sequence[Item | HybridError],
    compute: Callable[[list[Item]], Sequence[Result | HybridError]],
) -> list[Result | HybridError]:
    """What `compute` makes of all answers that are no errors; errors stay in their places."""
    found = iter(compute([answer for answer in answers if not isinstance(answer, HybridError)]))
    return [answer if isinstance(answer, HybridError) else next(found) for answer in answers]


def only(answers: Sequence[Result | HybridError]) -> Result:
    """The one answer that was asked for; raises the error that it may be."""
    (answer,) = answers
    if isinstance(answer, HybridError):
        raise answer
    return answer
