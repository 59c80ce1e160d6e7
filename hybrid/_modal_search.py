"""Search for the mode of a record: first guesses at its poles, and the rows that it explains.

Time in rows; a guess is (sigma, a0) as in `hybrid._modal_fit`.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from hybrid._modal_fit import (
    EPS,
    MEAN_ONLY_RAD,
    Array,
    Condensed,
    Fit,
    Index,
    condense,
    fit_weights,
    improve,
    misfit,
    mode_functions,
    refine,
    row_residuals,
)

Guess = tuple[float, float]

HEAD_ROWS = 6144  # rows looked at one by one; a longer record is averaged down to this order
WINDOW_RATIO = 8  # between one window and the next
WINDOW_PICKS = 48  # rows of a window that enter the regression
FASTEST_Z = 1e-3  # factor per row; a mode that decays faster leaves no second row
CLEAN_ROWS = 1024  # that are looked at in a record without noise
CLEAN = 1e-4  # share of the largest value that a regression leaves over in a record without noise
CLOSE = 1e-6  # share of the sum of squares left over by a guess that needs no rival

FEWEST_ROWS = 8
FIRST_ROWS = 32
OUTLIER = 5.0  # residual of a first row, in deviations, that gives away a faster mode
FOREIGN = 100.0  # times OUTLIER; such rows can belong to no second-order mode
DROPS = (4, 5, 8, 16, 32)  # first rows to leave out, tried in this order
LONG_DROPS = (128, 512, 2048, 8192)
FEWEST_GROWING = 16  # rows that are left of a record whose later half is left out
ROUNDED_OFF = 1e-12  # of the scale of the values: what spreads less has lost its digits to the mean
HIDDEN = 1e-10  # curvature between the poles' tangents that is mostly rounding
LEFT_ROWS = 9  # at least, when first rows are left out
MASKING_ROWS = 256  # in a shorter record a fit can bend to take up a faster mode
MASKED = 0.3  # ratio of deviations that proves that it did
CLEANER = 0.7  # ratio of deviations that proves that a slower transient was left out
SAME_MODE = 0.2  # largest change of the poles, relative to their size

EXACT = 1e-12  # share of the largest value below which a double-precision record holds nothing
TINY = 1e-18  # of the scale of the values, below which a deviation means nothing
TESTED_LAGS = 8
CORRELATED = 40.0  # chi-squared with TESTED_LAGS degrees of freedom; chance is 3e-6


def damped_frequency(poles: Guess | Array) -> float:
    """Damped frequency (rad/row) of a mode; 0 if its poles are real."""
    return math.sqrt(max(0.0, float(poles[1] - poles[0] ** 2)))


def averaged(values: Array, size: int) -> Array:
    """Means of consecutive runs of `size` rows."""
    rows = len(values) // size
    means: Array = values[: rows * size].reshape(rows, size).sum(axis=1) / size
    return means


def spectral_guess(values: Array) -> Guess:
    """Pole of the highest line of the spectrum, from two neighbouring bins.

    The transform of z^n at bin k is proportional to 1 / (1 - z u_k), u_k = exp(-2 pi i k / N), so
    two bins give z (Bertocco, Offelli and Petri, IEEE Trans. Instrum. Meas. 43 (1994) 245).
    """
    shift = max(0, len(values).bit_length() - 6)
    rows = (len(values) >> shift) << shift  # a length without large prime factors
    spectrum = np.fft.rfft(values[:rows])  # a constant shows in bin 0 alone
    power = spectrum.real**2 + spectrum.imag**2
    k = int(np.argmax(power[1:-1])) + 1
    j = k + 1 if power[k + 1] > power[k - 1] else k - 1
    turn = np.exp(-2j * np.pi * np.array([k, j]) / rows)
    above, below = spectrum[k] - spectrum[j], spectrum[k] * turn[0] - spectrum[j] * turn[1]
    if above == 0.0 or below == 0.0:
        return 0.0, float(2.0 * np.pi * k / rows) ** 2
    s = np.log(above / below)
    return float(s.real), float(s.real**2 + s.imag**2)


@lru_cache(maxsize=32)
def _window_picks(rows: int) -> Index:
    """Rows (windows, WINDOW_PICKS), evenly spread in log time, of windows that shorten."""
    windows = [rows]
    while windows[-1] >= 16 * WINDOW_RATIO:
        windows.append(windows[-1] // WINDOW_RATIO)
    spread = np.linspace(0.0, 1.0, WINDOW_PICKS)
    return np.stack([w**spread for w in windows]).astype(int) - 1


def running_sum_guesses(values: Array, windows: int | None = None) -> tuple[list[Guess], float]:
    """Poles from y = c + e n + g n^2 - a S y - b S S y by regression, S being the running sum.

    That is the difference equation of the mode summed twice: still exact, and smooth under noise.
    One guess for each of several windows, all from the first row, as the mode may fill only a part;
    and the largest residual of the first window, which is the whole.
    """
    sums = np.cumsum(values) - values
    double_sums = np.cumsum(sums) - sums
    guesses, largest = [], math.inf
    for picks in _window_picks(len(values))[:windows]:
        n, y = picks / picks[-1], values[picks]
        design = np.stack([sums[picks], double_sums[picks], np.ones_like(n), n, n * n])
        norms = np.sqrt(np.einsum("ij,ij->i", design, design))
        norms[norms == 0.0] = 1.0
        design /= norms[:, None]
        weights = np.linalg.lstsq(design.T, y, rcond=EPS)[0]
        slope, level = (weights[:2] / norms[:2]).tolist()
        root = cmath.sqrt(0.25 * slope * slope + level)
        s1, s2 = _logarithm(1.0 + 0.5 * slope + root), _logarithm(1.0 + 0.5 * slope - root)
        guesses.append((0.5 * (s1 + s2).real, (s1 * s2).real))
        if len(guesses) == 1:
            largest = float(np.abs(y - weights @ design).max())
    return guesses, largest


def _logarithm(z: complex) -> complex:
    """log z, for a mode that alternates or decays too fast as for one that decays in a row."""
    return cmath.log(FASTEST_Z if z.imag == 0.0 and z.real < FASTEST_Z else z)


def _scaled(guess: Guess, size: int) -> Guess:
    return guess[0] / size, guess[1] / size**2


def starting_poles(values: Array) -> tuple[Condensed, float, Array]:
    """The condensed record, its frequency, and the guess (2,) that leaves the least squares."""
    size = 1
    while len(values) // (2 * size) >= HEAD_ROWS:
        size *= 2
    means = averaged(values, size)
    guesses, residual = running_sum_guesses(means)
    guesses = [_scaled(guess, size) for guess in guesses]
    if residual < CLEAN * float(np.max(np.abs(means))):
        omega = damped_frequency(guesses[0])
        record = condense(values, omega)
        left, best = min((misfit(record, *guess), guess) for guess in {guesses[0], guesses[-1]})
        if left < CLOSE * float(record.data @ record.data):
            return record, omega, np.array(best)
    slow = size == 1 or np.var(means) > 0.5 * np.var(values[:: size - 1])
    line = _scaled(spectral_guess(means), size) if slow else spectral_guess(values)
    omega = line[1] ** 0.5
    record = condense(values, omega)
    if size > 1:
        guesses += running_sum_guesses(values[:HEAD_ROWS])[0]
    guesses.append(line)
    best = min(guesses, key=lambda guess: misfit(record, *guess))
    return record, omega, np.array(best)


@dataclass(frozen=True)
class Mode:
    """A fitted mode. The fit counts time from the stronger end: `backward` if that is the last row.

    values: the record, of which the first `dropped` rows were not fitted. deviation: standard
    deviation of a row. weak_part: poles and their covariance from a fit without the strong end,
    made where the residuals show that the model is not the whole truth.
    """

    values: Array
    dropped: int
    backward: bool
    record: Condensed
    fit: Fit
    deviation: float
    weak_part: tuple[Array, Array] | None = None

    @property
    def poles(self) -> Guess:
        """sigma and a0, in the direction of the fit."""
        return float(self.fit.poles[0]), float(self.fit.poles[1])

    @property
    def rows_used(self) -> int:
        """Rows that were fitted."""
        return len(self.values) - self.dropped

    @property
    def variance(self) -> float:
        """Variance of a row, enlarged to match the correlation between rows."""
        return self.deviation**2 * self.correlation

    @property
    def exact_rss(self) -> float:
        """Sum of squares below which a double-precision record holds nothing."""
        return EXACT**2 * float(self.record.data @ self.record.data)

    def fitted_values(self) -> Array:
        """The rows that were fitted, in the order of the fit."""
        fitted = self.values[self.dropped :]
        return fitted[::-1] if self.backward else fitted

    @cached_property
    def residuals(self) -> tuple[float, float]:
        """Root mean square and largest size of the rows less mode and constant."""
        return row_residuals(self.fitted_values(), self.record, self.fit)

    def times(self, rows: ArrayLike) -> Array:
        """The fit's times of rows of `values`."""
        row = np.asarray(rows, dtype=float)
        return len(self.values) - 1.0 - row if self.backward else row - self.dropped

    @cached_property
    def correlation(self) -> float:
        """Factor by which correlation between residuals enlarges the variance of their mean.

        1 if they pass for independent.
        """
        largest = 1.0
        for lane in range(3):
            x = self.fit.residual[self.record.lane == lane]
            power = float(x @ x)
            if len(x) < 4 * TESTED_LAGS or power == 0.0:
                continue
            c = np.correlate(np.append(x, np.zeros(TESTED_LAGS)), x)[1:] / power
            if len(x) * float(c @ c) > CORRELATED:
                c = np.correlate(x, x, "full")[len(x) : len(x) + len(x) // 4] / power
                largest = max(largest, 1.0 + 2.0 * float(np.sum(np.abs(c))))
        return largest

    def is_noisy(self) -> bool:
        """Whether the residuals are more than rounding."""
        return self.deviation > EXACT * max(float(self.values.max()), -float(self.values.min()))

    def is_structured(self) -> bool:
        """Whether the residuals are correlated, and are more than rounding."""
        return self.correlation > 1.0 and self.is_noisy()

    def outgrows_itself(self) -> bool:
        """Whether two real poles grow: the rounding of the last rows may hide the slower one."""
        sigma, a0 = self.poles
        return self.backward and sigma * sigma > a0

    @cached_property
    def _first_residuals(self) -> Array:
        """Sizes of the residuals of the rows left out and of the first fitted ones."""
        values = self.values[: self.dropped + FIRST_ROWS]
        a, b, offset = self.fit.weights
        with np.errstate(over="ignore", invalid="ignore"):  # before the start of a fast decay
            f, g = mode_functions(self.times(np.arange(len(values))), *self.fit.poles)
            sizes: Array = np.abs(values - a * f - b * g - offset)
        return sizes

    def _first_rounding(self) -> float:
        """What rounding may leave in the first rows."""
        return 32.0 * EPS * float(np.abs(self.values[: self.dropped + FIRST_ROWS]).max())

    def first_rows_fit(self) -> bool:
        """Whether the first fitted rows hold nothing but the mode."""
        largest = float(self._first_residuals[self.dropped :].max())
        return largest < OUTLIER * self.deviation + self._first_rounding()

    def dropped_rows_differ(self) -> bool:
        """Whether the rows left out hold, beyond doubt, more than the mode."""
        largest = float(self._first_residuals[: self.dropped].max())
        return largest > FOREIGN * (OUTLIER * self.deviation + self._first_rounding())


def _clean_guess(used: Array, backward: bool) -> Guess | None:
    """Poles of a plain oscillation without noise, or None if the record may be anything else.

    The first rows are left out, as they may hold a faster mode, and of a long record all but
    CLEAN_ROWS, as no noise needs to be averaged.
    """
    rest = used[: -DROPS[1]] if backward else used[DROPS[1] :]
    size = max(1, len(rest) // CLEAN_ROWS)
    picked = rest[::size][:CLEAN_ROWS]
    guesses, residual = running_sum_guesses(picked, windows=1)
    largest = max(float(picked.max()), -float(picked.min()))
    guess = _scaled(guesses[0], size)
    # Where the poles may be real, the first rows may be all there is to see of the faster one.
    turns = damped_frequency(guess) > max(abs(guess[0]), math.pi / len(used))
    return guess if turns and residual < CLEAN * largest else None


def _foreign_rows(values: Array, guess: Guess) -> int:
    """How many first rows hold more than the mode and a constant, by their difference equation.

    `guess`: poles in the direction of `values`. The equation (1 - 1/z) (1 - z1/z) (1 - z2/z) y = 0
    fails in a row by what that row holds of a faster mode, and later by less.
    """
    y = values[: FIRST_ROWS + 3]
    root = cmath.sqrt(guess[0] ** 2 - guess[1])
    z1, z2 = cmath.exp(guess[0] + root), cmath.exp(guess[0] - root)
    change = np.diff(y)
    left = np.abs(change[2:] - (z1 + z2).real * change[1:-1] + (z1 * z2).real * change[:-2])
    usual = float(np.sort(left)[FIRST_ROWS // 2])
    rounding = 32.0 * EPS * float(np.abs(y).max())
    foreign = np.flatnonzero(left > 2.0 * OUTLIER * usual + rounding)
    return int(foreign[-1]) + 1 if len(foreign) else 0


def _clean_mode(values: Array, backward: bool) -> Mode | None:
    """Mode of a plain oscillation without noise, found without detours; None if it is none."""
    if len(values) <= MASKING_ROWS:
        return None
    used = np.ascontiguousarray(values[::-1]) if backward else values
    guess = _clean_guess(used, backward)
    if guess is None:
        return None
    foreign = _foreign_rows(values, (-guess[0], guess[1]) if backward else guess)
    omega = damped_frequency(guess)
    whole = condense(used, omega)
    for dropped in [drop for drop in (0, *DROPS) if drop >= foreign]:
        record = whole.without(dropped, last=backward) if dropped else whole
        fit = fit_weights(record, np.array(guess))
        if fit is None or not fit.rss < CLOSE * float(record.data @ record.data):
            return None
        fit = improve(record, fit)
        mode = _mode(values, dropped, backward, record, fit)
        if not _waves_suit(record, omega, fit):
            return None
        if mode.first_rows_fit():
            return mode if dropped == 0 or mode.dropped_rows_differ() else None
    return None


def _waves_suit(record: Condensed, omega: float, fit: Fit) -> bool:
    """Whether waves of the frequency `omega` still keep what the fitted mode needs."""
    lasting = min(record.longest, 0.5 / (abs(float(fit.poles[0])) + EPS))
    return abs(damped_frequency(fit.poles) - omega) * lasting <= 0.5 * MEAN_ONLY_RAD


def _fit_values(used: Array, poles: Array | None) -> tuple[Condensed, Fit] | None:
    """Fit rows whose larger amplitude comes first, from the given poles if there are any."""
    if poles is None:
        record, omega, poles = starting_poles(used)
    else:
        omega = damped_frequency(poles)
        record = condense(used, omega)
    fit = refine(record, poles)
    if fit is None:
        return None
    if not _waves_suit(record, omega, fit):
        record = condense(used, damped_frequency(fit.poles))
        fit = refine(record, fit.poles) or fit
    return record, fit


def _fit_rows(values: Array, dropped: int, backward: bool, poles: Array | None) -> Mode | None:
    """Fit the rows after the first `dropped` ones."""
    used = np.ascontiguousarray(values[dropped:][::-1] if backward else values[dropped:])
    found = _fit_values(used, poles)
    if found is None:
        return None
    return _mode(values, dropped, backward, *found)


def _mode(values: Array, dropped: int, backward: bool, record: Condensed, fit: Fit) -> Mode:
    """The mode with the deviation that the fit left over."""
    variance = fit.rss / max(1, len(record.data) - 5)
    return Mode(values, dropped, backward, record, fit, max(variance**0.5, TINY))


def _without_faster_mode(whole: Mode) -> Mode:
    """Leave out as few first rows as it takes for the next ones to fit."""
    rows = len(whole.values)
    most = min(rows // 2, rows - LEFT_ROWS)
    best = whole if whole.first_rows_fit() else None
    for dropped in [drop for drop in DROPS if drop <= most]:
        mode = _fit_rows(whole.values, dropped, whole.backward, whole.fit.poles)
        if mode is None or not mode.first_rows_fit():
            continue
        if best is not None and mode.deviation > MASKED * best.deviation:
            break
        best = mode
        if rows > MASKING_ROWS:
            break
    return best or whole


def _without_transient(mode: Mode) -> Mode:
    """Leave out up to an eighth of the rows, if these hold a faster mode and the others do not."""
    most = len(mode.values) // 8
    late = _fit_rows(mode.values, most, mode.backward, mode.fit.poles)
    if late is None or late.deviation > CLEANER * mode.deviation:
        return mode
    for dropped in [*(drop for drop in LONG_DROPS if mode.dropped < drop < most), most]:
        other = _fit_rows(mode.values, dropped, mode.backward, mode.fit.poles)
        if other is not None and other.first_rows_fit() and not other.is_structured():
            change = np.abs(other.fit.poles - mode.fit.poles)
            size = abs(mode.poles[1]) ** np.array([0.5, 1.0])
            if (change > SAME_MODE * size).any():
                return mode
            return replace(other, weak_part=_weak_part(other))
    return mode


def _weak_part(mode: Mode) -> tuple[Array, Array] | None:
    """Poles and their covariance without the strong end of the record."""
    strong = int(min(mode.rows_used // 2, 1.0 / (abs(mode.poles[0]) + EPS)))
    found = _fit_values(np.ascontiguousarray(mode.fitted_values()[strong:]), mode.fit.poles)
    if found is None:
        return None
    record, fit = found
    return fit.poles, fit.covariance * fit.rss / max(1, len(record.data) - 5)


def _without_overgrowth(mode: Mode) -> Mode:
    """Leave out the later half of the rows, again and again, as long as they hide the slower pole.

    They do where rounding leaves nothing by which to tell the poles apart, or where the rest contradicts
    them or is surer of them.
    """
    while len(mode.values) >= 2 * FEWEST_GROWING:
        earlier = mode.values[: len(mode.values) // 2]
        if len(earlier) < mode.dropped + LEFT_ROWS or float(np.ptp(earlier)) < ROUNDED_OFF:
            return mode
        rest = _fit_rows(earlier, mode.dropped, True, None)
        if rest is None or not rest.outgrows_itself():
            return mode
        ours, theirs = (
            m.fit.covariance * m.variance + m.fit.rounding(m.record) for m in (mode, rest)
        )
        apart = np.abs(mode.fit.poles - rest.fit.poles)
        contradicts = (apart > OUTLIER * np.sqrt(np.diag(ours + theirs))).any()
        hidden = mode.fit.curvature.min() < HIDDEN
        if not (hidden or contradicts or theirs[1, 1] < ours[1, 1]):
            return mode
        mode = rest
    return mode


def _power(values: Array) -> float:
    """Sum of squares about the mean."""
    varying = values - values.sum() / len(values)
    return float(varying @ varying)


def find_mode(values: Array) -> Mode | None:
    """Fit the mode, without first rows that hold a faster one too; None if there is none."""
    rows = len(values)
    sample = values[:: rows // 2048 | 1]
    half = len(sample) // 2
    backward = bool(_power(sample[half:]) / (len(sample) - half) > _power(sample[:half]) / half)
    mode = _clean_mode(values, backward)
    if mode is None:
        mode = _fit_rows(values, 0, backward, None)
        if mode is None:
            return None
        if rows <= MASKING_ROWS or not mode.first_rows_fit():
            mode = _without_faster_mode(mode)
    if mode.is_structured():
        mode = _without_transient(mode)
    if mode.outgrows_itself():
        mode = _without_overgrowth(mode)
    if mode.weak_part is None and mode.is_structured():
        mode = replace(mode, weak_part=_weak_part(mode))
    return mode
