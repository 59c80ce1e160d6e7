"""Linear algebra on one core: BLAS starts threads of its own, for matrices of hundreds of rows.

Stage 0. Those of a run have fewer: threads take a second core and make nothing quicker, most of all
where runs are played on all cores. And what they add up is in another order, while the bits of a run
should not depend on how many cores there are.
"""

from __future__ import annotations

import functools
import sys
import threading
from contextlib import ContextDecorator
from typing import Any


class _OneThread(ContextDecorator, threading.local):
    """While somebody is within it; then things are as they were.

    The limit is the whole process's, so that threads of a crew are within it, too.
    """

    limit: Any

    def __init__(self) -> None:
        self.within = 0

    def __enter__(self) -> None:
        if self.within == 0:
            self.limit = _libraries(len(sys.modules)).limit(limits=1, user_api="blas")
        self.within += 1

    def __exit__(self, *_: object) -> None:
        self.within -= 1
        if self.within == 0:
            self.limit.restore_original_limits()


@functools.lru_cache(maxsize=1)
def _libraries(modules: int) -> Any:
    """What is in memory when so many modules are: numpy and scipy bring a BLAS each, some of them late.

    To look takes a millisecond.
    """
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


one_thread = _OneThread()
