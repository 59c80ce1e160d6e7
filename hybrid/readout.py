"""Figures of merit read from a record: extremes, means, and the mode of a transient."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hybrid._modal_drift import mode_noise
from hybrid._modal_fit import EPS, mode_functions, refine, straight_line_misfit
from hybrid._modal_search import FEWEST_ROWS, Mode, find_mode

Array = NDArray[np.float64]
Errors = tuple[float, float, float]
Readout = dict[str, float | str | None]

UNEVEN = 1e-6  # largest departure of a time step from the mean, relative to it
FEWEST_ROWS_PER_CYCLE = 2.5
FASTEST_DECAY = 3.5  # 1/row: the next row holds 3 % of what was there
RESTING_STEPS = 8.0  # steps of a converter
SHORTEST_RAD = 0.3  # omega times the length of the record; a parabola does as well below
LARGEST_ERROR = 0.15  # of omega, and of zeta or 1, whichever is larger; beyond it, no answer
MOST_ERRORS = 4.0  # by which the square of the damped frequency may be off
LARGEST_MISFIT = 0.02  # share of the sum of squares that correlated residuals may hold
SINGLE_POLE_GAIN = 25.0  # fall of the sum of squares, in variances, that proves a second pole


@dataclass(frozen=True)
class Transient:
    """The dominant second-order mode of a record, as measured by `measure_transient`.

    The mode is a solution of x'' + 2 zeta omega x' + omega^2 x = 0. omega = |s| is the undamped and
    omega_damped = |Im s| the damped frequency (rad/s; the latter is 0 if the poles are real);
    zeta = -Re s / omega, or (p1 + p2) / (2 sqrt(p1 p2)) for real poles that decay at the rates
    p1 and p2. The errors are one standard deviation. All of these are None if `reason` is not
    empty: it then says why the record has no answer.

    amplitude: at the start of the window (of its first row that moves), in the unit of the values;
    of the envelope if kind is 'oscillatory', sqrt(x^2 + (x' / omega)^2) if it is 'overdamped'.
    offset: the constant beside the mode. residual_rms: of the rows used.
    kind: 'oscillatory', 'overdamped', 'first-order' (one real pole; no answer) or 'none'.
    """

    omega: float | None
    omega_damped: float | None
    zeta: float | None
    omega_error: float | None
    omega_damped_error: float | None
    zeta_error: float | None
    amplitude: float | None
    offset: float | None
    residual_rms: float | None
    kind: str
    rows_used: int
    reason: str = ""

    def __str__(self) -> str:
        if self.reason:
            return f"no transient measured: {self.reason}"
        return (
            f"{self.kind}: omega = {self.omega:.10g} +- {self.omega_error:.2g} rad/s, "
            f"zeta = {self.zeta:.10g} +- {self.zeta_error:.2g}, "
            f"omega_damped = {self.omega_damped:.10g} +- {self.omega_damped_error:.2g} rad/s, "
            f"amplitude {self.amplitude:.6g}, offset {self.offset:.6g}, "
            f"residual {self.residual_rms:.2g} rms in {self.rows_used} rows"
        )


def measure_transient(values: ArrayLike, interval_s: float, *, start_s: float = 0.0) -> Transient:
    """Measure the dominant second-order mode of a transient, without knowing the answer.

    values: (rows,), sampled every `interval_s`; rows earlier than `start_s` after the first are
    left out. A mode, growing or decaying, and a constant are fitted by least squares (see
    `hybrid._modal_fit`). Rows at either end that never change are left out, and so are first rows
    that hold a faster mode besides. The errors allow for noise that kicks the mode itself and
    cannot be told from noise of the rows (see `hybrid._modal_drift`), so they are too large, by 1.8 on
    the average, for an undamped mode whose rows alone are noisy (by 2 to 3.5 in coloured noise). They
    cover a second mode close by whose beat bends visibly in a record of two cycles or more. Where that
    noise cannot be judged, the errors in the rows are taken for independent and equal in size; where the
    residuals are correlated, the errors are enlarged to match.

    Raises ValueError if `values` is not one-dimensional, or the times are not finite, or negative,
    or the interval is zero. A record without an answer raises nothing: see `Transient.reason`.
    """
    record = np.asarray(values, dtype=float)
    if record.ndim != 1:
        raise ValueError(f"values must have one dimension, not {record.ndim}")
    if not (math.isfinite(interval_s) and interval_s > 0.0):
        raise ValueError(f"interval_s must be finite and positive, not {interval_s}")
    if not (math.isfinite(start_s) and start_s >= 0.0):
        raise ValueError(f"start_s must be finite and not negative, not {start_s}")
    window = record[math.ceil(min(start_s / interval_s * (1.0 - 1e-12), len(record))) :]
    reason = _unusable(window)
    if reason:
        return _no_answer(reason, 0)
    moving = window[_moving_rows(window)]
    if len(moving) < FEWEST_ROWS:
        return _no_answer("the record is constant", 0)
    scale, mean, scaled = _scaled(moving)
    mode = find_mode(scaled)
    if mode is None:
        return _no_answer("no second-order mode fits the record", 0)
    kind, reason = _verdict(mode, interval_s)
    if reason:
        return _no_answer(reason, mode.rows_used, kind)
    errors = _errors(mode, mean)
    if _too_large(errors, mode):
        reason = "the mode is too uncertain in the noise, or too little of it is in the record"
        return _no_answer(reason, mode.rows_used, kind)
    return _answer(mode, kind, errors, interval_s, scale, mean)


def _no_answer(reason: str, rows: int, kind: str = "none") -> Transient:
    return Transient(None, None, None, None, None, None, None, None, None, kind, rows, reason)


def _unusable(window: Array) -> str:
    """Why the rows are no record; empty if they are one."""
    if len(window) < FEWEST_ROWS:
        few = "1 row is" if len(window) == 1 else f"{len(window)} rows are"
        return f"{few} too few; {FEWEST_ROWS} or more are needed"
    if not math.isfinite(float(window.max()) - float(window.min())):
        bad = np.flatnonzero(~np.isfinite(window))
        return f"row {bad[0]} is not a finite number" if len(bad) else "the values are too large"
    return ""


def _moving_rows(window: Array) -> slice:
    """The window without ends where the values rest, or move by a few steps of a converter only.

    There the error of a converter is not noise: it stays the same for many rows.
    """
    looked_at = max(FEWEST_ROWS, len(window) // 50)

    def resting(rows: Array) -> int:
        """Rows at the start that stay near the first one, if these are many."""
        if np.count_nonzero(np.diff(rows[:looked_at])) > looked_at // 2:
            return 0
        moved = rows != rows[0]
        if not moved.any():
            return len(rows)
        step = abs(rows[np.argmax(moved)] - rows[0])
        rest = int(np.argmax(np.abs(rows - rows[0]) > RESTING_STEPS * step)) - 1
        return rest if rest > 2 * looked_at else 0

    return slice(resting(window), max(0, len(window) - resting(window[::-1])))


def _scaled(moving: Array) -> tuple[float, float, Array]:
    """The moving rows as mean + values, in units of an exact scale near the peak."""
    peak = max(float(moving.max()), -float(moving.min()))
    scale = 2.0 ** max(math.frexp(peak)[1], -1000)
    scaled = moving * (1.0 / scale)
    mean = float(scaled.sum()) / len(scaled)
    scaled -= mean
    return scale, mean, scaled


def _significant_gain(mode: Mode) -> float:
    """Fall of the sum of squares that noise alone does not bring about."""
    free = max(1, len(mode.record.data) - 5)
    return (40.0 + 4.0 * math.log(mode.rows_used)) * math.exp(12.0 / free) * mode.deviation**2


def _verdict(mode: Mode, interval_s: float) -> tuple[str, str]:
    """Kind of the fitted mode, and why it is no answer; an empty reason if it is one."""
    sigma, a0 = mode.poles
    d = sigma * sigma - a0
    line = straight_line_misfit(mode.record)
    gain = line - mode.fit.rss
    if line <= mode.exact_rss or gain < _significant_gain(mode):
        return "none", "nothing stands out of the noise but a constant or a straight line"
    rate = _single_rate(mode) if d > -0.75 * a0 else None
    if rate is not None:
        return "first-order", (
            f"one real pole, s = {rate / interval_s:.6g} 1/s, explains the record; "
            "a second-order mode has two"
        )
    if math.sqrt(abs(a0)) * mode.rows_used < SHORTEST_RAD:
        return "none", "the record is too short: less than a twentieth of a cycle"
    if a0 <= 0.0:
        return "none", "one real pole grows and another decays: no natural frequency"
    if math.sqrt(max(d, 0.0)) + abs(sigma) > FASTEST_DECAY:
        return "none", "the faster pole decays within one row; sample faster"
    if math.sqrt(max(-d, 0.0)) * FEWEST_ROWS_PER_CYCLE > 2.0 * math.pi:
        return "none", (
            f"the oscillation has fewer than {FEWEST_ROWS_PER_CYCLE} rows per cycle "
            "and may be an alias; sample faster"
        )
    kind = "oscillatory" if d < 0.0 else "overdamped"
    if _holds_more(mode, line):
        return kind, "one second-order mode does not explain the record; it may hold several"
    return kind, ""


def _too_large(errors: Errors, mode: Mode) -> bool:
    """Whether omega and zeta are so uncertain that they are no answer."""
    sigma, a0 = mode.poles
    omega = math.sqrt(a0)
    return max(errors[0] / omega, errors[1] / max(1.0, abs(sigma) / omega)) > LARGEST_ERROR


def _holds_more(mode: Mode, line: float) -> bool:
    """Whether the residuals tell of more than the mode, and weigh too much to be passed over.

    line: sum of squares about a straight line. What the condensed record does not show, such as
    another tone or a spike, the rows do.
    """
    rms, largest = mode.residuals
    energy = mode.rows_used * rms**2
    strange = rms > 3.0 * mode.deviation or largest**2 > 0.3 * energy
    return (mode.correlation > 1.0 and mode.fit.rss > LARGEST_MISFIT * line) or (
        strange and energy > line - mode.fit.rss
    )


def _single_rate(mode: Mode) -> float | None:
    """Rate (1/row) of the single real pole that explains the record as well, if there is one."""
    sigma, a0 = mode.poles
    root = math.sqrt(max(0.0, sigma * sigma - a0))
    rate = sigma
    if root > 0.0:  # the pole with the larger share of the energy
        f, g = mode.fit.weights[0], mode.fit.weights[1] / root
        share = [(f + g) ** 2 * abs(sigma - root), (f - g) ** 2 * abs(sigma + root)]
        rate = sigma + root if share[0] >= share[1] else sigma - root
    enough = mode.fit.rss + SINGLE_POLE_GAIN * mode.variance + mode.exact_rss
    single = refine(mode.record, np.array([rate]), steps=2)
    if single is not None and enough < single.rss < 10.0 * enough:
        single = refine(mode.record, single.poles)
    if single is None or single.rss > enough:
        return None
    return float(single.poles[0]) * (-1.0 if mode.backward else 1.0)


def _errors(mode: Mode, mean: float) -> Errors:
    """Standard deviations of omega, zeta and damped frequency, per row; `mean` was taken off rows."""
    sigma, a0 = mode.poles
    omega = math.sqrt(a0)
    covariance = mode.fit.covariance * mode.variance
    noise = mode_noise(mode) if mode.is_noisy() else None
    if noise is not None:  # it explains the correlation, which need not be counted twice
        covariance = mode.fit.covariance * noise.level + noise.drift
    covariance = covariance + mode.fit.rounding(mode.record, mean)
    slopes = np.array(
        [[0.0, 0.5 / omega], [-1.0 / omega, 0.5 * sigma / omega**3], [-2.0 * sigma, 1.0]]
    )
    errors = np.sqrt(np.abs(np.sum((slopes @ covariance) * slopes, axis=1)))
    if mode.weak_part is not None:
        poles, covariance = mode.weak_part
        if noise is not None:
            covariance = covariance * (noise.level / mode.deviation**2) + 2.0 * noise.drift
        scatter = np.sqrt(np.abs(np.sum((slopes @ covariance) * slopes, axis=1)))
        errors += np.maximum(0.0, np.abs(slopes @ (poles - mode.fit.poles)) - 3.0 * scatter)
    omega_error, zeta_error, square_error = (float(error) for error in errors)
    return (
        omega_error + EPS * omega,
        zeta_error + EPS * max(1.0, abs(sigma) / omega),
        _root_error(a0 - sigma * sigma, square_error) + EPS * omega,
    )


def _root_error(square: float, error: float) -> float:
    """Error of sqrt(max(0, square)), which has no slope at 0, from the standard deviation of its square.

    A truth k errors of the square away is at most k of these away, for any k from 1 to MOST_ERRORS.
    """
    if square + MOST_ERRORS * error <= 0.0:
        return 0.0
    if square <= 0.0:  # the largest of sqrt(square + k error) / k, at k = -2 square / error
        k = min(max(1.0, -2.0 * square / error), MOST_ERRORS)
        return math.sqrt(square + k * error) / k
    root = math.sqrt(square)
    k = min(max(1.0, square / error), MOST_ERRORS) if error > 0.0 else 1.0
    below = (root - math.sqrt(max(0.0, square - k * error))) / k
    return max(below, error / (math.sqrt(square + error) + root))


def _answer(
    mode: Mode, kind: str, errors: Errors, interval_s: float, scale: float, mean: float
) -> Transient:
    """The fitted mode in the units of the record."""
    sigma, a0 = mode.poles
    omega, d = math.sqrt(a0), sigma * sigma - a0
    damped = math.sqrt(max(0.0, -d))
    omega_error, zeta_error, damped_error = errors
    a, b, offset = mode.fit.weights
    f, g = (float(values[0]) for values in mode_functions(mode.times([0.0]), sigma, a0))
    x, slope = a * f + b * g, a * (sigma * f + d * g) + b * (sigma * g + f)
    y = (slope - sigma * x) / damped if kind == "oscillatory" else slope / omega
    return Transient(
        omega=omega / interval_s,
        omega_damped=damped / interval_s,
        zeta=(sigma if mode.backward else -sigma) / omega,
        omega_error=omega_error / interval_s,
        omega_damped_error=damped_error / interval_s,
        zeta_error=zeta_error,
        amplitude=math.hypot(x, y) * scale,
        offset=(offset + mean) * scale,
        residual_rms=mode.residuals[0] * scale,
        kind=kind,
        rows_used=mode.rows_used,
    )


def _rows(time_s: Array, values: Array) -> None:
    """Raise ValueError unless there is a finite value for every time, and one at least."""
    if np.ndim(values) != 1 or np.shape(time_s) != np.shape(values):
        raise ValueError(
            f"time_s and values must be one-dimensional and of equal length, "
            f"not of shapes {np.shape(time_s)} and {np.shape(values)}"
        )
    if len(values) == 0:
        raise ValueError("the record has no rows; one or more are needed")
    if not np.isfinite(values).all():
        row = int(np.argmin(np.isfinite(values)))
        raise ValueError(f"row {row} of the record is {values[row]}; finite values are needed")


def final(time_s: Array, values: Array) -> Readout:
    """Last value of a record (rows,), and its time. Raises ValueError for a record without rows."""
    _rows(time_s, values)
    return {"value": float(values[-1]), "time_s": float(time_s[-1])}


def maximum(time_s: Array, values: Array) -> Readout:
    """Largest value of a record (rows,), and the time at which it is first reached."""
    _rows(time_s, values)
    row = int(np.argmax(values))
    return {"value": float(values[row]), "time_s": float(time_s[row])}


def minimum(time_s: Array, values: Array) -> Readout:
    """Smallest value of a record (rows,), and the time at which it is first reached."""
    _rows(time_s, values)
    row = int(np.argmin(values))
    return {"value": float(values[row]), "time_s": float(time_s[row])}


def rms(time_s: Array, values: Array) -> Readout:
    """Root of the time mean of the square of a record (rows,), by the trapezoidal rule."""
    _rows(time_s, values)
    peak = float(np.max(np.abs(values))) or 1.0  # keeps the squares from overflow
    return {"value": peak * math.sqrt(_time_mean(time_s, np.square(values / peak)))}


def mean(time_s: Array, values: Array) -> Readout:
    """Time mean of a record (rows,), by the trapezoidal rule."""
    _rows(time_s, values)
    peak = float(np.max(np.abs(values))) or 1.0  # keeps the sum from overflow
    return {"value": peak * _time_mean(time_s, values / peak)}


def _time_mean(time_s: Array, values: Array) -> float:
    """Integral over the rows' times by the trapezoidal rule, over their length; of one row its value.

    A row at either end of the record stands for half an interval only, so that a whole number of
    cycles of an oscillation has the mean 0 though its first row comes again as its last.
    """
    steps = np.diff(time_s)
    length_s = float(np.sum(steps))
    if not length_s > 0.0:
        return float(np.mean(values))
    return float(np.sum((values[1:] + values[:-1]) * steps)) / (2.0 * length_s)


def transient(time_s: Array, values: Array) -> Readout:
    """Figures of `measure_transient` for a record (rows,) that is sampled uniformly."""
    if np.ndim(values) != 1 or np.shape(time_s) != np.shape(values):
        _rows(time_s, values)
    steps = np.diff(time_s)
    interval_s = float(np.mean(steps)) if len(steps) else 0.0
    if len(values) < FEWEST_ROWS:
        return figures(_no_answer(_unusable(values), 0))
    if not interval_s > 0.0 or np.max(np.abs(steps - interval_s)) > (
        UNEVEN * interval_s + 4.0 * EPS * float(np.max(np.abs(time_s)))
    ):
        return figures(_no_answer("the rows are not evenly spaced in time", 0))
    return figures(measure_transient(values, interval_s))


def figures(found: Transient) -> Readout:
    """A transient as a readout tells it."""
    return {name: getattr(found, name) for name in TOLD}


TOLD = tuple(
    f.name for f in fields(Transient) if f.name not in ("residual_rms", "kind", "rows_used")
)
READOUTS: dict[str, Callable[[Array, Array], Readout]] = {
    "final": final,
    "maximum": maximum,
    "minimum": minimum,
    "rms": rms,
    "mean": mean,
    "transient": transient,
}
