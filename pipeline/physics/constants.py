"""Physical constants in SI units, each with its source."""

from __future__ import annotations

import math

SPEED_OF_LIGHT_M_S = 299_792_458.0  # exact (SI)
PLANCK_J_S = 6.626_070_15e-34  # exact (SI)
BOLTZMANN_J_K = 1.380_649e-23  # exact (SI)
ASTRONOMICAL_UNIT_M = 149_597_870_700.0  # exact (IAU 2012 B2)
DAY_S = 86_400.0
JULIAN_YEAR_DAYS = 365.25

SUN_RADIUS_M = 695_700_000.0  # nominal (IAU 2015 B3)
SUN_RADIUS_RAD = 4.652e-3  # 695,700 km at 1 au
EARTH_EQUATORIAL_RADIUS_M = 6_378_137.0  # WGS 84
EARTH_FLATTENING = 1.0 / 298.257_223_563  # WGS 84
EARTH_GM_M3_S2 = 3.986_004_418e14  # WGS 84 / EGM, including the atmosphere
EARTH_ROTATION_RAD_S = 7.292_115e-5  # WGS 84
SOLAR_CONSTANT_W_M2 = 1361.0  # nominal total solar irradiance at 1 au (IAU 2015 B3)

ARCSEC_RAD = math.pi / 648_000.0
MAS_RAD = ARCSEC_RAD / 1000.0
DEG_RAD = math.pi / 180.0
ARCSEC2_SR = ARCSEC_RAD**2
AB_ZERO_FLUX_W_M2_HZ = 3631e-26  # 3631 Jy (Oke & Gunn 1983)
