"""YAML 1.2 text of scenes: read as plain data, and written."""

from __future__ import annotations

from io import StringIO

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.constructor import SafeConstructor
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, ScalarEvent

from catalog_tools.documents import JsonObject, JsonValue
from pipeline.errors import BadInput


def read_yaml(text: str, name: str, most_depth: int) -> JsonValue:
    """Plain data; BadInput names the place of a mistake, an alias, or nesting that is too deep."""
    try:
        return _reader(name, most_depth).load(text)
    except (YAMLError, RecursionError, ValueError, LookupError, TypeError, AttributeError) as error:
        where = getattr(error, "problem_mark", None)
        place = f"line {where.line + 1}, column {where.column + 1}" if where else "the text"
        problem = getattr(error, "problem", None) or next(iter(str(error).splitlines()), "")
        raise BadInput(name, place, f"YAML or JSON; {problem}") from None


def write_yaml(data: JsonObject) -> str:
    """Plain data as YAML text, keys in their order."""
    out = StringIO()
    writer = YAML(typ="safe", pure=True)
    writer.default_flow_style = False
    writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    writer.dump(data, out)
    return out.getvalue()


def _reader(name: str, most_depth: int) -> YAML:
    """A YAML 1.2 loader of plain data that refuses aliases and deep nesting as it reads."""

    class BoundedComposer(Composer):
        """Composes nodes down to the depth that is allowed, and none twice."""

        nested = 0

        def compose_node(self, parent: object, index: object) -> object:
            if self.parser.check_event(AliasEvent):
                raise BadInput(name, f"*{self.parser.peek_event().anchor}", "no aliases")
            holds = not self.parser.check_event(ScalarEvent)
            self.nested += holds
            if self.nested > most_depth:
                raise BadInput(name, "nested too deeply", f"at most {most_depth} levels")
            try:
                return super().compose_node(parent, index)
            finally:
                self.nested -= holds

    class Plain(SafeConstructor):
        """Timestamps stay text: the epoch is parsed by the product's own clock."""

    Plain.add_constructor("tag:yaml.org,2002:timestamp", SafeConstructor.construct_yaml_str)
    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 2)
    reader.Composer, reader.Constructor = BoundedComposer, Plain
    return reader
