"""The demo: a synthetic catalogue, a scene that comes with the package, and its product."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

from catalog_tools.documents import JsonObject
from catalog_tools.storage.durable import write_atomically
from catalog_tools.synthetic.synthetic import make_demo
from pipeline.errors import BadInput
from pipeline.route.draw import Listener
from pipeline.route.run import Options, render
from pipeline.spec.load import load_scene

ALL_SKY_G_MAG = 9.0
# What the demo scene looks at: right ascension, declination, radius [deg], limiting G magnitude.
DEEP_FIELD = (266.2, 0.0, 2.0, 15.0)


def run_demo(
    folder: Path, replace: bool, listen: Listener | None, say: Callable[[str], None]
) -> tuple[Path, JsonObject]:
    """Make FOLDER/catalogue (kept if it is there) and FOLDER/product; returns product, report.

    A product of an earlier demo is continued, or taken as it is where it is complete. BadInput for
    a folder of anything else, and for a demo's whose scene.yaml was changed.
    """
    scene_file = folder / "scene.yaml"
    scene = files("pipeline").joinpath("scenes/demo.yaml").read_bytes()
    is_ours = scene_file.is_file() and scene_file.read_bytes() == scene
    if folder.exists() and not is_ours and any(folder.iterdir()):
        allowed = "a new folder, or that of an earlier demo with its scene.yaml as it was"
        raise BadInput("-o", str(folder), allowed)
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(scene_file, scene)
    if not (folder / "catalogue").exists():
        say("making the synthetic catalogue (no star of it is real)")
        made = make_demo(
            folder / "catalogue", faintest_g_mag=ALL_SKY_G_MAG, deep_fields=[DEEP_FIELD]
        )
        say(f"{folder / 'catalogue'}: {made.catalogue.rows} synthetic stars")
    product = folder / "product"
    resume = product.exists() and not replace
    report = render(
        load_scene(scene_file), product, Options(resume=resume, replace=replace), listen
    )
    return product, report
