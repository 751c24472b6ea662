"""Tone curves, disc colours and their relation to the nominal colours, as one adjustment.

Per channel, with g the curve, s a disc and w the white beside it, both as stored:
``log g(s) - log g(w) = rho + drift * level`` of the disc (1), with level the logarithm of the light
over its median, and drift zero but for what no curve explains; and
``rho = log(terms(nominal) @ b + flare)`` up to what colours under one light and to one sensor
differ from the nominal ones (2). (1) leaves the power of g open, (2) does not.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calichrome.colour.tone_spline import N_BENDS, N_PARAMETERS, ToneSamples
from calichrome.core.arrays import FloatArray, IntArray
from calichrome.core.least_squares import Step, damped_step

__all__ = ["CurveAt", "ToneData", "ToneEquations", "ToneProblem", "ToneScales"]

CurveAt = Callable[[FloatArray, FloatArray], ToneSamples]
"""Parameters and stored values to a curve; see `tone_spline`."""

_EXPONENT, _EXPONENT_SIGMA = 1.2, 0.4
"""Prior of a curve's exponent: it is 1.2 for gamma 2.2, 1.4 for sRGB, 1.2 for BT.709, 0 for linear
values (a candidate of its own)."""

_OFFSET_SIGMA = 0.001
"""Of full scale, light: video that stores black as 16 of 255 has -0.001. Below the darkest disc it
is this that holds the curve: at 0.003 colours there were 4.3 dE2000 off instead of 2.4, with a
known curve 1.2 (board simulations, synthetic spectra)."""

_FLARE_SIGMA = 0.005
"""Of the white: lenses scatter 1 to 3 % of a scene, which is a third as bright as the white."""

_MISMATCH_CHROMA = 15.0
"""Chroma of Lab at which the mismatch has doubled: 0.02 at 35, 0.025 at 50 on the same data."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToneData:
    """What a camera saw.

    Parameters
    ----------
    stored, light : (M, 3) float
        Disc and white beside it, 0..1 of full scale, as stored.
    sigma, light_sigma : (M, 3) float
        Their standard deviations.
    disc : (M,) int
        0..K-1; every disc has a row.
    terms : (K, T) float
        Of the nominal colours relative to the white, homogeneous of degree 1.
    white_terms : (1, T) or (0, T) float
        The same of the white; empty if its colour is not known.
    chroma : (K,) float
        Of the nominal colours, in Lab.
    copies : (K,) float
        Discs of the same nominal colour: together they tell of the mismatch once.
    nominal_sigma : (K,) float
        Relative standard deviation of the nominal colours.
    """

    stored: FloatArray
    light: FloatArray
    sigma: FloatArray
    light_sigma: FloatArray
    disc: IntArray
    terms: FloatArray
    white_terms: FloatArray
    chroma: FloatArray
    copies: FloatArray
    nominal_sigma: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ToneScales:
    """Standard deviations that the data tell, too."""

    noise: float  # of (1) beyond the sigmas of the data: uneven light, relative
    mismatch: float  # of (2), for a grey, relative
    bend: float  # of the curve's bends
    drift: float  # of disc over white, relative per e-fold of light


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """Where the unknowns are: curves, then rho and drift, then b and flare of each channel."""

    n_curves: int
    n_discs: int
    n_terms: int

    @property
    def size(self) -> int:
        return self.n_curves * N_PARAMETERS + 3 * (2 * self.n_discs + self.n_terms + 1)

    def curve(self, channel: int) -> slice:
        """Return where the curve of a channel is: its own, the common one, or nothing."""
        if not self.n_curves:
            return slice(0, 0)
        start = min(channel, self.n_curves - 1) * N_PARAMETERS
        return slice(start, start + N_PARAMETERS)

    def rho(self, channel: int) -> slice:
        start = self.n_curves * N_PARAMETERS + 2 * channel * self.n_discs
        return slice(start, start + self.n_discs)

    def drift(self, channel: int) -> slice:
        start = self.rho(channel).stop
        return slice(start, start + self.n_discs)

    def mix(self, channel: int) -> slice:
        """Return where b and flare of a channel are."""
        start = self.n_curves * N_PARAMETERS + 6 * self.n_discs + channel * (self.n_terms + 1)
        return slice(start, start + self.n_terms + 1)


@dataclass(frozen=True, slots=True, eq=False)
class ToneEquations:
    """The adjustment at a state: squares, and the logarithms of the variances of (1)."""

    cost: float
    n_residuals: int
    gradient: FloatArray
    hessian: FloatArray

    def step(self, damping: float) -> Step | None:
        """Solve (H + damping diag H) d = -g; None if that is not positive definite."""
        return damped_step(self.hessian, self.gradient, damping)


