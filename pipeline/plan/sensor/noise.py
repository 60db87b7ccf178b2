"""Noise and levels in the plan: which terms are drawn, and what their approximations may cost."""

from __future__ import annotations

from pipeline.physics.noise.joint import ABOVE_E, ANY_READ_E, DISTANCE, REACH, READ_E
from pipeline.plan.decision import Decision
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.spec.scene import Scene


def _terms(basis: PlanBasis) -> list[Decision]:
    """Of each plain effect of the detector whether its value is the neutral one."""
    s = basis.scene.sensor
    terms = [
        ("flat", s.flat != 1.0, "unity everywhere"),
        ("dark", s.dark_e_per_s != 0.0, "0 e-/s"),
        ("photon_noise", s.photon_noise, "switched off in the scene"),
        ("full_well", s.full_well_e is not None, "no full well given"),
        ("read_noise", s.read_noise_e != 0.0, "0 e-"),
        ("bias", s.bias_dn != 0.0, "0 DN"),
    ]
    given = "given in the scene"
    why = {
        "flat": f"{given}; it acts on light, not on the dark",
        "full_well": f"{given}; clips the charge after photon noise and before read noise; no "
        "blooming",
    }
    out = []
    for name, kept, why_not in terms:
        bound = None if kept or name == "photon_noise" else 0.0
        out.append(Decision(name, kept, why.get(name, given) if kept else why_not, bound, bound))
    return out


def _converter(basis: PlanBasis) -> list[Decision]:
    """Rounding to levels."""
    s = basis.scene.sensor
    return [
        Decision(
            "adc",
            True,
            f"{s.adc_bits} bits, rounding {s.adc_rounding}, clipped at both ends"
            + (" (floor lowers the mean by 0.5 DN)" if s.adc_rounding == "floor" else ""),
            bound=1.0 if s.adc_rounding == "floor" else 0.5,
            unit="DN",
        )
    ]


def _large_means(basis: PlanBasis) -> list[Decision]:
    """Poisson draws of large means."""
    if not basis.scene.sensor.photon_noise:
        return []
    return [
        Decision(
            "gaussian_for_poisson",
            True,
            "means above 1e8 e- are drawn as a rounded Gaussian; its distribution function "
            "differs by less than 7e-6",
            bound=7e-6,
            unit="of the distribution function",
        )
    ]


def _joint(basis: PlanBasis) -> list[Decision]:
    """Photon and read noise in one draw."""
    if not _one_draw(basis.scene):
        return []
    return [
        Decision(
            "one_noise_draw",
            True,
            f"pixels of {ANY_READ_E:g} e- of read noise or more ({READ_E:g} at means above "
            f"{ABOVE_E:g} e-), the full well {REACH:g} deviations away, take photon and read "
            "noise in one draw, by its quantile to third order; the mean is exact",
            bound=DISTANCE,
            unit="of the distribution function",
        )
    ]


def _one_draw(scene: Scene) -> bool:
    """Whether some pixels may take photon and read noise in one draw."""
    s, d = scene.sensor, scene.sensor.detector
    enough = not isinstance(s.read_noise_e, float) or s.read_noise_e >= READ_E
    bent = d is not None and (d.blooming or d.nonlinearity is not None)
    return s.photon_noise and enough and not bent


RULES = (
    Rule(
        ("flat", "dark", "photon_noise", "full_well", "read_noise", "bias"),
        "kept where its value is not the neutral one",
        "tests/rules/test_same_bits.py::test_components_leave_each_others_draws_alone",
        _terms,
    ),
    Rule(("adc",), "always; exact to 63 bits", "tests/physics/noise/test_chain.py", _converter),
    Rule(
        ("gaussian_for_poisson",),
        "above a mean of 1e8 e-: a rounded Gaussian, 7e-6 from the Poisson distribution function",
        "tests/physics/noise/test_streams.py",
        _large_means,
    ),
    Rule(
        ("one_noise_draw",),
        "photon and read noise of a pixel in one draw where both are smooth together",
        "tests/physics/noise/test_joint.py",
        _joint,
    ),
)
