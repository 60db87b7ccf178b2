"""What a scene that comes over REST may ask for: registered names only, and bounded size."""

from __future__ import annotations

import logging
from collections.abc import Callable

from catalog_tools.documents import JsonObject
from pipeline.errors import NightglassError
from pipeline.plan.cost import least_cpu_s
from pipeline.plan.timing import frame_count
from pipeline.spec.load import parse_scene, path_holders
from pipeline.spec.scene import Scene
from service.problems import Mistake, NotAllowed
from service.scenes.catalogues import catalogue_mistakes
from service.settings import Settings
from service.store.named_files import ID, NO_FILES, NO_SUCH, PREFIX

log = logging.getLogger("nightglass.service")
CATALOGUE_FIELD = "stars.catalogue"
HasFile = Callable[[str], bool]
Named = tuple[tuple[str, str | list[str]], ...]  # (dotted field, what it names)


def accept_scene(
    data: object, settings: Settings, has_file: HasFile | None = None, drawn: bool = True
) -> Scene:
    """The scene of a request body, fit to be run here; `has_file` knows the caller's uploads.

    drawn : whether its sky must be one that can be drawn

    Raises BadInput or InvalidScene (pipeline.spec) for a scene that is wrong anywhere, NotAllowed
    for one that only this service refuses. `stars.catalogue` stays the registered name: the
    engine runs inside the folder of catalogues, so that no path of the server enters a product.
    """
    scene = judge_scene(data, settings, drawn)
    check_named(named_in(scene.as_dict()), settings, has_file)
    return scene


def judge_scene(data: object, settings: Settings, drawn: bool = True) -> Scene:
    """The scene of a body, judged by itself alone: its form, its size, and where it names no
    file its times and its sky. Nothing that it names is read."""
    targets = data.get("targets") if isinstance(data, dict) else None
    if isinstance(targets, list) and len(targets) > settings.targets:
        _refuse([("targets", len(targets), f"at most {settings.targets} targets")])
    scene = parse_scene(data)
    _refuse(_size_mistakes(scene, settings))
    if drawn and all(name == CATALOGUE_FIELD for name, _ in named_in(scene.as_dict())):
        _judge_sky(scene)
    return scene


def _judge_sky(scene: Scene) -> None:
    """BadInput as planning would refuse the scene. What cannot be judged is left to the engine."""
    from pipeline.route.judge import judge

    try:
        judge(scene)
    except NightglassError:
        raise
    except Exception:
        log.exception("a scene could not be judged; it is taken")


def named_in(scene: JsonObject) -> Named:
    """Every field that names something outside of the scene, looked for after parsing, so that no
    spelling escapes."""
    found = []
    for name, holder, key in path_holders(scene):
        value = holder.get(key)
        if value is not None and (name == CATALOGUE_FIELD or isinstance(value, str | list)):
            found.append((name, value))
    return tuple(found)


def check_named(named: Named, settings: Settings, has_file: HasFile | None) -> None:
    """NotAllowed where something is named that is no registered catalogue or upload."""
    mistakes: list[Mistake] = []
    for name, value in named:
        if name == CATALOGUE_FIELD:
            mistakes += catalogue_mistakes(name, value, settings.catalogues)
        elif allowed := _wrong_file(value, has_file):
            mistakes.append((name, value, allowed))
    _refuse(mistakes)


def pixel_frames_of(scene: Scene) -> int:
    """Frames x pixels that a scene asks for."""
    rows, columns = scene.sensor.shape
    return rows * columns * frame_count(scene)


def _refuse(mistakes: list[Mistake]) -> None:
    if mistakes:
        field, _, allowed = mistakes[0]
        raise NotAllowed(f"{field}: allowed: {allowed}", tuple(mistakes))


def _wrong_file(value: str | list[str], has_file: HasFile | None) -> str | None:
    """What is allowed in place of something that is no upload of the caller's team."""
    if not isinstance(value, str) or not value.startswith(PREFIX):
        return NO_FILES
    file_id = value.removeprefix(PREFIX)
    if ID.fullmatch(file_id) is None:
        return NO_FILES
    return None if has_file is not None and has_file(file_id) else NO_SUCH


def product_bytes_of(scene: Scene) -> int:
    """Bytes of a scene's product before compression: the most that it takes on disk. `dn` is
    stored whether it is asked for or not."""
    dn = next(n for n in (1, 2, 4, 8) if 8 * n >= scene.sensor.adc_bits)
    return pixel_frames_of(scene) * (dn + 4 * sum(n != "dn" for n in scene.output.layers))


def _size_mistakes(scene: Scene, settings: Settings) -> list[Mistake]:
    asked, forecast = pixel_frames_of(scene), product_bytes_of(scene)
    if asked > settings.pixel_frames:
        allowed = f"frames x pixels of at most {settings.pixel_frames} (asked: {asked})"
        field = "exposure.frames" if scene.dwells is None else "dwells"
        return [(field, frame_count(scene), allowed)]
    if forecast > settings.product_bytes:
        allowed = f"layers of at most {settings.product_bytes} bytes in all (asked: {forecast})"
        return [("output.layers", list(scene.output.layers), allowed)]
    if (least := least_cpu_s(scene)) > settings.job_cpu_s:
        allowed = f"a scene of at most {settings.job_cpu_s:g} CPU s (forecast: {least:.0f})"
        field = "exposure.frames" if scene.dwells is None else "dwells"
        return [(field, frame_count(scene), allowed)]
    return []
