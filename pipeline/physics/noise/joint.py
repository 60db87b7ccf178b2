"""Photon and read noise in one draw: the quantile of a Poisson number and a Gaussian together.

A Gaussian of 1.5 electrons or more fills the steps between whole electrons (the first harmonic of
the comb falls to exp(-2 pi^2 s^2), 5e-20), so the sum has a smooth distribution, and its quantile
is a polynomial of the normal one (Cornish & Fisher 1938, Rev. Inst. Int. Stat. 5, 307; third order:
Hill & Davis 1968, Ann. Math. Stat. 39, 1264, doi:10.1214/aoms/1177698251).
"""

from __future__ import annotations

import math

import numpy as np
from numba import int64, njit

from pipeline.physics.noise.runs import RUN_PX, quantiles, to_uniforms, words
from pipeline.physics.noise.streams import normals_run, poisson_buffers, poisson_run

READ_E, ABOVE_E = 1.5, 10.0  # read noise and mean of the pixels that are drawn so
ANY_READ_E = 2.5  # or read noise, whatever the mean
DISTANCE = 7.4e-6  # that the distribution functions differ by at most, at READ_E and ABOVE_E
REACH = 12.0  # standard deviations that no draw comes near to: full wells beyond cut nothing off


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def joint_quantile(z, mean, read):
    """Where Poisson(mean) + Normal(0, read) has the probability that a normal has below z."""
    sigma = math.sqrt(mean + read * read)
    w = 1.0 / sigma
    k3 = mean * w * w * w
    k4 = k3 * w
    k5 = k4 * w
    q = z * z
    bend = k3 * (q - 1.0) * (1.0 / 6.0)
    bend += z * (k4 * (q - 3.0) * (1.0 / 24.0) - k3 * k3 * (2.0 * q - 5.0) * (1.0 / 36.0))
    bend += k5 * ((q - 6.0) * q + 3.0) * (1.0 / 120.0)
    bend -= k3 * k4 * ((q - 5.0) * q + 2.0) * (1.0 / 24.0)
    bend += k3 * k3 * k3 * ((12.0 * q - 53.0) * q + 17.0) * (1.0 / 324.0)
    return mean + sigma * (z + bend)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def serves(mean, read):
    """Whether the one draw keeps to DISTANCE."""
    return (read >= ANY_READ_E) | ((read >= READ_E) & (mean >= ABOVE_E))


@njit(cache=True, nogil=True, error_model="numpy")
def _pair_normals(n, x0, y, frame, k0, k1, x, first, second, p, z):
    """Standard normal draws z of the pixels (x0 + i, y): two pixels side by side share a block."""
    odd = x0 & 1
    blocks = (n + odd + 1) // 2
    for i in range(blocks):
        x[i] = x0 // 2 + i
    words(blocks, x, y, frame, int64(0), k0, k1, first, second)
    even_p, odd_p = first.view(np.float64), second.view(np.float64)
    for i in range(blocks):
        p[2 * i], p[2 * i + 1] = even_p[i], odd_p[i]
    mine = p[odd : odd + n]
    to_uniforms(n, mine)
    quantiles(n, mine, z)


@njit(cache=True, nogil=True, error_model="numpy")
def _sort(mean, drawn, well, read, sorts):
    """What each pixel of a run takes: 1, one draw for both terms, where that serves and the full
    well is out of reach; 0, a draw of read noise alone, where it is full for certain; else 2, a
    draw for each. Returns how many pixels are not of sort 1."""
    count = 0
    for i in range(len(mean)):
        m, s = mean[i], read[i]
        held, wide = m + drawn[i], REACH * math.sqrt(m + s * s)
        joint = serves(m, s) & (held + wide < well[i])
        sorts[i] = 1 if joint else (2 if held - wide < well[i] else 0)
        count += not joint
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_apart(run, sorts, at, photon, normal, buffers, line):
    """The pixels of a run that do not take the one draw for both terms.

    run : mean, drawn, well and read noise of the run's pixels; sorts : of `_sort`; at : the run's
    (x0, y, frame).
    """
    mean, drawn, well, read = run
    x0, y, frame = at
    which = np.empty(len(sorts), np.int64)
    x, means, draws = buffers[0], np.empty(len(sorts)), np.empty(len(sorts))
    n = int64(0)
    for i in range(len(sorts)):
        which[n], means[n], x[n] = i, mean[i], x0 + i
        n += sorts[i] == 2
    poisson_run(means[:n], x, y, frame, photon[0], photon[1], draws, buffers)
    for j in range(n):
        i = which[j]
        line[i] = min(draws[j] + drawn[i], well[i])
    n = int64(0)
    for i in range(len(sorts)):
        which[n], x[n] = i, x0 + i
        n += sorts[i] != 1
    normals_run(n, x, y, frame, normal[0], normal[1], draws, buffers)
    for j in range(n):
        i = which[j]
        line[i] = (line[i] if sorts[i] else well[i]) + draws[j] * read[i]


@njit(cache=True, nogil=True, error_model="numpy")
def measured_image(mean_e, drawn_e, well_e, read_e, y0, x0, frame, joint, photon, normal):
    """(ny, nx) electrons measured: min(Poisson(mean) + drawn, well) + Normal(0, read).

    drawn_e, well_e, read_e : (ny, nx), or (1, nx) for all rows alike; the first pixel is frame
    pixel (y0, x0). joint, photon, normal : keys of the one draw and of the two that other pixels
    take: of too little read noise for their mean (`serves`), or a full well within reach.
    """
    rows, columns = mean_e.shape
    out = np.empty((rows, columns))
    buffers = poisson_buffers()
    x, first, second = buffers[0], buffers[1], buffers[2]
    p, z = np.empty(RUN_PX + 2), np.empty(RUN_PX)
    sorts = np.empty(RUN_PX, np.int64)
    for r in range(rows):
        y = y0 + r
        for start in range(0, columns, RUN_PX):
            n = min(RUN_PX, columns - start)
            mean, line = mean_e[r, start : start + n], out[r, start : start + n]
            drawn = drawn_e[min(r, len(drawn_e) - 1), start : start + n]
            well = well_e[min(r, len(well_e) - 1), start : start + n]
            read = read_e[min(r, len(read_e) - 1), start : start + n]
            apart = _sort(mean, drawn, well, read, sorts)
            if apart < n:
                _pair_normals(n, x0 + start, y, frame, joint[0], joint[1], x, first, second, p, z)
                for i in range(n):
                    line[i] = drawn[i] + joint_quantile(z[i], mean[i], read[i])
            if apart:
                run = mean, drawn, well, read
                at = x0 + start, y, frame
                _draw_apart(run, sorts[:n], at, photon, normal, buffers, line)
    return out
