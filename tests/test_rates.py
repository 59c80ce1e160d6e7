"""The first moments of the rate test, by compiled windows and by the reference: the same figures."""

import numpy as np
import pytest

import hybrid
from hybrid import ratetest
from hybrid.compiler import compile_patch

# Two intervals' ends are known to this, in machine units, of both.
EXACT_MU = ratetest.EXACT_MU

MODES = """
title: What tells no rate
analog:
  one: {constant: 1, full_scale: 1}
  held: {integrate: {one: 1 1/s}, initial: 0.1, hold_when: above, full_scale: 1}
  stopped: {integrate: {one: 1 1/s}, initial: 0.4, high: 0.4, full_scale: 1}
  free: {integrate: {square: -3 1/s}, initial: 0.5, full_scale: 1}
  square: {multiply: [free, free], full_scale: 1}
  above: {compare: {one: 1}, threshold: 0.5, high: 1, full_scale: 1}
modes: {reset: 1 ms, operate: 1 ms}
run: {until: 10 ms, every: 1 ms, on_overload: WHAT}
"""


def both(machine):
    """The same moments twice: (start, length of an interval)."""
    given = np.array(list(ratetest.static_check(machine)[1].values()))
    found = [ratetest._first_moments(machine, given, plainly) for plainly in (False, True)]
    (compiled, step_s, _), (plain, same_s, _) = found
    assert step_s == same_s
    assert compiled.why_not == plain.why_not
    assert compiled.switched == plain.switched
    if not compiled.switched:
        shown = [
            machine.analog.signals.index(c.name)
            for c in machine.patch.components
            if c.kind == "integrate" and c.name not in plain.why_not
        ]
        off = np.abs(compiled.rates_mu - plain.rates_mu)[:, shown]
        assert np.max(off, initial=0.0) < 4.0 * EXACT_MU / step_s
    return plain


@pytest.mark.parametrize("preset", ["ideal", "lags", "analog_thing"])
@pytest.mark.parametrize("name", ["van_der_pol", "lorenz", "relay_servo", "shooting"])
def test_first_rates_need_no_compiled_windows(name, preset):
    both(compile_patch(hybrid.read_patch(name), machine=preset))


@pytest.mark.parametrize("what", ["continue", "stop", "hold"])
def test_why_a_rate_tells_nothing_is_the_same(what):
    patch = hybrid.parse_patch(MODES.replace("WHAT", what))
    why_not = both(compile_patch(patch, machine="lags")).why_not
    assert why_not == {"held": "in IC or HOLD", "stopped": "at its limit"}


@pytest.mark.parametrize("what", ["stop", "hold"])
def test_an_overload_at_the_start_is_the_same(what):
    text = MODES.replace("WHAT", what).replace("free], full_scale: 1", "free], full_scale: 0.2")
    both(compile_patch(hybrid.parse_patch(text), machine="lags"))


def test_a_check_without_a_trial_shows_what_one_with_it_does():
    tried, untried = (hybrid.check("van_der_pol", trial=trial).rates for trial in (True, False))
    for one, other in zip(tried, untried, strict=True):
        assert other.shown_mu == pytest.approx(one.shown_mu, abs=one.allowed_mu * 1e-3 + 1e-6)
        assert other.first_mu is None and one.first_mu is not None
