"""The ledger of omissions: every rule of the plan, in the order of the plan; the page of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

from catalog_tools.documents import JsonObject
from pipeline.plan import sections
from pipeline.plan.decision import Decision
from pipeline.plan.optics import decisions as optics
from pipeline.plan.pointing import decisions as pointing
from pipeline.plan.pointing import occultation
from pipeline.plan.response import decisions as response
from pipeline.plan.rule import PlanBasis, Rule
from pipeline.plan.sensor import decisions as detector
from pipeline.plan.sensor import noise
from pipeline.plan.sky import air
from pipeline.plan.sky import decisions as sky
from pipeline.plan.stars import effects
from pipeline.plan.targets import decisions as targets


def _decided_last(_: PlanBasis) -> tuple[Decision, ...]:
    """Nothing yet: `stars.shared_frames` spends what all the others leave of the accuracy."""
    return ()


SHARED_FRAMES = Rule(
    ("shared_frames",),
    "frames in a row of a sidereal pointing share one drawing of their stars, where these move by "
    "less than the accuracy leaves room for",
    "tests/acceptance/test_shared_frames.py",
    _decided_last,
)
LEDGER: tuple[Rule, ...] = (
    *sections.RULES,
    *noise.RULES,
    *effects.RULES,
    *response.RULES,
    *occultation.RULES,
    *targets.RULES,
    *optics.RULES,
    *air.RULES,
    *sky.RULES,
    *detector.RULES,
    *pointing.RULES,
    SHARED_FRAMES,
)


def page(measured: Sequence[JsonObject] = ()) -> str:
    """The ledger as a page of the documentation (Markdown).

    measured : a row for each rule, as `nightglass report ledger` writes them; `rule` is the first
    component's name
    """
    rows = {row["rule"]: row for row in measured}
    lines = [
        "# What the plan may omit", "",
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
