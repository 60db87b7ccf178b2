"""Airglow at the zenith: means in boxes, from the sky model of Cerro Paranal."""

# ESO SkyCalc (Noll et al. 2012, A&A 543, A92; Jones et al. 2013, A&A 560, A91), airglow lines and
# residual continuum at 130 solar flux units, as seen from 2640 m. A model fitted to spectra of the
# FORS1 instrument, good to some 20% on average; single nights vary by 50%.
# photons / s / m2 / um / arcsec2
EDGES_NM = (
    300, 320, 340, 360, 380, 400, 420, 440, 460, 480, 500, 520, 540, 554, 562, 580, 600, 620, 640,
    660, 680, 700, 720, 740, 760, 780, 800, 820, 840, 860, 880, 900, 920, 940, 960, 980, 1000, 1050,
    1100, 1150, 1200, 1300, 1400, 1500, 1600, 1700, 1800,
)  # fmt: skip
ZENITH = (
    198.5, 180.9, 152.6, 128.9, 96.3, 90.5, 77.2, 76.7, 76.0, 78.2, 78.6, 93.3, 95.8, 625.4, 123.4,
    199.0, 130.2, 371.1, 163.9, 107.7, 230.1, 140.1, 479.5, 303.7, 527.2, 831.7, 359.2, 806.6,
    805.9, 1057.5, 1690.8, 551.1, 1325.6, 1549.4, 1647.2, 2478.3, 3665.2, 3572.4, 3437.4, 2906.2,
    6686.4, 3089.1, 12521.9, 20534.5, 17487.9, 14021.1,
)  # fmt: skip
SOLAR_FLUX_SFU = 130.0
