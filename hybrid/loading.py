"""How a command loads its libraries in less time: for its own processes, not for who imports hybrid.

Stage 0.
"""

from __future__ import annotations

import gc
import sys
import warnings


def seldom_collect() -> None:
    """Look for garbage less often: loading makes many objects and hardly any garbage.

    Looking for some takes a quarter of the time in which a short run is over.
    """
    gc.set_threshold(200_000, 20, 20)


def load_matplotlib_without_3d() -> None:
    """Load matplotlib as if its drawing in three dimensions were not there, which no chart uses.

    matplotlib looks for it to know all its projections, and warns where it is missing.
    """
    three_d = "mpl_toolkits.mplot3d"
    if three_d in sys.modules:
        return
    sys.modules[three_d] = None  # type: ignore[assignment]  # what makes Python say: not there
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import matplotlib.projections  # noqa: F401
    finally:
        del sys.modules[three_d]
