"""`nightglass keys create|revoke|list`: who may use the service."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated

import sqlalchemy as sa
import typer

from pipeline.commands.options import Json, print_json
from pipeline.errors import BadInput
from service.accounts.keys import create_key, list_keys, revoke_key, usable
from service.settings import read_settings
from service.store.database import connect

app = typer.Typer(
    name="nightglass keys",
    help="API keys of the service: create, revoke, list.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
Home = Annotated[Path | None, typer.Option(help="data folder of the service")]


def _engine(home: Path | None, new: bool = False) -> tuple[sa.Engine, Path]:
    """The job table and the data folder; BadInput where it is not there, and not to be made."""
    settings = read_settings(home)
    if not new and not settings.home.is_dir():
        raise BadInput("--home", str(settings.home), "the data folder of a service")
    settings.make_folders()
    return connect(settings.database_url), settings.home


@app.command()
def create(
    team: Annotated[str, typer.Option(help="whose jobs the key shows and makes")],
    name: Annotated[str, typer.Option(help="a note: who holds it, what for")] = "",
    days: Annotated[float | None, typer.Option(help="days until it expires")] = None,
    home: Home = None,
) -> None:
    """Make a key and print it: the only time that it is shown."""
    engine, folder = _engine(home, new=True)
    print(create_key(engine, team, name, days))
    print(f"for {folder}; keep it: only its hash is stored.", file=sys.stderr)
    print("From now on every request to that service needs a key.", file=sys.stderr)


@app.command()
def revoke(
    key: Annotated[str, typer.Argument(metavar="KEY", help="id of a key, or the key itself")],
    home: Home = None,
) -> None:
    """Make a key worthless; a running service knows within two seconds."""
    revoke_key(_engine(home)[0], key)
    print("revoked; a running service refuses it within two seconds", file=sys.stderr)


@app.command("list")
def listing(home: Home = None, as_json: Json = False) -> None:
    """Every key ever made, without its secret."""
    rows = list_keys(_engine(home)[0])
    if as_json:
        print_json(rows)
        return
    for row in rows:
        made, ends = (_date(row[name]) for name in ("created_s", "expires_s"))
        ended = "revoked" if row["revoked_s"] else "expired"
        state = "usable" if usable(SimpleNamespace(**row)) else ended
        until = f"to {ends}" if ends else "on"
        print(f"{row['id']}  {state:8} {made} {until:13}  {row['team']}  {row['name']}")


def _date(s: float | None) -> str:
    """The date of seconds since 1970, in UTC; nothing for None."""
    return "" if s is None else str(datetime.fromtimestamp(s, UTC).date())