class ToneProblem:
    """The equations of some data and one kind of curve: see `tone_fit.fit_tones`.

    Attributes
    ----------
    weights : (M, 3) float
        Of the rows of (1): below 1 for outliers.
    mismatch_weights : (3, K or K + 1) float
        Of the rows of (2): discs, then the white if its colour is known.
    """

    def __init__(self, data: ToneData, curve_at: CurveAt, n_curves: int) -> None:
        self.data = data
        self.curve_at = curve_at
        self.layout = _Layout(n_curves, len(data.terms), data.terms.shape[1])
        self.weights = np.ones_like(data.stored)  # of robust rows of (1)
        n_rows = len(data.terms) + len(data.white_terms)
        self.mismatch_weights = np.ones((3, n_rows))
        constant = np.ones((n_rows, 1))  # takes the flare
        terms = np.concatenate([data.terms, data.white_terms])
        self.terms = np.concatenate([terms, constant], axis=1)
        self.looseness = np.ones(n_rows)
        self.looseness[: len(data.terms)] += data.chroma / _MISMATCH_CHROMA
        self.fixed = np.zeros(n_rows)
        self.fixed[: len(data.terms)] = data.nominal_sigma
        self.copies = np.ones(n_rows)
        self.copies[: len(data.terms)] = data.copies
        self.of_disc = (data.disc == np.arange(len(data.terms))[:, None]).astype(np.float64)
        self.levels = np.zeros_like(data.light)  # of light, e-folds, as the last curve saw them

    def look(self, state: FloatArray) -> None:
        """Take the levels of light from the curves of a state."""
        for channel in range(3):
            _, light = self.samples(state, channel)
            self.levels[:, channel] = light.log_light - np.median(light.log_light)

    def off(
        self, state: FloatArray, channel: int, stored: ToneSamples, light: ToneSamples
    ) -> FloatArray:
        """Residuals of (1), relative light, (M,)."""
        rho = state[self.layout.rho(channel)][self.data.disc]
        drift = state[self.layout.drift(channel)][self.data.disc] * self.levels[:, channel]
        return np.asarray(stored.log_light - light.log_light - rho - drift)

    def start(self) -> FloatArray:
        """Return a state to start from: the prior curve, and what it makes of the discs."""
        layout, data = self.layout, self.data
        state = np.zeros(layout.size)
        for channel in range(3):
            if layout.n_curves:
                state[layout.curve(channel).start] = _EXPONENT
            stored, light = self.samples(state, channel)
            difference = stored.log_light - light.log_light
            rho = np.array([np.median(difference[data.disc == k]) for k in range(layout.n_discs)])
            state[layout.rho(channel)] = rho
            level = np.exp(np.append(rho, np.zeros(len(data.white_terms))))
            relative = self.terms[:, :-1] / level[:, None]
            mix, *_ = np.linalg.lstsq(relative, np.ones(len(level)), rcond=None)
            state[layout.mix(channel)] = np.append(mix, 0)
        return state

    def samples(self, state: FloatArray, channel: int) -> tuple[ToneSamples, ToneSamples]:
        """Return the curve of a channel at the discs and at the white beside them."""
        both = np.concatenate([self.data.stored[:, channel], self.data.light[:, channel]])
        at = self.curve_at(state[self.layout.curve(channel)], both)
        half = len(both) // 2
        return ToneSamples(*(part[:half] for part in at)), ToneSamples(
            *(part[half:] for part in at)
        )

    def tolerances(self, scales: ToneScales) -> FloatArray:
        """Return the standard deviations of (2), relative, one for each disc and the white."""
        variances = (scales.mismatch * self.looseness) ** 2 + self.fixed**2
        return np.asarray(np.sqrt(variances * self.copies))

    def relation(self, state: FloatArray, channel: int) -> tuple[FloatArray, FloatArray]:
        """Return how far (2) is off, relative, and the predicted level, one row each."""
        level = np.maximum(self.terms @ state[self.layout.mix(channel)], 1e-4)
        rho = np.zeros(len(level))
        rho[: self.layout.n_discs] = state[self.layout.rho(channel)]
        return rho - np.log(level), level

    def relation_jacobian(self, channel: int, level: FloatArray) -> FloatArray:
        """Return the derivatives of what (2) is off by all unknowns."""
        jacobian = np.zeros((len(level), self.layout.size))
        jacobian[:, self.layout.mix(channel)] = -self.terms / level[:, None]
        n_discs = self.layout.n_discs
        jacobian[:n_discs, self.layout.rho(channel)] = np.eye(n_discs)
        return jacobian

    def linearise(self, state: FloatArray, scales: ToneScales) -> ToneEquations:
        """Return cost, gradient and Hessian at a state."""
        layout, data = self.layout, self.data
        gradient = np.zeros(layout.size)
        hessian = np.zeros((layout.size, layout.size))
        cost = 0.0
        for channel in range(3):
            # (1), as the probability of the stored value: its sigma in relative light goes with
            # the slope of the curve, and a flatter curve may not win by making residuals small
            stored, light = self.samples(state, channel)
            of_disc = (data.sigma[:, channel] * np.exp(stored.log_slope)) ** 2
            of_light = (data.light_sigma[:, channel] * np.exp(light.log_slope)) ** 2
            variance = of_disc + of_light + scales.noise**2
            half_by_curve = (
                of_disc[:, None] * stored.slope_jacobian + of_light[:, None] * light.slope_jacobian
            ) / variance[:, None]
            weight = np.sqrt(self.weights[:, channel] / variance)
            residual = self.off(state, channel, stored, light) * weight
            jacobian = (stored.light_jacobian - light.light_jacobian) * weight[:, None]
            jacobian -= residual[:, None] * half_by_curve
            cost += 0.5 * float(residual @ residual)
            cost += 0.5 * float(np.log(variance / of_disc).sum())  # of_disc: constant x slope^2
            curve = layout.curve(channel)
            gradient[curve] += jacobian.T @ residual
            gradient[curve] += (half_by_curve - stored.slope_jacobian).sum(axis=0)
            hessian[curve, curve] += jacobian.T @ jacobian
            blocks = (
                (layout.rho(channel), weight),
                (layout.drift(channel), weight * self.levels[:, channel]),
            )
            for at, by_unknown in blocks:
                gradient[at] -= np.bincount(data.disc, residual * by_unknown, layout.n_discs)
                by_disc = self.of_disc @ (jacobian * by_unknown[:, None])
                hessian[at, curve] -= by_disc
                hessian[curve, at] -= by_disc.T
                for other, by_other in blocks:
                    shared = np.bincount(data.disc, by_unknown * by_other, layout.n_discs)
                    hessian[at, other][np.diag_indices(layout.n_discs)] += shared
        tolerances = self.tolerances(scales)
        for channel in range(3):
            off, level = self.relation(state, channel)
            weight = np.sqrt(self.mismatch_weights[channel]) / tolerances
            residual = off * weight
            jacobian = self.relation_jacobian(channel, level) * weight[:, None]
            cost += 0.5 * float(residual @ residual)
            gradient += jacobian.T @ residual
            hessian += jacobian.T @ jacobian
        away, precision = self.priors(state, scales)
        cost += 0.5 * float(away**2 @ precision)
        gradient += away * precision
        hessian[np.diag_indices(layout.size)] += precision
        n_residuals = data.stored.size + tolerances.size * 3
        return ToneEquations(cost, n_residuals, gradient, hessian)

    def priors(self, state: FloatArray, scales: ToneScales) -> tuple[FloatArray, FloatArray]:
        """Return by how much each unknown is away from its prior, and the prior's precision."""
        centre, precision = np.zeros(self.layout.size), np.zeros(self.layout.size)
        for channel in range(self.layout.n_curves):
            at = self.layout.curve(channel)
            centre[at.start] = _EXPONENT
            precision[at.start] = _EXPONENT_SIGMA**-2
            precision[at.start + 1 : at.stop - 1] = scales.bend**-2
            precision[at.stop - 1] = _OFFSET_SIGMA**-2
        for channel in range(3):
            precision[self.layout.drift(channel)] = scales.drift**-2
            precision[self.layout.mix(channel).stop - 1] = _FLARE_SIGMA**-2
        return state - centre, precision

    def drift_noise(self, variances: FloatArray) -> FloatArray:
        """Return how well (1) tells each drift, (3, K), from the spread of the levels."""
        noise = np.empty((3, self.layout.n_discs))
        for channel in range(3):
            w, x, disc = 1 / variances[:, channel], self.levels[:, channel], self.data.disc
            total, first, second = (
                np.bincount(disc, w * x**power, self.layout.n_discs) for power in range(3)
            )
            information = second - first**2 / total
            noise[channel] = 1 / np.sqrt(np.maximum(information, 1e-12))
        return noise

    def bends(self, of_state: FloatArray) -> FloatArray:
        """Return the bends of all curves, of a state or of its variances."""
        curves = of_state[: self.layout.n_curves * N_PARAMETERS].reshape(-1, N_PARAMETERS)
        return curves[:, 1 : 1 + N_BENDS].ravel()

    def residuals(self, state: FloatArray, scales: ToneScales) -> tuple[FloatArray, FloatArray]:
        """Residuals of (1) and their variances, relative light, (M, 3) each."""
        off, variances = np.empty_like(self.data.stored), np.empty_like(self.data.stored)
        for channel in range(3):
            stored, light = self.samples(state, channel)
            off[:, channel] = self.off(state, channel, stored, light)
            of_disc = self.data.sigma[:, channel] * np.exp(stored.log_slope)
            of_light = self.data.light_sigma[:, channel] * np.exp(light.log_slope)
            variances[:, channel] = of_disc**2 + of_light**2 + scales.noise**2
        return off, variances
