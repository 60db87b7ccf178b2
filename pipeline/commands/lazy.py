"""A group of commands that imports the module of a command only where that command is called."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

Table = Mapping[str, tuple[str, str]]
"""Of each command's name: `module:attribute` below this package, and its caption, which is the
first paragraph of its help; it stands here so that the help of its group need not import it.
The attribute is a function with the options of a command, or a group."""


class Loaded(Mapping[str, Any]):
    """The commands of a table, each imported where it is asked for."""

    def __init__(self, table: Table) -> None:
        self.table = table

    def __getitem__(self, name: str) -> Any:
        module, _, attribute = self.table[name][0].partition(":")
        made = getattr(import_module(f"{__package__}.{module}"), attribute)
        command = get_command(made) if isinstance(made, typer.Typer) else _alone(name, made)
        command.name = name
        return command

    def __iter__(self) -> Iterator[str]:
        return iter(self.table)

    def __len__(self) -> int:
        return len(self.table)


class LazyGroup(TyperGroup):
    """A group whose help shows the captions of its table and imports no command."""

    table: ClassVar[Table] = {}

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.commands = Loaded(self.table)  # type: ignore[assignment]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """The help of the group, with captions in place of commands."""
        TyperGroup.format_help(self._captioned(), ctx, formatter)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Names of commands, with captions, that begin so."""
        ctx.command = self._captioned()
        return TyperGroup.shell_complete(ctx.command, ctx, incomplete)

    def _captioned(self) -> TyperGroup:
        """This group with captions in place of commands."""
        shown = copy.copy(self)
        shown.commands = {
            name: TyperCommand(name, help=caption) for name, (_, caption) in self.table.items()
        }
        return shown


def lazy_group(table: Table, completion: bool = False, **given: Any) -> typer.Typer:
    """A group of the commands of a table.

    completion : with the options that set up a shell's completion, once for a command line
    """
    kind = type("Group", (LazyGroup,), {"table": table})
    group = typer.Typer(
        cls=kind,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        add_completion=completion,
        **given,
    )
    group.callback()(lambda: None)
    return group


def _alone(name: str, made: Callable[..., Any]) -> Any:
    """A function with options as the library's command."""
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    alone.command(name)(made)
    return get_command(alone)
