"""JSBSim flying the F-16 that comes with it; optional, so imported when asked for."""

from __future__ import annotations

import math
import time
from importlib.util import find_spec

# Level flight at the height, speed and heading of NASA's check case 11.
START = {
    "ic/h-sl-ft": 10013.0,
    "ic/lat-geod-deg": 36.01916667,
    "ic/long-gc-deg": -75.67444444,
    "ic/vt-fps": 565.685,
    "ic/psi-true-deg": 45.0,
    "ic/theta-deg": 2.64,
    "ic/alpha-deg": 2.64,
}
FULL_TRIM = 1


def installed() -> bool:
    return find_spec("jsbsim") is not None


class F16:
    """Its F-16 in trimmed flight, with its flight control system and its engine, without any output."""

    def __init__(self, step_s: float) -> None:
        import jsbsim

        jsbsim.FGJSBBase().debug_lvl = 0
        self.flight = jsbsim.FGFDMExec(None)
        self.flight.set_debug_level(0)
        assert self.flight.load_model("f16")
        self.flight.set_dt(step_s)
        self.flight.disable_output()
        for name, value in START.items():
            self.flight[name] = value
        assert self.flight.run_ic()
        self.flight["propulsion/engine[0]/set-running"] = 1
        self.flight.do_trim(FULL_TRIM)
        self.step_s = step_s

    def fly(self, until_s: float) -> float:
        """Fly on for so long; processor seconds that it took."""
        run, begun = self.flight.run, time.process_time()
        for _ in range(round(until_s / self.step_s)):
            run()
        took_s = time.process_time() - begun
        assert math.isfinite(self.flight["position/h-sl-ft"])
        return took_s
