"""Nightglass in Python: plan and render scenes, open products and star catalogues."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.errors import BadInput, Damaged, Incomplete, NightglassError, TryLater

if TYPE_CHECKING:  # each function imports what it needs: `import nightglass` takes no time
    from catalog_tools.query.star_catalogue import StarCatalogue
    from pipeline.observe.observe import Observed
    from pipeline.opened_product import Product
    from pipeline.route.draw import Progress
    from pipeline.spec.scene import Scene
    from pipeline.spec.study import FieldOfRegard
    from pipeline.survey.find import FoundObjects
    from pipeline.sweep.run import SweepProgress

    AnyPath = str | os.PathLike[str]
    AnyFile = Mapping[str, Any] | AnyPath  # or what it holds
    AnyScene = Scene | AnyFile

__all__ = [
    "BadInput",
    "Damaged",
    "Incomplete",
    "NightglassError",
    "TryLater",
    "find",
    "load_scene",
    "observe",
    "open_catalogue",
    "open_product",
    "plan",
    "render",
    "study",
    "sweep",
]


def load_scene(scene: AnyScene, overrides: Iterable[str] = ()) -> Scene:
    """Read a scene and check it against the scene format; defaults are filled in.

    Parameters
    ----------
    scene : path or mapping
        A scene file (YAML or JSON), or its content; units stand in the keys. Relative paths in a
        file are taken from its folder, those in a mapping from the current folder.
    overrides : iterable of str, optional
        Values to set first: `"sensor.read_noise_e=3"`; `"accept+=sun"` adds to a list.

    Returns
    -------
    Scene
        What the other functions take; `as_dict()` gives it as plain data, complete.

    Raises
    ------
    BadInput
        For a file that cannot be read, or a scene with mistakes: its text names each field.
    """
    from pipeline.spec import load
    from pipeline.spec.scene import Scene

    overrides = [overrides] if isinstance(overrides, str) else list(overrides)
    if isinstance(scene, str | os.PathLike):
        return load.load_scene(Path(scene), overrides)
    if not isinstance(scene, Scene | Mapping):
        raise BadInput("scene", scene, "a scene file's path, or a mapping")
    from copy import deepcopy

    data = scene.as_dict() if isinstance(scene, Scene) else deepcopy(dict(scene))
    for override in overrides:
        load.apply_override(data, override)
    return load.parse_scene(data, base=Path.cwd())


def plan(scene: AnyScene) -> dict[str, Any]:
    """Work out what a scene shows and needs, without drawing it.

    Parameters
    ----------
    scene : Scene, path or mapping
        As `load_scene` gives or takes it.

    Returns
    -------
    dict
        Targets in view, faintest star, predicted time and memory, and every decision with its
        reason and the bound of its error, as `nightglass plan --json` prints it; units in the keys.

    Raises
    ------
    BadInput
        For a scene that cannot be rendered as it stands.
    Damaged
        Where a star catalogue does not match its checksums.
    """
    from pipeline.route.prepare import plan_scene

    return plan_scene(load_scene(scene))


def observe(
    scene: AnyScene,
    times: AnyPath | Iterable[str | float] | None = None,
    snr: float = 5.0,
    centroid_seed: int | None = None,
) -> Observed:
    """Where every target is, how bright, at what SNR, and whether it is seen, without drawing.

    Parameters
    ----------
    scene : Scene, path or mapping
        As `load_scene` gives or takes it.
    times : iterable of str or float, or str or path, optional
        Middles of exposures, UTC or seconds after the epoch; `"START,STOP,STEP"`, or a file's path.
    snr : float, optional
        Signal-to-noise ratio below which a target is too faint.
    centroid_seed : int, optional
        Adds measured places, with the noise of a centroid drawn from this seed.

    Returns
    -------
    Observed
        Its `table` (pyarrow) has a row for each time and target; `counts()` says why not all are
        seen, `notes` what else to know.

    Raises
    ------
    BadInput, Damaged
        As `plan` does; BadInput also for times, `snr` or too many rows.
    """
    from pipeline.observe.observe import observe as look

    return look(load_scene(scene), times, snr, centroid_seed=centroid_seed)


def render(
    scene: AnyScene,
    product: AnyPath,
    *,
    scheduler: str = "threads",
    workers: int | None = None,
    resume: bool = False,
    replace: bool = False,
    listen: Callable[[Progress], None] | None = None,
) -> Product:
    """Render a scene into a product and open it. Read the `warnings` of its `report`.

    Parameters
    ----------
    scene : Scene, path or mapping
        As `load_scene` gives or takes it.
    product : path
        Folder to make; `pipeline.route.run.render` takes s3 URLs too.
    scheduler : str, optional
        "threads", "synchronous", "processes" (a script then needs `if __name__ == "__main__":`),
        "slurm", or the address of a Dask scheduler. It does not change the product.
    workers : int, optional
        Number of threads or processes; by default one for each core.
    resume : bool, optional
        Go on with an unfinished product.
    replace : bool, optional
        Remove an old product first.
    listen : callable, optional
        Called after each step with an object: tiles `done` of `total`, and what was done (`doing`).

    Returns
    -------
    Product
        As `open_product` gives it.

    Raises
    ------
    BadInput, Damaged
        As `plan` does; BadInput also for a path that cannot be used, or already exists.
    Incomplete
        Where work ended early; what is finished is kept, and `resume=True` goes on.
    TryLater
        Where the scheduler cannot be reached, or another render is writing this product.
    """
    folder = _folder("product", product)
    from pipeline.opened_product import open_product
    from pipeline.route.run import Options
    from pipeline.route.run import render as run

    run(load_scene(scene), folder, Options(scheduler, workers, resume, replace), listen)
    return open_product(product)


def find(
    scene: AnyScene,
    *,
    at: str | None = None,
    hours: float = 0.0,
    night: bool = False,
    step_s: float = 10.0,
    least_snr: float = 5.0,
    regard: FieldOfRegard | None = None,
) -> FoundObjects:
    """Which objects of a scene's populations its sensor can see, when, and where to point.

    Parameters
    ----------
    scene : Scene, path or mapping
        As `load_scene` gives or takes it.
    at : str, optional
        UTC at which to begin; by default the scene's epoch.
    hours : float, optional
        How long to look [h]; 0, the default: at that moment alone.
    night : bool, optional
        Look through the night about that moment instead.
    step_s : float, optional
        Time between moments [s].
    least_snr : float, optional
        Signal-to-noise ratio in one frame that is enough.
    regard : FieldOfRegard, optional
        Where the sensor may point; by default as in a study without it.

    Returns
    -------
    FoundObjects
        `objects`, best first, as plain values with units in the keys; `looked_at`, `start`, `end`,
        `notes`.

    Raises
    ------
    BadInput
        As `plan` does; also for a scene without populations, or a site where it does not get dark.
    """
    from pipeline.survey.find import DEFAULT_REGARD, FindOptions
    from pipeline.survey.find import find as look

    request = FindOptions(at, hours, night, step_s, least_snr, regard or DEFAULT_REGARD)
    return look(load_scene(scene), request)


def sweep(
    sweep: AnyFile,
    out: AnyPath,
    *,
    scheduler: str = "threads",
    workers: int | None = None,
    resume: bool = False,
    retry_failed: bool = False,
    listen: Callable[[SweepProgress], None] | None = None,
) -> dict[str, Any]:
    """Render every point of a sweep into a folder and return its report.

    Its table is `points.parquet` in the folder: a row for each point.

    Parameters
    ----------
    sweep : path or mapping
        A sweep file (YAML or JSON), from whose folder relative paths are taken, or its data.
    out : path
        Folder to make.
    scheduler : str, optional
        As in `render`; the address of a Dask cluster's scheduler too.
    workers : int, optional
        Number of threads or processes; by default one for each core.
    resume : bool, optional
        Continue an unfinished sweep.
    retry_failed : bool, optional
        Continue a sweep, and try the points that failed once more.
    listen : callable, optional
        Called with a SweepProgress as points are finished.

    Returns
    -------
    dict
        As `nightglass sweep --json` prints it; units stand in the keys.

    Raises
    ------
    BadInput
        For what cannot be run; a point that fails is a row of the table with its message.
    Incomplete
        Where work ended early; what is finished is kept, and `resume=True` goes on.
    TryLater
        As `render` does.
    """
    from pipeline.route.run import Options
    from pipeline.spec.sweep_load import parse_sweep
    from pipeline.sweep.run import course_of, gather_course, run_course

    folder, options = _folder("out", out), Options(scheduler, workers, resume or retry_failed)
    if isinstance(sweep, Mapping):
        course = course_of(parse_sweep(dict(sweep)), Path.cwd(), folder)
    else:
        course = gather_course(Path(sweep), folder)
    return run_course(course, folder, options, retry_failed, listen)


def study(
    study: AnyFile,
    out: AnyPath,
    *,
    scheduler: str = "processes",
    workers: int | None = None,
    resume: bool = False,
    yes: bool = False,
    listen: Callable[[SweepProgress], None] | None = None,
) -> dict[str, Any]:
    """Run a study into a folder and return its report, as `nightglass study --json` prints it.

    Parameters
    ----------
    study : path or mapping
        A study file (YAML or JSON), from whose folder relative paths are taken, or its data.
    out : path
        Folder to make.
    scheduler : str, optional
        As in `sweep`.
    workers : int, optional
        Number of threads or processes; by default one for each core.
    resume : bool, optional
        Continue an unfinished study.
    yes : bool, optional
        Run it although its forecast is long.
    listen : callable, optional
        Called with a SweepProgress as tasks are finished.

    Returns
    -------
    dict
        Units stand in the keys.

    Raises
    ------
    BadInput
        For what cannot be run; a point of its axes that cannot is a row with its message.
    Incomplete
        Where work ended early; what is finished is kept, and `resume=True` goes on.
    TryLater
        As `render` does.
    """
    from pipeline.capacity.run import StudyOptions, run_study
    from pipeline.spec.study_load import read_study

    folder, options = _folder("out", out), StudyOptions(scheduler, workers, resume, yes)
    if isinstance(study, Mapping):
        return run_study(dict(study), Path(), folder, options, listen)
    return run_study(read_study(Path(study)), Path(study).parent, folder, options, listen)


def _folder(name: str, given: object) -> Path:
    """The path of a folder of this machine."""
    if not isinstance(given, str | os.PathLike) or "://" in str(given):
        raise BadInput(name, given, "the path of a folder")
    return Path(given)


def open_product(path: AnyPath) -> Product:
    """Open a complete product.

    Parameters
    ----------
    path : path
        Its folder.

    Returns
    -------
    Product
        With `cube`, `truth`, `plan`, `report` and `wcs(frame)`.

    Raises
    ------
    BadInput
        Where the path holds no product.
    Incomplete
        Where it holds an unfinished one.
    """
    from pipeline.opened_product import open_product

    return open_product(path)


def open_catalogue(path: AnyPath) -> StarCatalogue:
    """Open a star catalogue; no star is read yet.

    Parameters
    ----------
    path : path
        A folder, or a URL (`s3://`, `http://`).

    Returns
    -------
    StarCatalogue
        With `cone` and `facts`.

    Raises
    ------
    BadInput
        Where there is none of this format, or it cannot be reached.
    Damaged
        Where it fails its checksums.
    """
    from catalog_tools.query.star_catalogue import open_star_catalogue

    return open_star_catalogue(path)
