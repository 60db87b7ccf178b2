"""From a point's values to its scene: the base with the values set, its seed and noise floor."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from catalog_tools.catalogue import open_catalogue
from catalog_tools.documents import JsonObject
from catalog_tools.storage.durable import file_digest
from pipeline.errors import BadInput
from pipeline.inputs.sensor.images import read_image
from pipeline.spec.dotted import NoFieldError, set_dotted
from pipeline.spec.load import InvalidScene, parse_scene, path_holders, place_paths
from pipeline.spec.scene import Scene
from pipeline.spec.sweep import Sweep
from pipeline.store.product import CATALOGUES, named_files
from pipeline.sweep.dependence import AFTER_LIGHT, FLAT, FLOOR, SKY_FLOOR
from pipeline.sweep.design import Design
from pipeline.sweep.stages import Base, Stages, is_plain, without_noise
from pipeline.user_data import user_data_files

WHOLE = TypeAdapter(int)  # as a scene takes its seed: 7, 7.0 and "7"


@dataclass(frozen=True)
class Course:
    """A sweep ready to run: what every task needs, small enough to send to each worker.

    data : the base scene as plain data with absolute paths; base_folder : relative paths in the
    axes' values are from there; floors : field -> the quietest of its values (numbers)
    """

    sweep: Sweep
    data: JsonObject
    base_folder: str
    floors: dict[str, float]
    run: str
    out: str

    @property
    def design(self) -> Design:
        return Design(self.sweep)


def floors_of(sweep: Sweep, folder: str) -> dict[str, float]:
    """Of each field that the noise floor falls with and that an axis varies, its quietest value."""
    design, out = Design(sweep), {}
    for name in (*FLOOR, *SKY_FLOOR):
        numbers = [_number(v, name, folder) for v in design.extremes(name)]
        found = [n for n in numbers if n is not None]
        if len(set(found)) > 1:
            out[name] = max(found) if name.endswith("mag_arcsec2") else min(found)
    flats = {_flat(value, folder) for value in design.extremes(FLAT)}
    return out | ({FLAT: max(flats)} if len(flats) > 1 else {})


def _flat(value: object, folder: str) -> float:
    """A flat as errors of the light grow with it; 1 of one that fails its own points alone."""
    try:
        return max(1.0, _number(value, FLAT, folder) or 1.0)
    except BadInput:
        return 1.0


def _number(value: object, name: str, folder: str) -> float | None:
    """A value as a number, of an image its median; None where it is neither."""
    if isinstance(value, bool) or value is None:
        return None
    if isinstance(value, str):
        return float(np.median(read_image((Path(folder) / value).resolve(), name)))
    return float(value) if isinstance(value, int | float) else None


def scene_of(course: Course, design: Design, point: int) -> Scene:
    """A point's scene, without its noise floor. BadInput where its values are not a scene."""
    data = copy.deepcopy(course.data)
    for name, value in design.values(point).items():
        set_field(data, name, value)
    data["seed"] = later_seed(data.get("seed", 0), design.seed_step(point))
    data["name"] = f"{str(data.get('name', 'scene'))[:110]}-{point:07d}"
    return parse_scene(data, base=Path(course.base_folder))


def later_seed(seed: object, step: int) -> object:
    """A seed of plain data so many steps on; what is none stays, to be refused."""
    try:
        return seed if isinstance(seed, bool) else WHOLE.validate_python(seed) + step
    except ValidationError:
        return seed


def files_of(course: Course) -> list[list[str]]:
    """Field, name and SHA-256 of the content of all files that the points name, each read once;
    of catalogues that axes name their own digests (the base scene's is elsewhere in the identity).

    Tables of the user's data folder count, too. Raises BadInput for a catalogue that is there but
    cannot be used now, Damaged for a damaged one.
    """
    named = dict.fromkeys((*named_files(course.data, CATALOGUES), *user_data_files()))
    catalogues: dict[tuple[str, str], None] = {}
    for name, value in _words(course):
        data = copy.deepcopy(course.data)
        set_field(data, name, value)
        place_paths(data, Path(course.base_folder))
        named |= dict.fromkeys(named_files(data, CATALOGUES))
        if any(concerns(name, field) for field in CATALOGUES):
            catalogues |= dict.fromkeys(_catalogues_in(data))
    known = {file: file_digest(file) for file in {file for _, file in named}}
    found = {(field, f.name, known[f]) for field, f in named}
    for field, path in catalogues:
        found.add((field, path.rpartition("/")[2], open_catalogue(path, field=field).digest))
    return [list(one) for one in sorted(found)]


def names_of_axes(course: Course) -> Iterator[str]:
    """Names of the targets that values of axes bring with them."""
    for field, value in _words(course):
        if field.split(".")[0] == "targets":
            data = copy.deepcopy(course.data)
            set_field(data, field, value)
            yield from (str(target["name"]) for target in data["targets"] if "name" in target)


def _catalogues_in(data: JsonObject) -> Iterator[tuple[str, str]]:
    """Field and path of the catalogues that plain data names, but for folders that are not there:
    as with files, points that need one fail."""
    for field, holder, key in path_holders(data):
        paths = holder.get(key) if field in CATALOGUES else None
        for path in paths if isinstance(paths, list) else [paths]:
            if isinstance(path, str) and ("://" in path or Path(path).exists()):
                yield field, path


