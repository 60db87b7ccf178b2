"""The arrays that travel between stages: every field with shape and unit."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from catalog_tools.documents import Arguments

Array = NDArray[np.float64]
Value = float | Array


@dataclass(frozen=True)
class StarTable:
    """Catalogue rows of n stars with their light; NaN where a quantity is not known.

    source_id : int64; ra_rad, dec_rad : ICRS at the reference epoch
    pm_ra_cosdec_rad_yr, pm_dec_rad_yr, parallax_rad, radial_velocity_m_s
    g_mag : Gaia G; rate_e_s : electrons per second in the sensor; colour_flag : uint8, 0 measured
    colour, 1 default colour, 2 colour clamped to the fitted range
    """

    source_id: NDArray[np.int64]
    ra_rad: Array
    dec_rad: Array
    pm_ra_cosdec_rad_yr: Array
    pm_dec_rad_yr: Array
    parallax_rad: Array
    radial_velocity_m_s: Array
    g_mag: Array
    rate_e_s: Array
    colour_flag: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.source_id)


@dataclass(frozen=True)
class FrameStars:
    """Stars of one frame that send light onto the focal plane, in drawing order.

    x_px, y_px : place at mid-exposure; light_e : electrons in the exposure
    ra_rad, dec_rad : astrometric direction (space motion and parallax applied, no aberration), the
    coordinates of the product's WCS; catalogue : which of the scene's it is from, 0 the main one;
    visible_fraction : of the exposure in which the Earth does not hide it; its light is what is
    left; the rest as in StarTable
    """

    source_id: NDArray[np.int64]
    x_px: Array
    y_px: Array
    light_e: Array
    ra_rad: Array
    dec_rad: Array
    g_mag: Array
    colour_flag: NDArray[np.uint8]
    catalogue: NDArray[np.uint8]
    visible_fraction: Array

    def __len__(self) -> int:
        return len(self.source_id)


@dataclass(frozen=True)
class Geometry:
    """Where everything is during F frames, at K equally spaced nodes of each exposure.

    frame : (F,) frame numbers; offset_s : (F, K) seconds after the epoch
    tt1, tt2, utc1, utc2 : (F, K) two-part Julian dates
    observer_m, observer_m_s, sun_m : (F, K, 3) barycentric, ICRS axes
    attitude : (F, K, 3, 3) proper attitude (rows +x, +y, boresight)
    target_x_px, target_y_px : (T, F, K); target_light : (T, F, K) in-band irradiance at the
        observer over the solar irradiance at 1 au (dimensionless)
    target_range_m, target_phase_rad, target_sunlit : (T, F, K)
    target_clear : (T, F, K) positive where the Earth does not hide it: least height of the line of
        sight above the ellipsoid [m]; of a site the sine of the apparent elevation
    target_direction : (T, F, 3) observed direction at mid-exposure: proper, and refracted
    target_pose : (M, F, 4, 3) of the M targets that are meshes, in their order: the directions of
        Sun, observer, +x and +y of the focal plane at mid-exposure, in the body's axes
    target_pose_s : (M, F) that moment at the body, seconds after the epoch
    target_turn_rad : (M, F) by how much the body turns in an exposure against what it is seen in
    air : (F, K, 5) zenith of a site, ICRS axes, and refraction's A, B [rad]; (F, K, 0) without
    """

    frame: NDArray[np.int64]
    offset_s: Array
    tt1: Array
    tt2: Array
    utc1: Array
    utc2: Array
    observer_m: Array
    observer_m_s: Array
    sun_m: Array
    attitude: Array
    target_x_px: Array
    target_y_px: Array
    target_light: Array
    target_range_m: Array
    target_phase_rad: Array
    target_sunlit: Array
    target_clear: Array
    target_direction: Array
    target_pose: Array
    target_pose_s: Array
    target_turn_rad: Array
    air: Array

    @property
    def nodes(self) -> int:
        return self.offset_s.shape[1]

    @property
    def middle(self) -> int:
        return self.nodes // 2

    def observer_at(self, frame: int, node: int) -> tuple[Array, Array, Array]:
        """Position [m] and velocity [m/s] of the observer and the Sun's position [m], each (3,)
        barycentric, at one node of one frame (by index)."""
        return self.observer_m[frame, node], self.observer_m_s[frame, node], self.sun_m[frame, node]

    def air_at(self, frame: int, node: int | slice) -> Array | None:
        """The air (5,) at one node of one frame (by index), (n, 5) at several; None without."""
        return self.air[frame, node] if self.has_air else None

    @property
    def has_air(self) -> bool:
        """Whether anything depends on the air above the observer."""
        return self.air.shape[-1] > 0

    def frame_slice(self, index: int) -> Geometry:
        """The geometry of one of its frames alone (what a task of that frame needs)."""
        values: Arguments = {}
        for f in fields(self):
            value = getattr(self, f.name)
            axis = 1 if f.name.startswith("target_") else 0
            values[f.name] = value.take([index], axis=axis)
        return Geometry(**values)


class Refined(Geometry):
    """A geometry of which some frames have more nodes; all share first, middle and last node.

    finer : by the frame's place among the frames, its geometry of one frame
    """

    finer: dict[int, Geometry]

    @classmethod
    def of(cls, g: Geometry, finer: dict[int, Geometry]) -> Refined:
        made = cls(**{f.name: getattr(g, f.name) for f in fields(g)})
        object.__setattr__(made, "finer", finer)
        return made

    def frame_slice(self, index: int) -> Geometry:
        return self.finer[index] if index in self.finer else super().frame_slice(index)


@dataclass(frozen=True)
class SensorMaps:
    """Each term a number or a (rows, columns) image; units as in the scene's keys.

    linearity : charge collected and charge measured [e-], tables; None where they are the same
    bad : rows, columns and DN of the pixels that read the same in every frame
    """

    flat: Value
    dark_e_per_s: Value
    read_noise_e: Value
    gain_e_per_dn: Value
    bias_dn: Value
    linearity: tuple[Array, Array] | None = None
    bad: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]] | None = None

    def typical(self, name: str) -> float:
        """The number itself, or the image's median: what the plan reckons with."""
        return float(np.median(getattr(self, name)))


def seen_ends(start: Array, middle: Array, end: Array) -> tuple[Array, Array]:
    """Where paths (n,) begin and end along an axis: of one that is behind the camera there (NaN),
    where it is in the middle of its exposure, or else at its other end."""
    out = []
    for place, other in ((start, end), (end, start)):
        near = np.where(np.isnan(middle), other, middle)
        out.append(np.where(np.isnan(place), near, place))
    return out[0], out[1]


def select(table: Any, index: Any) -> Any:
    """Rows of a StarTable or FrameStars: those of a mask, or by their numbers in any order."""
    if np.asarray(index).dtype.kind == "b":
        index = np.flatnonzero(index)  # once: some 4 times as fast as a mask for each column
    return type(table)(**{f.name: getattr(table, f.name)[index] for f in fields(table)})


def concatenate(tables: list[Any], kind: type) -> Any:
    """Tables of one kind, one after the other."""
    if not tables:
        whole = {"source_id": np.int64, "colour_flag": np.uint8, "catalogue": np.uint8}
        return kind(**{f.name: np.empty(0, whole.get(f.name, float)) for f in fields(kind)})
    return kind(
        **{f.name: np.concatenate([getattr(t, f.name) for t in tables]) for f in fields(kind)}
    )
