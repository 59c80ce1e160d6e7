"""Loops that several tests play, predict and simulate by hand."""

from collections import defaultdict

import numpy as np

I_YY = 1000.0

_TWO_LOOPS = """
title: Two coupled oscillators, each closed through a converter pair
machine: ideal
parameters: {period: PERIOD, compute_time: 2.5*period, tau: 0 s}
analog:
  va: {integrate: {a: -9, fa: 1, b: 0.5}, initial: 0, full_scale: 4, tau: tau}
  a: {integrate: {va: 1}, initial: 1, full_scale: 2, tau: tau}
  vb: {integrate: {fb: 2, vb: -0.7}, initial: -0.5, full_scale: 3, tau: tau}
  b: {integrate: {vb: 1}, initial: -1, full_scale: 2, tau: tau}
  mix: {sum: {a: 1, b: -0.3}, full_scale: 4, tau: tau}
interface:
  s_a: {adc: mix, channel: 2, conversion_time: 0.3 ms}
  s_b: {adc: b, channel: 0, conversion_time: 0.7 ms}
  fa: {dac: w_a, full_scale: 5, initial: 0.2, tau: tau}
  fb: {dac: w_b, full_scale: 50, initial: 0, tau: tau}
digital:
  period: period
  compute_time: compute_time
  skew: 1 ms
  remember: {smooth: 0.25, last: -1}
  program:
    smooth: previous(smooth) + 0.3*(s_a - previous(smooth))
    last: s_b
    w_a: -2*smooth + 0.1*w_b
    w_b: -12*s_b - 3*(s_b - previous(last))
run: {RUN}
"""


def two_loops(period, run):
    """The patch with its cycle time and its `run:` line."""
    return _TWO_LOOPS.replace("PERIOD", period).replace("{RUN}", f"{{{run}}}")


def pitch_matrix(tau_s, gain=None):
    """x' = A x + b M_a of the pitch loop with five lags, in problem units; `gain` by component.

    States: M_a, theta_ddot, theta_dot inside and out, theta inside and out, alpha.
    """
    gain = gain or defaultdict(lambda: 1.0)
    a = np.diag([-1 / tau_s, -1 / tau_s, 0, -1 / tau_s, 0, -1 / tau_s, -1 / tau_s])
    a[1, 0] = gain["theta_ddot"] / I_YY / tau_s
    a[2, 1] = gain["theta_dot"]
    a[3, 2] = a[5, 4] = 1 / tau_s
    a[4, 3] = gain["theta"]
    a[6, 5] = gain["alpha"] / tau_s
    return a, np.array([gain["M_a"] / tau_s, 0, 0, 0, 0, 0, 0])
