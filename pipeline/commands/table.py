"""Every command by its name: where it is, and the first paragraph of its help."""

from __future__ import annotations

from pipeline.commands.lazy import Table, lazy_group

COMMANDS: Table = {
    "render": ("render:render", "Render a scene into a product directory, here or on a server."),
    "plan": (
        "plan:plan",
        "Show what a scene gives and needs: targets in view, limit, stars, time, memory.",
    ),
    "check": (
        "product:check",
        "Verify a product: markers, chunk checksums, tables. Exit 3 if it is not whole.",
    ),
    "info": (
        "product:info",
        "Show what a product is: state, frames, layers, truth, origin. Reads no pixel.",
    ),
    "calibrate": (
        "product:calibrate",
        "Copy a product with its frames calibrated: less bias and dark, over the flat (electrons).",
    ),
    "schema": ("scene:schema", "Print the JSON Schema of a scene, a sweep or a study."),
    "color-fit": (
        "scene:color_fit",
        "Show the colour correction from Gaia G to the sensor's band, with its residuals.",
    ),
    "light-curve": (
        "scene:light_curve",
        "Magnitude, phase angle, range and eclipse of targets against time, as Parquet or CSV.",
    ),
    "serve": ("serve:serve", "Serve the REST interface."),
    "keys": ("serve:keys", "API keys of the service: create, revoke, list."),
    "demo": (
        "demo:demo",
        "Make the demo catalogue, render the demo scene, and say what came out.",
    ),
    "selftest": (
        "studies.selftest:selftest",
        "Limiting cases against answers known from elsewhere. Exit 1 where one fails.",
    ),
    "observe": (
        "observe:observe",
        "Where every target is, how bright, at what SNR, and whether it is seen, without drawing.",
    ),
    "find": (
        "observe:find",
        "Which objects of a scene's populations can be seen, when and where to point: best first.",
    ),
    "study": (
        "study:study",
        "Run a study of capacity: what sensors observe of a catalogue, how often, with what gaps.",
    ),
    "sweep": (
        "sweep:sweep",
        "Run a sweep: many scenes that differ in some fields, measured into one table of points.",
    ),
    "export": (
        "export:export",
        "Write frames as FITS (WCS, times), PNG, GIF, MP4; labels as SatNet, COCO, or masks.",
    ),
    "join": (
        "render:join",
        "Finish a product whose parts are all done. Exit 3 where tiles are missing.",
    ),
    "worker": (
        "worker:worker",
        "Draw for a scheduler, with the certificates of the environment. Exit 4 when it goes away.",
    ),
    "catalog": ("table:catalog", "Make and look at star catalogues."),
    "jobs": ("jobs:jobs", "Jobs on a server (key: NIGHTGLASS_KEY)."),
    "import": ("imports:import_app", "Scenes of other simulators."),
    "cosmic-rays": ("cosmic_rays:cosmic_rays", "Make and compare libraries of cosmic rays."),
    "report": ("table:report", "Studies of error against run time."),
}

CATALOG: Table = {
    "ingest": (
        "catalog.make:ingest",
        "Repartition files of stars into HEALPix Parquet shards (HATS); goes on where it stopped.",
    ),
    "forms": ("catalog.look:forms", "The kinds of tables that are known by name."),
    "info": ("catalog.look:info", "What a catalogue holds."),
    "verify": (
        "catalog.prove:verify",
        "Verify a whole catalogue: every byte, every row's place, every count.",
    ),
    "starlight": (
        "catalog.make:starlight",
        "Sum the light of all stars once, so that scenes can leave faint ones to a smooth sky.",
    ),
    "cone": (
        "catalog.look:cone",
        "Stars in a cone or a polygon, to the screen (CSV) or a file.",
    ),
    "demo": (
        "catalog.demo:demo",
        "Make a SYNTHETIC all-sky catalogue from published star counts; no star of it is real.",
    ),
    "fetch": (
        "catalog.fetch:fetch",
        "Download the archive's files, or a cone's rows; the same command goes on where it "
        "stopped.",
    ),
}

REPORT: Table = {
    "accuracy": (
        "studies.accuracy:report_accuracy",
        "Error against CPU time of every engine and installed peer: JSON, table, figure.",
    ),
    "detection": (
        "studies.detection:report_detection",
        "Completeness and false alarms of public finders on a product: JSON, table, figure.",
    ),
    "scenes": (
        "studies.scenes:report_scenes",
        "Error against run time of whole scenes, and of each approximation: page, JSON, figures.",
    ),
    "ledger": (
        "studies.ledger:report_ledger",
        "Every rule of the plan measured: the bound, the error of an omission, the seconds saved.",
    ),
}

catalog = lazy_group(CATALOG, help=COMMANDS["catalog"][1])
report = lazy_group(REPORT, help=COMMANDS["report"][1])
