"""Moonlight and twilight above a site that its scene does not ask for: how much there would be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.physics.positions.limb import upright
from pipeline.physics.positions.refraction import refract
from pipeline.physics.vectors import unit
from pipeline.plan.pointing.air import terms_of
from pipeline.plan.pointing.lamps import TICKS, LampGeometry, look_through
from pipeline.plan.sky.inputs import SkyInputs
from pipeline.plan.sky.night import scattered_parts
from pipeline.plan.timing import frame_times, simpson
from pipeline.spec.scene import Scene
from pipeline.spec.sky.background import Background

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class UndrawnNight:
    """Light that the air scatters, by the functions that draw it where it is asked for.

    inputs : with the band's Sun and Moon, and the extinction of the air
    """

    scene: Scene
    inputs: SkyInputs
    dut1_s: float

    def most(self, name: Literal["moonlight", "twilight"], seen: LampGeometry) -> tuple[int, float]:
        """The moment (its number in `seen`) whose frame holds most of it in the middle, and the
        mean of that exposure, electrons per m2 of pupil and sr."""
        time_s = frame_times(self.scene, seen.tick // TICKS)[1]
        k = int(np.argmax(self._rates(name, seen) * time_s))
        weights, whole = simpson(TICKS, TICKS)
        rates = self._rates(name, look_through(self.scene, self.dut1_s, seen.frame(k)))
        mean = sum(w * rates[i] for i, w in weights.items()) / whole
        return k, float(mean * time_s[k])

    def _rates(self, name: str, seen: LampGeometry) -> Array:
        """Electrons/s per m2 of pupil and sr (n,) along the boresight of each moment."""
        b = Background.model_validate({"starlight": "none", name: True})
        zenith = unit(upright(seen.place_m))
        terms = np.broadcast_to(terms_of(self.scene), (len(zenith), 2))
        air = np.concatenate([zenith, terms], axis=1)
        observed = refract(seen.boresight, air)
        at = zip(air, observed[:, None], seen.place_m, seen.sun_m, seen.moon_m, strict=True)
        return np.array([scattered_parts(b, self.inputs, *one)[name][0] for one in at])