def _words(course: Course) -> Iterator[tuple[str, object]]:
    """Fields of the axes with each of their values that may name a file."""
    design = course.design
    for name in chain.from_iterable(axis.fields for axis in course.sweep.axes):
        words = [v for v in design.extremes(name) if isinstance(v, str | dict | list)]
        yield from ((name, v) for v in {json.dumps(v, sort_keys=True): v for v in words}.values())


def set_field(data: JsonObject, name: str, value: object) -> None:
    """Set a dotted field of plain data: `sensor.read_noise_e`, `targets.0.body.albedo`."""
    try:
        set_dotted(data, name, copy.deepcopy(value))  # what becomes of it here is not the axis's
    except NoFieldError as missing:
        allowed = f"a field of the scene; there is no {missing.args[0]}"
        raise BadInput(name, value, allowed) from None


def with_floor(course: Course, kept: Stages, scene: Scene) -> tuple[Scene, Base]:
    """A point's scene as it is rendered, and the base that it shares with others.

    Where axes vary what the noise floor comes from, all points are planned for the quietest values
    of those axes, and the largest flat: then the same light is drawn with the same accuracy for all
    of them.
    """
    numbers = {
        name: course.floors.get(f"sensor.{name}", _typical(kept, scene, name))
        for name in ("read_noise_e", "gain_e_per_dn", "dark_e_per_s")
    }
    if is_plain(scene):
        numbers["flat"] = course.floors.get(FLAT, max(1.0, _typical(kept, scene, "flat")))
    scale = course.floors.get("sensor.dark_scale", scene.sensor.dark_scale)
    numbers["dark_e_per_s"] *= scale
    if course.floors and scene.accuracy.noise_floor_e is None:
        facts = kept.base(without_noise(_quietest(course, scene), numbers)).plan.facts
        accuracy = scene.accuracy.model_copy(update={"noise_floor_e": facts.light_floor_e})
        scene = scene.model_copy(update={"accuracy": accuracy})
    return scene, kept.base(without_noise(scene, numbers))


def _quietest(course: Course, scene: Scene) -> Scene:
    """The scene under the darkest sky of the axes; with a detector that shares nothing, its too."""
    if scene.background is not None:
        darkest = {
            name: course.floors.get(f"background.{name}", getattr(scene.background, name))
            for name in ("uniform_e_per_s", "uniform_mag_arcsec2")
            if getattr(scene.background, name) is not None
        }
        sky = scene.background.model_copy(update=darkest)
        scene = scene.model_copy(update={"background": sky})
    if not is_plain(scene):
        least = {k.partition(".")[2]: v for k, v in course.floors.items() if k in FLOOR}
        sensor = scene.sensor.model_copy(update=least)
        scene = scene.model_copy(update={"sensor": sensor})
    return scene


def _typical(kept: Stages, scene: Scene, name: str) -> float:
    """A term of the detector as a number: of an image its median."""
    value = getattr(scene.sensor, name)
    if not isinstance(value, str):
        return float(value)

    def read() -> float:
        return float(np.median(read_image(Path(value), f"sensor.{name}")))

    return float(kept.get("typical", (name, value), read, lambda _: 100, small=True))


def light_group(design: Design, point: int) -> tuple[tuple[str, object], ...]:
    """The values of a point that its light may depend on: points of one group come together."""
    values = design.values(point)
    return tuple((k, repr(v)) for k, v in values.items() if k not in AFTER_LIGHT)


def check_axes(design: Design, base: JsonObject, parse: Callable[[JsonObject], object]) -> None:
    """Refuse axes whose values are not taken, by the names of the axis and of the field.

    base : plain data in which the axes set fields; parse : raises InvalidScene for what is wrong
    Values are tried one by one beside the first point's: of a list each (the first thousand), of a
    range both ends. Combinations are not tried.
    """
    first = design.values(0)
    for i, axis in enumerate(design.axes):
        for name in axis.fields:
            for k, value in enumerate(design.extremes(name)[:1000]):
                data = copy.deepcopy(base)
                for other, theirs in {**first, name: value}.items():
                    set_field(data, other, theirs)
                try:
                    parse(data)
                except InvalidScene as mistakes:
                    mine = [m for m in mistakes.mistakes if concerns(m[0], name)]
                    field, given, allowed = (mine or mistakes.mistakes)[0]
                    if field in _own_mistakes(base, parse):
                        raise
                    told = allowed.removeprefix("allowed: ")
                    raise BadInput(f"axes.{i} ({field}), value {k}", given, told) from None


def _own_mistakes(base: JsonObject, parse: Callable[[JsonObject], object]) -> set[str]:
    """The fields that are wrong in the base itself."""
    try:
        parse(copy.deepcopy(base))
    except InvalidScene as mistakes:
        return {field for field, *_ in mistakes.mistakes}
    return set()


def concerns(field: str, name: str) -> bool:
    """Whether one of two dotted fields is, holds or lies in the other."""
    return field.startswith(name) or name.startswith(field)
