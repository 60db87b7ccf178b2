"""The ledger of omissions: what decides each rule of the plan, and the test that measures it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from catalog_tools.documents import JsonObject

_ENGINES = "tests/execute/test_engines.py::test_engines_agree_within_the_sum_of_their_bounds"
_NEEDED = "tests/rules/test_only_what_the_scene_needs.py::test_imports"
_ALONE = "tests/rules/test_same_bits.py::test_components_leave_each_others_draws_alone"
_CHAIN = "tests/physics/noise/test_chain.py"


@dataclass(frozen=True)
class Rule:
    """What decides whether components of the plan are kept, and where the bound is measured.

    components : names as in the plan, `*` for any text
    test : path, or path::function, of the test that fails where the rule or its bound is broken
    """

    components: tuple[str, ...]
    rule: str
    test: str


LEDGER = (
    Rule(("stars", "targets", "background", "cosmic_rays"),
         "kept where the scene has such a section; else no import, no task, no read", _NEEDED),
    Rule(("flat", "dark", "photon_noise", "full_well", "read_noise", "bias"),
         "kept where its value is not the neutral one", _ALONE),
    Rule(("adc",), "always; exact to 63 bits", _CHAIN),
    Rule(("gaussian_for_poisson",),
         "above a mean of 1e8 e-: a rounded Gaussian, 7e-6 from the Poisson distribution function",
         "tests/physics/noise/test_streams.py"),
    Rule(("one_noise_draw",),
         "photon and read noise of a pixel in one draw where both are smooth together",
         "tests/physics/noise/test_joint.py"),
    Rule(("detector_extras", "bad_pixels", "dead_pixels", "hot_pixels", "prnu", "bias_structure",
          "amplifiers", "row_noise", "column_noise", "blooming", "nonlinearity", "lag",
          "frame_transfer", "tdi"),
         "each where the scene asks for it; nothing is computed or loaded otherwise",
         "tests/execute/test_detector.py::test_nothing_of_it_unless_asked_for"),
    Rule(("stars.space_motion", "stars.parallax", "stars.aberration", "stars.deflection"),
         "switched in the scene; on by default", "tests/physics/positions/test_apparent.py"),
    Rule(("stars.doppler",), "never: brightness and colour are those of an observer at rest",
         "tests/physics/positions/test_apparent.py"),
    Rule(("stars.faint", "stars.layer_*"),
         "stars below the limit (given, or where the sum of all fainter ones is below a share of "
         "the noise) become smooth light; in layers each star is drawn once",
         "tests/plan/sky/test_sky.py"),
    Rule(("shared_frames",),
         "frames in a row of a sidereal pointing share one drawing of their stars, where these "
         "move by less than the accuracy leaves room for",
         "tests/acceptance/test_shared_frames.py"),
    Rule(("precession_nutation", "polar_motion"),
         "IAU 2006/2000A always; the pole of the epoch where the IERS tables cover it, else the "
         "origin (10 m)",
         "tests/inputs/test_earth_orientation.py::test_a_scenes_site_against_astropy"),
    Rule(("atmosphere", "atmosphere.*"),
         "each part where observer.atmosphere asks for it",
         "tests/acceptance/test_site_with_air.py::test_elevations_against_astropy"),
    Rule(("earth_occultation", "earth_occultation.air"),
         "each source by itself where the limb or the horizon comes near the field; the air at a "
         "limb seen from space never, that of a site where its refraction is asked for",
         "tests/acceptance/test_behind_the_earth.py::test_stars_behind_the_limb_against_rays"),
    Rule(("pupil_projection",),
         "always, but where flat is an image (a measured flat holds it) or the sensor says no",
         "tests/acceptance/test_wide_field.py::test_stars_fall_with_the_cosine"),
    Rule(("distortion",), "where the sensor has one", "tests/acceptance/test_distortion.py"),
    Rule(("dwells",), "where the scene has them", "tests/plan/test_dwells.py"),
    Rule(("pointing_table",), "rows are interpolated; the error is measured by leaving rows out",
         "tests/inputs/test_pointing_tables.py"),
    Rule(("pointing_motion",),
         "jitter slower than the nodes of an exposure moves the path, faster one is blur; the "
         "bound is of what lies between", "tests/physics/motion/test_jitter.py"),
    Rule(("pointing_refraction",), "a pointing names the true place; the air lifts the camera",
         "tests/acceptance/test_site_with_air.py"),
    Rule(("one_psf", "psf_over_the_field", "table_band"),
         "one response, or mixtures of those the scene gives for places of the field; a table's "
         "spectrum is cut where at most 1e-5 of its light is left",
         "tests/execute/test_psf_field.py::"
         "test_a_star_at_a_place_is_its_own_and_between_two_their_mean"),
    Rule(("monochromatic_psf", "few_wavelengths"),
         "as few wavelengths as keep a pixel within a share of its source's light",
         "tests/physics/psf/test_band.py::test_against_a_hundred_wavelengths"),
    Rule(("stray_light.*",), "each body where background.stray_light asks for it",
         "tests/plan/sky/test_stray_light.py::test_sources_are_switched"),
    Rule(("background.*",),
         "light per solid angle where a pixel looks, through its own solid angle and the pupil's "
         "cosine; on a grid, of one value or refined until its error is within the accuracy",
         "tests/acceptance/test_wide_field.py::test_a_uniform_sky_falls_with_the_cosine"),
    Rule(("phase_interpolation", "common_streak", "crowds_by_transforms", "star_engines"),
         "the cheapest drawing whose bound is within its part of accuracy.noise_fraction",
         _ENGINES),
    Rule(("wings_on_a_coarse_grid", "wings_cut_off", "core_ends"),
         "light far from a source on a coarse grid, up to a reach beyond which less than "
         "accuracy.flux_fraction is left, 1e-8 where a response has no wings",
         "tests/physics/drawing/test_wings.py::test_stated_wing_error_holds"),
    Rule(("targets.point_sources", "targets.shapes_as_points", "targets.resolved_meshes"),
         "a point where its size changes no pixel by more than the budget",
         "tests/physics/drawing/test_extended.py::test_point_error_bounds_what_is_left_out"),
    Rule(("targets.eclipse", "targets.umbra_light"),
         "where eclipse is on; a disc's overlap, or the options of lighting; light that the air "
         "sends into the umbra never",
         "tests/physics/targets/test_eclipse.py::test_against_caps_on_the_sphere"),
    Rule(("targets.earthshine",), "where lighting asks for it",
         "tests/physics/targets/test_earthshine.py::test_against_a_fine_earth"),
    Rule(("rolling_shutter",), "where the detector's readout asks for it; refused where its bounds "
         "do not hold",
         "tests/execute/test_rolling_shutter.py::test_stars_against_each_rows_own_exposure"),
    Rule(("targets.earthshine_on_meshes",), "where lighting asks for it on a mesh",
         "tests/plan/test_mesh_earthshine.py::test_against_every_lamp_traced"),
    Rule(("targets.light_table",), "where the frames need many moments of a mesh's light, and a "
         "table within the error asked for takes at most a third of them",
         "tests/plan/bodies/test_mesh_tables.py::test_the_stated_error_holds"),
    Rule(("targets.ephemeris",), "tables are interpolated; the error is measured by leaving rows "
         "out", "tests/physics/positions/test_orbit_table.py::test_stated_error_holds"),
    Rule(("targets.forces", "targets.perturbations"),
         "the forces that the orbit names; sizes of the others are said",
         "tests/physics/positions/test_orbit_numerical.py::test_forces_one_by_one"),
    Rule(("targets.light_between_nodes",),
         "as many moments as keep the light within accuracy.flux_fraction",
         "tests/plan/bodies/test_bodies.py::test_flicker_bounds_the_error_at_the_edge_of_the_shadow"),
    Rule(("targets.light_between_facets", "targets.mesh_shadows", "targets.mutual_shadowing"),
         "shadows within a mesh always, to the error asked for; between facets and between the "
         "parts of composites never",
         "tests/physics/meshes/test_intensity.py::test_the_error_asked_for_is_met"),
    Rule(("populations.*",), "objects that come near the field in the dwell; none is missed",
         "tests/plan/targets/test_populations.py"),
)  # fmt: skip


def page(measured: Sequence[JsonObject] = ()) -> str:
    """The ledger as a page of the documentation (Markdown).

    measured : a row for each rule, as `nightglass report ledger` writes them; `rule` is the first
    component's name
    """
    rows = {row["rule"]: row for row in measured}
    lines = [
        "# What the plan may leave out", "",
        "For each component and approximation: what decides, and the test that fails where the "
        "rule or its bound is broken. `nightglass plan SCENE --explain` shows the same for a "
        "scene, with the bounds that hold there; `plan.json` in each product keeps them. The last "
        "columns are one measurement by `nightglass report ledger` (below: how): the bound that "
        "the plan of a small scene states, the error that the omission causes there against the "
        "same with it undone, the CPU seconds that it saves. Seconds below 0: what is omitted "
        "costs less than what is done to leave it out, in so small a scene.", "",
        "| components | rule | measured by | bound | error caused | seconds saved |",
        "| --- | --- | --- | --- | --- | --- |",
    ]  # fmt: skip
    for r in LEDGER:
        names = ", ".join(f"`{c}`" for c in r.components)
        cells = _measured(rows.get(r.components[0], {}))
        lines.append(f"| {names} | {r.rule} | `{r.test}` | {cells} |")
    every = [one for row in measured for one in row.get("all", (row,))]
    if every:
        lines += ["", "## How each was measured", "",
                  "| component | scene and reference | bound | error caused | seconds saved |",
                  "| --- | --- | --- | --- | --- |"]  # fmt: skip
        lines += [f"| `{one['component']}` | {one['how']} | {_cells(one)} |" for one in every]
    return "\n".join(lines) + "\n"


def _measured(row: Mapping[str, object]) -> str:
    """Bound, error and seconds of a rule as three cells of a table."""
    if "bound" not in row:
        return " | | "
    bound, rest = _cells(row).split(" | ", 1)
    return f"{bound} (`{row['component']}`) | {rest}"


def _cells(one: Mapping[str, object]) -> str:
    unit = one["unit"]
    saved = f"{one['seconds_saved']:.1g}"
    return f"{one['bound']:.2g} {unit} | {one['error']:.2g} {unit} | {saved}"


def rule_of(component: str) -> Rule | None:
    """The rule of a component of the plan; None where the ledger has none."""
    return next((r for r in LEDGER if any(fnmatchcase(component, c) for c in r.components)), None)
