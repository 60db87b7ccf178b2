"""What is measured of a point: SNR, background, limiting magnitude, saturation, detection."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from catalog_tools.documents import JsonObject
from pipeline.arrays import Array, Geometry, SensorMaps
from pipeline.execute.check import summary
from pipeline.execute.detector import tile_chain
from pipeline.execute.light import draw_targets
from pipeline.execute.outlook import clear_time_s, limiting_light_e, limiting_mag, target_snr
from pipeline.execute.sources import FrameTarget, place_targets
from pipeline.physics.detection import filtered, peak_near, robust_noise
from pipeline.physics.noise.chain import calibrated_e
from pipeline.plan.accuracy import doubts_of, total_sigma
from pipeline.plan.plan import Plan
from pipeline.plan.sensor.detector import full_e
from pipeline.plan.tiles import Tile, overlap
from pipeline.spec.sweep import Detection
from pipeline.spec.targets.mesh import MeshBody
from pipeline.store.markers import cell_checksums
from pipeline.store.product import Cell, cells_digest

SAMPLED_PX = 4  # the background is taken from every fourth pixel of each axis
MARGIN_PX = 24  # of sky around a target's response, for its noise
LARGEST_WINDOW_PX = 1024
OF_TARGETS = tuple(n for n in Geometry.__dataclass_fields__ if n.startswith("target_"))
POSES = ("target_pose", "target_pose_s", "target_turn_rad")  # of the targets that are meshes
KEPT_LIGHT = 0.98  # a window that holds less of a target's light is said to be outside


class TargetWindow:
    """The calibrated pixels around one target in one frame, gathered tile by tile."""

    def __init__(self, place: Tile, response: Array, corner: tuple[int, int]) -> None:
        self.place, self.response, self.corner = place, response, corner
        self.image_e = np.zeros((place.rows, place.columns))

    def peak(self, request: Detection, step_e: float) -> float:
        """Highest matched-filter statistic near the target's true place [sigma]."""
        statistic = filtered(self.image_e, self.response, step_e)
        return peak_near(statistic, *self.corner, request.search_px)[0]


class Measurement:
    """Metrics of one point, gathered tile by tile and frame by frame."""

    def __init__(
        self,
        plan: Plan,
        maps: SensorMaps,
        metrics: tuple[str, ...],
        names: tuple[str, ...],
        request: Detection,
    ) -> None:
        self.plan, self.maps, self.metrics, self.names = plan, maps, metrics, names
        self.request = request
        self.checked: list[JsonObject] = []  # of windows of the light that were drawn again
        self._cells: list[Cell] = []
        self._backgrounds: list[tuple[float, int]] = []
        self._step_e = maps.typical("gain_e_per_dn")
        self._saturated, self._pixels = 0, 0
        self._peaks: dict[str, list[float]] = {name: [] for name in names}
        self._snr: dict[str, list[float]] = {name: [] for name in names}
        self._limits: list[tuple[float, float]] = []  # light [e-], time above the air [s]
        self._windows: list[tuple[str, TargetWindow]] = []

    def begin_frame(self, g: Geometry, windows: list[tuple[str, TargetWindow]]) -> None:
        """Before a frame's tiles. windows : of targets, empty ones to copy."""
        self._windows = [(name, TargetWindow(w.place, w.response, w.corner)) for name, w in windows]
        if "snr" in self.metrics:
            for name, snr in target_snr(self.plan, g, self.names).items():
                self._snr[name].append(snr)
        if "limiting_magnitude" in self.metrics:
            time_s = clear_time_s(self.plan, g)
            if time_s > 0.0:  # a bias frame sees nothing
                self._limits.append((limiting_light_e(self.plan, g), time_s))

    def take(self, tile: Tile, frame: int, dn: np.ndarray, mean_e: Array) -> None:
        """One tile: digital numbers, and the mean before photon noise."""
        cells = cell_checksums(tile, dn)
        self._cells += [("dn", frame, *cell) for cell in cells]
        if "background" in self.metrics:
            light = self._calibrated(frame, tile, tile, dn, SAMPLED_PX)
            self._backgrounds.append((robust_noise(light, self._step_e)[0], dn.size))
        for _, window in self._windows:
            part = overlap(window.place, tile)
            if part.rows and part.columns:
                light = self._calibrated(frame, tile, part, dn)
                window.image_e[_cut(window.place, part)] = light
        if "saturation" in self.metrics:
            terms = (_of(tile, v) for v in (self.maps.gain_e_per_dn, self.maps.bias_dn))
            full = full_e(self.plan.scene.sensor, *terms)
            self._saturated += int(np.count_nonzero(mean_e >= full))
            self._pixels += mean_e.size

    def end_frame(self) -> None:
        """After a frame's tiles."""
        for name, window in self._windows:
            self._peaks[name].append(window.peak(self.request, self._step_e))
        self._windows = []

    def row(self) -> JsonObject:
        """The metrics by the names of their columns; None where there is nothing to tell."""
        bound, achieved = self._errors()  # what the time is spent for
        out: JsonObject = {
            "content_digest": self.content_digest(),
            "error_bound_sigma": bound,
            "achieved_error_sigma": achieved,
        }
        if "background" in self.metrics:
            out |= self._background()
        if "limiting_magnitude" in self.metrics:
            out |= self._limit()
        if "saturation" in self.metrics:
            out["saturated_fraction"] = self._saturated / self._pixels if self._pixels else None
        for name in self.names:
            snr, peaks = self._snr[name], self._peaks[name]
            if "snr" in self.metrics:
                out[f"snr.{name}"] = max(snr, default=0.0)
            if "detection" in self.metrics:
                found = [p >= self.request.threshold_sigma for p in peaks]
                out[f"peak_sigma.{name}"] = max(peaks, default=None)
                out[f"frames_in_view.{name}"] = len(peaks)
                out[f"detected_fraction.{name}"] = sum(found) / len(found) if found else None
        return out

    def doubts(self) -> list[str]:
        """What is said where the light errs by more than was stated."""
        bound, found = self._errors()
        return doubts_of(bound, found)

    def _errors(self) -> tuple[float, float | None]:
        """The bound of all approximations, and what was found, in units of an empty pixel's noise
        and of each pixel's; of points that share light those of the largest flat."""
        found: float | None = summary(self.checked)["achieved_error_sigma"]
        return total_sigma(self.plan.decisions), found

    def content_digest(self) -> str:
        """As of a product that holds `dn` alone: equal where every pixel of all frames is."""
        return cells_digest(self._cells)

    def _background(self) -> dict[str, float | None]:
        total = sum(n for _, n in self._backgrounds)
        mean = sum(v * n for v, n in self._backgrounds) / total if total else None
        sky_e, floor_e = self.plan.facts.background_e, self.plan.facts.sigma_floor_e
        return {"background_e": mean, "sky_e": sky_e, "noise_floor_e": floor_e}

    def _limit(self) -> dict[str, float | None]:
        """Of the frame that sees the faintest: times may differ, so light alone does not tell."""
        plan, none = self.plan, (math.inf, 1.0)
        least, time_s = min(self._limits, key=lambda limit: limit[0] / limit[1], default=none)
        out: dict[str, float | None] = {"limiting_light_e": least if least < math.inf else None}
        if plan.colour is not None:
            out["limiting_g_mag"] = limiting_mag(plan, least, time_s)
        return out

    def _calibrated(
        self, frame: int, tile: Tile, part: Tile, dn: np.ndarray, step: int = 1
    ) -> Array:
        """Light that every `step`-th pixel of a part of a tile tells of, by the detector's true
        terms [e-]; of those that tell of none (bad ones, a flat of 0) none."""
        time_s = self.plan.integration_s(frame)
        chain = tile_chain(self.plan.scene, self.maps, part, time_s, step)
        light = calibrated_e(dn[_cut(tile, part)][::step, ::step], chain)
        return np.nan_to_num(light, nan=0.0)


