"""Result of VRFT: gains, their accuracy, the predicted closed loop, and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from forcectl.arrays import Array, Mask
from forcectl.tuning.controller_basis import ControllerBasis, PidGains
from forcectl.tuning.identifiability import HIGHEST
from forcectl.tuning.plant_model import IdentifiedPlant
from forcectl.tuning.reference_model import ReferenceModel

OUT_OF_REACH = 0.1  # mismatch above which the reference model is out of reach, model error above which none is trusted
_BETTERED = 1.25  # times the smallest mismatch: above that, too, the reference model counts as out of reach
_NONE = 1e-4  # a mismatch that counts as zero
_NOTABLE = 0.01  # a mismatch above which better gains are worth a warning
_NOISE_SHARE = 0.1  # share of noise in the independent part of a regressor above which its gain is not identifiable
_NOISE_OF_ONE = 4.0  # largest noise of one sample, in units of its rms
_STANDARD_ERRORS = 3.0  # a gain that is within so many of zero is not identifiable either


@dataclass(frozen=True)
class VrftFit:
    """Gains found by VRFT, and measures of their reliability.

    Attributes:
        gains: theta in the form of `basis`, shape (p,).
        standard_errors: of theta, shape (p,), robust against correlated residuals; they do not contain the bias that
            noise in the output causes; NaN of refined gains.
        r_squared: share of the (filtered) input that the fit explains [-].
        residual_rms: of the residuals of the fit [m].
        condition_number: of the regressors, each scaled to length one [-].
        excitation_order: persistent-excitation order of e_L, at most 10.
        noise_rms: of the output where the input rests [N]; None when it never does.
        noise_share: per gain, the share of noise in the part of its regressor that is independent of the others [-];
            None as above.
        plant: model identified from the same record; it does not enter the gains unless they are refined.
        predicted_step, model_step: unit step responses of the tuned loop on that plant and of the reference model,
            shape (h,) [-]; NaN from where the loop has diverged.
        stable: whether the tuned loop on that plant is stable.
        model_error, record_mismatch: error of the prediction, and the mismatch computed from the record without a plant
            model (None where that is not possible), in the unit of `model_mismatch` [-]; see
            `forcectl.tuning.prediction`.
        best_mismatch: smallest mismatch of any gains on that plant [-]; None with more gains than are searched.
        vrft_gains: the gains of VRFT where `gains` are refined ones, else None.
        warnings: one line each.
    """

    basis: ControllerBasis
    model: ReferenceModel
    prefiltered: bool
    instrumented: bool
    gains: Array
    standard_errors: Array
    r_squared: float
    residual_rms: float
    condition_number: float
    excitation_order: int
    noise_rms: float | None
    noise_share: Array | None
    plant: IdentifiedPlant
    predicted_step: Array
    model_step: Array
    stable: bool
    model_error: float
    record_mismatch: float | None
    best_mismatch: float | None
    vrft_gains: Array | None = None
    warnings: tuple[str, ...] = ()

    @property
    def pid(self) -> PidGains | None:
        """The gains in discrete and continuous form; None for a basis that is no PID."""
        return self.basis.pid_gains(self.gains)

    @property
    def model_mismatch(self) -> float:
        """`|s_T - s_M|` over `|1 - s_M|`, the step responses of tuned loop and reference model [-]; infinite:
        unstable."""
        return mismatch(self.predicted_step, self.model_step) if self.stable else np.inf

    @property
    def trusted(self) -> bool:
        """Whether the plant model, in the loop, reproduces the record well enough for its prediction to be trusted."""
        return self.model_error <= OUT_OF_REACH

    @property
    def expected_mismatch(self) -> float:
        """`model_mismatch`, or `record_mismatch` where the prediction is not trusted and that one is larger [-]."""
        read = self.record_mismatch if not self.trusted and self.record_mismatch is not None else 0.0
        return max(self.model_mismatch, read) if self.stable else np.inf

    @property
    def out_of_reach(self) -> bool:
        """Whether the loop is expected to miss the model by more than `OUT_OF_REACH`, or other gains to do better."""
        best = np.inf if self.best_mismatch is None or not self.trusted else self.best_mismatch
        return self.expected_mismatch > OUT_OF_REACH or self.model_mismatch > _BETTERED * best + _NONE


def mismatch(step: Array, wanted: Array) -> float:
    """`|s_T - s_M|` over `|1 - s_M|` of two unit step responses, shape (h,) [-]."""
    return float(np.linalg.norm(step - wanted) / np.linalg.norm(1 - wanted))


def warnings(fit: VrftFit, y: Array) -> Iterator[str]:
    """The warnings about a fit to a record with the output y, a line each."""
    size = fit.basis.size
    if fit.excitation_order < min(size, HIGHEST):
        yield f"the record excites {fit.excitation_order} of {size} gains: move more often, or at other intervals"
    noise = fit.noise_share if fit.noise_share is not None else np.zeros(size)
    noisy = noise > _NOISE_SHARE
    open_sign = (np.abs(fit.gains) < _STANDARD_ERRORS * fit.standard_errors) & ~noisy
    # By rounding, a gain that is exactly zero has a standard error, too.
    open_sign &= fit.standard_errors > 1e-9 * np.abs(fit.gains).max()
    if noisy.any():
        it, its = ("it", "its regressor") if noisy.sum() == 1 else ("them", "their regressors")
        share = f"{100 * noise[noisy].max():.0f} % of the independent part of {its} is noise"
        yield f"{_named(fit, noisy)} not identifiable: {share}; leave {it} out or move faster"
    if open_sign.any():
        yield f"{_named(fit, open_sign)} not identifiable: within {_STANDARD_ERRORS:g} standard errors of zero"
    if abs(y[0]) > 0.1 * float(np.sqrt(np.mean(y**2))) + _NOISE_OF_ONE * (fit.noise_rms or 0.0):
        yield f"the record does not begin at rest: y[0] = {y[0]:.3g}; u and y must be deviations from rest"
    if abs(fit.model.static_gain - 1) > 1e-6:
        yield f"the reference model ends at {fit.model.static_gain:.4g} of the reference, not at 1"
    if not fit.trusted:
        error = f"by {100 * fit.model_error:.0f} %" if np.isfinite(fit.model_error) else "without bounds"
        yield (
            f"the prediction is not to be trusted: the plant model explains "
            f"{100 * max(fit.plant.explained, 0.0):.1f} % of the output, but in the loop misses the record {error} "
            f"(friction?)"
        )
    if not fit.stable:
        yield "reference model out of reach: the tuned loop is expected to be unstable; choose a slower model"
    elif fit.expected_mismatch > OUT_OF_REACH:
        source = "computed from the record" if fit.expected_mismatch > fit.model_mismatch else "predicted"
        yield (
            f"reference model out of reach: the loop is expected to miss it by {100 * fit.expected_mismatch:.0f} % "
            f"({source}); choose a slower model, or one with the delay of the plant"
        )
    elif fit.out_of_reach and fit.best_mismatch is not None and fit.model_mismatch > _NOTABLE:
        yield (
            f"other gains come nearer to the reference model: these are expected to miss it by "
            f"{100 * fit.model_mismatch:.2g} %, refined ones by {100 * fit.best_mismatch:.2g} %"
        )


def _named(fit: VrftFit, which: Mask) -> str:
    names = [name for name, named in zip(fit.basis.names, which, strict=True) if named]
    return f"{names[0]} is" if len(names) == 1 else f"{', '.join(names[:3])}{', ...' if len(names) > 3 else ''} are"