def target_windows(
    plan: Plan, g: Geometry, names: tuple[str, ...], search_px: float
) -> list[tuple[str, TargetWindow]]:
    """An empty window for each target that is wholly in view, with the response in it."""
    out: list[tuple[str, TargetWindow]] = []
    for t in place_targets(plan, g) if names else ():
        name = plan.scene.targets[t.index].name
        if name not in names or t.light_e <= 0:
            continue
        window = _window(plan, g, t, math.ceil(search_px) + MARGIN_PX)
        if window is not None:
            out.append((name, window))
    return out


def _window(plan: Plan, g: Geometry, t: FrameTarget, spare_px: int) -> TargetWindow | None:
    """An empty window around a target and `spare_px` more; None if too large or not in view."""
    reach = math.ceil(min(8.0 * _core_px(plan), 64.0)) + math.ceil(t.radius_px)
    (top, bottom), (left, right) = (
        (math.floor(c + float(p.min())) - reach, math.ceil(c + float(p.max())) + reach + 1)
        for c, p in ((t.y_px, t.path.y_px), (t.x_px, t.path.x_px))
    )
    core = Tile(0, 0, top, left, bottom - top, right - left)
    if max(core.rows, core.columns) + 2 * spare_px > LARGEST_WINDOW_PX:
        return None
    light = draw_targets(_one(plan, t.index), _geometry_of(plan, g, t.index), core, [])
    rows, columns = plan.scene.sensor.shape
    y0, x0 = max(0, top - spare_px), max(0, left - spare_px)
    y1, x1 = min(rows, bottom + spare_px), min(columns, right + spare_px)
    inside = Tile(0, 0, y0, x0, max(0, y1 - y0), max(0, x1 - x0))
    seen = overlap(core, inside)
    total = float(light.sum())
    if total <= 0 or not (seen.rows and seen.columns):
        return None
    response = light[_cut(core, seen)] / total
    if float(response.sum()) < KEPT_LIGHT:
        return None
    return TargetWindow(inside, response, (seen.y0 - inside.y0, seen.x0 - inside.x0))


def _one(plan: Plan, index: int) -> Plan:
    """A plan with one of its targets alone."""
    targets = (plan.scene.targets[index],)
    return replace(plan, scene=plan.scene.model_copy(update={"targets": targets}))


def _geometry_of(plan: Plan, g: Geometry, index: int) -> Geometry:
    """A geometry with one of its targets alone; of meshes alone it has poses."""
    kinds = [isinstance(t.body, MeshBody) for t in plan.scene.targets]
    number = sum(kinds[:index])
    mesh = slice(number, number + kinds[index])
    which = {name: mesh if name in POSES else slice(index, index + 1) for name in OF_TARGETS}
    return replace(g, **{name: getattr(g, name)[rows] for name, rows in which.items()})


def _core_px(plan: Plan) -> float:
    """Radius of a usual core [px]."""
    return plan.responses.usual_px or 1.0


def _cut(place: Tile, part: Tile) -> tuple[slice, slice]:
    """The slices of a part in an image that stands at `place`."""
    top, left = part.y0 - place.y0, part.x0 - place.x0
    return slice(top, top + part.rows), slice(left, left + part.columns)


def _of(tile: Tile, value: float | Array) -> float | Array:
    """A tile's part of a term of the detector."""
    if not isinstance(value, np.ndarray):
        return value
    return value[tile.y0 : tile.y0 + tile.rows, tile.x0 : tile.x0 + tile.columns]
